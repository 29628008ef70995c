"""Plants whose equations of motion are CasADi expressions."""

from abc import abstractmethod
from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.tracing import FixedCall
from tarc.core.types import Array, Vector
from tarc.core.validation import Numbers
from tarc.plants.base import Plant

MAX_INLINED = 2000
"""Instructions up to which a function becomes part of what calls it; longer ones stay calls, which compile sooner."""

MAX_INLINED_STEP = 2 * MAX_INLINED
"""The same for a step of the midpoint method, of which a period has one."""

FEW_STATES = 16
"""States up to which single calls over fixed memory are faster than one call of CasADi for all."""

MATRICES = ("inertia", "coriolis", "damping", "tangent", "tangent_at_rest", "inertia_slopes")


class ForwardDynamics(NamedTuple):
    """Symbols and expressions of M(q) q̈ = f(q, q̇, u), for joints that take something else than torques.

    Attributes
    ----------
    inputs
        Symbols of u, as `SymbolicPlant.joint_input` makes it.
    inertia
        M(q), (m, m).
    force
        f, (m, 1).
    """

    inputs: ca.SX
    inertia: ca.SX
    force: ca.SX


class InverseDynamics(NamedTuple):
    """Symbols of the acceleration (m, 1), and the expression of M(q) q̈ + N(q, q̇), (m, 1)."""

    acceleration: ca.SX
    torque: ca.SX


class Equations(NamedTuple):
    """Symbols and expressions of M(q) q̈ + N(q, q̇) = B τ.

    Attributes
    ----------
    q, dq
        Symbols of all coordinates and their velocities, each (m, 1).
    parameters
        Symbols of the physical parameters, by name.
    inertia
        M(q), (m, m).
    bias
        N(q, q̇), (m, 1), with all friction.
    friction
        Part of N that is friction of the joints.
    extra
        Further expressions of q, q̇ and the parameters, by name.
    forward
        What gives the acceleration in a simulation; None for M(q) q̈ = B τ − N(q, q̇).
    inverse
        Inverse dynamics where they are shorter than that; None for the sum of M(q) q̈ and N.
    """

    q: ca.SX
    dq: ca.SX
    parameters: dict[str, ca.SX]
    inertia: ca.SX
    bias: ca.SX
    friction: ca.SX
    extra: dict[str, ca.SX]
    forward: ForwardDynamics | None = None
    inverse: InverseDynamics | None = None


class _Functions:
    """Functions of the equations of motion, each made when it is first needed.

    Attributes
    ----------
    symbolic_fields
        Names of parameters that are known to be symbols of the equations, see `EulerLagrange.with_parameters`.
    """

    def __init__(self, equations: Equations, driven: tuple[int, ...]):
        q, dq, parameters, M, N, friction, extra, forward, inverse = equations
        n = q.shape[0]
        ddq = ca.SX.sym("ddq", n)
        needed = M @ ddq + N if inverse is None else ca.substitute(inverse.torque, inverse.acceleration, ddq)
        step = ca.SX.sym("step")
        if forward is None:
            forward = _torque_driven(M, N, driven)
            missing = forward.force + N - needed
        else:
            missing = forward.force - forward.inertia @ ddq
        inputs, mass, force = forward
        self._parameters = list(parameters.values())
        self.symbolic_fields: set[str] = set()
        self._functions: dict[str, ca.Function] = {}
        self._outputs: dict[str, tuple[list[ca.SX], Callable[[], ca.SX]]] = {
            "inertia": ([q], lambda: M),
            "bias": ([q, dq], lambda: N),
            "gravity": ([q], lambda: ca.substitute(N - friction, dq, ca.SX.zeros(*dq.shape))),
            "friction": ([q, dq], lambda: friction),
            "acceleration": ([q, dq, inputs], lambda: _Factors(mass).solve(force)),
            "midpoint": ([q, dq, inputs, step], lambda: _midpoint(mass, force, missing, (q, dq, ddq), step)),
            "damping": ([q, dq], lambda: ca.jacobian(N, dq)),
            "tangent": ([q, dq, ddq], lambda: ca.horzcat(M, ca.jacobian(N, dq), ca.jacobian(needed, q))),
        }
        for name, expression in extra.items():
            self._outputs[name] = ([q, dq], lambda expression=expression: expression)
        self.names = list(self._outputs)
        self._add_derivatives(q, dq, ddq)

    def _add_derivatives(self, q: ca.SX, dq: ca.SX, ddq: ca.SX) -> None:
        """Add what the searches over postures need: the tangent at rest, and derivatives over q."""
        n = q.shape[0]
        weight, tangent_weight = ca.SX.sym("weight", n, n), ca.SX.sym("weight", n, 3 * n)
        direction = ca.SX.sym("direction", n)

        def tangent() -> ca.SX:
            return self._outputs["tangent"][1]()

        def tangent_at_rest() -> ca.SX:
            return ca.substitute(tangent(), ca.vertcat(dq, ddq), ca.SX.zeros(2 * n))

        def inertia_rate() -> ca.SX:
            return ca.jtimes(ca.vec(inertia()), q, direction)

        inertia = self._outputs["inertia"][1]
        self._outputs |= {
            "tangent_at_rest": ([q], tangent_at_rest),
            "inertia_slopes": ([q], lambda: ca.jacobian(ca.vec(inertia()), q)),
            "inertia_gradient": ([q, weight], lambda: ca.gradient(ca.dot(weight, inertia()), q)),
            "inertia_rate_gradient": (
                [q, direction, weight],
                lambda: ca.gradient(ca.dot(ca.vec(weight), inertia_rate()), q),
            ),
            "tangent_gradient": (
                [q, dq, ddq, tangent_weight],
                lambda: ca.gradient(ca.dot(tangent_weight, tangent()), q),
            ),
            "tangent_gradient_at_rest": (
                [q, tangent_weight],
                lambda: ca.gradient(ca.dot(tangent_weight, tangent_at_rest()), q),
            ),
        }

    def get(self, name: str) -> ca.Function:
        if name not in self._functions:
            inputs, output = self._outputs[name]
            expression = ca.densify(output())
            self._functions[name] = ca.Function(name, [*inputs, *self._parameters], [expression], {"cse": True})
        return self._functions[name]


