"""Equations of motion of a MuJoCo model as CasADi expressions, by the algorithms of ``adam-robotics``.

Only the algorithms are adam's: its readers of files lose joints without a word. Links and joints come from the compiled
MuJoCo model instead. The world is the root link, and each joint of a body has a link of its own.
"""

# adam gives CasADi's matrices the types of NumPy's:
# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportReturnType=false
# pyright: reportIncompatibleMethodOverride=false, reportIncompatibleVariableOverride=false

from collections.abc import Sequence

from tarc.core.optional import require

require("robots", "tarc.plants.RigidBody")

import casadi as ca
import mujoco
import numpy as np
from adam.casadi.casadi_like import CasadiLike, SpatialMath
from adam.core import RBDAlgorithms
from adam.core.constants import Representations
from adam.model import Joint, Link, Model, ModelFactory

from tarc.core.types import Array
from tarc.plants.robot_file import rotation_matrix

_WORLD = "world"


def rigid_body_equations(
    model: mujoco.MjModel, q: ca.SX, dq: ca.SX, masses: dict[int, ca.SX], inertias: dict[int, ca.SX]
) -> tuple[ca.SX, ca.SX]:
    """Return M(q), shape (n, n), and C(q, q̇) q̇ + g(q), shape (n, 1), of a model of hinges and slides.

    Neither has what acts on the joints alone: rotor inertia, friction, springs.

    Parameters
    ----------
    model
        The compiled model.
    q, dq
        Position and velocity, shape (n, 1).
    masses
        Mass [kg] of each body but the world, by its number.
    inertias
        Inertia of each of these bodies about its centre of mass, in the axes of its frame [kg m²], shape (3, 3).

    Raises
    ------
    ValueError
        For a joint that is neither a hinge nor a slide.

    References
    ----------
    Featherstone, Rigid Body Dynamics Algorithms, 2008: composite rigid bodies and recursive Newton–Euler.
    """
    spatial = {body: _about_centre(mass, model.body_ipos[body], inertias[body]) for body, mass in masses.items()}
    return _equations(model, q, dq, spatial)


def rigid_body_regressor(
    model: mujoco.MjModel, q: ca.SX, dq: ca.SX, ddq: ca.SX, bodies: Sequence[int]
) -> tuple[ca.SX, Array]:
    """Return Y(q, q̇, q̈), shape (n, 10 b), and the parameters p, shape (10 b,), of the torque Y p of moving bodies.

    The torque is linear in them. Each body has its mass m, its first moments m c_x, m c_y, m c_z, and its inertia I_xx,
    I_yy, I_zz, I_xy, I_xz, I_yz about the origin of its frame. All are in the axes of that frame.

    Parameters
    ----------
    model
        The compiled model.
    q, dq, ddq
        Position, velocity and acceleration, shape (n, 1).
    bodies
        Numbers of the b bodies; the others have no part in the torque.

    References
    ----------
    Khalil and Dombre, Modeling, Identification and Control of Robots, 2002, chapter 12.
    """
    symbols = ca.SX.sym("p", 10 * len(bodies))
    empty = dict.fromkeys(range(1, model.nbody), ca.SX.zeros(6, 6))
    parts = dict(zip(bodies, ca.vertsplit(symbols, 10), strict=True))
    M, bias = _equations(model, q, dq, empty | {body: _about_origin(part) for body, part in parts.items()})
    values = np.concatenate([_parameters_about_origin(model, body) for body in bodies])
    return ca.jacobian(M @ ddq + bias, symbols), values


def _equations(model: mujoco.MjModel, q: ca.SX, dq: ca.SX, spatial: dict[int, ca.SX]) -> tuple[ca.SX, ca.SX]:
    """Return M(q) and C(q, q̇) q̇ + g(q) with the spatial inertia (6, 6) of each body but the world."""
    math = SpatialMath()
    factory = _MujocoFactory(math, model, spatial)
    algorithms = RBDAlgorithms(Model.build(factory, [joint.name for joint in factory.moving]), math)
    algorithms.set_frame_velocity_representation(Representations.BODY_FIXED_REPRESENTATION)
    base = ca.SX.eye(4)
    gravity = ca.SX([*model.opt.gravity, 0.0, 0.0, 0.0])
    M, _ = algorithms.crba(base, q)
    bias = algorithms.rnea(base, q, ca.SX.zeros(6), dq, gravity)
    return M.array[6:, 6:], bias.array[6:]


class _Link(Link):
    """A link with a spatial inertia (6, 6) at its origin, linear part first."""

    def __init__(self, math: SpatialMath, name: str, inertia: ca.SX):
        self.math = math
        self.name = name
        self._inertia = CasadiLike(inertia)

    def spatial_inertia(self) -> CasadiLike:
        return self._inertia

    def homogeneous(self) -> CasadiLike:
        return self.math.factory.eye(4)


