"""Computed torque: inverse dynamics by a model."""

from dataclasses import dataclass

import numpy as np

from tarc.core import validation as check
from tarc.core.types import Vector
from tarc.core.validation import Numbers
from tarc.laws.base import ControlInput
from tarc.laws.model_based import ModelBased, inertia_and_bias


@dataclass(frozen=True, kw_only=True, eq=False)
class ComputedTorque(ModelBased):
    """Computed torque: a model of the robot cancels its dynamics, and the error has the chosen poles.

        τ = M(q) (q̈ᵈ − K2 (v̂ − q̇ᵈ) − K1 e1) + N(q, v̂),     K1 = ωn²,  K2 = 2 ζ ωn

    Takes the parameters of `Law`, and:

    Parameters
    ----------
    model
        Robot of `tarc.plants` that gives M and N, such as the true one with another payload. In a scenario, ``robot``
        is the scenario's own.
    natural_frequency, damping_ratio
        ωn [rad/s] and ζ, one number or one per joint.

    Notes
    -----
    It shows the value of a model. With the true robot as the model, its error is a lower bound for laws without one. It
    has no integral: a load that the model lacks leaves an offset. A robot in symbols becomes part of the law and
    is compiled with it. A `tarc.plants.MujocoPlant` is called, in some 30 µs per period and without dry friction; such
    a law cannot be compiled. No certificate covers the law, since it has no constant M̂.

    Raises
    ------
    InvalidParameter
        For a model that is no robot of `tarc.plants`.

    References
    ----------
    J.-J. Slotine and W. Li, Applied Nonlinear Control, 1991, Section 9.1; J. Y. S. Luh, M. W. Walker and R. P. C. Paul,
    Resolved-acceleration control of mechanical manipulators, IEEE Trans. Autom. Control 25(3), 1980.
    """

    damping_ratio: Numbers = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check.vector("damping_ratio", self.damping_ratio, self.n_joints, 0, strict=True)

    def initial_state(self, torque: np.ndarray) -> tuple[()]:
        """Return no state."""
        return ()

    def control(self, state: tuple[()], tracking: ControlInput) -> tuple[tuple[()], Vector, dict[str, Vector]]:
        """Evaluate τ = M(q) u + N(q, v̂)."""
        estimate, zeta = tracking.estimate, np.asarray(self.damping_ratio)
        M, N = inertia_and_bias(self.model, estimate.position, estimate.velocity)
        proportional, derivative = self.omega**2, 2 * zeta * self.omega
        u = tracking.acceleration_reference - derivative * tracking.error_rate - proportional * tracking.error
        return state, M @ u + N, {"auxiliary": u}
