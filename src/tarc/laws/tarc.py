"""Time-delayed adaptive robust control."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.errors import TarcError
from tarc.core.validation import Matrix
from tarc.laws.base import Tracking
from tarc.laws.tde import TDE


class GainState(NamedTuple):
    """The switching gain ĉ, and ‖s‖ over the past delay, newest first, shape (1, m)."""

    gain: Any
    sliding: Any


@dataclass(frozen=True, kw_only=True, eq=False)
class TARC(TDE):
    """Time-delayed adaptive robust control: TDC with an adaptive switching gain on estimated derivatives.

        Δu = −α ĉ s / max(‖s‖, ε),     s = P2 e1
        ĉ' = +c̄ ‖s‖  if ĉ ≤ γ or ‖s‖ > ‖s_h‖,     −c̲ ‖s‖  otherwise
        AᵀP + PA = −Q,     P = [P1 P2ᵀ; P2 P3]

    The gain rises while the error grows and falls while it does not; no bound on the uncertainty and no threshold
    on the error is set beforehand. The adaptation runs as forward Euler, held at the floor γ from below as the
    continuous law is. Takes the parameters of `TDE`, `PolePlacement` and `Law`, and:

    Parameters
    ----------
    rise, fall
        c̄ and c̲ [1/s³ per unit of s], both above zero. The default weight makes s = e1 [rad or m]; with Q = I, s is
        1/(2ωn²) of the error and both must be thousands of times larger.
    boundary
        ε [unit of s], the layer in which the switching term is linear; its slope α ĉ/ε adds to K1.
    floor
        γ [rad/s²], least gain.
    margin
        α ≥ 1.
    initial_gain
        ĉ(0) [rad/s²], above the floor; None for twice the floor.
    cap
        Largest gain [rad/s²]; None for none. The boundedness argument in print has a gap, and the gain can run away
        for a large rise with a small boundary.
    weight
        Q: one number, 2n numbers or a (2n, 2n) symmetric positive definite matrix; None for diag(K1 + K1ᵀ, 2 I), which
        gives P2 = I for scalar gains.

    Raises
    ------
    TarcError
        When ĉ(0) ≤ γ, α < 1, or P3 P2ᵀ is not positive definite (condition (c2)).

    References
    ----------
    Paper, Section II-B: the control input (tarc input), (delta u), the adaptive law (ATRC), condition (c2).
    """

    frozen: ClassVar[tuple[str, ...]] = (*TDE.frozen, "gain", "sliding")

    rise: float
    fall: float
    boundary: float = 0.01
    floor: float = 0.01
    margin: float = 1.0
    initial_gain: float | None = None
    cap: float | None = None
    weight: Matrix | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("rise", "fall", "boundary", "floor"):
            check.number(name, getattr(self, name), 0, strict=True)
        check.number("margin", self.margin, 1.0)
        if not self.start > self.floor:
            raise TarcError(
                f"initial_gain: got {self.start:g}, which is not above the floor {self.floor:g}; the adaptive law "
                "needs ĉ(0) > γ. Raise initial_gain or lower floor"
            )
        if self.cap is not None and not check.number("cap", self.cap) >= self.start:
            raise TarcError(f"cap: got {self.cap:g}; needs at least the initial gain {self.start:g}")
        product = self.P3 @ self.P2.T
        if np.linalg.eigvalsh(product + product.T)[0] <= 0:
            raise TarcError(
                "weight: P3 P2ᵀ is not positive definite, so condition (c2) fails; use a block-diagonal weight Q, "
                "such as the default"
            )

    @property
    def start(self) -> float:
        """The initial gain ĉ(0) [rad/s²]."""
        value = 2 * self.floor if self.initial_gain is None else self.initial_gain
        return check.number("initial_gain", value, 0)

    @cached_property
    def Q(self) -> np.ndarray:
        """Weight of the Lyapunov equation, shape (2n, 2n)."""
        n = self.joints
        if self.weight is None:
            zero = np.zeros((n, n))
            return check.definite("weight", np.block([[self.K1 + self.K1.T, zero], [zero, 2 * np.eye(n)]]), 2 * n)
        return check.definite("weight", self.weight, 2 * n)

    @cached_property
    def P(self) -> np.ndarray:
        """Solution of AᵀP + PA = −Q, shape (2n, 2n)."""
        from scipy.linalg import solve_continuous_lyapunov

        P = solve_continuous_lyapunov(self.A.T, -self.Q)
        return (P + P.T) / 2

    @property
    def P2(self) -> np.ndarray:
        """Lower left block of P, shape (n, n): s = P2 e1."""
        return self.P[self.joints :, : self.joints]

    @property
    def P3(self) -> np.ndarray:
        """Lower right block of P, shape (n, n)."""
        return self.P[self.joints :, self.joints :]

    @property
    def robust_slope(self) -> float:
        """α ĉ ‖P2‖/ε at the cap; infinite without one."""
        highest = np.inf if self.cap is None else self.cap
        return self.margin * highest / self.boundary * float(np.linalg.norm(self.P2, 2))

    def sliding(self, error: Any, error_rate: Any) -> Any:
        """s = P2 e1, shape (n,)."""
        return self.P2 @ error

    def robust_init(self) -> GainState:
        """The initial gain, and no error before the start."""
        return GainState(np.array(self.start), np.zeros((1, self.delay_periods)))

    def robust(self, state: GainState, tracking: Tracking) -> tuple[GainState, Any, dict[str, Any]]:
        """Δu = −α ĉ s / max(‖s‖, ε) and the adaptation of ĉ."""
        s = self.sliding(tracking.error, tracking.error_rate)
        size = ops.norm(s)
        correction = -self.margin * state.gain * s / ops.norm(s, self.boundary)
        rising = ops.either(state.gain <= self.floor, size > state.sliding[0, -1])
        rate = ((self.rise + self.fall) * rising - self.fall) * size
        highest = ops.HUGE if self.cap is None else self.cap
        rate = ops.only(ops.negate(tracking.fault), rate)
        gain = ops.clip(state.gain + self.period * rate, self.floor, highest)
        next_state = GainState(gain, ops.push(state.sliding, size))
        return next_state, correction, {"gain": state.gain, "rising": rising}
