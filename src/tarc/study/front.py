"""The Pareto front of a search: gains that no others beat in both error and torque variation."""

import csv
import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter

PICKS = ("knee", "error", "variation")


@dataclass(frozen=True)
class FrontPoint:
    """Gains on the front.

    Attributes
    ----------
    law
        The law as a scenario writes it.
    gains
        Its free gains, by key.
    rms_error
        RMS error, the geometric mean over the training scenarios [rad or m].
    torque_variation
        Torque variation, the geometric mean over the training scenarios [N m/s or N/s].
    margin
        Smallest robust margin; None where none was computed.
    least_error
        Error of the best linear controller with that torque variation, by the linear loop; None where unknown.
    """

    law: dict[str, Any]
    gains: dict[str, float]
    rms_error: float
    torque_variation: float
    margin: float | None = None
    least_error: float | None = None


@dataclass(frozen=True)
class TuningFront:
    """Result of a search with two objectives.

    Attributes
    ----------
    points
        The front, least error first.
    trials
        Number of sets of gains that were tried.
    failures
        Number of trials that ended early, by reason.
    """

    points: tuple[FrontPoint, ...]
    trials: int
    failures: dict[str, int] = field(default_factory=dict)

    @property
    def knee(self) -> FrontPoint:
        """The point with the least sum of both logarithms, each scaled to one between the ends."""
        places = np.log([[point.torque_variation, point.rms_error] for point in self.points])
        span = np.ptp(places, axis=0)
        scaled = (places - places.min(axis=0)) / np.where(span > 0, span, 1.0)
        return self.points[np.argmin(scaled.sum(axis=1))]

    def pick(self, choice: str | int = "knee") -> FrontPoint:
        """Return a point of the front.

        Parameters
        ----------
        choice
            ``knee``, ``error`` for the least error, ``variation`` for the least torque variation, or the number of the
            point from 1 on, least error first.

        Raises
        ------
        InvalidParameter
            For another choice, and a number beyond the front.
        """
        text = str(choice)
        if text.isdigit():
            number = int(text)
            if not 1 <= number <= len(self.points):
                raise InvalidParameter(
                    f"pick: got {number}; the front has points 1 to {len(self.points)}, least error first"
                )
            return self.points[number - 1]
        check.one_of("pick", text, PICKS)
        return {"knee": self.knee, "error": self.points[0], "variation": self.points[-1]}[text]


def is_on_front(errors: np.ndarray, variations: np.ndarray) -> np.ndarray:
    """Return which points no other beats in both values, shape (k,); of equal points the first."""
    order = np.lexsort((variations, errors))
    least = np.minimum.accumulate(np.concatenate([[np.inf], variations[order][:-1]]))
    chosen = np.zeros(len(errors), dtype=bool)
    chosen[order] = variations[order] < least
    return chosen


def front_rows(fronts: Mapping[str, TuningFront]) -> list[dict[str, Any]]:
    """Return the points of some fronts as plain data, with law and number."""
    return [
        {
            "name": name,
            "point": number,
            "rms_error": _rounded(point.rms_error),
            "torque_variation": _rounded(point.torque_variation),
            **({} if point.margin is None else {"margin": _rounded(point.margin)}),
            **({} if point.least_error is None else {"least_error": _rounded(point.least_error)}),
            "law": point.law,
        }
        for name, front in fronts.items()
        for number, point in enumerate(front.points, 1)
    ]


def front_csv(fronts: Mapping[str, TuningFront]) -> str:
    """Return the points of some fronts as a table, one per line, in SI units, header first."""
    keys = list(dict.fromkeys(key for front in fronts.values() for point in front.points for key in point.gains))
    columns = ["name", "point", "rms_error", "torque_variation", "margin", "least_error"]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*columns, *keys])
    points: Iterable[FrontPoint] = (point for front in fronts.values() for point in front.points)
    for row, point in zip(front_rows(fronts), points, strict=True):
        writer.writerow([*(row.get(key, "") for key in columns), *(point.gains.get(key, "") for key in keys)])
    return text.getvalue()


def _rounded(value: float) -> float:
    return float(f"{value:.5g}")
