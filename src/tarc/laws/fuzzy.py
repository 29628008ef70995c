"""Adaptive fuzzy control."""

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.types import Vector
from tarc.laws.base import ControlInput
from tarc.laws.lyapunov import solution
from tarc.laws.pole_placement import PolePlacement


class FuzzyState(NamedTuple):
    """Consequents [rad/s² or m/s²], one column per rule, shape (n, rules)."""

    consequents: Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class AdaptiveFuzzy(PolePlacement):
    """Adaptive fuzzy control: rules "if q is about c and q̇ about d, the robot accelerates by w", with adaptive w.

        f̂_j(q_j, q̇_j) = Σ_k w_jk φ_k(q_j, v̂_j),     Σ_k φ_k = 1
        τ = M̂ (q̈ᵈ − K2 (v̂ − q̇ᵈ) − K1 e1 − f̂),     s = BᵀP e
        ẇ_jk = adaptation_rate s_j φ_k,     |w_jk| ≤ max_consequent

    with P as in `CorlessLeitmann`, so that s = e1 + (v̂ − q̇ᵈ)/(ζ ωn) for scalar gains. Takes the parameters of
    `PolePlacement` and `Law`, and:

    Parameters
    ----------
    adaptation_rate
        Adaptation gain [1/s³]. While the joint stays within one rule it acts as an integral. With M̂ = M and ζ = 1 the
        poles are −ωn and the roots of σ² + ωn σ + adaptation_rate/ωn, which are complex above adaptation_rate = ωn³/4.
    max_consequent
        Greatest consequent [rad/s² or m/s²], and so the greatest |f̂|: above the acceleration to be learnt.
    memberships
        Number of membership functions for each of position and velocity; the rules are all their pairs.
    position_span, velocity_span
        The centres lie evenly over ±position_span [rad or m] and ±velocity_span [rad/s or m/s]; beyond them the
        outermost function counts. Choose what the reference covers.

    Notes
    -----
    Each joint has rules for its own motion alone. Membership functions are Gaussian, with the distance of the centres
    as standard deviation. Their products are normalised (a Takagi–Sugeno system of order zero). The adaptation is
    integrated by forward Euler. Projection on ±max_consequent keeps the consequents bounded. They are constant once the
    law has given up. Repeated motions improve; a new one starts over.

    References
    ----------
    After T. Das and I. N. Kar, IEEE Trans. Control Syst. Technol. 14(3), 2006, an adaptive fuzzy law for a wheeled
    robot; this decentralised version, its inputs, memberships and projection are ours. The adaptive law is that of
    L.-X. Wang, Stable adaptive fuzzy control of nonlinear systems, IEEE Trans. Fuzzy Syst. 1(2), 1993.
    """

    adaptation_rate: float
    max_consequent: float
    memberships: int = 5
    position_span: float = np.pi
    velocity_span: float = 2.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("adaptation_rate", "max_consequent", "position_span", "velocity_span"):
            check.number(name, getattr(self, name), 0, strict=True)
        check.integer("memberships", self.memberships, 2, 20)

    def linearisation_constants(self, gain: float) -> dict[str, float | None]:
        """Return the constants of every law, and the states that adapt."""
        return {**super().linearisation_constants(gain), "consequents": None}

    @cached_property
    def P(self) -> np.ndarray:
        """Return the solution of AᵀP + PA = −Q, shape (2n, 2n)."""
        return solution(self)

    def rules(self, position: Vector, velocity: Vector) -> list[Any]:
        """Return φ_k of each joint, one vector (n,) per rule; the index of velocity varies fastest."""
        grades = []
        for value, span in ((position, self.position_span), (velocity, self.velocity_span)):
            centres, width = np.linspace(-span, span, self.memberships, retstep=True)
            inside = ops.clip(value, -span, span)
            gaussians = [np.e ** (-(((inside - centre) / width) ** 2) / 2) for centre in centres]
            total = sum(gaussians)
            grades.append([gaussian / total for gaussian in gaussians])
        return [position_grade * velocity_grade for position_grade, velocity_grade in product(*grades)]

    def initial_state(self, torque: np.ndarray) -> FuzzyState:
        """Return consequents that balance the torque already applied."""
        first = np.clip(-np.linalg.solve(self.M, torque), -self.max_consequent, self.max_consequent)
        return FuzzyState(np.repeat(first[:, None], self.memberships**2, axis=1))

    def control(self, state: FuzzyState, tracking: ControlInput) -> tuple[FuzzyState, Vector, dict[str, Vector]]:
        """Evaluate τ = M̂ (q̈ᵈ − K2 (v̂ − q̇ᵈ) − K1 e1 − f̂) and adapt the consequents."""
        n, old = self.n_joints, state.consequents
        s = self.P[n:, :n] @ tracking.error + self.P[n:, n:] @ tracking.error_rate
        grades = self.rules(tracking.estimate.position, tracking.estimate.velocity)
        approximation: Vector = sum(old[:, k] * grade for k, grade in enumerate(grades))
        step = self.period * self.adaptation_rate * ops.where_or_zero(ops.logical_not(tracking.fault), s)
        consequents = old
        for k in reversed(range(len(grades))):  # pushed one by one, the first is in front at the end
            consequents = ops.shift_in(
                consequents, ops.clip(old[:, k] + step * grades[k], -self.max_consequent, self.max_consequent)
            )
        torque = self.M @ (self.feedback(tracking) - approximation)
        return FuzzyState(consequents), torque, {"disturbance_estimate": approximation}
