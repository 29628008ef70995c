"""What a backend records."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tarc.core.errors import TarcError
from tarc.core.trees import leaves, names


@dataclass(frozen=True)
class Record:
    """Recorded outputs: dotted name to array with time first."""

    arrays: dict[str, np.ndarray]

    @classmethod
    def from_rows(cls, example: Any, rows: np.ndarray) -> "Record":
        """Split rows, one an instant, by an output of the same structure."""
        arrays, start = {}, 0
        for label, leaf in zip(names(example), leaves(example), strict=True):
            name = label.split(".")[-1]
            if name in arrays:
                raise TarcError(f"signals: two are called {name!r}; a law's signals need names of their own")
            size = int(np.size(leaf))
            block = rows[:, start : start + size]
            arrays[name] = block.reshape(len(rows), *np.shape(leaf)[::-1])
            start += size
        return cls(arrays)
