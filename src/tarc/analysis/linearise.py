"""The loop that runs, linearised: the traced law itself, by automatic differentiation, gain frozen."""

from dataclasses import dataclass, replace
from typing import Any
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np

from tarc.control.digital_controller import ControllerInput, DigitalController
from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.errors import TarcError
from tarc.core.trees import leaves, names, pack, rebuild
from tarc.core.types import Array
from tarc.estimators.oracle import refuse_oracle
from tarc.laws.base import Law
from tarc.laws.pole_placement import PolePlacement
from tarc.signals.sensors import Encoder


@dataclass(frozen=True)
class Channel:
    """One of the loops that a law makes around q̈ = ρ M̂⁻¹ τ.

        x⁺ = F x + G q + H w,     v = M̂⁻¹ τ = C x + D q + E w,     q̈ = ρ v, held for T

    with w what a robust term Δu adds to the auxiliary input. ``joints`` are those that have this loop.
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
        """How many joints the loop has: 1 unless the gains couple them."""
        return self.D.shape[0]

    def closed_loop(self, ratio: float | Array) -> tuple[Array, Array, Array, Array, Array]:
        """A, B, C, W, V of the loop around q̈ = ratio v under zero-order hold: y⁺ = A y + B a + W w, v = C y + V w.

        The ratio is a number, or M⁻¹M̂ itself. The state y holds q, q̇ T and x; a is an acceleration besides ratio v,
        held like it. The velocity is scaled by the period, so that rounding does not depend on it.
        """
        n, inner = self.n_coupled, self.F.shape[0]
        ratio = ratio * np.eye(n) if np.ndim(ratio) == 0 else np.asarray(ratio)
        eye, T2 = np.eye(n), self.period**2
        A, B, C = np.zeros((2 * n + inner,) * 2), np.zeros((2 * n + inner, n)), np.zeros((n, 2 * n + inner))
        A[: 2 * n, : 2 * n] = np.eye(2 * n)
        A[:n, n : 2 * n] = eye
        A[2 * n :, :n], A[2 * n :, 2 * n :] = self.G, self.F
        B[:n], B[n : 2 * n] = T2 / 2 * eye, T2 * eye
        C[:, :n], C[:, 2 * n :] = self.D, self.C
        W = B @ ratio @ self.E
        W[2 * n :] += self.H
        return A + B @ ratio @ C, B, C, W, self.E

    def state_matrix(self, ratio: float | Array) -> Array:
        """State matrix of the loop around q̈ = ratio v."""
        return self.closed_loop(ratio)[0]

    def with_delay(self, periods: int) -> "Channel":
        """The same loop with v so many periods later: the newest v first among the states added."""
        if periods == 0:
            return self
        n, inner, queue = self.n_coupled, self.F.shape[0], self.n_coupled * periods
        F = np.zeros((inner + queue, inner + queue))
        F[:inner, :inner] = self.F
        F[inner : inner + n, :inner] = self.C
        F[inner + n :, inner:-n] = np.eye(queue - n)
        G, H = (np.concatenate([a, b, np.zeros((queue - n, n))]) for a, b in ((self.G, self.D), (self.H, self.E)))
        C, none = np.concatenate([np.zeros((n, inner + queue - n)), np.eye(n)], axis=1), np.zeros((n, n))
        return replace(self, F=F, G=G, H=H, C=C, D=none, E=none)


def decoupled_channels(law: Law, computation_delay: int = 0, gain: float = 0.0) -> list[Channel]:
    """The independent loops of a law around q̈ = ρ M̂⁻¹ τ, each once.

    With K1 and K2 scalar, or diagonal and the gain at zero, the joints decouple in coordinates M̂^½ q (M̂⁻¹τ, for
    diagonal gains), so that n joints cost what their different gains cost.

    Parameters
    ----------
    law
        A law on time-delay estimation.
    computation_delay
        Periods between a measurement and its torque.
    gain
        Frozen switching gain ĉ [rad/s²]: inside its boundary layer the law adds α ĉ P2/ε to K1.
    """
    if not isinstance(law, PolePlacement):
        raise TarcError(f"law: got {type(law).__name__}; the loop certificate needs a law with an inertia M̂")
    check.number("gain", gain, 0)
    check.integer("computation_delay", computation_delay)
    known = _CHANNELS.setdefault(law, {})
    if gain not in known:
        known[gain] = _decouple(law, gain)
    return [channel.with_delay(computation_delay) for channel in known[gain]]


_CHANNELS: WeakKeyDictionary[Law, dict[float, list[Channel]]] = WeakKeyDictionary()
"""What was linearised, by law and gain: the certificates of one law all start from it."""


def coupled_channel(law: PolePlacement, computation_delay: int = 0) -> Channel:
    """The loop of all joints at once, for a mismatch that is no multiple of the identity; the gain at zero."""
    return _linearise(law, 0.0, tuple(range(law.n_joints))).with_delay(computation_delay)


def joints_share_loop(law: Law) -> bool:
    """Whether K1, K2 and, with a robust term, P2 are multiples of the identity, so that all joints' loops are one."""
    if not isinstance(law, PolePlacement):
        return False
    matrices = [law.K1, law.K2] if law.P2 is None else [law.K1, law.K2, law.P2]
    return all(_is_scalar(K) for K in matrices)


