"""A robot in MuJoCo that speaks as a robot of ROS 2 does, over DDS."""

from tarc.core.optional import require

require("ros2", "ROS 2 over DDS", "cyclonedds", "rosbags")
require("robots", "tarc.runtime.ros2_peer")

from collections.abc import Sequence
from typing import Any

import numpy as np
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.core.validation import Numbers
from tarc.plants.base import Plant
from tarc.plants.mujoco import MujocoPlant
from tarc.plants.rigid_body import RigidBody
from tarc.runtime.dds import join_domain
from tarc.runtime.mujoco_peer import MujocoBody
from tarc.runtime.packets import Flag, Kind, decode, encode
from tarc.runtime.peer import Peer
from tarc.runtime.ros2_types import (
    Float64MultiArray,
    Header,
    JointState,
    Received,
    Time,
    decoded,
    quality_of_service,
)
from tarc.runtime.transports import Transport
from tarc.signals.ros2_messages import stamp_of


class RosTransport(Transport):
    """States as ``sensor_msgs/JointState``, and commands from ``std_msgs/Float64MultiArray``.

    Parameters
    ----------
    joint_names
        Names of the joints.
    controller
        Controller whose commands it takes.
    domain
        DDS domain.
    """

    def __init__(self, joint_names: Sequence[str], controller: str, domain: int | None):
        participant = join_domain(domain)

        def topic(name: str, kind: Any) -> Topic:
            return Topic(participant, f"rt/{name}", kind, qos=quality_of_service(kind))

        states, commands = topic("joint_states", JointState), topic(f"{controller}/commands", Float64MultiArray)
        self._writer = DataWriter(participant, states, qos=quality_of_service(JointState))
        self._reader = DataReader(participant, commands, qos=quality_of_service(Float64MultiArray))
        self._names = list(joint_names)
        self._sequence = 0

    def send(self, data: bytes) -> None:
        """Send the state of a packet."""
        packet = decode(data)
        if packet is None or packet.kind != Kind.STATE:
            return
        position, torque = packet.values
        header = Header(Time(**stamp_of(packet.time)))
        self._writer.write(JointState(header, self._names, position.tolist(), [], torque.tolist()))

    def receive(self) -> list[bytes]:
        """Return the newest command as a packet."""
        commands = [one for one in self._reader.take(N=64) if isinstance(one, Received)]
        packets = []
        for received in commands[-1:]:
            message = decoded(Float64MultiArray, received.data)
            values = [] if message is None else [np.array(message.data)]
            if not values or values[0].shape != (len(self._names),) or not np.all(np.isfinite(values[0])):
                self.strangers += 1
                continue
            self._sequence += 1
            packets.append(encode(Kind.COMMAND, self._sequence, 0.0, values, flags=Flag.RELEASE))
        return packets

    def close(self) -> None:
        """Leave the domain."""
        del self._writer, self._reader


def ros2_peer(
    plant: Plant,
    period: float,
    *,
    position: Numbers | None = None,
    controller: str = "effort_controller",
    domain: int | None = None,
    watchdog: float = 0.1,
    seed: int = 0,
) -> Peer:
    """Return a robot in MuJoCo that sends joint states and takes effort commands; its ``run`` moves it.

    Its brakes hold it until the first command comes, and where none came for the time of its watchdog.

    Parameters
    ----------
    plant
        A robot of `tarc.plants.load_robot`.
    period
        Time between two joint states [s].
    position
        Where it starts [rad or m], (n,); None for the robot's home.
    controller, domain
        As for `tarc.runtime.dds.DdsRobot`.
    watchdog
        Time without a command after which the brakes are engaged [s].
    seed
        Seed of its noise.

    Raises
    ------
    InvalidParameter
        For a robot that is not from a file, or that takes positions.
    """
    source = plant.mujoco if isinstance(plant, RigidBody) else plant
    if not isinstance(source, MujocoPlant) or source.servo is not None:
        raise InvalidParameter(
            f"robot: MuJoCo cannot run {plant.label} with efforts; give a robot of tarc.plants.load_robot that takes "
            "torques"
        )
    n = source.n_joints
    coordinates = source.home if position is None else check.vector("position", position, n)
    if np.shape(coordinates) != (source.n_coordinates,):
        coordinates = source.coordinates(coordinates)
    zero: Array = np.zeros(n)
    settings = {
        "period": check.number("period", period, 0, strict=True),
        "substeps": 1,
        "watchdog": watchdog,
        "echoes": False,
        "driven": list(source.driven),
        "measured": list(source.measured),
        "joint_names": source.joint_names,
        "commanded": [],
        "position": coordinates,
        "step_size": zero,
        "noise": zero,
        "seed": seed,
    }
    body = MujocoBody(source.copy_model(), settings)
    return Peer(body, settings, RosTransport(source.joint_names, controller, domain))
