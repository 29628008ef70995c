"""Parts of what every command prints."""

from collections.abc import Iterable
from pathlib import Path

from rich.console import Console
from rich.markup import escape

WIDE = 110
"""Columns of a terminal from which tables show every column; the files contain all of them."""
VERDICT_COLOURS = {"certified": "green", "refuted": "red", "inconclusive": "yellow"}


def print_written(console: Console, files: Iterable[Path]) -> None:
    """Print the names of the files that were written."""
    console.print("written: " + ", ".join(escape(str(file)) for file in files), soft_wrap=True)
