"""`tarc export fmu`: a law as a Functional Mock-up Unit."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tarc.laws.base import Law


def names_of(text: str) -> list[str] | None:
    """Return the names in a list with commas: None for no text, no name for "none"."""
    if not text:
        return None
    return [] if text == "none" else [name.strip() for name in text.split(",")]


def export_fmu_file(
    law: "Law", file: Path, as_json: bool, fmi: str, platforms: str, tunable: str, **options: Any
) -> None:
    """Write an FMU and print what is in it."""
    from rich.console import Console

    from tarc.export import export_fmu
    from tarc.export.fmu_platforms import PLATFORMS

    chosen = list(PLATFORMS) if platforms == "all" else names_of(platforms)
    written = export_fmu(law, file, fmi=fmi, platforms=chosen, tunable=names_of(tunable), **options)
    if as_json:
        content = {"file": str(written.file), "fmi": written.fmi, "libraries": list(written.libraries)}
        print(json.dumps(content | {"tunable": list(written.tunable), "fixed": written.fixed}, indent=2))
        return
    console = Console(width=None if Console().is_terminal else 100)
    lines = [
        f"{type(law).__name__} by FMI {written.fmi} in {written.file}, for co-simulation and model exchange",
        *(f"  {path}" for path in written.libraries),
        f"may change while it runs: {', '.join(written.tunable) or 'nothing'}",
        *(f"fixed: {name}, since {reason}" for name, reason in written.fixed.items()),
        f"communication step: {law.period:g} s, no other; a torque of co-simulation acts one period late",
    ]
    for line in lines:
        console.print(line, highlight=False, markup=False)
