"""Options that several commands share, and what they are converted to."""

import re
from pathlib import Path
from typing import Annotated

import typer

from tarc.core.errors import InvalidParameter

Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Change a key of the scenario, e.g. law.natural_frequency=15. Repeatable."
    ),
]
Out = Annotated[Path | None, typer.Option("--out", "-o", help="Folder for the results; default runs/NAME.")]
Json = Annotated[bool, typer.Option("--json", help="Print the results as JSON instead of a table.")]
Figures = Annotated[bool, typer.Option("--figures/--no-figures", help="Draw figures.")]


def numbers_of(name: str, text: str) -> float | list[float] | None:
    """One number, or several with commas between; None for nothing."""
    try:
        found = [float(one) for one in text.split(",")] if text.strip() else []
    except ValueError:
        raise InvalidParameter(
            f"{name}: got {text!r}; needs one number, or one per joint with commas between"
        ) from None
    return found if len(found) > 1 else found[0] if found else None


def file_stem(name: str) -> str:
    """A name as that of one file or folder."""
    return re.sub(r"[^\w.+-]+", "-", str(name)).strip(".-") or "run"
