"""The sampled loop of a law, linearised at rest by automatic differentiation of the law's own code."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from tarc.control.digital_controller import ControllerInput, DigitalController
from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.errors import NotLinearisable, UnsupportedLaw
from tarc.core.tracing import numpy_on_symbols
from tarc.core.trees import leaves, names, pack, rebuild
from tarc.core.types import Array, Vector
from tarc.estimators.oracle import refuse_oracle
from tarc.laws.base import Law
from tarc.laws.nominal_inertia import NominalInertia
from tarc.laws.pole_placement import PolePlacement
from tarc.signals.sensors import Encoder


@dataclass(frozen=True)
class Channel:
    """One of the independent loops that a law makes around q̈ = ρ M̂⁻¹ τ.

        x⁺ = F x + G q + H w,     v = M̂⁻¹ τ = C x + D q + E w,     q̈ = ρ v over each period T

    Attributes
    ----------
    F, G, H, C, D, E
        Matrices of the controller; w is what a robust term Δu adds to the auxiliary input.
    period
        T [s].
    joints
        Indices of the joints that have this loop.
    """

    F: Array
    G: Array
    H: Array
    C: Array
    D: Array
    E: Array
    period: float
    joints: tuple[int, ...]

    @property
    def n_coupled(self) -> int:
        """Number of joints in the loop: 1 unless the gains couple them."""
        return self.D.shape[0]

    def closed_loop(self, ratio: float | Array) -> tuple[Array, Array, Array, Array, Array]:
        """Return A, B, C, W, V of the loop around q̈ = ρ v under zero-order hold.

            y⁺ = A y + B a + W w,     v = C y + V w

        The state y contains q, q̇ T and x. The input a is an acceleration in addition to ρ v, held over each period.
        The velocity is scaled by the period, so that rounding does not depend on it.

        Parameters
        ----------
        ratio
            ρ, or M⁻¹M̂ itself, shape (n, n).
        """
        n, n_states = self.n_coupled, self.F.shape[0]
        ratio = ratio * np.eye(n) if np.ndim(ratio) == 0 else np.asarray(ratio)
        identity, T2 = np.eye(n), self.period**2
        A, B, C = np.zeros((2 * n + n_states,) * 2), np.zeros((2 * n + n_states, n)), np.zeros((n, 2 * n + n_states))
        A[: 2 * n, : 2 * n] = np.eye(2 * n)
        A[:n, n : 2 * n] = identity
        A[2 * n :, :n], A[2 * n :, 2 * n :] = self.G, self.F
        B[:n], B[n : 2 * n] = T2 / 2 * identity, T2 * identity
        C[:, :n], C[:, 2 * n :] = self.D, self.C
        W = B @ ratio @ self.E
        W[2 * n :] += self.H
        return A + B @ ratio @ C, B, C, W, self.E

    def state_matrix(self, ratio: float | Array) -> Array:
        """Return A of the loop around q̈ = ρ v."""
        return self.closed_loop(ratio)[0]

    def with_delay(self, periods: int) -> "Channel":
        """Return the loop with v delayed by additional periods; the newest v is first among the added states."""
        if periods == 0:
            return self
        n, n_states, n_added = self.n_coupled, self.F.shape[0], self.n_coupled * periods
        F = np.zeros((n_states + n_added, n_states + n_added))
        F[:n_states, :n_states] = self.F
        F[n_states : n_states + n, :n_states] = self.C
        F[n_states + n :, n_states:-n] = np.eye(n_added - n)
        padding, zero = np.zeros((n_added - n, n)), np.zeros((n, n))
        G, H = np.concatenate([self.G, self.D, padding]), np.concatenate([self.H, self.E, padding])
        C = np.concatenate([np.zeros((n, n_states + n_added - n)), np.eye(n)], axis=1)
        return replace(self, F=F, G=G, H=H, C=C, D=zero, E=zero)


def require_inertia(law: Law, purpose: str) -> PolePlacement:
    """Return a law that has a nominal inertia M̂.

    Raises
    ------
    UnsupportedLaw
        For any other law.
    """
    if not isinstance(law, PolePlacement):
        raise UnsupportedLaw(
            f"law: got {type(law).__name__}; {purpose} needs a law with an inertia M̂, such as tarc.laws.TDC"
        )
    return law


def refuse_nominal_inertia(law: PolePlacement, purpose: str) -> None:
    """Refuse a law whose M̂(q) comes from a model.

    Raises
    ------
    UnsupportedLaw
        For such a law, with what applies to it.
    """
    if isinstance(law.inertia, NominalInertia):
        raise UnsupportedLaw(
            f"law: {type(law).__name__} has M̂(q) from a model, which {purpose} does not cover, since M̂ changes with "
            "the posture; use tarc.certificates.certify_known_inertia"
        )


def decoupled_channels(law: Law, computation_delay: int = 0, gain: float = 0.0) -> list[Channel]:
    """Return the independent loops of a law around q̈ = ρ M̂⁻¹ τ, each once.

    With scalar K1 and K2, or with diagonal ones and no gain, the joints decouple in coordinates M̂^½ q. For diagonal
    gains the coordinates are M̂⁻¹τ. So n joints cost only what their different gains cost. For M̂(q) of a model v is the
    law's acceleration, M̂(q)⁻¹ (τ − ĥ), and the loops hold at each posture. Feed-forward does not change them.

    Parameters
    ----------
    law
        A law with an inertia M̂.
    computation_delay
        Periods between a measurement and its torque.
    gain
        Frozen switching gain ĉ [rad/s²]. Inside its boundary layer the law adds α ĉ P2/ε to K1.

    Raises
    ------
    UnsupportedLaw
        For a law without an inertia.
    NotLinearisable
        For a law that has no linearisation at rest.
    InvalidParameter
        For a negative delay or gain.
    """
    law = require_inertia(law, "its linearisation")
    check.number("gain", gain, 0)
    check.integer("computation_delay", computation_delay)
    K1, K2 = law.K1, law.K2
    P2 = law.P2 if gain else None
    scalar = all(_is_scalar(K) for K in (K1, K2)) and (P2 is None or _is_scalar(P2))
    diagonal = all(np.abs(K - np.diag(np.diag(K))).max() <= 1e-9 * np.abs(K).max() for K in (K1, K2))
    if not (scalar or (diagonal and not gain)):
        return [_linearise(law, gain, tuple(range(law.n_joints))).with_delay(computation_delay)]
    joints_of: dict[tuple[float, float], list[int]] = {}
    for joint in range(law.n_joints):
        joints_of.setdefault((float(K1[joint, joint]), float(K2[joint, joint])), []).append(joint)
    weight = None if P2 is None else float(P2[0, 0])
    return [
        _linearise(law.single_joint(*gains, weight), gain, tuple(joints)).with_delay(computation_delay)
        for gains, joints in joints_of.items()
    ]


def coupled_channel(law: PolePlacement, computation_delay: int = 0) -> Channel:
    """Return the loop of all joints at once without a switching gain, for any M⁻¹M̂."""
    return _linearise(law, 0.0, tuple(range(law.n_joints))).with_delay(computation_delay)


def joints_share_loop(law: Law) -> bool:
    """Return whether all joints have the same loop: K1, K2 and P2 are multiples of the identity."""
    if not isinstance(law, PolePlacement):
        return False
    matrices = [law.K1, law.K2] if law.P2 is None else [law.K1, law.K2, law.P2]
    return all(_is_scalar(K) for K in matrices)


def _is_scalar(K: Array) -> bool:
    return bool(np.abs(K - K[0, 0] * np.eye(len(K))).max() <= 1e-9 * abs(K[0, 0]))


def posture_channels(law: Law, computation_delay: int = 0) -> Callable[[Array], Channel]:
    """Return a function from a posture q (n,) to the loop of all joints there, whose v is the torque itself.

    This is for any law, also one with a model of the robot: its slopes are those at rest in the posture.

    Parameters
    ----------
    law
        The law.
    computation_delay
        Periods between a measurement and its torque.

    Raises
    ------
    UnsupportedLaw
        For an estimator that is given the true derivatives.
    NotLinearisable
        From the returned function, for a law that has no linearisation at rest.
    """
    refuse_oracle(law.estimator)
    slopes = _slopes_at_rest(law, 0.0, anywhere=True)

    def channel(posture: Array) -> Channel:
        F, G, H, C, D, E = _required_slopes(law, *slopes(posture))
        joints = tuple(range(law.n_joints))
        return Channel(F=F, G=G, H=H, C=C, D=D, E=E, period=law.period, joints=joints).with_delay(computation_delay)

    return channel


def _linearise(law: PolePlacement, gain: float, joints: tuple[int, ...]) -> Channel:
    """Return the Jacobian of the traced controller at rest with N̂ = 0; states that adapt or count are constant."""
    refuse_oracle(law.estimator)
    law = law.without_model()
    F, G, H, C, D, E = _required_slopes(law, *_slopes_at_rest(law, gain)(np.zeros(law.n_joints)))
    M_inverse = np.linalg.inv(law.M)
    return Channel(F=F, G=G, H=H, C=M_inverse @ C, D=M_inverse @ D, E=M_inverse @ E, period=law.period, joints=joints)


def parametric_channel(law: PolePlacement, symbolic: PolePlacement, parameters: ca.SX) -> Callable[[Array], Channel]:
    """Return a function from numbers of a law to its loop, traced once for all of them.

    Parameters
    ----------
    law
        The law of one joint with M̂ = 1 and without a model, as `decoupled_channels` linearises it.
    symbolic
        The same law with symbols in place of some numbers.
    parameters
        These symbols, shape (p, 1).
    """
    slopes = _slopes_at_rest(law, 0.0, symbolic=symbolic, parameters=parameters)

    def channel(values: Array) -> Channel:
        F, G, H, C, D, E = _required_slopes(law, *slopes(np.zeros(law.n_joints), values))
        return Channel(F=F, G=G, H=H, C=C, D=D, E=E, period=law.period, joints=(0,))

    return channel


def _required_slopes(law: Law, J: Array, n_states: int) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Return F, G, H, C, D, E out of the slopes of a law, without the states that do not matter."""
    n = law.n_joints
    if not np.all(np.isfinite(J)):
        raise NotLinearisable(
            f"law: {type(law).__name__} with {type(law.estimator).__name__} has no linearisation at rest, where a "
            "slope is infinite; certificates of the loop need a linear estimator, such as tarc.estimators.Algebraic"
        )
    F, inputs = J[:n_states, :n_states], J[:n_states, n_states:]
    outputs, direct = J[n_states:, :n_states], J[n_states:, n_states:]
    used = _required_states(F, inputs, outputs)
    F, inputs, outputs = F[np.ix_(used, used)], inputs[used], outputs[:, used]
    return F, inputs[:, :n], inputs[:, n:], outputs, direct[:, :n], direct[:, n:]


