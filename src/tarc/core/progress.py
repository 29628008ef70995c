"""A progress bar that appears only when the work takes over two seconds."""

import sys
import time
from typing import TYPE_CHECKING

from tarc.core.optional import is_installed

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

PATIENCE = 2.0


class Progress:
    """Counts steps of work; use as a context manager and call `advance`.

    Parameters
    ----------
    label, total
        What is done, and in how many steps.
    show
        Whether to show a bar at all; None for when standard error is a terminal. Without rich there is none.
    unit
        What the steps are, such as ``runs``, to show how many are done and the rate; empty for neither.
    """

    def __init__(self, label: str, total: int, show: bool | None = None, unit: str = ""):
        self.label, self.total, self.done, self.unit = label, total, 0, unit
        self.show = is_installed("rich") and (sys.stderr.isatty() if show is None else show)
        self._start = time.monotonic()
        self._bar: Bar | None = None

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def advance(self, steps: int = 1) -> None:
        """Count further steps as done."""
        self.done += steps
        if not self.show:
            return
        if self._bar is None and time.monotonic() - self._start > PATIENCE:
            self._bar = _bar(self.unit)
            self._bar.start()
            self._bar.add_task(self.label, total=self.total)
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], completed=self.done)


def _bar(unit: str) -> "Bar":
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        ProgressColumn,
        Task,
        TaskProgressColumn,
        TextColumn,
        TimeRemainingColumn,
    )
    from rich.progress import Progress as Bar
    from rich.text import Text

    class RateColumn(ProgressColumn):
        def render(self, task: Task) -> Text:
            return Text(f"{task.speed:.3g} {unit}/s" if task.speed else f"– {unit}/s")

    counts = [MofNCompleteColumn(), RateColumn()] if unit else [TaskProgressColumn()]
    columns = TextColumn("{task.description}"), BarColumn(), *counts, TimeRemainingColumn()
    return Bar(*columns, console=Console(stderr=True), transient=True)
