"""What `tarc show` prints."""

import inspect
import json
import re
import textwrap
from collections.abc import Iterator
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

import tarc.laws
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.plants.load import load_robot
from tarc.plants.robot_file import shipped_robots
from tarc.scenario.loader import find_scenario, shipped_scenarios
from tarc.scenario.schema import SECTIONS, catalogue, parameters


def _entries() -> dict[str, dict[str, Any]]:
    entries: dict[str, dict[str, Any]] = {section: dict(catalogue(section)) for section in SECTIONS}
    entries["robot"] = {"file": load_robot, **entries["robot"]}
    return entries


def _first_line(kind: object) -> str:
    return _plain(inspect.getdoc(kind) or "").split("\n\n")[0].replace("\n", " ")


def _plain(text: str) -> str:
    """Return a docstring without the backticks of its markup."""
    return text.replace("`", "")


def _paragraphs(text: str) -> Iterator[tuple[str, bool]]:
    """Yield the paragraphs of a docstring, and whether each may be wrapped; equations and examples may not."""
    joined = ""
    section = ""
    for line in text.splitlines():
        if re.fullmatch("-+", line):
            section = joined
        is_fixed = section == "Examples" or (not section and line.startswith("    "))
        starts_anew = is_fixed or not line.strip() or re.match(r"-|\s*- ", line) is not None
        if joined and not starts_anew and _indent(line) == _indent(joined):
            joined += f" {line.strip()}"
            continue
        if joined:
            yield joined, True
        joined = "" if starts_anew else line
        if starts_anew:
            yield line, not is_fixed
    if joined:
        yield joined, True


def _indent(line: str) -> str:
    return line[: len(line) - len(line.lstrip())]


def _wrap(text: str, width: int) -> str:
    """Wrap a docstring to a width, each paragraph at its own indent."""
    lines: list[str] = []
    for paragraph, may_wrap in _paragraphs(text):
        indent = _indent(paragraph)
        wrapped = textwrap.wrap(paragraph.strip(), width, initial_indent=indent, subsequent_indent=indent)
        lines += wrapped if may_wrap and wrapped else [paragraph]
    return "\n".join(lines)


def print_catalogue(as_json: bool) -> None:
    """Print all kinds of all sections, each with its parameters."""
    entries = _entries()
    if as_json:
        content = {
            section: {name: {"about": _first_line(kind), "parameters": _defaults(kind)} for name, kind in kinds.items()}
            for section, kinds in entries.items()
        }
        shipped = {"robots": [r.removesuffix(".xml") for r in shipped_robots()], "scenarios": shipped_scenarios()}
        print(json.dumps({**content, "shipped": shipped}, indent=2, default=str))
        return
    console = Console()
    for section, kinds in entries.items():
        table = Table(title=section, title_justify="left", show_header=False, title_style="bold", expand=True)
        table.add_column("kind", no_wrap=True, style="cyan")
        table.add_column("what")
        for name, kind in kinds.items():
            text = "parameters: " + (", ".join(parameters(kind)) or "none")
            table.add_row(name, f"{escape(_first_line(kind))}\n[dim]{escape(text)}[/dim]")
        console.print(table)
    robots = ", ".join(name.removesuffix(".xml") for name in shipped_robots())
    console.print(f"shipped robots: {robots}; shipped scenarios: {', '.join(shipped_scenarios())}")
    console.print("Details of one: tarc show TARC")


def _defaults(kind: Any) -> dict[str, Any]:
    return {
        name: {"allowed": parameter.words, "default": "required" if parameter.needed else parameter.default}
        for name, parameter in parameters(kind).items()
    }


def print_kind(name: str, as_json: bool) -> None:
    """Print one kind: its documentation, and its parameters with defaults."""
    kinds_by_name = {key: kind for kinds in _entries().values() for key, kind in kinds.items()}
    # their parameters are those of every law on them
    kinds_by_name |= {name: getattr(tarc.laws, name) for name in ("TDE", "PolePlacement", "Law")}
    names = {key.lower(): key for key in kinds_by_name}
    if name.lower().removesuffix(".xml") in (file.removesuffix(".xml") for file in shipped_robots()):
        print_robot(name.lower(), as_json)
        return
    if name.lower() in shipped_scenarios():
        print(find_scenario(name).read_text(encoding="utf-8"), end="")
        return
    name = names.get(name.lower(), name)
    if name not in kinds_by_name:
        raise InvalidParameter(
            f"show: nothing is called {name!r}; there are {', '.join(kinds_by_name)}."
            f"{check.did_you_mean(name, kinds_by_name)}"
        )
    kind = kinds_by_name[name]
    if as_json:
        print(
            json.dumps({"name": name, "about": _first_line(kind), "parameters": _defaults(kind)}, indent=2, default=str)
        )
        return
    console = Console()
    console.print(f"[bold]{name}[/bold]\n")
    console.print(escape(_wrap(_plain(inspect.getdoc(kind) or ""), console.width)), highlight=False)
    table = Table(title="\nparameters in a scenario", title_justify="left")
    for column in ("name", "default", "allowed"):
        table.add_column(column)
    for parameter in parameters(kind).values():
        table.add_row(parameter.name, "required" if parameter.needed else str(parameter.default), parameter.words)
    console.print(table)


def print_robot(name: str, as_json: bool) -> None:
    """Print the joints of a shipped robot: names, units and limits."""
    plant = load_robot(name)
    rows = [
        {"joint": joint, "unit": unit, "torque_limit": float(torque), "velocity_limit": float(velocity)}
        for joint, unit, torque, velocity in zip(
            plant.joint_names, plant.units, plant.torque_limits, plant.velocity_limits, strict=True
        )
    ]
    if as_json:
        print(json.dumps({"name": name, "joints": rows}, indent=2))
        return
    table = Table(title=f"robot {name}", title_justify="left")
    for column in ("joint", "unit", "torque limit [N m or N]", "velocity limit [1/s]"):
        table.add_column(column)
    for row in rows:
        limits = [row[key] for key in ("torque_limit", "velocity_limit")]
        table.add_row(row["joint"], row["unit"], *("none" if np.isinf(limit) else f"{limit:g}" for limit in limits))
    console = Console()
    console.print(table)
    console.print(f"In a scenario: robot: {{file: {name}}}; tarc show file lists its options", highlight=False)
