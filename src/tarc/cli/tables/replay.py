"""Tables of a replayed log."""

from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tarc.cli.tables.console import print_written
from tarc.logs.tables import replay_tables

if TYPE_CHECKING:
    from tarc.logs.replayed import Replay


def print_replay(replay: "Replay", files: list[Path]) -> None:
    """Print the results of a log, and the files that were written."""
    console = Console()
    for title, header, rows in replay_tables(replay):
        table = Table(title=escape(title), title_justify="left", show_header=any(header))
        for number, name in enumerate(header):
            table.add_column(escape(name), justify="right" if number else "left")
        for row in rows:
            table.add_row(*map(escape, row))
        console.print(table)
    if files:
        print_written(console, files)
