"""Limits of a run on a robot, each with its reaction."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tarc.core import validation as check
from tarc.core.array_ops import HUGE
from tarc.core.component import Component
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.core.validation import Numbers
from tarc.laws.base import Law
from tarc.signals.torque_limits import TorqueLimits


@dataclass(frozen=True, kw_only=True, eq=False)
class SafetyLimits(Component):
    """Limits of torque, its rate, error, speed and steps between samples; each one number or one per joint.

    Torque and rate are clipped, and the law knows what passed. A sample beyond ``max_step`` counts as missing; too many
    in a row are a fault of the law, and a safe stop. Error and speed beyond their limits are a safe stop at once.

    Parameters
    ----------
    torque
        Largest magnitude [N m or N], beside the law's own limit; None for no other.
    torque_rate
        Largest rate [N m/s or N/s].
    error
        Largest distance of the position from the reference [rad or m].
    speed
        Largest magnitude of the estimated velocity [rad/s or m/s].
    max_step
        Largest distance of a position from the last valid one [rad or m].
    span
        Travel after which a position repeats [rad or m], as for `tarc.Controller`.

    Raises
    ------
    InvalidParameter
        For numbers that are not above zero.
    """

    torque: Numbers | None = None
    torque_rate: Numbers | None = None
    error: Numbers | None = None
    speed: Numbers | None = None
    max_step: Numbers | None = None
    span: Numbers | None = None

    def __post_init__(self) -> None:
        for name in ("error", "speed"):
            value = getattr(self, name)
            if value is not None and not np.all(check.float_array(name, value) > 0):
                raise InvalidParameter(f"{name}: got {value!r}; needs one number above 0, or one per joint", name)
        _ = self.interface

    @cached_property
    def interface(self) -> TorqueLimits | None:
        """Return the limits of torque and its rate as those of a robot's interface; None without."""
        if self.torque is None and self.torque_rate is None:
            return None
        return TorqueLimits(magnitude=self.torque, rate=self.torque_rate)

    def largest_torque(self, law: Law) -> Array:
        """Return the largest torque that may reach the robot [N m or N], shape (n,); `HUGE` where there is no limit."""
        own = law.torque_limits
        return own if self.interface is None else np.minimum(own, self.interface.magnitudes(law.n_joints))

    def rows(self, n_joints: int) -> tuple[Array, Array]:
        """Return the largest error and speed of each joint, each (n,), infinite where there is no limit."""
        return _row("error", self.error, n_joints), _row("speed", self.speed, n_joints)


def require_torque_limit(limits: SafetyLimits, law: Law) -> None:
    """Refuse joints without a torque limit.

    Raises
    ------
    InvalidParameter
        With their numbers.
    """
    without = [str(i + 1) for i, limit in enumerate(limits.largest_torque(law)) if limit >= HUGE]
    if without:
        raise InvalidParameter(
            f"torque_limit: joint {', '.join(without)} has none; give the law torque_limit, or SafetyLimits(torque=…), "
            "or start without one by allow_unlimited_torque=True",
            "torque_limit",
        )


def _row(name: str, value: Numbers | None, n_joints: int) -> Array:
    row = check.float_array(name, np.inf if value is None else value)
    if row.size not in (1, n_joints):
        raise InvalidParameter(f"{name}: got {row.size} numbers; needs one number or {n_joints}, one per joint", name)
    return np.broadcast_to(row, (n_joints,)).copy()
