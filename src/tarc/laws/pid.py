"""Proportional, integral and derivative feedback."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from tarc.core import validation as check
from tarc.core.types import Vector
from tarc.laws.base import ControlInput
from tarc.laws.integral import IntegralState, integrate, remember, start
from tarc.laws.model_based import check_model, inertia_and_bias
from tarc.laws.pole_placement import PolePlacement
from tarc.plants.base import Plant


@dataclass(frozen=True, kw_only=True, eq=False)
class PID(PolePlacement):
    """PID with acceleration feedforward, and gravity compensation where there is a model: the law of most robots.

        τ = M̂ (q̈ᵈ − K2 (v̂ − q̇ᵈ) − K1 e1 + z) + ĝ(q),     ż = −K_i e1,     K_i = integral_gain K1

    Takes the parameters of `PolePlacement` and `Law`, and:

    Parameters
    ----------
    integral_gain
        K_i K1⁻¹ = 1/T_i [1/s], the inverse of the reset time; 0 for PD. Where M̂ is M, the continuous loop is stable
        while it is below K2 = 2 ζ ωn; a tenth of the natural frequency to a third of it is usual.
    model
        Robot of `tarc.plants` whose gravity torque ĝ(q), springs included, is added: PD with gravity compensation for
        ``integral_gain=0``. None for ĝ = 0. In a scenario, ``robot`` is the scenario's own.

    Notes
    -----
    The law's estimator filters the derivative. The integral is a sum by Euler's rule, the newest error included, with
    back-calculation from the applied torque; its tracking time is T_i. It starts from the torque applied before, so
    that the law takes over without a bump; with a model it starts from zero. Without a model the torque comes from the
    error alone: raise M̂ and the natural frequency as far as noise and delay allow. With a model the certificates of a
    robot refuse the law, which states M̂ alone. The acceleration q̈ᵈ enters without a weight, since the
    certificates take its path into the loop for that of Δu.

    References
    ----------
    K. J. Åström and T. Hägglund, PID Controllers: Theory, Design, and Tuning, 2nd ed., 1995, on back-calculation;
    M. Takegaki and S. Arimoto, A new feedback method for dynamic control of manipulators, ASME J. Dyn. Syst. Meas.
    Control 103(2), 1981, on gravity compensation.
    """

    integral_gain: float = 0.0
    model: Plant | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check.number("integral_gain", self.integral_gain, 0)
        if self.model is not None:
            check_model(self.model, self.n_joints)

    @property
    def has_model(self) -> bool:
        """Return whether ĝ is given."""
        return self.model is not None

    def without_model(self) -> Self:
        """Return this law with ĝ = 0."""
        return replace(self, model=None)

    @property
    def robust_slope_bound(self) -> float:
        """Return zero: the law is linear."""
        return 0.0

    def initial_state(self, torque: np.ndarray) -> IntegralState:
        """Return the integral that gives the torque already applied; zero for PD, where it would never decay.

        It is zero with a model too, whose gravity torque is the one already applied at rest.
        """
        return start(self, torque, bumpless=self.integral_gain > 0 and self.model is None)

    def control(self, state: IntegralState, tracking: ControlInput) -> tuple[IntegralState, Vector, dict[str, Vector]]:
        """Evaluate τ = M̂ (q̈ᵈ − K2 (v̂ − q̇ᵈ) − K1 e1 + z) + ĝ(q)."""
        z = integrate(self, state, tracking, -self.integral_gain * (self.K1 @ tracking.error), self.integral_gain)
        torque = self.M @ (self.feedback(tracking) + z)
        if self.model is not None:
            estimate = tracking.estimate
            torque = torque + inertia_and_bias(self.model, estimate.position, 0 * estimate.velocity)[1]
        return remember(state, z, torque), torque, {"integral": z}
