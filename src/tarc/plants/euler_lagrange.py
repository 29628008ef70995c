"""Euler–Lagrange plants from their energies, by symbolic differentiation."""

from abc import abstractmethod
from dataclasses import dataclass, fields, replace
from functools import cached_property
from types import SimpleNamespace
from typing import Any, Self

import casadi as ca
import numpy as np

from tarc.core import validation as check
from tarc.core.component import Component
from tarc.core.errors import InvalidParameter
from tarc.core.types import Vector
from tarc.plants.symbolic import Equations, SymbolicPlant


def joint_friction(dq: Vector, p: SimpleNamespace) -> Vector:
    """Return viscous and smoothed Coulomb friction [N m]: viscous q̇ + coulomb tanh(q̇ / coulomb_width)."""
    return p.viscous * dq + p.coulomb * ca.tanh(dq / p.coulomb_width)


@dataclass(frozen=True, kw_only=True, eq=False)
class EulerLagrange(Component, SymbolicPlant):
    """A plant given by kinetic energy T, potential energy V and further forces F and G.

        d/dt ∂T/∂q̇ − ∂T/∂q + ∂V/∂q + G(q, q̇) q̇ + F(q, q̇) = B τ

    so that M = ∂²T/∂q̇² and N = C q̇ + ∂V/∂q + G q̇ + F, with Christoffel's C, all by differentiation. A subclass is a
    frozen dataclass whose numeric fields are the physical parameters p. It defines T and V, and where needed F and the
    skew-symmetric G. `q`, `q̇` and the fields of `p` arrive as CasADi symbols. A mechanism with passive coordinates
    states their number by `n_coordinates`, and by `driven` the coordinates on which the torques act.
    """

    @abstractmethod
    def kinetic_energy(self, q: Vector, dq: Vector, p: SimpleNamespace) -> Vector:
        """Return T(q, q̇) [J]."""

    @abstractmethod
    def potential_energy(self, q: Vector, p: SimpleNamespace) -> Vector:
        """Return V(q) [J]."""

    def dissipation(self, q: Vector, dq: Vector, p: SimpleNamespace) -> Vector:
        """Return the friction torque F(q, q̇) [N m or N], shape (m, 1); by default none."""
        return 0 * dq

    def gyroscopic(self, q: Vector, dq: Vector, p: SimpleNamespace) -> Vector:
        """Return the skew-symmetric G(q, q̇) of forces that do no work, shape (m, m); by default none."""
        return ca.SX(self.n_coordinates, self.n_coordinates)

    def __post_init__(self) -> None:
        hidden = [field.name for field in fields(self) if callable(getattr(SymbolicPlant, field.name, None))]
        if hidden:
            raise InvalidParameter(
                f"{type(self).__name__}: its fields {', '.join(hidden)} hide methods that every plant has; rename them"
            )
        self.validate()
        q = np.linspace(0.1, 1.1, self.n_coordinates)
        if not np.isfinite(self.evaluate("energy", q, q)):
            raise InvalidParameter(
                f"{type(self).__name__}: its energy is not a number at q = {q.round(2).tolist()}; write the "
                "energies with CasADi's functions, such as casadi.sin, not with those of math"
            )
        self._check_inertia()

    def _check_inertia(self) -> None:
        """Refuse an inertia matrix that is not positive definite."""
        q = np.linspace(0.1, 1.1, self.n_coordinates)
        M = self.inertia(q)
        if not np.all(np.isfinite(M)) or np.linalg.eigvalsh(M)[0] <= 0:
            raise InvalidParameter(
                f"{type(self).__name__}: its inertia matrix is not positive definite at q = {q.round(2).tolist()}; "
                "check masses, lengths and inertias"
            )

    def validate(self) -> None:
        """Check the fields; raise an `InvalidParameter` that names the one at fault. By default nothing is checked."""

    @property
    def parameters(self) -> dict[str, np.ndarray]:
        """Return the numeric fields, as arrays that are read only."""
        return dict(self._arrays)

    @cached_property
    def _arrays(self) -> dict[str, np.ndarray]:
        arrays = {field.name: np.array(getattr(self, field.name), dtype=float) for field in fields(self)}
        for array in arrays.values():
            array.setflags(write=False)
        return arrays

    def equations(self) -> Equations:
        """Return the equations of motion, by differentiation of the energies."""
        n = self.n_coordinates
        q = ca.SX.sym("q", n)
        dq = ca.SX.sym("dq", n)
        symbols = {name: ca.SX.sym(name, max(value.size, 1)) for name, value in self.parameters.items()}
        p = SimpleNamespace(**symbols)
        T = self.kinetic_energy(q, dq, p)
        V = self.potential_energy(q, p)
        M = ca.densify(ca.hessian(T, dq)[0])
        coriolis = _christoffel(M, q, dq) + self.gyroscopic(q, dq, p)
        friction = self.dissipation(q, dq, p)
        N = coriolis @ dq + ca.gradient(V, q) + friction
        return Equations(q, dq, symbols, M, N, friction, {"coriolis": coriolis, "energy": T + V})

    def with_parameters(self, values: dict[str, Any]) -> Self:
        """Return the same plant with other fields.

        It shares the equations of this one for fields that are known to enter them as symbols. A field becomes known
        when it is first changed: both plants must then have the same energy and acceleration.
        """
        for name in values:
            check.one_of("parameters", name, self.parameters)
        functions = self._functions
        if type(self).__post_init__ is EulerLagrange.__post_init__ and functions.symbolic_fields.issuperset(values):
            plant = self._with_shared_equations(values)
            if plant is not None:
                return plant
        plant = replace(self, **values)
        functions.symbolic_fields |= self._fields_as_symbols(plant, values)
        return plant

    def _with_shared_equations(self, values: dict[str, Any]) -> Self | None:
        """Return the plant with other fields and this one's equations; None where the fields have another shape."""
        plant = object.__new__(type(self))
        for field in fields(self):
            value = values.get(field.name, getattr(self, field.name))
            object.__setattr__(plant, field.name, value.copy() if isinstance(value, np.ndarray) else value)
        plant.validate()
        own = self.parameters
        if any(np.shape(value) != np.shape(own[name]) for name, value in plant.parameters.items()):
            return None
        vars(plant)["_functions"] = self._functions
        plant._check_inertia()
        return plant

    def _fields_as_symbols(self, plant: Self, values: dict[str, Any]) -> set[str]:
        """Return the names of changed fields, if this plant's equations with another's fields are those of the other.

        None are returned otherwise: energies that use ``self.mass`` in place of ``p.mass`` hide a field.
        """
        theirs, own = plant.parameters, self.parameters
        changed = {name for name in values if not np.array_equal(theirs[name], own[name])}
        if any(np.shape(theirs[name]) != np.shape(own[name]) for name in own):
            return set()
        q = np.linspace(0.1, 1.1, self.n_coordinates)
        inputs = np.ones(np.shape(self.joint_input(np.ones(self.n_joints), np.ones(self.n_joints))))
        for quantity, arguments in (("energy", (q, q)), ("acceleration", (q, q, inputs))):
            expected = plant.evaluate(quantity, *arguments)
            if not np.allclose(self.evaluate(quantity, *arguments, parameters=theirs), expected, rtol=1e-9, atol=0):
                return set()
        return changed

    def spread(self, name: str, low: float = -np.inf, *, strict: bool = False) -> None:
        """Check a field that has one number per joint; one number stands for all."""
        numbers = check.vector(name, getattr(self, name), self.n_joints, low, strict=strict)
        object.__setattr__(self, name, tuple(numbers.tolist()))
        vars(self).pop("_arrays", None)


def _christoffel(M: ca.SX, q: ca.SX, dq: ca.SX) -> ca.SX:
    """Return Christoffel's C(q, q̇), which makes Ṁ − 2C skew-symmetric."""
    n = q.shape[0]
    slopes = [ca.reshape(ca.jacobian(ca.vec(M), q[k]), n, n) for k in range(n)]
    C = ca.SX(n, n)
    for i in range(n):
        for j in range(n):
            C[i, j] = sum((slopes[k][i, j] + slopes[j][i, k] - slopes[i][j, k]) * dq[k] for k in range(n)) / 2
    return C
