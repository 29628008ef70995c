"""Time-delayed control with internal model."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Vector
from tarc.laws.base import ControlInput
from tarc.laws.tde import TDE, TDEState


class ModelState(NamedTuple):
    """Filtered velocity of the model before the newest acceleration (n,), and past N̂, newest first, (n, d + 1)."""

    velocity: Vector
    tde_estimate: Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class TDCIM(TDE):
    """TDC with internal model: the deviation of the robot from q̈ = u is filtered and subtracted from the input.

        Δu = −Q(s) (q̈ − u_a),     Q(s) = 1/(λ s + 1),     u_a = M̂⁻¹ (τ_a − N̂)

    With perfect time-delay estimation the robot is the double integrator q̈ = u_a, which is the internal model; τ_a is
    the applied torque. Only positions are needed, since Q(s) q̈ = (q̇ − Q(s) q̇)/λ. Takes the parameters of `TDE`,
    `PolePlacement` and `Law`, and:

    Parameters
    ----------
    time_constant
        λ [s], time constant of the filter, at least one period. A smaller λ is stiffer against friction and allows less
        delay. Half to twice 1/ωn is usual.

    Raises
    ------
    InvalidParameter
        For a λ below one period.

    Notes
    -----
    Use it as `IVF`, against Coulomb friction and stiction, above all under a torque limit. With this filter it equals
    IVF with Γ = 1/λ while no limit is reached and no ``actuation_delay`` is given. Then λ Δu + v̂ is the integral of
    q̈ᵈ − K2 (v̂ − q̇ᵈ) − K1 e1. Its model takes the torque that acted, so that nothing winds up.

    References
    ----------
    After G. R. Cho, P. H. Chang, S. H. Park and M. Jin, IEEE Trans. Control Syst. Technol. 17(6), 2009: time-delay
    estimation for what is smooth, internal model control for what it leaves of hard friction. The filter of first order
    and the form with applied torque and estimated velocity, stepped as forward Euler, are a reading of that idea and
    not a transcription.
    """

    time_constant: float

    def __post_init__(self) -> None:
        super().__post_init__()
        if not check.number("time_constant", self.time_constant, 0, strict=True) >= self.period:
            raise InvalidParameter(
                f"time_constant: got {self.time_constant:g} s; needs at least the period {self.period:g} s"
            )

    @cached_property
    def inverse(self) -> np.ndarray:
        """Return M̂⁻¹, shape (n, n)."""
        return np.linalg.inv(self.command_inertia)

    @property
    def robust_slope_bound(self) -> float:
        """Return zero: the robust term is linear, with a state of its own."""
        return 0.0

    def robust_init(self) -> ModelState:
        """Return the state at rest without a torque."""
        return ModelState(np.zeros(self.n_joints), np.zeros((self.n_joints, self.actuation_delay + 1)))

    def initial_state(self, torque: np.ndarray) -> TDEState:
        """Return the state at rest, where N̂ is the applied torque."""
        state = super().initial_state(torque)
        return state._replace(robust=state.robust._replace(tde_estimate=state.robust.tde_estimate + torque[:, None]))

    def robust(self, state: ModelState, tracking: ControlInput) -> tuple[ModelState, Vector, dict[str, Vector]]:
        """Evaluate Δu = (x − v̂)/λ with the filtered model x' = (v̂ − x)/λ + u_a."""
        applied = self.inverse @ (tracking.past_torque - state.tde_estimate[:, -1])
        model = state.velocity + self.period * applied
        correction = (model - tracking.estimate.velocity) / self.time_constant
        # u_a of this period is known in the next, once the torque has met its limits
        velocity = model - self.period * correction
        return state._replace(velocity=velocity), correction, {"model_velocity": model}

    def control(self, state: TDEState, tracking: ControlInput) -> tuple[TDEState, Vector, dict[str, Vector]]:
        """Evaluate the equation of `TDE`; keep N̂ = τ − M̂ u, which gives u_a from the torque that acts."""
        state, torque, signals = super().control(state, tracking)
        tde_estimate = ops.shift_in(state.robust.tde_estimate, torque - self.command_inertia @ signals["auxiliary"])
        return state._replace(robust=state.robust._replace(tde_estimate=tde_estimate)), torque, signals
