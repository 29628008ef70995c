"""Limits between the torque that a law commands and the torque that is applied."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.component import Component
from tarc.core.errors import InvalidParameter
from tarc.core.types import Vector
from tarc.core.validation import Numbers

ROUNDING = 1e-9
"""Share of a step of torque that counts as rounding where limits are counted in steps."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueLimits(Component):
    """Magnitude, rate and resolution of the torque that a robot's interface accepts.

        |τ_k| ≤ magnitude,     |τ_k − τ_{k−1}| ≤ rate T,     τ_k a multiple of the resolution

    The applied torque is the nearest allowed one to the command. The law's past torques are those that were applied, so
    that its anti-windup counts them too. Each number is one for all joints or one per joint.

    Parameters
    ----------
    magnitude
        Largest magnitude [N m or N]; None or infinity for none.
    rate
        Largest rate [N m/s or N/s], counted over one period; None or infinity for none.
    resolution
        Step of the torque [N m or N]; None or 0 for none. Magnitudes are then whole steps.

    Raises
    ------
    InvalidParameter
        For numbers that are not above zero, and where the limits are below one step.
    """

    magnitude: Numbers | None = None
    rate: Numbers | None = None
    resolution: Numbers | None = None

    def __post_init__(self) -> None:
        sizes = {}
        for name in ("magnitude", "rate", "resolution"):
            value = getattr(self, name)
            row = np.ones(()) if value is None else check.float_array(name, value)
            is_allowed = row >= 0 if name == "resolution" else row > 0
            if row.ndim > 1 or row.size == 0 or not np.all(is_allowed) or np.any(np.isnan(row)):
                least = "of at least 0" if name == "resolution" else "above 0"
                raise InvalidParameter(f"{name}: got {value!r}; needs one number {least}, or one per joint", name)
            if row.size > 1:
                sizes[name] = row.size
        if len(set(sizes.values())) > 1:
            raise InvalidParameter(
                f"{', '.join(sizes)}: got {', '.join(map(str, sizes.values()))} numbers; give one number, or one per "
                "joint each"
            )
        if np.any(self._magnitudes < self._steps):
            raise InvalidParameter(
                f"magnitude: got {self.magnitude!r} with a resolution of {self.resolution!r}; needs at least one step"
            )

    @cached_property
    def _magnitudes(self) -> np.ndarray:
        return _or_huge(self.magnitude)

    @cached_property
    def _rates(self) -> np.ndarray:
        return _or_huge(self.rate)

    @cached_property
    def _steps(self) -> np.ndarray:
        return np.asarray(0.0 if self.resolution is None else self.resolution, dtype=float)

    def check_fits(self, n_joints: int, period: float) -> None:
        """Refuse another number of joints, and a rate that never reaches the next step of torque.

        Raises
        ------
        InvalidParameter
            For one number per joint where there are more or fewer joints, and for a rate below a step per period.
        """
        for name in ("magnitude", "rate", "resolution"):
            value = getattr(self, name)
            if value is not None and np.size(value) not in (1, n_joints):
                raise InvalidParameter(
                    f"torque_limits.{name}: got {np.size(value)} numbers; needs one number or {n_joints} of them, one "
                    "per joint",
                    name,
                )
        if np.any(self._rates * period < self._steps * (1 - ROUNDING)):
            raise InvalidParameter(
                f"torque_limits.rate: got {self.rate!r}, which is below one step of {self.resolution!r} per period of "
                f"{period:g} s, so that the torque would never change",
                "rate",
            )

    def magnitudes(self, n_joints: int) -> np.ndarray:
        """Return the largest magnitude of each joint [N m or N], shape (n,); `HUGE` of `array_ops` where none is."""
        return self._magnitudes if ops.symbolic(self._magnitudes) else np.broadcast_to(self._magnitudes, (n_joints,))

    def initial_torque(self, torque: np.ndarray) -> np.ndarray:
        """Return the nearest torque to one (n,) that magnitude and resolution allow."""
        return np.asarray(self.apply(torque, torque, np.inf))

    def apply(self, command: Vector, past_torque: Vector, period: float) -> Vector:
        """Return the nearest allowed torque to a command, after the torque of one period before; each (n,)."""
        change = ops.minimum(self._rates * period, ops.HUGE)
        allowed = _limited(command, past_torque, change, self._magnitudes)
        steps, has_symbols = self._steps, ops.symbolic(self._steps)
        if not has_symbols and not np.any(steps > 0):
            return allowed
        divisors = steps if has_symbols else np.where(steps > 0, steps, 1.0)
        # counted in whole steps, so that rounding can violate no limit
        count = ops.floor(command / divisors + 0.5)
        past_count = ops.floor(past_torque / divisors + 0.5)
        most_change, most = (ops.floor(limit / divisors + ROUNDING) for limit in (change, self._magnitudes))
        stepped = divisors * _limited(count, past_count, most_change, most)
        return stepped if has_symbols or np.all(steps > 0) else ops.where(steps > 0, stepped, allowed)


def _limited(value: Vector, past: Vector, change: Vector, magnitude: Vector) -> Vector:
    """Return a value within ±change of the past one, and within ±magnitude where both do not overlap."""
    if not ops.symbolic(change) and np.all(change >= ops.HUGE):
        return ops.clip(value, -magnitude, magnitude)
    return ops.clip(ops.clip(value, past - change, past + change), -magnitude, magnitude)


def _or_huge(value: Numbers | None) -> np.ndarray:
    """Return numbers, with `HUGE` for None and infinity."""
    return np.minimum(np.asarray(np.inf if value is None else value, dtype=float), ops.HUGE)
