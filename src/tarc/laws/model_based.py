"""Base of the laws with a model of the robot."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Tree, Vector
from tarc.core.validation import Numbers
from tarc.laws.base import ControlInput, Law
from tarc.plants.base import Plant
from tarc.plants.symbolic import SymbolicPlant

if TYPE_CHECKING:
    from tarc.plants.mujoco import MujocoPlant


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelBased(Law):
    """A law with a model of the robot, and the poles of the error set by a natural frequency.

    Parameters
    ----------
    model
        Model of the robot, one of `tarc.plants`; in a scenario, ``robot`` is the scenario's own.
    natural_frequency
        ωn [rad/s], one number or one per joint.
    """

    model: Plant
    natural_frequency: Numbers

    def __post_init__(self) -> None:
        if not isinstance(self.model, Plant):
            raise InvalidParameter(f"model: got {self.model!r}; needs one of tarc.plants, such as the robot itself")
        self.model.require_fully_driven(f"the model of {type(self).__name__}")
        super().__post_init__()
        _ = self.omega

    @property
    def n_joints(self) -> int:
        """Return the number of joints n, that of the model."""
        return self.model.n_joints

    @cached_property
    def omega(self) -> np.ndarray:
        """Return ωn [rad/s], shape (n,)."""
        return check.vector("natural_frequency", self.natural_frequency, self.n_joints, 0, strict=True)

    @abstractmethod
    def control(self, state: Tree, tracking: ControlInput) -> tuple[Tree, Vector, dict[str, Vector]]:
        """Evaluate the law's equation."""


def check_model(model: Plant, n_joints: int) -> None:
    """Refuse a model that is no robot of `tarc.plants`, and one of another number of joints."""
    if not isinstance(model, Plant):
        raise InvalidParameter(f"model: got {model!r}; needs one of tarc.plants, or None")
    if model.n_joints != n_joints:
        raise InvalidParameter(f"model: it has {model.n_joints} joints, the inertia {n_joints}; they must be the same")
    model.require_fully_driven("the model of a law")


def inertia_and_bias(model: Plant, position: Vector, velocity: Vector) -> tuple[Vector, Vector]:
    """Return M(q), shape (n, n), and N(q, q̇), shape (n,), of a robot at numbers or at CasADi symbols.

    A robot in symbols becomes part of the law. A `tarc.plants.MujocoPlant` is called by CasADi: a call takes some 30 µs
    and cannot be compiled; derivatives are finite differences. Its bias has no dry friction, which is a constraint in
    MuJoCo.
    """
    if isinstance(model, SymbolicPlant):
        return model.evaluate("inertia", position), model.evaluate("bias", position, velocity)
    M, N = _called(model)(position, velocity)
    return (M, N) if ops.symbolic(position, velocity) else (np.array(M), np.array(N)[:, 0])


class _RigidBodyCallback(ca.Callback):
    """M(q) and N(q, q̇) of a MuJoCo robot as a CasADi function."""

    def __init__(self, model: "MujocoPlant"):
        import mujoco

        ca.Callback.__init__(self)
        self._mujoco, self._model = mujoco, model.copy_model()
        self._data, self._n = mujoco.MjData(self._model), model.n_joints
        self.construct("rigid_body", {"enable_fd": True})

    def get_n_in(self) -> int:
        """Return 2: position and velocity."""
        return 2

    def get_n_out(self) -> int:
        """Return 2: inertia and bias."""
        return 2

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """Return the sparsity of a vector."""
        return ca.Sparsity.dense(self._n, 1)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        """Return the sparsity of a matrix and of a vector."""
        return ca.Sparsity.dense(self._n, 1 if i else self._n)

    def eval(self, arg: Sequence[ca.DM]) -> list[Any]:
        """Evaluate by MuJoCo; return NaN where the magnitude of an input is 1e9 or more."""
        q, v = (np.array(vector)[:, 0] for vector in arg)
        M, data = np.full((self._n, self._n), np.nan), self._data
        if not (np.all(np.abs(q) < 1e9) and np.all(np.abs(v) < 1e9)):
            return [M, M[0]]
        data.qpos[:], data.qvel[:] = q, v
        self._mujoco.mj_fwdPosition(self._model, data)
        self._mujoco.mj_fwdVelocity(self._model, data)
        self._mujoco.mj_fullM(self._model, data, M)
        return [M, data.qfrc_bias - data.qfrc_passive]


_LIVE_CALLBACKS: list[_RigidBodyCallback] = []
"""CasADi does not own a callback, and functions that were traced with one may live as long as the program."""


@cache
def _called(model: Plant) -> ca.Function:
    from tarc.plants.mujoco import MujocoPlant

    if not isinstance(model, MujocoPlant) or model.servo is not None:
        raise InvalidParameter(
            f"model: got {type(model).__name__}; needs a robot of tarc.plants, in symbols where its "
            "joints have inner loops"
        )
    _LIVE_CALLBACKS.append(_RigidBodyCallback(model))
    q, v = ca.MX.sym("q", model.n_joints), ca.MX.sym("v", model.n_joints)
    return ca.Function("robot_model", [q, v], _LIVE_CALLBACKS[-1].call([q, v]), {"never_inline": True})
