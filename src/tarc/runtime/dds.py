"""A robot of ROS 2 over DDS, without an installation of ROS."""

from tarc.core.optional import require

require("ros2", "ROS 2 over DDS", "cyclonedds", "rosbags")

import os
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from cyclonedds.core import DDSException, Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.runtime.online import OnlineReference
from tarc.runtime.robot import Robot
from tarc.runtime.ros2_inbox import Inbox
from tarc.runtime.ros2_types import Float64MultiArray, JointState, JointTrajectory, Received, quality_of_service

MAX_MESSAGES = 64
"""Messages that one call of `DdsRobot.read` takes, so that a flood cannot hold the loop up."""
OBSERVED = 20
"""Joint states whose rate is compared with that of the law."""
RATE_TOLERANCE = 0.05
"""Largest relative distance of the rates."""
POLL = 1e-3
"""Time between two looks for the first joint states [s]."""
MAX_DOMAIN = 232
"""Largest number of a DDS domain, of which the ports fit."""


class DdsRobot(Robot):
    """A robot that sends ``sensor_msgs/JointState`` and takes ``std_msgs/Float64MultiArray``, as ROS 2 sends them.

    Joints are found by name. Messages of another sender than the first, or without the robot's joints, are ignored and
    counted, and so are malformed ones. Also takes ``trajectory_msgs/JointTrajectory`` for an `OnlineReference`.

    Parameters
    ----------
    joint_names
        Names of the law's joints, in its order. The commands have this order, and no names.
    controller
        Controller that takes efforts at ``<controller>/commands``, such as one of ``forward_command_controller``.
    joint_states, joint_trajectory
        Topics, without a slash at the start.
    period
        Period of the law [s], with which the rate of the joint states is compared; None to compare nothing.
    domain
        DDS domain; None for that of the environment's ``ROS_DOMAIN_ID``, else 0.
    timeout
        How long to wait for the first joint state [s].

    Attributes
    ----------
    reference
        Where trajectories go; None to drop them.
    newest
        The last position that came [rad or m], shape (n,).
    applied_torque
        The ``effort`` of the newest joint state [N m or N], which a start takes over.

    Raises
    ------
    InvalidParameter
        When no joint state with these joints comes in time, and for another rate.
    MissingTool
        Without the extra ``ros2``.
    """

    def __init__(
        self,
        joint_names: Sequence[str],
        *,
        controller: str = "effort_controller",
        joint_states: str = "joint_states",
        joint_trajectory: str = "tarc/joint_trajectory",
        period: float | None = None,
        domain: int | None = None,
        timeout: float = 3.0,
    ):
        self.joint_names = tuple(joint_names)
        self.reference: OnlineReference | None = None
        self._inbox = Inbox(self.joint_names)
        self._nothing = self.newest = np.full(len(self.joint_names), np.nan)
        self._is_stopped = self._is_closed = False
        self._participant = join_domain(domain)
        self._states = self._reader(joint_states, JointState)
        self._trajectories = self._reader(joint_trajectory, JointTrajectory)
        topic = self._topic(f"{controller}/commands", Float64MultiArray)
        self._writer = DataWriter(self._participant, topic, qos=quality_of_service(Float64MultiArray))
        self._command = Float64MultiArray()
        self._connect(timeout)
        if period is not None:
            self._compare_rate(period)

    def _topic(self, name: str, kind: Any) -> Topic:
        return Topic(self._participant, f"rt/{name.strip('/')}", kind, qos=quality_of_service(kind))

    def _reader(self, name: str, kind: Any) -> DataReader:
        return DataReader(self._participant, self._topic(name, kind), qos=quality_of_service(kind))

    @property
    def counts(self) -> dict[str, int]:
        """Return messages that were malformed, of strangers, stale or not sent, and trajectories that were refused."""
        return dict(self._inbox.counts)

    def _connect(self, timeout: float) -> None:
        """Wait for the first joint state."""
        end = time.monotonic() + timeout
        while not np.all(np.isfinite(self.read())):
            if time.monotonic() > end:
                came = ", ".join(f"{number} {name}" for name, number in self._inbox.counts.items() if number)
                names = f"; one had the joints {', '.join(self._inbox.other_names)}" if self._inbox.other_names else ""
                raise InvalidParameter(
                    f"robot: no joint state with {', '.join(self.joint_names)} came within {timeout:g} s "
                    f"({came or 'nothing at all'}{names}); check the domain, the network interface of CYCLONEDDS_URI, "
                    "and the names of the joints"
                )
            time.sleep(POLL)

    def _compare_rate(self, period: float) -> None:
        """Refuse joint states at another rate than the law's.

        Raises
        ------
        InvalidParameter
            With both rates.
        """
        stamps: list[float] = []
        end = time.monotonic() + OBSERVED * max(10 * period, 0.01)
        while len(stamps) < OBSERVED and time.monotonic() < end:
            if np.any(np.isfinite(self.read())) and np.isfinite(self.sample_time):
                stamps.append(self.sample_time)
            time.sleep(period / 5)
        if len(stamps) < 2:
            raise InvalidParameter(
                "robot: hardly a joint state came after the first; it needs stamps, at the law's rate", "update_rate"
            )
        spacing = float(np.median(np.diff(stamps)))
        if abs(spacing / period - 1) > RATE_TOLERANCE:
            raise InvalidParameter(
                f"update_rate: the joint states come at {1 / spacing:.4g} Hz; the law is for {1 / period:.4g} Hz. Set "
                "the robot's update_rate, or the law's period",
                "update_rate",
            )

    @property
    def refusal(self) -> str:
        """Why the last trajectory was refused; empty for none."""
        return self._inbox.refusal

    def read(self) -> Array:
        """Return the position of the newest joint state (n,), NaN where none came since the call before."""
        if self._is_closed:
            return self._nothing
        inbox = self._inbox
        for received in self._states.take(N=MAX_MESSAGES):
            if isinstance(received, Received):
                inbox.take_state(received.data, received.sample_info.publication_handle)
        for received in self._trajectories.take(N=1):
            points = inbox.trajectory(received.data) if isinstance(received, Received) else None
            if points is not None and self.reference is not None:
                self.reference.incoming.append(points)
        position = inbox.position()
        self.sample_time, self.applied_torque = inbox.stamp, inbox.effort
        if position is None:
            return self._nothing
        self.newest = position
        return position

    def write(self, torque: Array) -> None:
        """Send a torque (n,); after the end zero."""
        if self._is_closed:
            return
        self._command.data = [0.0] * len(self.joint_names) if self._is_stopped else torque.tolist()
        try:
            self._writer.write(self._command)
        except DDSException:  # no room within the time of the writer
            self._inbox.counts["unsent"] += 1

    def engage_brakes(self) -> None:
        """Send zero torque, with this command and every later one: ROS has no message for brakes."""
        self._is_stopped = True
        self.write(np.zeros(len(self.joint_names)))

    def release_brakes(self) -> None:
        """Let torques pass."""
        self._is_stopped = False

    def close(self) -> None:
        """Leave the domain."""
        if not self._is_closed:
            self._is_closed = True
            del self._states, self._trajectories, self._writer, self._participant


def join_domain(domain: int | None) -> DomainParticipant:
    """Return a participant of a DDS domain; None for that of the environment.

    Raises
    ------
    InvalidParameter
        For a domain that is none, and where DDS cannot start.
    """
    number = dds_domain(domain)
    try:
        return DomainParticipant(number, Qos(Policy.Userdata(b"enclave=/;")))
    except DDSException:
        raise InvalidParameter(
            f"domain: DDS cannot join domain {number}; its reason is above. Check CYCLONEDDS_URI, the interface "
            "in it, and that ports are free",
            "domain",
        ) from None


def dds_domain(given: int | None) -> int:
    """Return the number of the DDS domain.

    Raises
    ------
    InvalidParameter
        For one that is no number from 0 to 232.
    """
    if given is not None:
        return check.integer("domain", given, 0, MAX_DOMAIN)
    text = os.environ.get("ROS_DOMAIN_ID", "").strip() or "0"
    if not text.isdecimal():
        raise InvalidParameter(f"ROS_DOMAIN_ID: got {text!r}; needs a number from 0 to {MAX_DOMAIN}", "domain")
    return check.integer("ROS_DOMAIN_ID", int(text), 0, MAX_DOMAIN)
