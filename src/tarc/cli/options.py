"""Options that several commands share, and what they are converted to."""

import re
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Annotated

import typer

from tarc.core.errors import InvalidParameter

ScenarioName = Annotated[str, typer.Argument(help="A YAML file, or the name of a shipped scenario.")]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change a key of the scenario, such as law.natural_frequency=15. May be repeated.",
    ),
]
LawKind = Annotated[
    str,
    typer.Option(
        "--law",
        metavar="FILE.py:CLASS",
        help="A law from your own file, or one of tarc.laws, in place of the scenario's. It keeps the parameters of "
        "the scenario's first law that it has too; give others by --set law.KEY=VALUE.",
    ),
]
Out = Annotated[
    Path | None,
    typer.Option("--out", "-o", help="Folder for the results. Default: one in runs/ that is named after the scenario."),
]
Tube = Annotated[float, typer.Option(help="Largest distance of each joint from its reference \\[rad or m].")]
FullRange = Annotated[
    bool,
    typer.Option("--full-range", help="Certify for all that the joints reach, instead of the tube."),
]
Speed = Annotated[
    str,
    typer.Option(
        metavar="NUMBERS",
        help="Largest joint speed \\[rad/s or m/s], one number or one per joint; inf for any. Default: 1.2 times those "
        "of the reference, with its accelerations; with --full-range any speed.",
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print the results as JSON instead of a table.")]
Figures = Annotated[bool, typer.Option("--figures/--no-figures", help="Draw figures.")]
Animate = Annotated[
    Path | None,
    typer.Option(
        "--animate",
        metavar="FILE",
        help="Write the robots in 3D, with the reference as a ghost, in one file of HTML that any browser opens. "
        "Needs the extra view.",
    ),
]
View = Annotated[
    bool,
    typer.Option(
        "--view", help="Play each run in MuJoCo's viewer; closing its window shows the next. Needs a display."
    ),
]
Jobs = Annotated[int | None, typer.Option(help="Number of processes. Default: one per core.")]


def names_of(text: str) -> list[str]:
    """Return the names in a text with commas between them."""
    return [name.strip() for name in text.split(",") if name.strip()]


def numbers_of(name: str, text: str) -> float | list[float] | None:
    """Return one number, or several with commas between; None for an empty text.

    Raises
    ------
    InvalidParameter
        For text that is no number.
    """
    try:
        numbers = [float(part) for part in text.split(",")] if text.strip() else []
    except ValueError:
        raise InvalidParameter(
            f"{name}: got {text!r}; needs one number, or one per joint with commas between"
        ) from None
    if len(numbers) > 1:
        return numbers
    return numbers[0] if numbers else None


def names_or_positions(name: str, text: str) -> list[str] | dict[str, float] | None:
    """Return names, or positions by name from ``a=0.3,b=0``; None for an empty text.

    Raises
    ------
    InvalidParameter
        For a position that is no number, and where only some names have one.
    """
    pairs = [part.partition("=") for part in names_of(text)]
    if not any(equals for _, equals, _ in pairs):
        return [name for name, _, _ in pairs] or None
    try:
        return {joint.strip(): float(position) for joint, _, position in pairs}
    except ValueError:
        raise InvalidParameter(
            f"{name}: got {text!r}; needs names with commas between, or a position for each: a=0.3,b=0"
        ) from None


def posture_of(name: str, text: str) -> float | list[float] | dict[str, float] | None:
    """Return positions in order, or by name from ``a=0.3,b=0``; None for an empty text.

    Raises
    ------
    InvalidParameter
        For text that is neither.
    """
    if "=" not in text:
        return numbers_of(name, text)
    positions = names_or_positions(name, text)
    return positions if isinstance(positions, dict) else None


def file_stem(name: str) -> str:
    """Return a name as that of one file or folder."""
    return re.sub(r"[^\w.+-]+", "-", str(name)).strip(".-") or "run"


def drawing_figures() -> AbstractContextManager[object]:
    """Show on standard error that figures are drawn."""
    from rich.console import Console

    return Console(stderr=True).status("drawing figures")
