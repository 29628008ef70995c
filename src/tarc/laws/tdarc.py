"""Adaptive-robust time-delay control under a state-dependent bound of the estimation error."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Vector
from tarc.laws.base import ControlInput
from tarc.laws.state_bound import BoundGains, state_norm, switching_gain
from tarc.laws.tde import TDE


@dataclass(frozen=True, kw_only=True, eq=False)
class TDARC(TDE):
    """Time-delayed adaptive-robust control: TDC with a switching gain that grows with the tracking error.

        Δu = −ĉ s / max(‖s‖, ε),     ĉ = K̂0 + K̂1 ‖ξ‖,     s = (v̂ − q̇ᵈ) + Λ e1,     Λ = ½ K2
        K̂0' = +a0 ‖s‖  if K̂0 ≤ γ or sᵀ ŝ' > 0,     −b0 ‖s‖  otherwise
        K̂1' = +a1 ‖s‖ ‖ξ‖  if K̂1 ≤ 0 or sᵀ ŝ' > 0,     −b1 ‖s‖ ‖ξ‖  otherwise
        ‖ξ‖² = ‖Λ e1‖² + ‖v̂ − q̇ᵈ‖²,     ŝ' = (â − q̈ᵈ) + Λ (v̂ − q̇ᵈ)

    The error of time-delay estimation holds the state, so that no constant bounds it beforehand. The gain follows the
    bound β0 + β1 ‖ξ‖ with unknown β0 and β1. Both gains rise while the distance from the surface grows and fall
    otherwise. Takes the parameters of `TDE`, `PolePlacement` and `Law`, and:

    Parameters
    ----------
    rise_rate, fall_rate
        a0 and b0 [1/s²], both above zero: rates of K̂0 [rad/s² or m/s²] per unit of ‖s‖.
    state_rise_rate, state_fall_rate
        a1 and b1 [1/rad² or 1/m²], both above zero: rates of K̂1 [1/s] per unit of ‖s‖ ‖ξ‖.
    boundary_layer
        ε [rad/s or m/s], the layer in which the switching term is linear. There ĉ/ε adds to K2, and Λ ĉ/ε to K1. It
        must exceed the noise of v̂, else the torque chatters.
    min_gain
        γ [rad/s²], least K̂0.
    initial_gain
        K̂0 at the start [rad/s²]; None for twice ``min_gain``. K̂1 starts at zero.
    max_gain
        Largest K̂0, and largest ĉ [rad/s²]; None for none.
    max_state_gain
        Largest K̂1 [1/s]; None for none.

    Raises
    ------
    InvalidParameter
        For a rate, layer or minimal gain that is not above zero, and a maximal gain below the initial one.

    Notes
    -----
    Only the position is measured, while the published law takes the velocity as measured. Here v̂ and â come from the
    estimator, late by a part of its window. So sᵀ ŝ' is the growth as the window sees it, with the window's noise.

    The gains are integrated by forward Euler. The boundary layer, the caps and ``min_gain`` bound the sampled law.
    `tarc.certificates.certify_constant_ratio` decides the loop inside the layer at a frozen K̂0.

    References
    ----------
    After S. Roy, J. Lee and S. Baldi, A new adaptive-robust design for time delay control under state-dependent
    stability condition, IEEE Trans. Control Syst. Technol. 29(1), 2021. The rule of rise and fall is after S. Roy,
    S. B. Roy, J. Lee and S. Baldi, Overcoming the underestimation and overestimation problems in adaptive sliding mode
    control, IEEE/ASME Trans. Mechatron. 24(5), 2019. A reading of their abstracts and not a transcription: the
    equations of the papers were not at hand. From the papers are the bound in the state, and gains that rise and fall.
    The scaling of ξ, the weight ½ K2 in s, separate rates, layer and caps are ours.
    """

    rise_rate: float
    fall_rate: float
    state_rise_rate: float
    state_fall_rate: float
    boundary_layer: float = 0.2
    min_gain: float = 0.01
    initial_gain: float | None = None
    max_gain: float | None = None
    max_state_gain: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        positive = ("rise_rate", "fall_rate", "state_rise_rate", "state_fall_rate", "boundary_layer", "min_gain")
        for name in positive:
            check.number(name, getattr(self, name), 0, strict=True)
        if self.max_gain is not None and not check.number("max_gain", self.max_gain) >= self.start_gain:
            raise InvalidParameter(
                f"max_gain: got {self.max_gain:g}; needs at least the initial gain {self.start_gain:g}"
            )
        if self.max_state_gain is not None:
            check.number("max_state_gain", self.max_state_gain, 0)

    def linearisation_constants(self, gain: float) -> dict[str, float | None]:
        """Return the constants of every law, and the states that adapt."""
        return {**super().linearisation_constants(gain), "constant_gain": gain, "state_gain": None}

    @property
    def start_gain(self) -> float:
        """Return K̂0 before the first step [rad/s²]."""
        value = 2 * self.min_gain if self.initial_gain is None else self.initial_gain
        return check.number("initial_gain", value, 0)

    @cached_property
    def Lambda(self) -> np.ndarray:
        """Return Λ = ½ K2 [1/s], shape (n, n)."""
        return self.K2 / 2

    def sliding(self, error: Vector, error_rate: Vector) -> Vector:
        """Return the sliding variable s [rad/s or m/s], shape (n,)."""
        return error_rate + self.Lambda @ error

    def robust_init(self) -> BoundGains:
        """Return the initial K̂0, and zero for K̂1."""
        return BoundGains(np.array(self.start_gain), np.zeros(()))

    def robust(self, state: BoundGains, tracking: ControlInput) -> tuple[BoundGains, Vector, dict[str, Vector]]:
        """Evaluate Δu = −ĉ s / max(‖s‖, ε) and adapt K̂0 and K̂1."""
        s = self.sliding(tracking.error, tracking.error_rate)
        growth = tracking.estimate.acceleration - tracking.acceleration_reference + self.Lambda @ tracking.error_rate
        is_growing = ops.dot(s, growth) > 0
        norm = state_norm(self.Lambda, tracking.error, tracking.error_rate)
        gain = switching_gain(state, norm, self.max_gain)
        correction = -gain * s / ops.norm(s, self.boundary_layer)
        size = ops.norm(s)
        constant_rises = ops.logical_or(state.constant_gain <= self.min_gain, is_growing)
        state_rises = ops.logical_or(state.state_gain <= 0, is_growing)
        constant_rate = ops.where(constant_rises, self.rise_rate, -self.fall_rate) * size
        state_rate = ops.where(state_rises, self.state_rise_rate, -self.state_fall_rate) * size * norm
        moved = BoundGains(
            _integrated(state.constant_gain, self.period * constant_rate, self.min_gain, self.max_gain),
            _integrated(state.state_gain, self.period * state_rate, 0.0, self.max_state_gain),
        )
        next_state = BoundGains(*(ops.where(tracking.fault, old, new) for old, new in zip(state, moved, strict=True)))
        signals = {"gain": gain, "constant_gain": state.constant_gain, "state_gain": state.state_gain}
        return next_state, correction, {**signals, "rising": is_growing}


def _integrated(gain: Vector, change: Vector, lowest: float, highest: float | None) -> Vector:
    """Return a gain after a period, limited on both sides."""
    return ops.clip(gain + change, lowest, ops.HUGE if highest is None else highest)
