"""Engines of a study: what runs a chunk of its runs."""

from dataclasses import dataclass
from typing import Protocol

from tarc.core.types import Array


@dataclass(frozen=True, eq=False)
class ChunkResult:
    """Results of a chunk of runs, as arrays over the runs of the chunk and the laws.

    Attributes
    ----------
    measures
        Measures by name, each (runs, laws); NaN where a run ended before they begin.
    completed
        Whether each run came to its end, (runs, laws).
    end_time
        Time of divergence, or the duration [s], (runs, laws).
    applied
        Values that were read back from plant, sensor and law, by key: (runs,), or (runs, laws) for keys of laws.
    """

    measures: dict[str, Array]
    completed: Array
    end_time: Array
    applied: dict[str, Array]


class Engine(Protocol):
    """Runs chunks of a study. The results do not depend on how the runs are cut into chunks.

    Attributes
    ----------
    name
        ``virtual machine``, ``compiled``, ``lanes`` or ``MuJoCo``.
    """

    name: str

    def run(self, indices: Array, values: Array, seeds: Array) -> ChunkResult:
        """Run a chunk.

        Parameters
        ----------
        indices
            Numbers of the runs in the study, (runs,).
        values
            Drawn values, one row per run and one column per key, (runs, keys).
        seeds
            Seeds of the runs, (runs,).
        """
        ...
