"""Robots from MJCF or URDF files in symbols."""

from tarc.core.optional import require

require("robots", "tarc.plants.RigidBody")

import copy
from collections.abc import Mapping
from typing import Any, Self

import casadi as ca
import numpy as np

from tarc.core import validation as check
from tarc.core.types import Array
from tarc.plants.delegating import DelegatingPlant
from tarc.plants.mujoco import PAYLOAD_RADIUS, MujocoPlant
from tarc.plants.mujoco_equations import rigid_body_equations, rigid_body_regressor
from tarc.plants.robot_file import rotation_matrix
from tarc.plants.symbolic import Equations, InverseDynamics, SymbolicPlant

COULOMB_WIDTH = 0.01
"""Speed [rad/s or m/s] at which smoothed dry friction has reached tanh 1 = 76 % of its size."""


class RigidBody(DelegatingPlant, SymbolicPlant):
    """A robot from a file as CasADi expressions. Made by `load_robot`.

        M(q) q̈ + C(q, q̇) q̇ + g(q) + D q̇ + F tanh(q̇/w) + K (q − q_s) = B τ

    M includes the rotor inertia. Springs K with rest position q_s are those of the file. The stops of the joints are
    not simulated.

    Attributes
    ----------
    mujoco
        The same robot in MuJoCo, which gives the file's facts and is an independent check of the equations.

    Raises
    ------
    RobotFileError
        For a robot that needs MuJoCo, with the reason.
    """

    def __init__(self, mujoco: MujocoPlant):
        mujoco.require_equations()
        self.mujoco = mujoco
        model = mujoco.model
        self._links = [body for body in range(1, model.nbody) if body != mujoco.payload_body]
        self._parameters = {
            **mujoco.parameters,
            "coulomb_width": np.full(model.nv, COULOMB_WIDTH),
            "masses": model.body_mass[self._links].copy(),
            "length_factors": np.ones(model.nv),
        }

    def __repr__(self) -> str:
        return f"RigidBody({self.label!r}, joints={self.n_joints})"

    def equations(self) -> Equations:
        """Return the equations of motion, by composite rigid bodies and recursive Newton–Euler."""
        model, n = self.mujoco.model, self.n_coordinates
        q = ca.SX.sym("q", n)
        dq = ca.SX.sym("dq", n)
        ddq = ca.SX.sym("ddq", n)
        p = {name: ca.SX.sym(name, value.size) for name, value in self._parameters.items()}
        masses = dict(zip(self._links, ca.vertsplit(p["masses"]), strict=True)) | {
            self.mujoco.payload_body: p["payload"]
        }
        inertias = {body: self._inertia_about_centre(body, mass) for body, mass in masses.items()}
        M, bias, torque = rigid_body_equations(model, (q, dq, ddq), masses, inertias, ca.vertsplit(p["length_factors"]))
        friction = p["viscous"] * dq + p["coulomb"] * ca.tanh(dq / p["coulomb_width"])
        spring = model.jnt_stiffness.reshape(n, -1)[:, 0] * (q - model.qpos_spring)
        joints = spring + friction
        inverse = InverseDynamics(ddq, torque + p["armature"] * ddq + joints)
        return Equations(q, dq, p, M + ca.diag(p["armature"]), bias + joints, friction, {}, inverse=inverse)

    def _inertia_about_centre(self, body: int, mass: ca.SX) -> ca.SX:
        """Return the inertia of a body about its centre of mass, in the axes of its frame [kg m²], shape (3, 3)."""
        model = self.mujoco.model
        if body == self.mujoco.payload_body:
            return 0.4 * PAYLOAD_RADIUS**2 * mass * ca.SX.eye(3)
        axes = rotation_matrix(model.body_iquat[body])
        inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
        nominal = ca.SX(ca.sparsify(ca.DM((inertia + inertia.T) / 2)))
        return mass / model.body_mass[body] * nominal if model.body_mass[body] > 0 else nominal

    def link_regressor(self) -> tuple[ca.Function, Array]:
        """Return the function Y(q, q̇, q̈), shape (n, 10 b), of the torque of b moving links, and their parameters p.

        The torque of the links is Y p. The parameters of a link are mass, first moments and inertia about the origin of
        its frame, as `rigid_body_regressor` of `tarc.plants.mujoco_equations` has them.
        """
        model, n = self.mujoco.model, self.n_coordinates
        moving = [b for b in self._links if model.body_mass[b] > 0 and model.body_weldid[b] != 0]
        q, dq, ddq = (ca.SX.sym(name, n) for name in ("q", "dq", "ddq"))
        regressor, values = rigid_body_regressor(model, q, dq, ddq, moving)
        return ca.Function("link_regressor", [q, dq, ddq], [ca.densify(regressor)], {"cse": True}), values

    @property
    def parameters(self) -> dict[str, Array]:
        """Payload and link masses [kg], rotor inertia, viscous and dry friction, and the width of dry friction.

        A link's inertia is in proportion to its mass. ``length_factors`` has a number per joint, by which its link is
        longer than in the file. The joints after it, the centres of mass and the payload are farther from the joint, in
        all directions. Mass and inertia about the centre of mass stay. Drawings and `facts` have the file's lengths.
        """
        return dict(self._parameters)

    def with_parameters(self, values: dict[str, Any]) -> Self:
        """Return the same robot with other `parameters`, by name."""
        functions = self._functions  # their inputs include the parameters
        plant = copy.copy(self)
        vars(plant)["_functions"] = functions
        plant._parameters = dict(self._parameters)
        for name, value in values.items():
            check.one_of("parameters", name, self._parameters)
            size = self._parameters[name].size
            plant._parameters[name] = check.vector(name, value, size, 0).reshape(self._parameters[name].shape)
        known = {name: value for name, value in values.items() if name in self.mujoco.parameters}
        plant.mujoco = self.mujoco.with_parameters(known)
        return plant

    @property
    def facts(self) -> MujocoPlant:
        """Return the same robot in MuJoCo."""
        return self.mujoco

    @property
    def file_options(self) -> Mapping[str, object]:
        """Return the arguments of `load_robot` that read this robot again; empty where no arguments do."""
        model = self.mujoco.model
        as_read = np.all(self._parameters["masses"] == model.body_mass[self._links])
        as_read = as_read and np.all(self._parameters["length_factors"] == 1)
        has_width = np.all(self._parameters["coulomb_width"] == COULOMB_WIDTH)
        return self.mujoco.file_options if as_read and has_width else {}