def _slopes_at_rest(
    law: Law,
    gain: float,
    anywhere: bool = False,
    *,
    symbolic: Law | None = None,
    parameters: ca.SX | None = None,
) -> Callable[..., tuple[Array, int]]:
    """Return a function to the slopes of (x⁺, τ) over (x, q, w) at rest in a posture, and the number of states x.

    The acceleration reference enters the auxiliary input as Δu does, so its columns are those of w. Unless it is for
    ``anywhere``, the posture is zero. With the law in symbols, the function takes the numbers for the parameters too.
    """
    controller = DigitalController(Encoder(), law)
    n, zero = law.n_joints, np.zeros(law.n_joints)
    state = controller.init(zero)
    labels = [label.split(".")[-1] for label in names(state)]
    constants = law.linearisation_constants(gain)
    values = [
        leaf if constants.get(label) is None else constants[label] + 0 * leaf
        for label, leaf in zip(labels, leaves(state), strict=True)
    ]
    # constant states and the reference stay numbers where they can, so that the graph is that of the loop alone
    varying = [i for i, label in enumerate(labels) if label not in constants]
    symbols = {i: ca.SX.sym("x", *(*np.shape(values[i]), 1, 1)[:2]) for i in varying}
    position, acceleration = ca.SX.sym("q", n), ca.SX.sym("a", n)
    reference = ca.SX.sym("r", n) if anywhere else zero
    symbolic_state = rebuild(state, [symbols.get(i, value) for i, value in enumerate(values)])
    value = ControllerInput(position, zero, reference, zero, acceleration, zero)
    stepping = controller if symbolic is None else DigitalController(Encoder(), symbolic)
    with numpy_on_symbols():
        next_state, output = stepping.step(symbolic_state, value)
    x = ca.vertcat(*(_column(symbol) for symbol in symbols.values())) if symbols else ca.SX(0, 1)
    rows = [_column(leaf) for i, leaf in enumerate(leaves(next_state)) if i in symbols]
    slopes = ca.jacobian(ca.vertcat(*rows, output.torque), ca.vertcat(x, position, acceleration))
    inputs = [x, position, acceleration, *([reference] if anywhere else [])]
    inputs += [] if parameters is None else [parameters]
    # common subexpressions take longer to find than they save, unless there are many evaluations
    evaluate = ca.Function("slopes", inputs, [slopes], {"cse": parameters is not None})
    places = tuple(np.array(indices, dtype=int) for indices in evaluate.sparsity_out(0).get_triplet())

    def at(posture: Array, *numbers: Array) -> tuple[Array, int]:
        present = leaves(controller.init(posture)) if anywhere else values
        x_at_rest = pack(tuple(present[i] for i in varying))
        J = np.zeros(slopes.shape)
        J[places] = evaluate(x_at_rest, posture, zero, *([posture] if anywhere else []), *numbers).nonzeros()
        return J, len(x_at_rest)

    return at