def _torque_driven(M: ca.SX, N: ca.SX, driven: tuple[int, ...]) -> ForwardDynamics:
    """Return the forward dynamics under torques on some coordinates."""
    torque = ca.SX.sym("torque", len(driven))
    if driven == tuple(range(len(driven))) and len(driven) == M.shape[0]:
        return ForwardDynamics(torque, M, torque - N)
    force = ca.SX.zeros(M.shape[0])
    force[list(driven)] = torque
    return ForwardDynamics(torque, M, force - N)


class _Factors:
    """Factors of a positive definite M = Lᵀ D L, made from the last coordinate to the first.

    The M of a tree of bodies has no fill-in in this order. Featherstone, Rigid Body Dynamics Algorithms, 2008, 6.5.
    """

    def __init__(self, M: ca.SX):
        n = M.shape[0]
        remainder = ca.SX(M)
        self._reciprocals = [ca.SX(0)] * n
        self._lower: dict[tuple[int, int], ca.SX] = {}
        for k in reversed(range(n)):
            self._reciprocals[k] = 1 / remainder[k, k]
            before = [i for i in range(k) if not remainder[k, i].is_zero()]
            for place, i in enumerate(before):
                self._lower[k, i] = remainder[k, i] * self._reciprocals[k]
                for j in before[: place + 1]:
                    remainder[i, j] -= self._lower[k, i] * remainder[k, j]

    def solve(self, right: ca.SX) -> ca.SX:
        """Return M⁻¹ times a column."""
        column = ca.densify(right)
        for (k, i), factor in self._lower.items():
            column[i] -= factor * column[k]
        column *= ca.vertcat(*self._reciprocals)
        for (k, i), factor in reversed(self._lower.items()):
            column[k] -= factor * column[i]
        return column


def _midpoint(mass: ca.SX, force: ca.SX, missing: ca.SX, motion: tuple[ca.SX, ca.SX, ca.SX], step: ca.SX) -> ca.SX:
    """Return the accelerations a₁ and a₂, one below the other, of a step by the midpoint method.

    Parameters
    ----------
    mass, force
        M(q) and f(q, q̇, u) of M q̈ = f.
    missing
        Force f(q, q̇, u) − M(q) q̈ that an acceleration leaves.
    motion
        Symbols of q, q̇ and q̈.
    step
        Symbol of h.
    """
    q, dq, _ = motion
    factors = _Factors(mass)
    first = factors.solve(force)
    middle = [q + step / 2 * dq + step**2 / 8 * first, dq + step / 2 * first, first]
    (left,) = ca.substitute([missing], list(motion), middle)
    return ca.vertcat(first, first + factors.solve(left))


