"""Definitions of the ROS 2 messages that are read and written, the same in Humble, Jazzy and rolling."""

SEPARATOR = f"\n{'=' * 80}\n"
"""Between the definitions of a message and of those in it."""

TIME = "builtin_interfaces/Time\nint32 sec\nuint32 nanosec"
DURATION = "builtin_interfaces/Duration\nint32 sec\nuint32 nanosec"
HEADER = "std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id"
POINT = (
    "trajectory_msgs/JointTrajectoryPoint\n"
    "float64[] positions\nfloat64[] velocities\nfloat64[] accelerations\nfloat64[] effort\n"
    "builtin_interfaces/Duration time_from_start"
)
DIMENSION = "std_msgs/MultiArrayDimension\nstring label\nuint32 size\nuint32 stride"
LAYOUT = "std_msgs/MultiArrayLayout\nMultiArrayDimension[] dim\nuint32 data_offset"

JOINT_STATE = "sensor_msgs/msg/JointState"
JOINT_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
FLOAT_ARRAY = "std_msgs/msg/Float64MultiArray"


def _joined(fields: str, *parts: str) -> str:
    return SEPARATOR.join([fields, *(f"MSG: {part}" for part in parts)])


DEFINITIONS = {
    JOINT_STATE: _joined(
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort", HEADER, TIME
    ),
    JOINT_TRAJECTORY: _joined(
        "std_msgs/Header header\nstring[] joint_names\nJointTrajectoryPoint[] points", HEADER, TIME, POINT, DURATION
    ),
    FLOAT_ARRAY: _joined("MultiArrayLayout layout\nfloat64[] data", LAYOUT, DIMENSION),
}
"""Definition of each message with those in it, as MCAP stores it."""


def stamp_of(time: float) -> dict[str, int]:
    """Return a time [s] as the seconds and nanoseconds of a stamp or duration."""
    nanoseconds = nanoseconds_of(time)
    return {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}


def nanoseconds_of(time: float) -> int:
    """Return a time [s] in nanoseconds."""
    return round(1e9 * time)