class _Joint(Joint):
    """The joint between a link and its parent link.

    At zero displacement the child's frame has the rotation R and the origin p in the parent's frame. A hinge turns it
    about an axis through an anchor, a slide moves it along the axis; axis and anchor are in the child's frame.
    """

    def __init__(self, math: SpatialMath, name: str, parent: str, child: str, rotation: Array, origin: Array):
        self.math = math
        self.name = name
        self.parent = parent
        self.child = child
        self.type = "fixed"
        self.idx: int | None = None
        self._rotation = _sparse(rotation)
        self._origin = _sparse(origin)

    def move(self, model: mujoco.MjModel, joint: int) -> "_Joint":
        """Make it a joint of the model."""
        kinds = {mujoco.mjtJoint.mjJNT_HINGE: "revolute", mujoco.mjtJoint.mjJNT_SLIDE: "prismatic"}
        kind = mujoco.mjtJoint(int(model.jnt_type[joint]))
        if kind not in kinds:
            raise ValueError(f"joint {joint} is neither a hinge nor a slide")
        self.type = kinds[kind]
        self._axis = model.jnt_axis[joint]
        self._anchor = model.jnt_pos[joint]
        self._zero = float(model.qpos0[model.jnt_qposadr[joint]])
        return self

    def homogeneous(self, q: CasadiLike) -> CasadiLike:
        rotation, origin = self._pose(q.array)
        return CasadiLike(ca.vertcat(ca.horzcat(rotation, origin), ca.SX([[0, 0, 0, 1]])))

    def spatial_transform(self, q: CasadiLike) -> CasadiLike:
        rotation, origin = self._pose(q.array)
        return self.math.spatial_transform(CasadiLike(rotation.T), CasadiLike(-rotation.T @ origin))

    def motion_subspace(self) -> CasadiLike:
        if self.type == "fixed":
            return self.math.zeros(6, 1)
        if self.type == "prismatic":
            return CasadiLike(ca.SX([*self._axis, 0.0, 0.0, 0.0]))
        return CasadiLike(ca.SX([*np.cross(self._anchor, self._axis), *self._axis]))

    def _pose(self, q: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return rotation and origin of the child's frame in the parent's."""
        if self.type == "fixed":
            return self._rotation, self._origin
        displacement = q - self._zero
        if self.type == "prismatic":
            return self._rotation, self._origin + self._rotation @ (self._axis * displacement)
        cross = ca.sparsify(ca.skew(ca.DM(self._axis)))
        turn = ca.DM.eye(3) + ca.sin(displacement) * cross + (1 - ca.cos(displacement)) * (cross @ cross)
        origin = self._origin + self._rotation @ (self._anchor - turn @ self._anchor)
        return self._rotation @ turn, origin


class _MujocoFactory(ModelFactory):
    """Links and joints of a compiled model."""

    def __init__(self, math: SpatialMath, model: mujoco.MjModel, spatial: dict[int, ca.SX]):
        self.math = math
        self.name = "robot"
        self.moving: list[_Joint] = []
        self._links = [_Link(math, _WORLD, ca.SX.zeros(6, 6))]
        self._joints: list[_Joint] = []
        for body in range(1, model.nbody):
            self._add(model, body, spatial[body])

    def _add(self, model: mujoco.MjModel, body: int, inertia: ca.SX) -> None:
        """Add a body, with one link for each of its joints."""
        parent = _name(int(model.body_parentid[body]))
        rotation, origin = rotation_matrix(model.body_quat[body]), model.body_pos[body]
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        for joint in range(first, first + count - 1):
            child = f"{_name(body)}.{joint}"
            self._links.append(_Link(self.math, child, ca.SX.zeros(6, 6)))
            self._connect(model, parent, child, rotation, origin, joint)
            parent, rotation, origin = child, np.eye(3), np.zeros(3)
        self._links.append(_Link(self.math, _name(body), inertia))
        self._connect(model, parent, _name(body), rotation, origin, first + count - 1 if count else None)

    def _connect(
        self, model: mujoco.MjModel, parent: str, child: str, rotation: Array, origin: Array, joint: int | None
    ) -> None:
        connection = _Joint(self.math, f"to {child}", parent, child, rotation, origin)
        self._joints.append(connection)
        if joint is not None:
            self.moving.append(connection.move(model, joint))

    # adam's own readers make links and joints one by one by these two; here all are made from the model at once
    def build_link(self) -> _Link:
        raise NotImplementedError("the links are made from the MuJoCo model, all at once")

    def build_joint(self) -> _Joint:
        raise NotImplementedError("the joints are made from the MuJoCo model, all at once")

    def get_links(self) -> list[_Link]:
        return self._links

    def get_frames(self) -> list[_Link]:
        return []

    def get_joints(self) -> list[_Joint]:
        return self._joints


def _name(body: int) -> str:
    return f"body{body}" if body else _WORLD


def _sparse(matrix: Array) -> ca.SX:
    return ca.SX(ca.sparsify(ca.DM(matrix)))


def _about_centre(mass: ca.SX, centre: Array, about_centre: ca.SX) -> ca.SX:
    """Return the inertia (6, 6) at the origin of a body with its centre of mass at a place, linear part first."""
    cross = ca.sparsify(ca.skew(ca.DM(centre)))
    coupling = mass * ca.SX(cross)
    return ca.blockcat([[mass * ca.SX.eye(3), coupling.T], [coupling, about_centre + mass * ca.SX(cross @ cross.T)]])


def _about_origin(p: ca.SX) -> ca.SX:
    """Return the inertia (6, 6) at the origin of a body from its ten parameters, linear part first."""
    mass, first, (xx, yy, zz, xy, xz, yz) = p[0], p[1:4], ca.vertsplit(p[4:])
    coupling = ca.skew(first)
    return ca.blockcat(
        [[mass * ca.SX.eye(3), coupling.T], [coupling, ca.blockcat([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])]]
    )


def _parameters_about_origin(model: mujoco.MjModel, body: int) -> Array:
    """Return the ten parameters of a body of the model."""
    mass, centre = model.body_mass[body], model.body_ipos[body]
    axes = rotation_matrix(model.body_iquat[body])
    about_centre = axes @ np.diag(model.body_inertia[body]) @ axes.T
    inertia = about_centre + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    rows, columns = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
    return np.concatenate([[mass], mass * centre, inertia[rows, columns]])
