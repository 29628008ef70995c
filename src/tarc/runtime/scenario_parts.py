"""Robot, limits and start-up of a scenario that runs on a robot."""

import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.core.validation import Numbers
from tarc.plants.base import Plant
from tarc.plants.mujoco import MujocoPlant
from tarc.plants.rigid_body import RigidBody
from tarc.runtime.limits import SafetyLimits
from tarc.runtime.live_loop import StartUp
from tarc.runtime.mujoco_robot import MujocoRobot
from tarc.runtime.packet_robot import udp_robot
from tarc.runtime.plant_robot import PlantRobot
from tarc.runtime.push import Push
from tarc.runtime.robot import Robot
from tarc.scenario.model import Scenario
from tarc.scenario.parts import Setup
from tarc.signals.torque_limits import TorqueLimits


def scenario_robot(
    name: str, scenario: Scenario, setup: Setup, period: float, priority: int = 0, in_step: bool = False
) -> Robot:
    """Return a robot by the name that ``tarc run-live --robot`` takes.

    Parameters
    ----------
    name
        ``mujoco`` for the scenario's robot in a process of its own, ``mujoco:udp`` for the same over UDP, or
        ``udp://host:port``. A robot that is not from a file is simulated by its own equations.
    scenario, setup
        The scenario and what it built.
    period
        Of the law [s].
    priority
        Of a simulated robot's process, 0 for the ordinary scheduler.
    in_step
        Let a simulated robot move by a period for each command instead of by its clock.

    Raises
    ------
    InvalidParameter
        For another text, and a robot that does not answer.
    """
    if name.startswith("udp:"):
        return udp_robot(name)
    if name not in ("mujoco", "mujoco:udp"):
        raise InvalidParameter(f"--robot: got {name!r}; needs mujoco, mujoco:udp or udp://host:port")
    n = setup.plant.n_joints
    start = scenario.initial_position
    bits, span = setup.sensor.bits, 2 * np.pi if setup.sensor.span is None else setup.sensor.span
    step = setup.sensor.resolution if bits is None else np.asarray(span) / 2.0 ** np.asarray(bits)
    return _simulation(setup.simulated)(
        setup.simulated,
        period,
        position=setup.reference.sample([0.0])[0][:, 0] if start is None else start,
        udp=0 if name == "mujoco:udp" else None,
        substeps=scenario.substeps or 1,
        step_size=np.broadcast_to(0.0 if step is None else step, (n,)),
        noise=setup.sensor.noise,
        seed=scenario.seed,
        priority=priority,
        in_step=in_step,
    )


def _simulation(plant: Plant) -> type[MujocoRobot] | type[PlantRobot]:
    """Return what simulates a robot: MuJoCo where it is from a file, else its own equations."""
    return MujocoRobot if isinstance(plant, MujocoPlant | RigidBody) else PlantRobot


def safety_limits(
    setup: Setup,
    interface: TorqueLimits | None,
    *,
    error: Numbers | None = 0.3,
    speed: Numbers | None = None,
    max_step: Numbers | None = None,
    torque_rate: Numbers | None = None,
) -> SafetyLimits:
    """Return limits with those of the scenario's interface and of the robot's file.

    Parameters
    ----------
    setup
        What the scenario built.
    interface
        Torque limits of the robot's interface; None for none.
    error, speed, max_step, torque_rate
        As in `tarc.runtime.SafetyLimits`; None for the speeds of the robot's file and the rate of the interface.
    """
    speeds = setup.plant.velocity_limits
    return SafetyLimits(
        torque=None if interface is None else interface.magnitude,
        torque_rate=interface.rate if torque_rate is None and interface is not None else torque_rate,
        error=error,
        speed=speeds if speed is None and np.any(np.isfinite(speeds)) else speed,
        max_step=max_step,
    )


def start_up(scenario: Scenario, setup: Setup, robot: Robot, push: float = 0.2, ramp_speed: float = 0.25) -> StartUp:
    """Return the start-up: a push with the robot's inertia, and its torque at rest where the robot reports none."""
    plant = setup.plant
    place = setup.reference.sample([0.0])[0][:, 0]
    holding = None
    if robot.applied_torque is None or not np.all(np.isfinite(robot.applied_torque)):
        given = scenario.initial_torque
        holding = plant.holding_torque(plant.coordinates(place)) if isinstance(given, str) else given
    inertia = plant.inertia(place) if plant.is_fully_driven else None
    test = Push(share=push, inertia=inertia) if push else None
    return StartUp(holding_torque=holding, push=test, ramp_speed=ramp_speed)