def _is_scalar(K: Array) -> bool:
    return bool(np.abs(K - K[0, 0] * np.eye(len(K))).max() <= 1e-9 * abs(K[0, 0]))


def _decouple(law: PolePlacement, gain: float) -> list[Channel]:
    diagonal = all(np.abs(K - np.diag(np.diag(K))).max() <= 1e-9 * np.abs(K).max() for K in (law.K1, law.K2))
    P2 = law.P2 if gain else None
    scalar = all(_is_scalar(K) for K in (law.K1, law.K2)) and (P2 is None or _is_scalar(P2))
    if not (scalar or (diagonal and not gain)):
        return [_linearise(law, gain, tuple(range(law.n_joints)))]
    groups: dict[tuple[float, float], list[int]] = {}
    for joint in range(law.n_joints):
        groups.setdefault((float(law.K1[joint, joint]), float(law.K2[joint, joint])), []).append(joint)
    weight = None if P2 is None else float(P2[0, 0])
    return [_linearise(law.single_joint(*gains, weight), gain, tuple(joints)) for gains, joints in groups.items()]


def _linearise(law: PolePlacement, gain: float, joints: tuple[int, ...]) -> Channel:
    """Jacobian of the traced drive at rest; what adapts or counts is frozen.

    The acceleration reference enters the auxiliary input as Δu does, so that its columns are those of w.
    """
    refuse_oracle(law.estimator)
    drive = DigitalController(Encoder(), law)
    n = law.n_joints
    rest = np.zeros(n)
    state = drive.init(rest)
    labels = [label.split(".")[-1] for label in names(state)]
    constants = law.linearisation_constants(gain)
    values = [
        leaf if constants.get(label) is None else constants[label] + 0 * leaf
        for label, leaf in zip(labels, leaves(state), strict=True)
    ]
    # constant states and the reference stay numbers, so that the graph is that of the loop alone
    moving = [i for i, label in enumerate(labels) if label not in constants]
    symbols = {i: ca.SX.sym("x", *(*np.shape(values[i]), 1, 1)[:2]) for i in moving}
    position, asked = ca.SX.sym("q", n), ca.SX.sym("a", n)
    mixed = rebuild(state, [symbols.get(i, value) for i, value in enumerate(values)])
    after, output = drive.step(mixed, ControllerInput(position, rest, rest, asked, rest))
    x = ca.vertcat(*(_column(one) for one in symbols.values())) if symbols else ca.SX(0, 1)
    rows = [_column(leaf) for i, leaf in enumerate(leaves(after)) if i in symbols]
    torque: Any = output.torque
    slopes = ca.jacobian(ca.vertcat(*rows, torque), ca.vertcat(x, position, asked))
    point = pack(tuple(values[i] for i in moving))
    J = np.array(ca.Function("slopes", [x, position, asked], [slopes])(point, rest, rest))
    m = len(point)
    F, inputs, outputs, through = J[:m, :m], J[:m, m:], J[m:, :m], J[m:, m:]
    if not all(np.all(np.isfinite(part)) for part in (F, inputs, outputs, through)):
        raise TarcError(
            f"law: {type(law).__name__} with {type(law.estimator).__name__} has no linearisation at rest, where a "
            "slope is infinite; certificates of the loop need a linear estimator, such as tarc.estimators.Algebraic"
        )
    keep = _observable_states(F, inputs, outputs)
    F, inputs, outputs = F[np.ix_(keep, keep)], inputs[keep], outputs[:, keep]
    root = np.linalg.inv(law.M)
    G, H, D, E = inputs[:, :n], inputs[:, n:], root @ through[:, :n], root @ through[:, n:]
    return Channel(F, G, H, root @ outputs, D, E, law.period, joints)


def _column(leaf: Any) -> Any:
    leaf = leaf if ops.symbolic(leaf) else ca.SX(leaf)
    return leaf if leaf.shape[1] == 1 else ca.vec(leaf)


def _observable_states(F: Array, inputs: Array, outputs: Array) -> Array:
    """States that an input moves and an output shows; all, unless the others are memories that empty themselves."""
    arrows = F != 0
    seen, moved = (outputs != 0).any(axis=0), (inputs != 0).any(axis=1)
    before = -1
    while before < (before := int(seen.sum() + moved.sum())):
        seen, moved = seen | arrows[seen].any(axis=0), moved | arrows[:, moved].any(axis=1)
    keep = seen & moved
    rest = arrows[np.ix_(~keep, ~keep)]
    walks = rest
    for _ in range(len(rest)):
        walks = walks @ rest
    # a ring among them could have an eigenvalue of its own
    return np.ones_like(keep) if walks.any() else keep
