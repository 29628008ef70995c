"""The loop that runs, linearised: the traced law itself, by automatic differentiation, gain frozen."""

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from tarc import check
from tarc.errors import TarcError
from tarc.laws.base import Law
from tarc.laws.tde import TDE
from tarc.loop import Drive, DriveInput
from tarc.signals.sensors import Encoder
from tarc.system import leaves, names, pack, trace

Array = np.ndarray


@dataclass(frozen=True)
class Channel:
    """One of the loops that a law makes around q̈ = ρ M̂⁻¹ τ: x⁺ = F x + G q, v = C x + D q, q̈ = ρ v held for T.

    ``joints`` are those that have this loop.
    """

    F: Array
    G: Array
    C: Array
    D: Array
    period: float
    joints: tuple[int, ...]

    @property
    def width(self) -> int:
        """How many joints the loop has: 1 unless the gains couple them."""
        return self.D.shape[0]

    def closed(self, ratio: float) -> Array:
        """State matrix of the loop around q̈ = ratio v under zero-order hold; states q, q̇ T, then the drive's.

        The velocity is scaled by the period, so that rounding does not depend on it.
        """
        step = ratio * self.period**2
        n = self.width
        eye = np.eye(n)
        return np.block(
            [
                [eye + step / 2 * self.D, eye, step / 2 * self.C],
                [step * self.D, eye, step * self.C],
                [self.G, np.zeros((self.F.shape[0], n)), self.F],
            ]
        )


def decouple(law: Law, computation_delay: int = 0, gain: float = 0.0) -> list[Channel]:
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
    if not isinstance(law, TDE):
        raise TarcError(f"law: got {type(law).__name__}; the loop certificate needs a law with an inertia M̂")
    check.number("gain", gain, 0)
    diagonal = all(np.allclose(K, np.diag(np.diag(K))) for K in (law.K1, law.K2))
    P2 = getattr(law, "P2", np.zeros_like(law.K1)) if gain else np.zeros_like(law.K1)
    scalar = all(np.allclose(K, K[0, 0] * np.eye(law.joints), rtol=1e-9) for K in (law.K1, law.K2, P2))
    if not (scalar or (diagonal and not gain)):
        return [_linearise(law, computation_delay, gain, tuple(range(law.joints)))]
    groups: dict[tuple[float, float], list[int]] = {}
    for joint in range(law.joints):
        groups.setdefault((float(law.K1[joint, joint]), float(law.K2[joint, joint])), []).append(joint)
    plain: dict[str, Any] = {"inertia": 1.0, "torque_limit": None, "bandwidth": None, "safe_torque": "zero"}
    channels = []
    for (k1, k2), joints in groups.items():
        if gain:
            plain["weight"] = [2 * k1 * P2[0, 0], 2.0]  # the weight Q of one joint that has this P2
        one = replace(law, **plain, stiffness=k1, viscosity=k2)
        channels.append(_linearise(one, computation_delay, gain, tuple(joints)))
    return channels


def _linearise(law: TDE, computation_delay: int, gain: float, joints: tuple[int, ...]) -> Channel:
    """Jacobians of the traced drive at rest; what adapts or counts is frozen."""
    drive = Drive(Encoder(), law, check.whole("computation_delay", computation_delay))
    n = law.joints
    rest = np.zeros(n)
    state = drive.init(rest)
    value = DriveInput(rest, rest, rest, rest, rest)
    step, _ = trace(drive.step, state, value)
    x, u = ca.SX.sym("x", step.nnz_in(0)), ca.SX.sym("u", step.nnz_in(1))
    x_next, y = step(x, u)
    slopes = ca.Function("slopes", [x, u], [ca.jacobian(x_next, x), ca.jacobian(x_next, u), *_torque(y, x, u, n)])
    labels = [label.split(".")[-1] for label in names(state)]
    sizes = [int(np.size(leaf)) for leaf in leaves(state)]
    owner = np.repeat(labels, sizes)
    point = pack(state)
    if "gain" in labels:
        point[owner == "gain"] = gain
    keep = ~np.isin(owner, law.frozen)
    Fx, Fu, Cx, Cu = (np.array(part) for part in slopes(point, pack(value)))
    root = np.linalg.inv(law.M)
    F, G = Fx[np.ix_(keep, keep)], Fu[keep, :n]
    return Channel(F, G, root @ Cx[:, keep], root @ Cu[:, :n], law.period, joints)


def _torque(y: Any, x: Any, u: Any, n: int) -> tuple[Any, Any]:
    torque = y[n : 2 * n]
    return ca.jacobian(torque, x), ca.jacobian(torque, u)
