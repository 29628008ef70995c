"""Rows of numbers from the loop to another process, over memory that both map."""

from pathlib import Path
from typing import Literal

import numpy as np

from tarc.core.types import Array

HEADER = 4
"""Numbers before the rows: rows written, whether the loop has ended, capacity, columns."""


class Ring:
    """The newest rows of a table, in a file of shared memory.

    The loop writes a row and then counts it. A reader counts as lost what was overwritten before it was read. The loop
    never waits.

    Attributes
    ----------
    columns
        Numbers in a row.
    """

    def __init__(self, file: Path, mode: Literal["r", "r+"] = "r+"):
        head = np.memmap(file, float, "r", shape=(HEADER,))
        self.capacity, self.columns = int(head[2]), int(head[3])
        memory = np.memmap(file, float, mode, shape=(HEADER + self.capacity * self.columns,))
        self._memory: Array = np.asarray(memory)
        self._rows = self._memory[HEADER:].reshape(self.capacity, self.columns)
        self._written = 0
        self._read = 0

    @staticmethod
    def create(file: Path, capacity: int, columns: int) -> "Ring":
        """Make the file and return its ring."""
        memory = np.memmap(file, float, "w+", shape=(HEADER + capacity * columns,))
        memory[:] = 0.0  # so that no page is missing in the loop
        memory[2:4] = capacity, columns
        del memory
        return Ring(file)

    def append(self, row: Array) -> None:
        """Write a row (columns,)."""
        self._rows[self._written % self.capacity] = row
        self._written += 1
        self._memory[0] = self._written

    def end(self) -> None:
        """Say that no row comes any more."""
        self._memory[1] = 1.0

    @property
    def is_ended(self) -> bool:
        """Return whether the loop has ended."""
        return bool(self._memory[1])

    def newest(self) -> Array | None:
        """Return the newest row, or None before the first."""
        written = int(self._memory[0])
        return self._rows[(written - 1) % self.capacity].copy() if written else None

    def read(self) -> Array:
        """Return the rows since the last call, shape (k, columns), oldest first, less those that were overwritten."""
        written = int(self._memory[0])
        first = max(self._read, written - self.capacity)
        rows = self._rows[np.arange(first, written) % self.capacity]
        overwritten = max(0, int(self._memory[0]) - self.capacity + 1 - first)
        self._read = written
        return rows[overwritten:]
