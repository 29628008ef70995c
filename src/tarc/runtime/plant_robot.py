"""A robot by its own equations, in a second process, over shared memory or UDP."""

from pathlib import Path

import casadi as ca

from tarc.core import validation as check
from tarc.core.validation import Numbers
from tarc.plants.base import Plant
from tarc.runtime.peer_robot import PeerRobot
from tarc.runtime.sampled_plant import SampledPlant


class PlantRobot(PeerRobot):
    """A robot in symbols, simulated in real time in a process of its own: for robots that are not from a file.

    It keeps its own clock and moves on whether or not commands come, as a machine does. Its brakes are those of
    `MujocoRobot`. Dry friction is that of the equations, without stiction.

    Parameters
    ----------
    plant
        A robot in symbols whose joints are all driven, such as `tarc.plants.TwoLinkArm`.
    period
        Time between two states [s].
    position
        Where it starts [rad or m], one number or one per joint.
    substeps
        Runge–Kutta steps per period.
    udp, watchdog, step_size, noise, in_step, seed, priority
        As for `MujocoRobot`.

    Raises
    ------
    InvalidParameter
        For a robot in MuJoCo alone, or with coordinates that no torque drives, and a port in use.
    """

    module = "tarc.runtime.plant_peer"

    def __init__(
        self,
        plant: Plant,
        period: float,
        *,
        position: Numbers = 0.0,
        udp: int | None = None,
        watchdog: float = 0.1,
        substeps: int = 2,
        step_size: Numbers = 0.0,
        noise: Numbers = 0.0,
        in_step: bool = False,
        seed: int = 0,
        priority: int = 80,
    ):
        self._sampled = SampledPlant.from_robot(plant, period, substeps)
        first = check.vector("position", position, plant.n_joints)
        super().__init__(
            {"joint_names": list(plant.joint_names), "position": first.tolist()},
            period=period,
            udp=udp,
            watchdog=watchdog,
            substeps=substeps,
            step_size=step_size,
            noise=noise,
            in_step=in_step,
            seed=seed,
            priority=priority,
        )

    def save(self, folder: Path) -> None:
        """Write the motion over a period, and the torque at rest, into the folder of the process."""
        self._sampled.function().save(str(folder / "motion.casadi"))
        position = ca.SX.sym("q", self._sampled.plant.n_joints)
        holding = ca.Function("holding", [position], [self._sampled.plant.gravity_torque(position)])
        holding.save(str(folder / "holding.casadi"))
