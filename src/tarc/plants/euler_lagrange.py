"""Euler–Lagrange plants from their energies, by symbolic differentiation."""

from abc import abstractmethod
from dataclasses import dataclass, fields, replace
from functools import cached_property
from types import SimpleNamespace
from typing import Any, Self

import casadi as ca
import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.component import Component
from tarc.core.errors import InvalidParameter
from tarc.core.types import Vector
from tarc.core.validation import Numbers
from tarc.plants.base import Plant


def joint_friction(dq: Vector, p: SimpleNamespace) -> Vector:
    """Return viscous and smoothed Coulomb friction [N m]: viscous q̇ + coulomb tanh(q̇ / coulomb_width)."""
    return p.viscous * dq + p.coulomb * ca.tanh(dq / p.coulomb_width)


@dataclass(frozen=True, kw_only=True, eq=False)
class EulerLagrange(Component, Plant):
    """A plant given by kinetic energy T, potential energy V and further forces F and G.

        d/dt ∂T/∂q̇ − ∂T/∂q + ∂V/∂q + G(q, q̇) q̇ + F(q, q̇) = τ

    so that M = ∂²T/∂q̇² and N = C q̇ + ∂V/∂q + G q̇ + F, with Christoffel's C, all by differentiation. A subclass is a
    frozen dataclass whose numeric fields are the physical parameters p. It defines T and V, and where needed F and the
    skew-symmetric G. `q`, `q̇` and the fields of `p` arrive as CasADi symbols.
    """

    @abstractmethod
    def kinetic_energy(self, q: Vector, dq: Vector, p: SimpleNamespace) -> Vector:
        """Return T(q, q̇) [J]."""

    @abstractmethod
    def potential_energy(self, q: Vector, p: SimpleNamespace) -> Vector:
        """Return V(q) [J]."""

    def dissipation(self, q: Vector, dq: Vector, p: SimpleNamespace) -> Vector:
        """Return the friction torque F(q, q̇) [N m or N], shape (n, 1); by default none."""
        return 0 * dq

    def gyroscopic(self, q: Vector, dq: Vector, p: SimpleNamespace) -> Vector:
        """Return the skew-symmetric G(q, q̇) of forces that do no work, shape (n, n); by default none."""
        return ca.SX(self.n_joints, self.n_joints)

    def __post_init__(self) -> None:
        self.validate()
        q = np.linspace(0.1, 1.1, self.n_joints)
        M = self.inertia(q)
        if not np.isfinite(self.evaluate("energy", q, q)):
            raise InvalidParameter(
                f"{type(self).__name__}: its energy is not a number at q = {q.round(2).tolist()}; write the "
                "energies with CasADi's functions, such as casadi.sin, not with those of math"
            )
        if not np.all(np.isfinite(M)) or np.linalg.eigvalsh(M)[0] <= 0:
            raise InvalidParameter(
                f"{type(self).__name__}: its inertia matrix is not positive definite at q = {q.round(2).tolist()}; "
                "check masses, lengths and inertias"
            )

    def validate(self) -> None:
        """Check the fields; raise an `InvalidParameter` that names the one at fault. By default nothing is checked."""

    @property
    def parameters(self) -> dict[str, np.ndarray]:
        """Return the numeric fields."""
        return {field.name: np.array(getattr(self, field.name), dtype=float) for field in fields(self)}

    @cached_property
    def _model(self) -> dict[str, ca.Function]:
        n = self.n_joints
        q, dq, ddq, tau = (ca.SX.sym(name, n) for name in ("q", "dq", "ddq", "tau"))
        symbols = [ca.SX.sym(name, max(value.size, 1)) for name, value in self.parameters.items()]
        p = SimpleNamespace(**dict(zip(self.parameters, symbols, strict=True)))
        T, V = self.kinetic_energy(q, dq, p), self.potential_energy(q, p)
        M = ca.densify(ca.hessian(T, dq)[0])
        slopes = [ca.reshape(ca.jacobian(ca.vec(M), q[k]), n, n) for k in range(n)]
        C = ca.SX(n, n)
        for i in range(n):
            for j in range(n):
                C[i, j] = sum((slopes[k][i, j] + slopes[j][i, k] - slopes[i][j, k]) * dq[k] for k in range(n)) / 2
        coriolis = C + self.gyroscopic(q, dq, p)
        gravity = ca.gradient(V, q)
        friction = self.dissipation(q, dq, p)
        N = coriolis @ dq + gravity + friction
        D, L, order = ca.ldl(M)
        acceleration = ca.ldl_solve(tau - N, D, L, order)
        tangent = ca.horzcat(M, ca.jacobian(N, dq), ca.jacobian(M @ ddq + N, q))

        def function(name: str, inputs: list[Any], output: Vector) -> ca.Function:
            return ca.Function(name, [*inputs, *symbols], [ca.densify(output)], {"cse": True})

        return {
            "inertia": function("inertia", [q], M),
            "coriolis": function("coriolis", [q, dq], coriolis),
            "bias": function("bias", [q, dq], N),
            "gravity": function("gravity", [q], gravity),
            "friction": function("friction", [q, dq], friction),
            "energy": function("energy", [q, dq], T + V),
            "acceleration": function("acceleration", [q, dq, tau], acceleration),
            "tangent": function("tangent", [q, dq, ddq], tangent),
        }

    def with_parameters(self, values: dict[str, Any]) -> Self:
        """Return the same plant with other fields."""
        for name in values:
            check.one_of("parameters", name, self.parameters)
        return replace(self, **values)

    def evaluate(self, quantity: str, *arguments: Vector, parameters: dict[str, Any] | None = None) -> Vector:
        """Evaluate one of the model's functions, on arrays or on CasADi symbols.

        Parameters
        ----------
        quantity
            ``inertia`` M(q), ``coriolis`` C + G (q, q̇), ``bias`` N(q, q̇), ``gravity`` ∂V/∂q (q), ``friction``
            F(q, q̇), ``energy`` T + V (q, q̇), ``acceleration`` q̈(q, q̇, τ), ``tangent`` [M, ∂N/∂q̇, ∂(M q̈ + N)/∂q]
            (q, q̇, q̈).
        arguments
            As in brackets, each of shape (n,).
        parameters
            Values that replace the plant's own, by name.
        """
        check.one_of("quantity", quantity, self._model)
        for name in parameters or {}:
            check.one_of("parameters", name, self.parameters)
        values = {**self.parameters, **(parameters or {})}
        result = self._model[quantity](*arguments, *values.values())
        if ops.symbolic(*arguments, *values.values()):
            return result
        numbers = np.array(result)
        return (
            numbers
            if quantity in ("inertia", "coriolis", "tangent")
            else numbers[:, 0]
            if quantity != "energy"
            else numbers.item()
        )

    def inertia(self, position: Numbers) -> np.ndarray:
        """Return M(q) [kg m² or kg], shape (n, n)."""
        return self.evaluate("inertia", self._position(position))

    def bias(self, position: Numbers, velocity: Numbers) -> np.ndarray:
        """Return N(q, q̇) without dry friction [N m or N], shape (n,)."""
        return self.evaluate("bias", self._position(position), self._position(velocity), parameters=self._smooth)

    def linearised(
        self, position: Numbers, velocity: Numbers | None = None, acceleration: Numbers | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return M, D and G of M δq̈ + D δq̇ + G δq = δτ, the linearisation about a motion without dry friction."""
        motion = self._motion(position, velocity, acceleration)
        M, D, G = np.hsplit(self.evaluate("tangent", *motion, parameters=self._smooth), 3)
        return M, D, G

    @property
    def _smooth(self) -> dict[str, np.ndarray] | None:
        """Return the parameters without dry friction."""
        return {"coulomb": 0 * self.parameters["coulomb"]} if "coulomb" in self.parameters else None

    def gravity_torque(self, position: Vector) -> Vector:
        """Return ∂V/∂q [N m or N], shape (n,); accepts CasADi symbols."""
        return self.evaluate("gravity", position if ops.symbolic(position) else self._position(position))

    def spread(self, name: str, low: float = -np.inf, *, strict: bool = False) -> None:
        """Check a field that has one number per joint; one number stands for all."""
        numbers = check.vector(name, getattr(self, name), self.n_joints, low, strict=strict)
        object.__setattr__(self, name, tuple(numbers.tolist()))

    def _position(self, position: Numbers) -> np.ndarray:
        return check.vector("position", position, self.n_joints)
