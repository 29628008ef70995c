"""Adaptive robust control with projection."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Vector
from tarc.laws.base import ControlInput
from tarc.laws.model_based import ModelBased
from tarc.plants.euler_lagrange import EulerLagrange


class ParameterState(NamedTuple):
    """Estimates p̂ of the uncertain parameters, shape (k,)."""

    adapted: Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class ProjectionARC(ModelBased):
    """Adaptive robust control: physical parameters adapt within known bounds, and a robust term covers their error.

        s = v̂ − q̇ᵣ,     q̇ᵣ = q̇ᵈ − Ω e1,     Ω = diag ωn
        τ = M(q; p̂) q̈ᵣ + C(q, v̂; p̂) q̇ᵣ + ∂V/∂q(q; p̂) + F(q, q̇ᵣ; p̂) − Ω^½ M(q; p0) Ω^½ s − h s/max(|s|, ε)
        dp̂/dt = −Γ Yᵀ s, projected on p_min ≤ p̂ ≤ p_max
        Y = ∂τ/∂p̂,     Γ = adaptation_gain (p_max − p_min)²
        h = robust_fraction Σ_i |Y_i| (p_max − p_min)_i + disturbance_bound

    Takes the parameters of `Law`, and:

    Parameters
    ----------
    model
        A robot with energies (`tarc.plants.EulerLagrange`), whose own parameters p0 are the initial p̂. In a scenario,
        ``robot`` is the scenario's own.
    parameter_bounds
        Uncertain parameters, each with its least and greatest value: ``{"masses": [0.5, 2.0]}``. A parameter with one
        value per joint adapts each of them. The dynamics must be affine in all of them together: masses, or payload, or
        friction, but not masses and lengths.
    natural_frequency
        ωn [rad/s], one number or one per joint. For the right p̂ and equal ωn, both poles of the error lie at −ωn.
    adaptation_gain
        Γ over the squared ranges [1/J]: 0 for none.
    robust_fraction
        Share of the largest error of p̂ that the robust term covers; 1 by the theory, 0 without a robust term.
    disturbance_bound
        Disturbance torque that the robust term covers too [N m or N].
    boundary_layer
        ε [rad/s or m/s], the layer in which the robust term is linear, with the slope h/ε.

    Notes
    -----
    The regressor Y is that of Slotine and Li, by differentiation of the model. Bounds, projection and the robust term
    make it the adaptive robust control of Yao and Tomizuka. Additions: friction is taken at q̇ᵣ, where it is free of
    noise. The robust term is a saturation per joint, which meets their two conditions and adds at most h ε/4 per joint
    to V̇. The adaptation is integrated by forward Euler, and the feedback gain is Ω^½ M Ω^½. Parameters converge only
    under a reference that excites them; s goes to zero under any.

    Raises
    ------
    InvalidParameter
        For a model that is no `EulerLagrange`, unknown parameters, and dynamics that are not affine in them. Also for
        bounds that are not in order or exclude the model's own value.

    References
    ----------
    J.-J. Slotine and W. Li, On the adaptive control of robot manipulators, Int. J. Robotics Research 6(3), 1987;
    B. Yao and M. Tomizuka, Adaptive robust control of SISO nonlinear systems in a semi-strict feedback form, Automatica
    33(5), 1997; paper, Section I, on what it needs that TARC does without.
    """

    parameter_bounds: dict[str, Sequence[float]]
    adaptation_gain: float = 1.0
    robust_fraction: float = 1.0
    disturbance_bound: float = 0.0
    boundary_layer: float = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("adaptation_gain", "robust_fraction", "disturbance_bound"):
            check.number(name, getattr(self, name), 0)
        check.number("boundary_layer", self.boundary_layer, 0, strict=True)
        model = self.robot
        if not isinstance(self.parameter_bounds, dict) or not self.parameter_bounds:
            raise InvalidParameter(
                f"parameter_bounds: got {self.parameter_bounds!r}; needs least and greatest by name, such as "
                f"masses: [0.5, 2]"
            )
        for name, pair in self.parameter_bounds.items():
            check.one_of("parameter_bounds", name, model.parameters)
            low, high = check.vector(f"bounds of {name}", pair, 2)
            nominal = model.parameters[name]
            if not (low < high and np.all(nominal >= low) and np.all(nominal <= high)):
                raise InvalidParameter(
                    f"bounds of {name}: got {low:g} to {high:g}; the model's own is {nominal.tolist()}"
                )
        _ = self.model_torque

    def linearisation_constants(self, gain: float) -> dict[str, float | None]:
        """Return the constants of every law, and the states that adapt."""
        return {**super().linearisation_constants(gain), "adapted": None}

    @property
    def robot(self) -> EulerLagrange:
        """Return the model, which must have energies."""
        if not isinstance(self.model, EulerLagrange):
            raise InvalidParameter(
                f"model: got {self.model!r}; this law differentiates the model with respect to its parameters, which "
                "needs one from energies, such as TwoLinkArm or NLinkArm"
            )
        return self.model

    @cached_property
    def labels(self) -> list[str]:
        """Return a name for each of the k numbers that adapt."""
        sizes = {name: self.robot.parameters[name].size for name in self.parameter_bounds}
        return [f"{name}{i + 1}" if size > 1 else name for name, size in sizes.items() for i in range(size)]

    @cached_property
    def limits(self) -> np.ndarray:
        """Return least and greatest p̂, shape (2, k)."""
        sizes = [self.robot.parameters[name].size for name in self.parameter_bounds]
        return np.repeat(
            np.array([list(pair) for pair in self.parameter_bounds.values()], dtype=float), sizes, axis=0
        ).T

    @cached_property
    def nominal(self) -> np.ndarray:
        """Return p0, shape (k,)."""
        return np.concatenate([self.robot.parameters[name].ravel() for name in self.parameter_bounds])

    @cached_property
    def model_torque(self) -> ca.Function:
        """Return the function of (q, v̂, q̇ᵣ, q̈ᵣ) for the torque at p = 0, (n,), the regressor Y, (n, k), and M(q;
        p0)."""
        model, n = self.robot, self.n_joints
        q, v, rate, acceleration = (ca.SX.sym(name, n) for name in ("q", "v", "rate", "acceleration"))
        p = ca.SX.sym("p", len(self.nominal))
        values, start = {}, 0
        for name in self.parameter_bounds:
            size = model.parameters[name].size
            values[name] = p[start : start + size]
            start += size

        def at_parameters(quantity: str, *arguments: Vector) -> Vector:
            return model.evaluate(quantity, *arguments, parameters=values)

        torque = (
            at_parameters("inertia", q) @ acceleration
            + at_parameters("coriolis", q, v) @ rate
            + at_parameters("gravity", q)
        )
        torque += at_parameters("friction", q, rate)
        if not ca.is_linear(torque, p):
            raise InvalidParameter(
                f"parameter_bounds: the dynamics of {type(model).__name__} are not affine in "
                f"{', '.join(self.parameter_bounds)} together; "
                "leave out those that multiply the others, such as lengths where there are masses"
            )
        regressor = ca.densify(ca.jacobian(torque, p))
        constant = ca.densify(ca.substitute(torque, p, 0 * self.nominal))
        arguments = [q, v, rate, acceleration]
        return ca.Function(
            "model_torque", arguments, [constant, regressor, model.evaluate("inertia", q)], {"cse": True}
        )

    def initial_state(self, torque: np.ndarray) -> ParameterState:
        """Return the model's own parameters."""
        return ParameterState(self.nominal)

    def control(
        self, state: ParameterState, tracking: ControlInput
    ) -> tuple[ParameterState, Vector, dict[str, Vector]]:
        """Sum the model's torque at p̂, feedback and robust term; adapt p̂."""
        estimate, old = tracking.estimate, state.adapted
        s = tracking.error_rate + self.omega * tracking.error
        rate = estimate.velocity - s
        acceleration = tracking.acceleration_reference - self.omega * tracking.error_rate
        arguments: list[Vector] = [estimate.position, estimate.velocity, rate, acceleration]
        parts = self.model_torque(*arguments)
        if not ops.symbolic(s):
            parts = np.array(parts[0])[:, 0], np.array(parts[1]), np.array(parts[2])
        constant, Y, M = parts

        low, high = self.limits
        root = np.diag(self.omega**0.5)
        h = self.robust_fraction * (abs(Y) @ (high - low)) + self.disturbance_bound
        robust = h * s / ops.maximum(abs(s), self.boundary_layer)
        torque = constant + Y @ old - root @ (M @ (root @ s)) - robust

        step = self.period * self.adaptation_gain * (high - low) ** 2 * (Y.T @ s)
        step = ops.where_or_zero(ops.logical_and(ops.logical_not(tracking.fault), ops.finite(step)), step)
        adapted = ops.clip(old - step, low, high)
        signals = {f"adapted_{label}": old[i] for i, label in enumerate(self.labels)}
        return ParameterState(adapted), torque, {**signals, "surface": s}
