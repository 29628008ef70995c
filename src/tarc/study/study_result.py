"""Results of a study, read from its folder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np
import xarray as xr

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.simulation.quantities import MEASURES
from tarc.simulation.run import Run
from tarc.study.report import write_report
from tarc.study.store import RESULTS, TRACES, read_store
from tarc.study.summary import StudySummary, summarise


@dataclass(frozen=True, eq=False)
class StudyResult:
    """Results of the finished runs of a study.

    Attributes
    ----------
    folder
        Folder of the study.
    n_runs
        Number of runs of the study.
    data
        ``xarray.Dataset`` over run and law, of the finished runs alone; it is read when its values are needed. It has
        every measure of `Run.metrics`, ``completed``, ``end_time`` [s], ``seed``, and of each drawn key ``drawn:KEY``
        and ``applied:KEY``.
    """

    folder: Path
    n_runs: int
    data: xr.Dataset

    @classmethod
    def open(cls, folder: str | Path) -> Self:
        """Open the folder of a study, finished or not.

        Raises
        ------
        InvalidParameter
            For a folder that has no study in it.
        """
        place = Path(folder)
        store = read_store(place)
        data = xr.open_zarr(place / RESULTS, chunks=None, consolidated=False)
        rows = np.flatnonzero(store.is_finished())
        if len(rows) < store.runs:
            data = data.isel(run=rows)
        return cls(place, store.runs, data[sorted(map(str, data.data_vars), key=_place)])

    @property
    def is_complete(self) -> bool:
        """Whether all runs are finished."""
        return self.data.sizes["run"] == self.n_runs

    @property
    def laws(self) -> list[str]:
        """Names of the laws."""
        return [str(name) for name in self.data["law"].values]

    @property
    def measures(self) -> list[str]:
        """Names of the measures."""
        own = ("completed", "end_time", "seed")
        return [str(name) for name in self.data.data_vars if name not in own and ":" not in str(name)]

    @property
    def keys(self) -> list[str]:
        """Drawn keys of the scenario."""
        names = map(str, self.data.data_vars)
        return [name.removeprefix("drawn:") for name in names if name.startswith("drawn:")]

    @cached_property
    def success_rate(self) -> dict[str, float]:
        """Share of the runs of each law that came to their end, by law."""
        shares = (
            self.data["completed"].values.mean(axis=0) if self.data.sizes["run"] else np.full(len(self.laws), np.nan)
        )
        return dict(zip(self.laws, map(float, shares), strict=True))

    def quantiles(self, measure: str, probabilities: Array | list[float]) -> dict[str, Array]:
        """Return quantiles of a measure over the runs of each law, by law; NaN for a law without the measure.

        The measure of a run that diverged counts as infinite, as in `quantile_interval`.

        Raises
        ------
        InvalidParameter
            For an unknown measure.
        """
        check.one_of("measure", measure, self.measures)
        values, completed = self.data[measure].values, self.data["completed"].values
        result = {}
        for column, law in enumerate(self.laws):
            numbers = values[:, column]
            is_measured = completed[:, column] & np.isfinite(numbers)
            if (np.any(completed[:, column]) and not np.any(is_measured)) or not len(numbers):
                result[law] = np.full(len(probabilities), np.nan)
            else:
                result[law] = np.quantile(np.where(is_measured, numbers, np.inf), probabilities, method="inverted_cdf")
        return result

    def summary(self, reference: str | None = None, limits: Mapping[str, float] | None = None) -> StudySummary:
        """Compute rates, quantiles, comparisons of laws and sensitivities, with their intervals.

        Parameters
        ----------
        reference
            Name of the law that the others are compared with; the first without a name.
        limits
            Largest allowed value by measure [SI units]: a run that exceeds one is no success.

        Raises
        ------
        InvalidParameter
            For an unknown law or measure, and for a study without finished runs.
        """
        return summarise(self.data, reference=reference, limits=limits)

    def report(
        self,
        path: str | Path | None = None,
        *,
        reference: str | None = None,
        limits: Mapping[str, float] | None = None,
        more: Sequence[str] = (),
    ) -> Path:
        """Write the report of the study as one HTML file, as `write_report`.

        Parameters
        ----------
        path
            File to write; None for ``report.html`` in the folder of the study.
        reference, limits, more
            As in `write_report`.

        Raises
        ------
        InvalidParameter
            For a file that cannot be written, an unknown law or measure, and a study without finished runs.
        """
        target = self.folder / "report.html" if path is None else Path(path)
        return write_report(self.data, target, reference=reference, limits=limits, more=more)

    @property
    def traced(self) -> list[Path]:
        """Files of the runs of which the trajectories are kept."""
        return sorted((self.folder / TRACES).glob("*.nc"))

    def trace(self, run: int, law: str = "") -> Run:
        """Read the trajectories of a run.

        Parameters
        ----------
        run
            Its number.
        law
            Name of the law; the first without one.

        Raises
        ------
        InvalidParameter
            For a run whose trajectories are not kept, and an unknown law.
        """
        number = self.laws.index(check.one_of("law", law or self.laws[0], self.laws))
        path = self.folder / TRACES / f"{run}-{number}.nc"
        if not path.is_file():
            raise InvalidParameter(
                f"run: no trajectories of run {run} in {path.parent}; name it in the key traces and run it again",
                "run",
            )
        return Run.load(path)


def _place(name: str) -> tuple[int, str]:
    """Return the place of a variable: measures, how the runs ended, seeds, then keys."""
    order = [*MEASURES, "completed", "end_time", "seed"]
    return (order.index(name), "") if name in order else (len(order), name)