def _column(leaf: Vector) -> Vector:
    leaf = leaf if ops.symbolic(leaf) else ca.SX(leaf)
    return leaf if leaf.shape[1] == 1 else ca.vec(leaf)


def _required_states(F: Array, inputs: Array, outputs: Array) -> Array:
    """Return which states an input reaches and an output shows; all, unless the rest only shifts values out."""
    arrows = F != 0
    shown, reached = (outputs != 0).any(axis=0), (inputs != 0).any(axis=1)
    required = _ancestors(arrows, shown) & _ancestors(arrows.T, reached)
    unused = arrows[np.ix_(~required, ~required)]
    lasting = np.ones(len(unused), dtype=bool)  # states from which a walk among the unused ones goes on
    while lasting.sum() > (lasting := unused[:, lasting].any(axis=1)).sum():
        pass
    # a cycle among the unused states could have an eigenvalue of its own
    return np.ones_like(required) if lasting.any() else required


def _ancestors(arrows: Array, marked: Array) -> Array:
    """Return which states lead to marked ones, or are marked; arrows[i, j] says that state j enters state i."""
    found, new = marked, marked
    while new.any():
        new = arrows[new].any(axis=0) & ~found
        found = found | new
    return found


def initial_responses(law: Law, computation_delay: int = 0) -> tuple[Array, Array]:
    """Return the states x of the loop of one joint at the start, for a unit position and for a unit v.

    The law starts with a window full of the first position, and with the torque that was applied before.

    Parameters
    ----------
    law
        A law whose joints share a loop, see `decoupled_channels`.
    computation_delay
        Periods between a measurement and its torque.

    Returns
    -------
    tuple
        x for the position 1 and v = 0, and for the position 0 and v = 1, each of the shape of the states of `Channel`.
    """
    law = require_inertia(law, "its linearisation")
    single = law.single_joint(float(law.K1[0, 0]), float(law.K2[0, 0]), None).without_model()
    controller = DigitalController(Encoder(), single)
    J, n_states = _slopes_at_rest(single, 0.0)(np.zeros(1))
    used = _required_states(J[:n_states, :n_states], J[:n_states, n_states:], J[n_states:, :n_states])
    labels = [label.split(".")[-1] for label in names(controller.init(np.zeros(1)))]
    varying = [i for i, label in enumerate(labels) if label not in single.linearisation_constants(0.0)]

    def state(position: float, torque: float) -> Array:
        present = leaves(controller.init(np.array([position]), np.array([torque])))
        x = pack(tuple(present[i] for i in varying))[used]
        return np.concatenate([x, np.full(computation_delay, torque / single.M.item())])

    return state(1.0, 0.0), state(0.0, single.M.item())
