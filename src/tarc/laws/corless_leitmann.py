"""Robust control with a known bound, continuous inside a layer."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.types import Vector
from tarc.laws.base import ControlInput
from tarc.laws.lyapunov import solution
from tarc.laws.model_based import check_model, inertia_and_bias
from tarc.laws.pole_placement import PolePlacement
from tarc.plants.base import Plant


@dataclass(frozen=True, kw_only=True, eq=False)
class CorlessLeitmann(PolePlacement):
    """Robust control by a bound: for any uncertainty within ρ, the error enters a ball and stays there.

        τ = M̂ (q̈ᵈ − K2 (v̂ − q̇ᵈ) − K1 e1 + Δu) + N̂(q, v̂)
        Δu = −ρ s / max(‖s‖, ε),     s = BᵀP e,     AᵀP + PA = −Q = −diag(K1 + K1ᵀ, 2 I)

    Takes the parameters of `PolePlacement` and `Law`, and:

    Parameters
    ----------
    uncertainty_bound
        ρ [rad/s² or m/s²], above the norm of the acceleration that M̂ and N̂ leave unexplained.
    boundary_layer
        ε [unit of s, for scalar gains that of e1]: the layer in which Δu is linear with the slope ρ/ε.
    model
        N̂: a nominal robot, whose Coriolis, gravity and friction torque are added; None for N̂ = 0. In a scenario,
        ``robot`` is the scenario's own.

    Notes
    -----
    This is the robust term of TARC with a known gain instead of an adapted one, and with a velocity in s. The paper's
    layer is ρ ‖s‖ ≤ ε', so ε = ε'/ρ; its ρ may depend on state and time, and is constant here. Use it where a bound is
    known, without time-delay estimation. Sampled, and with a delayed velocity, a large ρ/ε chatters.
    `tarc.certificates.certify_constant_ratio` decides whether the loop inside the layer is stable (without N̂). The
    certificate of a robot does not cover N̂, and refuses a law with a model.

    Raises
    ------
    InvalidParameter
        For a model of another number of joints.

    References
    ----------
    M. Corless and G. Leitmann, Continuous state feedback guaranteeing uniform ultimate boundedness for uncertain
    dynamic systems, IEEE Trans. Autom. Control 26(5), 1981.
    """

    uncertainty_bound: float
    boundary_layer: float = 0.01
    model: Plant | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check.number("uncertainty_bound", self.uncertainty_bound, 0)
        check.number("boundary_layer", self.boundary_layer, 0, strict=True)
        if self.model is not None:
            check_model(self.model, self.n_joints)

    @cached_property
    def P(self) -> np.ndarray:
        """Return the solution of AᵀP + PA = −Q, shape (2n, 2n)."""
        return solution(self)

    @property
    def has_model(self) -> bool:
        """Return whether N̂ is given."""
        return self.model is not None

    def without_model(self) -> Self:
        """Return this law with N̂ = 0."""
        return replace(self, model=None)

    @property
    def error_bound(self) -> float:
        """Return the final bound on ‖e1‖ [rad or m], for the law in continuous time with true derivatives.

        With V = eᵀPe, M̂ = M and an uncertainty within ρ, V̇ ≤ −eᵀQe + ρε/2, so that V ends below
        ρ ε λmax(Q⁻¹P)/2 and ‖e1‖² below that over the least eigenvalue of (the e1 block of P⁻¹)⁻¹.
        """
        n, P = self.n_joints, self.P
        Q = -(self.A.T @ P + P @ self.A)
        level = self.uncertainty_bound * self.boundary_layer / 2 * np.max(np.linalg.eigvals(np.linalg.solve(Q, P)).real)
        return float(np.sqrt(level * np.linalg.eigvalsh(np.linalg.inv(P)[:n, :n])[-1]))

    def initial_state(self, torque: np.ndarray) -> tuple[()]:
        """Return no state."""
        return ()

    def control(self, state: tuple[()], tracking: ControlInput) -> tuple[tuple[()], Vector, dict[str, Vector]]:
        """Evaluate τ = M̂ (q̈ᵈ − K2 (v̂ − q̇ᵈ) − K1 e1 + Δu) + N̂(q, v̂)."""
        n = self.n_joints
        s = self.P[n:, :n] @ tracking.error + self.P[n:, n:] @ tracking.error_rate
        correction = -self.uncertainty_bound * s / ops.norm(s, self.boundary_layer)
        torque = self.M @ (self.feedback(tracking) + correction)
        if self.model is not None:
            _, bias = inertia_and_bias(self.model, tracking.estimate.position, tracking.estimate.velocity)
            torque = torque + bias
        return state, torque, {"surface": s}
