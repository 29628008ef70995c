"""Adaptive sliding mode whose gain only grows."""

from dataclasses import dataclass

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Vector
from tarc.laws.switching import Switching


@dataclass(frozen=True, kw_only=True, eq=False)
class MonotoneASMC(Switching):
    """Adaptive sliding mode of the first kind: the gain grows with the distance from the surface and never falls.

        Δu = −ϱ s / max(‖s‖, ε),     s = (v̂ − q̇ᵈ) + λ e1
        ϱ' = ϱ̄ ‖s‖  if ‖s‖ > δ,     0  otherwise

    It works alone with ``time_delay=False``, or on time-delay estimation. Takes the parameters of `Switching`, `TDE`,
    `PolePlacement` and `Law`, and:

    Parameters
    ----------
    adaptation_rate
        ϱ̄ [1/s²]: rate of the gain [rad/s³] per rad/s of ‖s‖.
    dead_zone
        δ [rad/s or m/s], below which the gain is constant. The default 0 is the plain law, whose gain noise alone
        raises for ever. A dead zone just above the boundary layer is the usual remedy.
    initial_gain
        ϱ(0) [rad/s²].
    max_gain
        Largest gain [rad/s²]; None for none. Give one, since nothing else stops the gain.

    Raises
    ------
    InvalidParameter
        For a rate that is not above zero, a dead zone or initial gain below zero, and a maximal gain below the initial
        one.

    Notes
    -----
    Use it to measure the cost of a gain that cannot fall. The largest past disturbance, the first jump of the reference
    included, sets the later chatter.

    References
    ----------
    The kind of law that the TARC paper names as monotone; after C.-Y. Chen, T.-H. S. Li, Y.-C. Yeh and C.-C. Chang,
    Mechatronics 19(2), 2009. The rate ϱ̄ ‖s‖ is the form common to this kind, not a transcription of theirs; the
    boundary layer, the dead zone and the cap are additions.
    """

    adaptation_rate: float
    dead_zone: float = 0.0
    initial_gain: float = 0.0
    max_gain: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check.number("adaptation_rate", self.adaptation_rate, 0, strict=True)
        check.number("dead_zone", self.dead_zone, 0)
        if self.max_gain is not None and not check.number("max_gain", self.max_gain) >= self.start_gain:
            raise InvalidParameter(
                f"max_gain: got {self.max_gain:g}; needs at least the initial gain {self.start_gain:g}"
            )

    @property
    def start_gain(self) -> float:
        """Return the initial gain ϱ(0) [rad/s²]."""
        return check.number("initial_gain", self.initial_gain, 0)

    def adapt(self, gain: Vector, size: Vector) -> Vector:
        """Return ϱ + T ϱ̄ ‖s‖ outside the dead zone, at most ``max_gain``."""
        grown = gain + self.period * self.adaptation_rate * ops.where_or_zero(size > self.dead_zone, size)
        return ops.clip(grown, 0.0, ops.HUGE if self.max_gain is None else self.max_gain)
