"""Continuous positions from readings that wrap, and refusal of readings that jump."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Vector
from tarc.core.validation import Numbers


@dataclass(frozen=True, eq=False)
class ReadingCheck:
    """Unwrap each reading by the nearest turn to the last valid one, and drop a reading that jumps.

        y = r + span ⌊(y_last − r) / span + 1/2⌋,    NaN where |y − y_last| > max_step

    Parameters
    ----------
    span
        Travel after which a reading repeats [rad or m], one number or one per joint; None or infinity for none.
    max_step
        Largest distance from the last valid reading [rad or m], one number or one per joint; None or infinity for any.

    Raises
    ------
    InvalidParameter
        For numbers that are not above 0, and for a ``max_step`` that a span makes without effect.
    """

    span: Numbers | None = None
    max_step: Numbers | None = None

    def __post_init__(self) -> None:
        sizes = {name: len(row) for name, row in (("span", self._spans), ("max_step", self._steps)) if row.size > 1}
        if len(set(sizes.values())) > 1:
            raise InvalidParameter(
                f"span, max_step: got {sizes['span']} and {sizes['max_step']} numbers; give one number, or one per "
                "joint each"
            )
        is_idle = np.isfinite(self._spans) & np.isfinite(self._steps) & (self._steps >= self._spans / 2)
        if np.any(is_idle):
            raise InvalidParameter(
                f"max_step: got {self.max_step!r} with a span of {self.span!r}; needs less than half the span, since "
                "no unwrapped reading is farther away",
                "max_step",
            )

    @cached_property
    def _spans(self) -> np.ndarray:
        return positive_or_infinite("span", self.span)

    @cached_property
    def _steps(self) -> np.ndarray:
        return positive_or_infinite("max_step", self.max_step)

    @property
    def is_needed(self) -> bool:
        """Return whether any joint wraps or has a largest step."""
        return bool(np.any(np.isfinite(self._spans)) or np.any(np.isfinite(self._steps)))

    def check_joints(self, n_joints: int, label: str = "") -> None:
        """Refuse one number per joint for another number of joints."""
        for name, row in (("span", self._spans), ("max_step", self._steps)):
            if row.size not in (1, n_joints):
                raise InvalidParameter(
                    f"{label}{name}: got {row.size} numbers; needs one number or {n_joints} of them, one per joint",
                    name,
                )

    def unwrap(self, last: Vector, reading: Vector) -> Vector:
        """Return the reading (n,) in the turn that is nearest to the last valid one (n,)."""
        spans = np.broadcast_to(self._spans, (last.shape[0],))
        turns = ops.floor((last - reading) / np.where(np.isfinite(spans), spans, ops.HUGE) + 0.5)
        return reading + np.where(np.isfinite(spans), spans, 0.0) * turns

    def step(self, last: Vector, reading: Vector) -> tuple[Vector, Vector]:
        """Return the last valid reading from now on, and the unwrapped reading, NaN where it jumps; each (n,)."""
        unwrapped = self.unwrap(last, reading)
        limits = np.minimum(np.broadcast_to(self._steps, (last.shape[0],)), ops.HUGE)
        is_valid = ops.abs(unwrapped - last) <= limits
        return ops.where(is_valid, unwrapped, last), ops.where(is_valid, unwrapped, np.nan)


def positive_or_infinite(name: str, value: Numbers | None) -> np.ndarray:
    """Return numbers above 0, one or one per joint, infinite for None."""
    result = check.float_array(name, np.inf if value is None else value)
    if result.ndim > 1 or result.size == 0 or not np.all(result > 0):
        raise InvalidParameter(
            f"{name}: got {value!r}; needs one number above 0 [rad or m], or one per joint; None or infinity for none",
            name,
        )
    return np.atleast_1d(result)
