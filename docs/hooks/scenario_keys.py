"""Page of the keys of a scenario, from the schema and the docstrings."""

import inspect
from collections.abc import Collection
from typing import Any

from griffe import Docstring, DocstringSectionKind
from mkdocs.structure.files import File, Files

from tarc.plants import load_robot
from tarc.scenario.model import Scenario
from tarc.scenario.schema import SECTIONS, catalogue, parameters

PAGE = "reference/scenario-keys.md"
INTRODUCTION = """\
# Scenario keys

Every key that a [scenario](../how-to/scenarios.md) may have.
This page is written from the classes that read it.
"""
NOTES = {
    "law": "One law, or a list of laws that run side by side. Each has a "
    "`kind`, and may have a `label` and an `estimator` of its own.",
    "disturbance": "A list; each entry has a `kind`.",
    "torque_limits": "Its kind is always `TorqueLimits` and may be left out.",
    "gearbox": "Its kind is always `Gearbox` and may be left out.",
    "drive": "Its kind is always `Drive` and may be left out.",
    "sensor": "Its kind is always `Encoder` and may be left out.",
}
FILE_HEADING = "file: a robot from MJCF or URDF"


def on_files(files: Files, config: Any) -> Files:
    """Add the page to the site."""
    files.append(File.generated(config, PAGE, content=page()))
    return files


def page() -> str:
    """Return the whole page."""
    parts = [INTRODUCTION, "## Scenario", fields_table(Scenario)]
    for section in SECTIONS:
        parts += section_parts(section)
    return "\n\n".join(parts) + "\n"


def section_parts(section: str) -> list[str]:
    """Return a section's heading, the keys of all its kinds, each kind."""
    kinds = catalogue(section)
    shared = set.intersection(*(set(parameters(k)) for k in kinds.values()))
    parts = [f"## {section}"]
    if section in NOTES:
        parts.append(NOTES[section])
    if section == "robot":
        parts += [f"### {FILE_HEADING}", kind_table(load_robot)]
    if section != "law":
        shared = set()
    elif shared:
        first = next(iter(kinds.values()))
        others = set(parameters(first)) - shared
        parts += ["### Keys of every law", kind_table(first, others)]
    for name, kind in kinds.items():
        parts += [f"### {name}", summary(kind), kind_table(kind, shared)]
    return parts


def fields_table(model: Any) -> str:
    """Return the keys of a pydantic model."""
    texts = descriptions(model)
    rows = []
    for name, field in model.model_fields.items():
        default = "required" if field.is_required() else spell(field.default)
        if field.default_factory:
            default = ""
        rows.append((name, "", default, texts.get(name, "")))
    return table(rows)


def kind_table(kind: Any, left_out: Collection[str] = ()) -> str:
    """Return the keys of one kind of law, robot, estimator or signal."""
    texts = descriptions(kind)
    rows = []
    for name, parameter in parameters(kind).items():
        if name in left_out:
            continue
        default = "required" if parameter.needed else spell(parameter.default)
        source = "path" if name == "file" else name
        rows.append((name, parameter.words, default, texts.get(source, "")))
    return table(rows)


def table(rows: list[tuple[str, str, str, str]]) -> str:
    """Return rows of key, value, default and meaning as a table."""
    if not rows:
        return "No keys but `kind`."
    if not any(row[1] for row in rows):
        lines = ["| key | default | meaning |", "| --- | --- | --- |"]
        return "\n".join(
            lines + [f"| `{k}` | {d} | {text} |" for k, _, d, text in rows]
        )
    lines = ["| key | value | default | meaning |", "| --- | --- | --- | --- |"]
    return "\n".join(
        lines + [f"| `{k}` | {v} | {d} | {text} |" for k, v, d, text in rows]
    )


def summary(kind: Any) -> str:
    """Return the first line of a docstring."""
    return one_line((inspect.getdoc(kind) or "").split("\n\n")[0])


def descriptions(thing: Any) -> dict[str, str]:
    """Return what docstrings say of parameters, the nearest class first."""
    sources = thing.__mro__ if inspect.isclass(thing) else [thing]
    texts: dict[str, str] = {}
    for source in sources:
        for section in sections(source):
            for entry in section.value:
                for name in entry.name.split(", "):
                    texts.setdefault(name, one_line(entry.description))
    return texts


def sections(source: Any) -> list[Any]:
    """Return the sections of parameters and attributes of a docstring."""
    text = source.__doc__ if source is not object else None
    if not text:
        return []
    wanted = (DocstringSectionKind.parameters, DocstringSectionKind.attributes)
    parsed = Docstring(inspect.cleandoc(text)).parse("numpy", warnings=False)
    return [section for section in parsed if section.kind in wanted]


def one_line(text: str) -> str:
    """Return a text on one line, fit for the cell of a table."""
    return " ".join(text.split()).replace("|", "\\|").replace("``", "`")


def spell(value: Any) -> str:
    """Return a default as YAML has it."""
    if value is None:
        return "`null`"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, float):
        return f"`{value:g}`"
    if isinstance(value, tuple):
        return f"`[{', '.join(f'{item:g}' for item in value)}]`"
    return f"`{value}`"
