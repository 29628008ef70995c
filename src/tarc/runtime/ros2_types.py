"""Messages of ROS 2 as DDS sends them: their types, their hashes and their bytes."""

from tarc.core.optional import require

require("ros2", "ROS 2 over DDS", "cyclonedds", "rosbags")

import struct
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar, cast

from cyclonedds.core import Policy, Qos
from cyclonedds.idl import IdlStruct
from cyclonedds.util import duration
from rosbags.typesys import Stores, get_typestore

from tarc.signals.ros2_messages import FLOAT_ARRAY, JOINT_STATE, JOINT_TRAJECTORY

if TYPE_CHECKING:  # what their values are
    from builtins import float as float64
    from builtins import int as int32
    from builtins import int as uint32
    from builtins import list as sequence
else:
    from cyclonedds.idl.types import float64, int32, sequence, uint32

DEPTH = 10
"""Messages that a history keeps: the depth of ROS."""
BLOCKING_TIME = 1
"""Longest time that a writer waits for room [ms]."""

Message = TypeVar("Message", bound=IdlStruct)


class Received:
    """The bytes of a message with their header, as DDS took them, so that a malformed one hinders no other."""

    __slots__ = ("data", "sample_info")

    def __init__(self, data: bytes):
        self.data = data
        self.sample_info: Any = None


class _Undecoded(IdlStruct, typename="tarc::Undecoded"):
    """A message that a reader leaves as bytes."""

    @classmethod
    def deserialize(cls, data: bytes, has_header: bool = True, use_version_2: bool | None = None) -> Any:
        """Return the bytes as they are; `decoded` reads them."""
        return Received(bytes(data))


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    """Time of a clock."""

    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Duration(IdlStruct, typename="builtin_interfaces::msg::dds_::Duration_"):
    """Time between two events."""

    sec: int32 = 0
    nanosec: uint32 = 0


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    """Stamp and frame."""

    stamp: Time = field(default_factory=Time)
    frame_id: str = ""


@dataclass
class JointState(_Undecoded, typename="sensor_msgs::msg::dds_::JointState_"):
    """Joints by name, with position, velocity and effort, each empty or one per name."""

    header: Header = field(default_factory=Header)
    name: sequence[str] = field(default_factory=list)
    position: sequence[float64] = field(default_factory=list)
    velocity: sequence[float64] = field(default_factory=list)
    effort: sequence[float64] = field(default_factory=list)


@dataclass
class JointTrajectoryPoint(IdlStruct, typename="trajectory_msgs::msg::dds_::JointTrajectoryPoint_"):
    """Point of a trajectory."""

    positions: sequence[float64] = field(default_factory=list)
    velocities: sequence[float64] = field(default_factory=list)
    accelerations: sequence[float64] = field(default_factory=list)
    effort: sequence[float64] = field(default_factory=list)
    time_from_start: Duration = field(default_factory=Duration)


@dataclass
class JointTrajectory(_Undecoded, typename="trajectory_msgs::msg::dds_::JointTrajectory_"):
    """Points of the named joints."""

    header: Header = field(default_factory=Header)
    joint_names: sequence[str] = field(default_factory=list)
    points: sequence[JointTrajectoryPoint] = field(default_factory=list)


@dataclass
class MultiArrayDimension(IdlStruct, typename="std_msgs::msg::dds_::MultiArrayDimension_"):
    """Dimension of an array."""

    label: str = ""
    size: uint32 = 0
    stride: uint32 = 0


@dataclass
class MultiArrayLayout(IdlStruct, typename="std_msgs::msg::dds_::MultiArrayLayout_"):
    """Layout of an array."""

    dim: sequence[MultiArrayDimension] = field(default_factory=list)
    data_offset: uint32 = 0


@dataclass
class Float64MultiArray(_Undecoded, typename="std_msgs::msg::dds_::Float64MultiArray_"):
    """Numbers, such as one command per joint."""

    layout: MultiArrayLayout = field(default_factory=MultiArrayLayout)
    data: sequence[float64] = field(default_factory=list)


ROS_NAMES: dict[type[IdlStruct], str] = {
    JointState: JOINT_STATE,
    JointTrajectory: JOINT_TRAJECTORY,
    Float64MultiArray: FLOAT_ARRAY,
}
"""Name in ROS of each type."""


def encoded(message: IdlStruct) -> bytes:
    """Return a message as CDR with its header, as ROS sends it."""
    return message.serialize(use_version_2=False)


def decoded(kind: type[Message], data: bytes) -> Message | None:
    """Return the message of some bytes with their header; None where they are none of that type."""
    try:
        return cast(Message, kind.__idl__.deserialize(data, has_header=True))
    except (struct.error, ValueError, IndexError, MemoryError):  # too short, no text, a length beyond all
        return None


@cache
def type_hash(kind: type[IdlStruct]) -> str:
    """Return the hash of a type by REP 2011, which ROS compares from Iron on."""
    return get_typestore(Stores.ROS2_JAZZY).hash_rihs01(ROS_NAMES[kind])


def quality_of_service(kind: type[IdlStruct]) -> Qos:
    """Return how ROS sends by default: reliable, the newest ten, with the hash of the type."""
    return Qos(
        Policy.Reliability.Reliable(duration(milliseconds=BLOCKING_TIME)),
        Policy.Durability.Volatile,
        Policy.History.KeepLast(DEPTH),
        Policy.DataRepresentation(use_cdrv0_representation=True),
        Policy.Userdata(f"typehash={type_hash(kind)};".encode()),
    )