class SymbolicPlant(Plant):
    """A robot M(q) q̈ + N(q, q̇) = B τ given by CasADi expressions.

    Its equations are fused with a law's into one function, compiled, and differentiated exactly. The parameters are
    inputs of all functions, so that other values need no new equations.
    """

    @abstractmethod
    def equations(self) -> Equations:
        """Return the equations of motion."""

    def joint_input(self, torque: Vector, disturbance: Vector) -> Vector:
        """Return what acts on the joints, the input of ``acceleration``, for outputs of the law and disturbances.

        Parameters
        ----------
        torque
            Output of the law, (n,) or (n, k).
        disturbance
            Torque of disturbances [N m or N], of the same shape.
        """
        return torque + disturbance

    @cached_property
    def _functions(self) -> "_Functions":
        return _Functions(self.equations(), self.driven)

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy or another process needs; it makes the functions again."""
        return {name: value for name, value in self.__dict__.items() if name not in ("_functions", "_calls")}

    def evaluate(self, quantity: str, *arguments: Vector, parameters: dict[str, Vector] | None = None) -> Any:
        """Evaluate one of the plant's functions, on arrays or on CasADi symbols.

        Parameters
        ----------
        quantity
            ``inertia`` M(q), ``bias`` N(q, q̇), ``gravity`` N(q, 0) without friction, ``friction`` F(q, q̇),
            ``acceleration`` q̈(q, q̇, u) for u of `joint_input`, ``damping`` ∂N/∂q̇ (q, q̇) or ``tangent``
            [M, ∂N/∂q̇, ∂(M q̈ + N)/∂q] (q, q̇, q̈). ``midpoint`` has the accelerations [a₁; a₂] of a step h of
            `tarc.simulation.closed_loop.midpoint` (q, q̇, u, h). Plants from energies have ``coriolis`` C + G (q, q̇)
            and ``energy`` T + V (q, q̇) too.
        arguments
            As in brackets, each of shape (m,) and τ (n,), or with k columns for k states at once.
        parameters
            Values that replace the plant's own, by name.

        Raises
        ------
        InvalidParameter
            For unknown names.
        """
        check.one_of("quantity", quantity, self._functions.names)
        for name in parameters or {}:
            check.one_of("parameters", name, self.parameters)
        values = {**self.parameters, **(parameters or {})}
        function = self._functions.get(quantity)
        if ops.symbolic(*arguments, *values.values()):
            longest = MAX_INLINED_STEP if quantity == "midpoint" else MAX_INLINED
            (result,) = function.call([*arguments, *values.values()], False, function.n_instructions() > longest)
            return result
        return _as_documented(quantity, np.array(function(*arguments, *values.values())))

    def inertia(self, position: Numbers) -> Array:
        """Return M(q) with rotor inertia [kg m² or kg], shape (m, m)."""
        return self._smooth("inertia", self._checked("position", position))

    def inertia_matrices(self, positions: Array) -> Array:
        """Return M(q) at the columns of coordinates (m, k), shape (k, m, m)."""
        n = self.n_coordinates
        if positions.shape[1] <= FEW_STATES:
            return np.array([self._smooth("inertia", position) for position in positions.T])
        return self.evaluate("inertia", positions).T.reshape(-1, n, n)

    def bias(self, position: Numbers, velocity: Numbers) -> Array:
        """Return N(q, q̇) without dry friction [N m or N], shape (m,)."""
        return self._smooth("bias", self._checked("position", position), self._checked("velocity", velocity))

    def biases(self, positions: Array, velocities: Array) -> Array:
        """Return N(q, q̇) of `bias` at the columns of arrays (m, k), shape (k, m)."""
        if positions.shape[1] <= FEW_STATES:
            return super().biases(positions, velocities)
        return np.array(self._functions.get("bias")(positions, velocities, *self._smooth_parameters.values())).T

    def linearised(
        self, position: Numbers, velocity: Numbers | None = None, acceleration: Numbers | None = None
    ) -> tuple[Array, Array, Array]:
        """Return M, D and G of M δq̈ + D δq̇ + G δq = δτ, the linearisation about a motion without dry friction."""
        q, v, a = self._motion(position, velocity, acceleration)
        is_moving = v.any() or a.any()
        tangent = self._smooth("tangent", q, v, a) if is_moving else self._smooth("tangent_at_rest", q)
        M, D, G = np.hsplit(tangent, 3)
        return M, D, G

    def linearised_at(self, positions: Array, velocities: Array, accelerations: Array) -> tuple[Array, Array, Array]:
        """Return M, D and G of `linearised` at k motions, the columns of arrays (m, k), each of shape (k, m, m)."""
        if positions.shape[1] <= FEW_STATES:
            return super().linearised_at(positions, velocities, accelerations)
        is_moving = np.any(velocities) or np.any(accelerations)
        name, motions = ("tangent", [velocities, accelerations]) if is_moving else ("tangent_at_rest", [])
        tangents = np.array(self._functions.get(name)(positions, *motions, *self._smooth_parameters.values()))
        M, D, G = tangents.T.reshape(-1, 3, *(2 * [self.n_coordinates])).transpose(1, 0, 3, 2)
        return M, D, G

    def tangent_gradient(
        self, position: Numbers, weight: Array, velocity: Numbers | None = None, acceleration: Numbers | None = None
    ) -> Array:
        """Return ∂⟨W, [M, D, G]⟩/∂q of the matrices of `linearised`, shape (n,), for a weight W (n, 3n)."""
        q, v, a = self._motion(position, velocity, acceleration)
        if v.any() or a.any():
            return self._smooth("tangent_gradient", q, v, a, weight)
        return self._smooth("tangent_gradient_at_rest", q, weight)

    def inertia_slopes(self, position: Numbers) -> Array:
        """Return ∂M/∂q_i, shape (n, n, n), the joint i first."""
        slopes = self._smooth("inertia_slopes", self._checked("position", position))
        return slopes.T.reshape(-1, self.n_coordinates, self.n_coordinates)

    def inertia_gradient(self, position: Numbers, weight: Array) -> Array:
        """Return ∂⟨W, M⟩/∂q, shape (n,), for a weight W (n, n)."""
        return self._smooth("inertia_gradient", self._checked("position", position), weight)

    def inertia_rate_gradient(self, position: Numbers, direction: Array, weight: Array) -> Array:
        """Return ∂⟨W, Σ d_i ∂M/∂q_i⟩/∂q, shape (n,), for a direction d (n,) and a weight W (n, n)."""
        return self._smooth("inertia_rate_gradient", self._checked("position", position), direction, weight)

    def damping(self, position: Numbers, velocity: Numbers | None = None) -> Array:
        """Return D = ∂N/∂q̇ without dry friction [N m s/rad or N s/m], shape (m, m); at rest by default."""
        q, v, _ = self._motion(position, velocity, None)
        return self._smooth("damping", q, v)

    def gravity_torque(self, position: Vector) -> Vector:
        """Return N(q, 0) without friction [N m or N], shape (m,); accepts CasADi symbols."""
        if ops.symbolic(position):
            return self.evaluate("gravity", position)
        return self._smooth("gravity", self._checked("position", position))

    @property
    def dry_friction(self) -> tuple[str, ...]:
        """Return the parameters that are zero without dry friction."""
        return ("coulomb",)

    @cached_property
    def _calls(self) -> dict[str, FixedCall]:
        """Calls with this plant's parameters and no dry friction, by quantity."""
        return {}

    @property
    def _smooth_parameters(self) -> dict[str, Array]:
        """Return the parameters without dry friction."""
        return {name: 0 * value if name in self.dry_friction else value for name, value in self.parameters.items()}

    def _smooth(self, quantity: str, *arguments: Array) -> Array:
        """Evaluate a function at numbers, without dry friction."""
        call = self._calls.get(quantity)
        if call is None:
            call = self._calls[quantity] = FixedCall(self._functions.get(quantity))
            for array, value in zip(call.inputs[len(arguments) :], self._smooth_parameters.values(), strict=True):
                array[:] = np.ravel(value)
        for array, argument in zip(call.inputs, arguments, strict=False):
            array[:] = np.ravel(argument, order="F")
        return _as_documented(quantity, call())

    def _checked(self, name: str, vector: Numbers) -> Array:
        return check.vector(name, vector, self.n_coordinates)


def _as_documented(quantity: str, numbers: Array) -> Any:
    """Return a matrix, a vector or a number, as `SymbolicPlant.evaluate` documents it."""
    if quantity in MATRICES:
        return numbers
    if quantity == "energy":
        return numbers.item()
    return numbers[:, 0] if numbers.shape[1] == 1 else numbers
