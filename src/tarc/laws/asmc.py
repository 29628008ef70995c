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

    It works alone with ``time_delay=False``, or on time-delay estimation, where TARC is its successor. Takes the
    parameters of `Switching`, `TDE`, `PolePlacement` and `Law`, and:

    Parameters
    ----------
    adaptation_rate
        ϱ̄ [rad/s³], rate of the gain, upwards and downwards; [rad/s³ per rad/s of ‖s‖] if ``scale_by_error``.
    threshold
        δ [rad/s or m/s], above the noise of s and above the smallest ‖s‖ that the loop can reach. A smaller threshold
        is never reached, and the gain only rises. A larger one leaves an error of its size. It must be found for each
        robot and task, which TARC avoids.
    min_gain
        γ̄: the gain [rad/s²] below which it rises in any case, and the rate [rad/s³] of that rise. The source prints
        one number with two units.
    initial_gain
        ϱ(0) [rad/s²]; None for twice ``min_gain``. Below ``min_gain`` the gain rises at the rate γ̄ alone, slowly.
    max_gain
        Largest gain [rad/s²]; None for none.
    scale_by_error
        Multiply ϱ̄ by ‖s‖, as in the original law. Otherwise it is constant, as in the TARC paper.

    Raises
    ------
    InvalidParameter
        For a rate, threshold or minimal gain that is not above zero, and a maximal gain below the initial one.

    Notes
    -----
    Use it as the reference for TARC. While ‖s‖ > δ it raises the gain, even where the error already shrinks. While ‖s‖
    < δ it lowers the gain, even where the error grows.

    The gain is integrated by forward Euler. A step downwards stops at ``min_gain``, which the continuous law does not
    cross. There the printed rate lifts the gain by T γ̄, and the next step takes it back.

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
        """Return the initial gain ϱ(0) [rad/s²]."""
        return check.number("initial_gain", 2 * self.min_gain if self.initial_gain is None else self.initial_gain, 0)

    def adapt(self, gain: Vector, size: Vector) -> Vector:
        """Return ϱ + T ϱ', limited to ``min_gain`` and ``max_gain``."""
        rate = (
            self.adaptation_rate * ops.where(size >= self.threshold, 1.0, -1.0) * (size if self.scale_by_error else 1.0)
        )
        moved = ops.maximum(gain + self.period * rate, self.min_gain)
        lifted = gain + self.period * self.min_gain
        highest = ops.HUGE if self.max_gain is None else self.max_gain
        return ops.clip(ops.where(gain > self.min_gain, moved, lifted), 0.0, highest)
