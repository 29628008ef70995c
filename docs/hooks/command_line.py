"""Page of the command line, from the commands themselves."""

import re
from typing import Any

import typer
from mkdocs.structure.files import File, Files

from tarc.cli.main import app

PAGE = "reference/command-line.md"
INTRODUCTION = """\
# Command line

`tarc --help` lists the commands, `tarc COMMAND --help` describes one.
This page is written from the commands themselves.
A command that is given wrong input prints one line and exits with status 2.

"""


def on_files(files: Files, config: Any) -> Files:
    """Add the page to the site."""
    files.append(File.generated(config, PAGE, content=page()))
    return files


def page() -> str:
    """Return the whole page."""
    group: Any = typer.main.get_command(app)
    sections = [section(name, command) for name, command in commands(group)]
    options = table("option", group.params, group)
    return (
        INTRODUCTION
        + "\n\n".join(sections)
        + "\n\n## Without a command\n\n"
        + options
    )


def commands(group: Any) -> list[tuple[str, Any]]:
    """Return the commands by name, those of groups behind their group's."""
    named = []
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            named += [
                (f"{name} {below}", part) for below, part in commands(command)
            ]
        else:
            named.append((name, command))
    return named


def section(name: str, command: Any) -> str:
    """Return the part of one command: usage, text, arguments and options."""
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    options = [p for p in command.params if p.param_type_name == "option"]
    usage = " ".join(argument_name(argument) for argument in arguments)
    parts = [
        f"## tarc {name}",
        f"```text\ntarc {name} [OPTIONS] {usage}".rstrip() + "\n```",
        text(command.help),
    ]
    if arguments:
        parts.append(table("argument", arguments, command))
    panels = dict.fromkeys(option.rich_help_panel for option in options)
    for panel in sorted(panels, key=lambda heading: heading is not None):
        inside = [o for o in options if o.rich_help_panel == panel]
        if panel:
            parts.append(f"**{panel}**")
        parts.append(table("option", inside, command))
    return "\n\n".join(parts)


def argument_name(argument: Any) -> str:
    """Return an argument as the usage shows it."""
    name = argument.name.upper() + ("..." if argument.nargs == -1 else "")
    return name if argument.required else f"[{name}]"


def table(kind: str, parameters: list[Any], command: Any) -> str:
    """Return a table of parameters with their defaults."""
    rows = [f"| {kind} | default | meaning |", "| --- | --- | --- |"]
    for parameter in parameters:
        rows.append(
            f"| {spelling(parameter, command)} | {default(parameter)} "
            f"| {text(parameter.help).replace('|', chr(92) + '|')} |"
        )
    return "\n".join(rows)


def spelling(parameter: Any, command: Any) -> str:
    """Return the ways to write a parameter, with the kind of its value."""
    if parameter.param_type_name == "argument":
        return f"`{argument_name(parameter)}`"
    words = ", ".join(
        f"`{name}`" for name in [*parameter.opts, *parameter.secondary_opts]
    )
    kind = parameter.metavar or value_kind(parameter, command)
    return f"{words} `{kind}`" if kind else words


def value_kind(option: Any, command: Any) -> str:
    """Return what kind of value an option takes; empty for a flag."""
    context = command.context_class(command, info_name=command.name)
    record = option.get_help_record(context)
    kind = re.search(r"<(.*)>", record[0]) if record else None
    return kind[1].upper() if kind else ""


def default(parameter: Any) -> str:
    """Return the default in words; empty where the text has it, or none."""
    value = parameter.default
    if parameter.required:
        return "required"
    if value is None or value == "" or callable(value):
        return ""
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, tuple | list):
        return f"`{' '.join(f'{number:g}' for number in value)}`"
    return f"`{value:g}`" if isinstance(value, float) else f"`{value}`"


def text(words: str | None) -> str:
    """Return a help text as Markdown."""
    plain = re.sub(r"\[/?(?:bold|italic|dim)\]", "**", words or "")
    plain = plain.replace("\\[", "[").strip()
    return re.sub(
        r"(?m)^((?:Example|Then): )(.*)$", r"\1`\2`", plain.replace("<", "&lt;")
    )
