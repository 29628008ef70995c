"""Raw output of a simulation."""

from dataclasses import dataclass

import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.core.trees import leaves, names
from tarc.simulation.closed_loop import LoopOutput


@dataclass(frozen=True)
class Record:
    """Recorded outputs: signal name to array, with time as the first axis."""

    arrays: dict[str, np.ndarray]

    @classmethod
    def from_rows(cls, example: LoopOutput, rows: np.ndarray) -> "Record":
        """Split rows, one per instant, by an output of the same structure.

        Raises
        ------
        InvalidParameter
            When two signals have the same name.
        """
        arrays: dict[str, np.ndarray] = {}
        start = 0
        for label, leaf in zip(names(example), leaves(example), strict=True):
            name = label.split(".")[-1]
            if name in arrays:
                raise InvalidParameter(f"signals: two are called {name!r}; a law's signals need names of their own")
            size = int(np.size(leaf))
            block = rows[:, start : start + size]
            arrays[name] = block.reshape(len(rows), *np.shape(leaf)[::-1])
            start += size
        return cls(arrays)
