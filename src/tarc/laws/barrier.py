"""Adaptive-robust time-delay control with barriers at limits of the position and velocity errors."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Vector
from tarc.core.validation import Numbers
from tarc.laws.base import ControlInput
from tarc.laws.state_bound import BoundGains, state_norm, switching_gain
from tarc.laws.tde import TDE


class BarrierState(NamedTuple):
    """Gains K̂0 and K̂1, and the share of the initial widening of the limits that is left, from 1 to 0."""

    constant_gain: Vector
    state_gain: Vector
    widening: Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class BarrierTDARC(TDE):
    """TDC with barriers at limits of the errors that shrink with time, and an adaptive robust term.

        Δu = −κ (β1/β2) e1 − ĉ η / max(‖η‖, ε),     η = β2 s,     s = (v̂ − q̇ᵈ) + Λ e1,     Λ = ½ K2
        β1 = 1/(1 − min(e1²/d1², 1 − 1/B)),     β2 = 1/(1 − min(s²/d2², 1 − 1/B)),     joint by joint
        d1 = r ℓ1,     d2 = r (ℓ2 − |Λ| ℓ1),     r = 1 + (r0 − 1) exp(−t/t0)
        ĉ = K̂0 + K̂1 ‖ξ‖,     ‖ξ‖² = ‖Λ e1‖² + ‖v̂ − q̇ᵈ‖²
        K̂0' = a0 ‖η‖ − μ K̂0,     K̂1' = a1 ‖η‖ ‖ξ‖ − μ K̂1

    Where |e1| < d1 and |s| < d2, the rate of the error is below r ℓ2, and the logarithmic barrier
    V = ½ Σ κ d1² log β1 + ½ Σ d2² log β2 is finite. With damping 1 and perfect estimation, V falls outside a region
    that the error of time-delay estimation sets. Takes the parameters of `TDE`, `PolePlacement` and `Law`, and:

    Parameters
    ----------
    position_limit, velocity_limit
        ℓ1 [rad or m] and ℓ2 [rad/s or m/s], final limits of |e1| and of |q̇ − q̇ᵈ|. One number or one per joint. ℓ2
        must exceed |Λ| ℓ1, since an error at its limit returns at that speed.
    barrier_gain
        κ [1/s²], slope of the position barrier at zero error; adds to K1 there. Zero for no position barrier.
    adaptation_rate, state_adaptation_rate
        a0 [1/s²] and a1 [1/rad² or 1/m²], zero for a gain that stays at zero.
    leakage
        μ [1/s], rate at which both gains decay without error. Below 1/T.
    boundary_layer
        ε [rad/s or m/s], the layer in which the robust term is linear. It must exceed the noise of v̂.
    initial_scale
        r0 ≥ 1, by which both limits are wider at the start.
    decay_time
        t0 [s], time constant of the limits. The limits may not shrink faster than Λ lets the error decay.
    max_amplification
        B > 1, largest β1 and β2.
    max_gain
        Largest K̂0, and largest ĉ [rad/s²]; None for none.
    max_state_gain
        Largest K̂1 [1/s]; None for none.

    Raises
    ------
    InvalidParameter
        For a velocity limit that the position limit leaves no room, and limits that shrink too fast. Also for a
        leakage of 1/T or more, and values out of range.

    Notes
    -----
    A barrier has no value outside its limits. There the law saturates: β1 and β2 stay at B, and the torque stays
    continuous. The signal ``outside_limits`` counts the joints whose position or velocity error is outside.

    The limits are no guarantee of the sampled loop. The velocity is that of the window, so that its error counts with
    its noise and delay. Noise, torque limits, and any step of the reference larger than the limit leave them.

    The time of the limits starts at reset. `tarc.certificates.certify_constant_ratio` decides the loop at zero error,
    with the final limits and a frozen K̂0.

    References
    ----------
    After S. Gupta, R. D. Yadav, S. Mishra, A. Sharma, S. Ganguly, W. Pan, S. Roy and S. Baldi, Adaptive artificial
    time-delay control with barrier Lyapunov constraints for Euler-Lagrange robots, arXiv 2605.31405, 2026. Its text
    was not at hand beyond the abstract, so this is no transcription. From the abstract are time-delay estimation, a
    state-dependent bound with adapted parameters, and a barrier with time-varying limits on position and velocity. The
    barrier is the logarithmic one of K. P. Tee, S. S. Ge and E. H. Tay, Automatica 45(4), 2009. The weights, the
    common shrinking, the leakage, the saturation and the position measurement are ours.
    """

    position_limit: Numbers
    velocity_limit: Numbers
    barrier_gain: float = 0.0
    adaptation_rate: float = 0.0
    state_adaptation_rate: float = 0.0
    leakage: float = 1.0
    boundary_layer: float = 0.2
    initial_scale: float = 1.0
    decay_time: float = 1.0
    max_amplification: float = 5.0
    max_gain: float | None = None
    max_state_gain: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("barrier_gain", "adaptation_rate", "state_adaptation_rate"):
            check.number(name, getattr(self, name), 0)
        for name in ("leakage", "boundary_layer", "decay_time"):
            check.number(name, getattr(self, name), 0, strict=True)
        check.number("initial_scale", self.initial_scale, 1.0)
        check.number("max_amplification", self.max_amplification, 1.0, strict=True)
        for name in ("max_gain", "max_state_gain"):
            if getattr(self, name) is not None:
                check.number(name, getattr(self, name), 0)
        if self.leakage * self.period >= 1:
            raise InvalidParameter(
                f"leakage: got {self.leakage:g} 1/s; needs less than one over the period, {1 / self.period:g} 1/s",
                "leakage",
            )
        self._check_limits()

    def _check_limits(self) -> None:
        """Refuse limits that leave no room, and limits that shrink faster than the error decays."""
        if np.any(self.surface_limits <= 0):
            least = (np.abs(self.Lambda) @ self.position_limits).max()
            raise InvalidParameter(
                f"velocity_limit: got {self.velocity_limit}; needs more than |½ K2| position_limit, {least:.4g} at "
                "most over the joints. Raise it, or lower position_limit or the natural frequency",
                "velocity_limit",
            )
        shrinking = (self.initial_scale - 1) / (self.initial_scale * self.decay_time)
        slowest = float(np.min(np.linalg.eigvals(self.Lambda).real))
        if shrinking >= slowest:
            raise InvalidParameter(
                f"decay_time: got {self.decay_time:g} s, with which the limits shrink at {shrinking:.3g} 1/s; needs "
                f"less than the error's own decay, {slowest:.3g} 1/s. Raise decay_time or lower initial_scale",
                "decay_time",
            )

    def linearisation_constants(self, gain: float) -> dict[str, float | None]:
        """Return the constants of every law, the gains that adapt, and the final limits."""
        own = {"constant_gain": gain, "state_gain": None, "widening": 0.0}
        return {**super().linearisation_constants(gain), **own}

    @cached_property
    def Lambda(self) -> np.ndarray:
        """Return Λ = ½ K2 [1/s], shape (n, n)."""
        return self.K2 / 2

    @cached_property
    def position_limits(self) -> np.ndarray:
        """Return ℓ1 [rad or m], shape (n,)."""
        return check.vector("position_limit", self.position_limit, self.n_joints, 0, strict=True)

    @cached_property
    def velocity_limits(self) -> np.ndarray:
        """Return ℓ2 [rad/s or m/s], shape (n,)."""
        return check.vector("velocity_limit", self.velocity_limit, self.n_joints, 0, strict=True)

    @cached_property
    def surface_limits(self) -> np.ndarray:
        """Return ℓ2 − |Λ| ℓ1 [rad/s or m/s], shape (n,), the final limits of |s|."""
        return self.velocity_limits - np.abs(self.Lambda) @ self.position_limits

    def limit_scale(self, widening: Vector) -> Vector:
        """Return r = 1 + (r0 − 1) w, by which the limits are wider than the final ones."""
        return 1 + (self.initial_scale - 1) * widening

    def amplification(self, value: Vector, limit: Vector) -> Vector:
        """Return 1/(1 − x²/k²) for each joint, at most ``max_amplification``."""
        return 1 / (1 - ops.minimum((value / limit) ** 2, 1 - 1 / self.max_amplification))

    def sliding(self, error: Vector, error_rate: Vector) -> Vector:
        """Return the sliding variable s [rad/s or m/s], shape (n,)."""
        return error_rate + self.Lambda @ error

    def robust_init(self) -> BarrierState:
        """Return gains of zero, and the limits at their widest."""
        return BarrierState(np.zeros(()), np.zeros(()), np.ones(()))

    def robust(self, state: BarrierState, tracking: ControlInput) -> tuple[BarrierState, Vector, dict[str, Vector]]:
        """Evaluate Δu = −κ (β1/β2) e1 − ĉ η / max(‖η‖, ε), adapt K̂0 and K̂1, and let the limits shrink."""
        error, rate = tracking.error, tracking.error_rate
        scale = self.limit_scale(state.widening)
        s = self.sliding(error, rate)
        position_factor = self.amplification(error, scale * self.position_limits)
        surface_factor = self.amplification(s, scale * self.surface_limits)
        eta = surface_factor * s
        norm = state_norm(self.Lambda, error, rate)
        gain = switching_gain(BoundGains(state.constant_gain, state.state_gain), norm, self.max_gain)
        barrier = self.barrier_gain * position_factor / surface_factor * error
        correction = -barrier - gain * eta / ops.norm(eta, self.boundary_layer)
        size = ops.norm(eta)
        moved = BarrierState(
            self._adapted(state.constant_gain, self.adaptation_rate * size, self.max_gain),
            self._adapted(state.state_gain, self.state_adaptation_rate * size * norm, self.max_state_gain),
            state.widening * float(np.exp(-self.period / self.decay_time)),
        )
        next_state = BarrierState(*(ops.where(tracking.fault, old, new) for old, new in zip(state, moved, strict=True)))
        beyond = ops.logical_or(abs(error) >= scale * self.position_limits, abs(rate) >= scale * self.velocity_limits)
        outside = ops.dot(ops.where(beyond, 1.0, 0.0), np.ones(self.n_joints))
        signals = {"gain": gain, "constant_gain": state.constant_gain, "state_gain": state.state_gain}
        return next_state, correction, {**signals, "outside_limits": outside}

    def _adapted(self, gain: Vector, rate: Vector, highest: float | None) -> Vector:
        """Return a gain after a period with leakage, limited on both sides."""
        moved = gain + self.period * (rate - self.leakage * gain)
        return ops.clip(moved, 0.0, ops.HUGE if highest is None else highest)
