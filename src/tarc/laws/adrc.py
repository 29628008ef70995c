"""Active disturbance rejection control."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.types import Vector
from tarc.core.validation import Numbers
from tarc.laws.base import ControlInput, LawState
from tarc.laws.pole_placement import PolePlacement


class ObserverState(NamedTuple):
    """Observed position, velocity and disturbing acceleration, each of shape (n,)."""

    position: Vector
    velocity: Vector
    disturbance: Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class ADRC(PolePlacement):
    """Active disturbance rejection: an observer estimates the acceleration that M̂ does not explain, as one more state.

        q̈ = z3 + M̂⁻¹ τ,     ż3 unknown;     ẑ' = A ẑ + B M̂⁻¹ τ + L (q − ẑ1),     L = (3 ωo, 3 ωo², ωo³)
        τ = M̂ (q̈ᵈ − K2 (ẑ2 − q̇ᵈ) − K1 (ẑ1 − qᵈ) − ẑ3)

    Takes the parameters of `PolePlacement` and `Law`, and:

    Parameters
    ----------
    observer_bandwidth
        ωo [rad/s]: all poles of the observer lie at −ωo. Three to ten times the natural frequency ωn is usual. A larger
        ωo passes more noise to the torque, and allows less delay and a smaller M̂.

    Notes
    -----
    The observer takes the position and the torque that acted. The law's `estimator` only fills the recorded signals.
    The observer is discretised exactly for a torque held over each period, in predictor–corrector form. All its poles
    lie at z = exp(−ωo T). A missing sample gives no correction. This is the linear form; Han's original has nonlinear
    gains and a tracking differentiator. Use it where a window's acceleration is too noisy for time-delay estimation.

    References
    ----------
    J. Han, IEEE Trans. Ind. Electron. 56(3), 2009; Z. Gao, Scaling and natural frequency-parameterization based
    controller
    tuning, American Control Conference, 2003; R. Miklosovic, A. Radke and Z. Gao, Discrete implementation and
    generalization of the extended state observer, American Control Conference, 2006.
    """

    observer_bandwidth: float

    def __post_init__(self) -> None:
        super().__post_init__()
        check.number("observer_bandwidth", self.observer_bandwidth, 0, strict=True)

    @property
    def correction(self) -> np.ndarray:
        """Return the gain ℓ, shape (3,): (I − ℓ C) Φ has its three eigenvalues at β = exp(−ωo T)."""
        beta, T = np.exp(-self.observer_bandwidth * self.period), self.period
        return np.array([1 - beta**3, 1.5 * (1 - beta) ** 2 * (1 + beta) / T, (1 - beta) ** 3 / T**2])

    @property
    def robust_slope_bound(self) -> float:
        """Return zero: the law is linear."""
        return 0.0

    def init(self, position: Numbers, torque: Numbers = 0.0) -> LawState:
        """Return the state of every law, with the observer at the position."""
        state = super().init(position, torque)
        return state._replace(control=state.control._replace(position=state.position))

    def initial_state(self, torque: np.ndarray) -> ObserverState:
        """Return the observer at rest, where the disturbance balances the applied torque."""
        zero = np.zeros(self.n_joints)
        return ObserverState(zero, zero, -np.linalg.solve(self.M, torque))

    def control(self, state: ObserverState, tracking: ControlInput) -> tuple[ObserverState, Vector, dict[str, Vector]]:
        """Predict, correct, and cancel the disturbance observed."""
        T, gain = self.period, self.correction
        acceleration = state.disturbance + np.linalg.inv(self.M) @ tracking.past_torque
        position = state.position + T * state.velocity + T**2 / 2 * acceleration
        velocity = state.velocity + T * acceleration

        estimate = tracking.estimate
        innovation = ops.where_or_zero(estimate.valid, estimate.position - position)
        position, velocity = position + gain[0] * innovation, velocity + gain[1] * innovation
        disturbance = state.disturbance + gain[2] * innovation

        # the errors as the observer sees them, from those that the estimator saw
        error = tracking.error + (position - estimate.position)
        error_rate = tracking.error_rate + (velocity - estimate.velocity)
        u = self.feedback(tracking._replace(error=error, error_rate=error_rate))
        signals = {"auxiliary": u, "disturbance_estimate": disturbance}
        return ObserverState(position, velocity, disturbance), self.M @ (u - disturbance), signals
