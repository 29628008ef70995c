"""A robot in MuJoCo, in a second process, over shared memory or UDP."""

from pathlib import Path

from tarc.core.optional import require

require("robots", "tarc.runtime.MujocoRobot")

import mujoco
import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.validation import Numbers
from tarc.plants.base import Plant
from tarc.plants.mujoco import MujocoPlant
from tarc.plants.rigid_body import RigidBody
from tarc.runtime.peer_robot import PeerRobot


class MujocoRobot(PeerRobot):
    """A robot from a file, simulated in real time by MuJoCo in a process of its own.

    It keeps its own clock and moves on whether or not commands come, as a machine does. Its brakes hold it until the
    loop releases them, after a safe stop, and where commands fail to come for the time of its watchdog.

    Parameters
    ----------
    plant
        A robot of `tarc.plants.load_robot`.
    period
        Time between two states [s].
    position
        Coordinates at the start [rad or m], shape (m,) or that of the joints, (n,); None for the robot's home.
    udp
        Port of UDP to speak by, 0 for any that is free; None for shared memory.
    watchdog
        Time without a command after which the brakes are engaged [s].
    substeps
        Steps of MuJoCo per period.
    step_size, noise
        Step of the encoders, and standard deviation of white noise before it [rad or m].
    in_step
        Let the robot move by a period for each command instead of by its clock. Then a run is the same every time.
    seed
        Seed of the noise.
    priority
        Of SCHED_FIFO for the process, 1 to 99, where it is allowed; 0 for the ordinary scheduler.

    Attributes
    ----------
    process
        The process.

    Raises
    ------
    InvalidParameter
        For a robot that is not from a file, and a port in use.
    """

    module = "tarc.runtime.mujoco_peer"

    def __init__(
        self,
        plant: Plant,
        period: float,
        *,
        position: Numbers | None = None,
        udp: int | None = None,
        watchdog: float = 0.1,
        substeps: int = 1,
        step_size: Numbers = 0.0,
        noise: Numbers = 0.0,
        in_step: bool = False,
        seed: int = 0,
        priority: int = 80,
    ):
        source = plant.mujoco if isinstance(plant, RigidBody) else plant
        if not isinstance(source, MujocoPlant):
            raise InvalidParameter(
                f"robot: MuJoCo cannot run {plant.label}, which is not from a file; give a robot of "
                "tarc.plants.load_robot without a gearbox, or take tarc.runtime.PlantRobot"
            )
        if position is None:
            position = source.home
        coordinates = check.array("position", position)
        if coordinates.shape != (source.n_coordinates,):
            coordinates = source.coordinates(check.vector("position", coordinates, source.n_joints))
        self._source = source
        settings = {
            "driven": list(source.driven),
            "measured": list(source.measured),
            "joint_names": source.joint_names,
            "commanded": _commanded(source),
            "position": coordinates.tolist(),
        }
        super().__init__(
            settings,
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
        """Write the model into the folder of the process."""
        mujoco.mj_saveModel(self._source.copy_model(), str(folder / "model.mjb"))


def _commanded(source: MujocoPlant) -> list[tuple[int, int, float]]:
    """Return joint, actuator and control input per unit, for joints that take positions."""
    if source.servo is None:
        return []
    scale = np.asarray(source.servo.scale, dtype=float)
    return [
        (joint, int(source.model.actuator(name).id), float(scale[joint]))
        for joint, name in enumerate(source.servo.names)
        if name
    ]
