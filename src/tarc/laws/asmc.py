"""Adaptive sliding mode with a threshold."""

from dataclasses import dataclass

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Vector
from tarc.laws.switching import Switching


@dataclass(frozen=True, kw_only=True, eq=False)
class ASMC(Switching):
    """Adaptive sliding mode: the gain rises while ‖s‖ is above a threshold and falls while it is below.

        Δu = −ϱ s / max(‖s‖, ε),     s = (v̂ − q̇ᵈ) + λ e1
        ϱ' = ϱ̄ sgn(‖s‖ − δ)  if ϱ > γ̄,     γ̄  otherwise

    Alone with ``time_delay=False``, and on time-delay estimation, where TARC is its successor. Takes the parameters of
    `Switching`, `TDE`, `PolePlacement` and `Law`, and:

    Parameters
    ----------
    adaptation_rate
        ϱ̄ [rad/s³], how fast the gain moves, up and down alike; [rad/s³ for each rad/s of ‖s‖] if ``scale_by_error``.
    threshold
        δ [rad/s or m/s], above the noise of s and above what ‖s‖ can be held to. Too small a threshold is never
        reached and the gain only rises, too large a one leaves the error at its size; that it must be found for each
        robot and task is the reason for TARC.
    min_gain
        γ̄ [rad/s²] as the value of the gain below which it rises regardless, and [rad/s³] as the rate at which it
        then does: one number with two units, as printed.
    initial_gain
        ϱ(0) [rad/s²]; None for twice the floor. From below the floor the gain comes up at the rate γ̄ alone, slowly.
    max_gain
        Largest gain [rad/s²]; None for none.
    scale_by_error
        Multiply ϱ̄ by ‖s‖, as in the law's origin, instead of leaving it constant, as in the TARC paper.

    Raises
    ------
    InvalidParameter
        For a speed, threshold or floor that is not above zero, and a cap below the initial gain.

    Notes
    -----
    Use it as the yardstick that TARC is measured against. It raises the gain although the error already shrinks, as
    long as ‖s‖ > δ, and lowers it although the error grows, as long as ‖s‖ < δ.

    The gain runs as forward Euler. A step downwards stops at the floor, which the continuous law does not cross; there
    the printed rate lifts the gain by T γ̄ and the next step takes it back.

    References
    ----------
    TARC paper, Section II-C, equation (Asmc), with r = s. After F. Plestan, Y. Shtessel, V. Bregeault and A. Poznyak,
    Int. J. Control 83(9), 2010, and Control Eng. Pract. 21(5), 2013, where the rate is ϱ̄ ‖s‖ sgn(‖s‖ − δ) and there is
    no boundary layer.
    """

    adaptation_rate: float
    threshold: float
    min_gain: float = 0.01
    initial_gain: float | None = None
    max_gain: float | None = None
    scale_by_error: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("adaptation_rate", "threshold", "min_gain"):
            check.number(name, getattr(self, name), 0, strict=True)
        if self.max_gain is not None and not check.number("max_gain", self.max_gain) >= self.start_gain:
            raise InvalidParameter(
                f"max_gain: got {self.max_gain:g}; needs at least the initial gain {self.start_gain:g}"
            )

    @property
    def start_gain(self) -> float:
        """The initial gain ϱ(0) [rad/s²]."""
        return check.number("initial_gain", 2 * self.min_gain if self.initial_gain is None else self.initial_gain, 0)

    def adapt(self, gain: Vector, size: Vector) -> Vector:
        """ϱ + T ϱ', between the floor and the cap."""
        rate = (
            self.adaptation_rate * ops.where(size >= self.threshold, 1.0, -1.0) * (size if self.scale_by_error else 1.0)
        )
        moved = ops.maximum(gain + self.period * rate, self.min_gain)
        lifted = gain + self.period * self.min_gain
        highest = ops.HUGE if self.max_gain is None else self.max_gain
        return ops.clip(ops.where(gain > self.min_gain, moved, lifted), 0.0, highest)
