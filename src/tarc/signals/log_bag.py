"""Reader of ROS 2 bags in MCAP: joint states, and trajectories."""

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.core.optional import require
from tarc.core.types import Array
from tarc.signals.log_columns import LogColumns
from tarc.signals.robot_log import RobotLog
from tarc.signals.ros2_messages import JOINT_STATE, JOINT_TRAJECTORY

JOINT_STATES = (JOINT_STATE, "sensor_msgs/JointState")
"""Names of the type of joint states."""

TRAJECTORIES = (JOINT_TRAJECTORY, "trajectory_msgs/JointTrajectory")
"""Names of the type of trajectories."""

COMMON_TOPIC = "/joint_states"
"""Topic that is read where several have joint states."""

NO_BAG = "path: {file} does not read as MCAP ({error})"


def read_bag(file: Path, columns: LogColumns) -> RobotLog:
    """Read the joint states of a bag, stamped by their headers, or by the recorder where a header has no stamp.

    Raises
    ------
    InvalidParameter
        For a file that is no bag, a topic that it lacks, and joints that a message lacks.
    MissingTool
        Without the libraries that read a bag.
    """
    require("logs", f"A bag ({file.name})", "mcap", "mcap_ros2")
    from mcap.exceptions import McapError

    try:
        messages = list(_messages(file, columns.topic, JOINT_STATES, "joint states"))
    except McapError as error:
        raise InvalidParameter(NO_BAG.format(file=file, error=error), "path") from None
    if not messages:
        raise InvalidParameter(f"path: {file} has no message on that topic", "path")
    states = [message for _, message in messages]
    names = [str(name) for name in columns.joints or states[0].name]
    position, velocity, torque = (_table(states, field, names, file) for field in ("position", "velocity", "effort"))
    if position is None:
        raise InvalidParameter(f"path: {file} has joint states without positions", "path")
    log_times = np.array([time for time, _ in messages])
    stamps = np.array([state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec for state in states])
    times = stamps if np.all(stamps > 0) else log_times
    order = np.argsort(times, kind="stable")
    return RobotLog(
        times=times[order] - times[order[0]],
        position=columns.scale("position") * position[order],
        velocity=None if velocity is None else columns.scale("velocity") * velocity[order],
        torque=None if torque is None else columns.scale("torque") * torque[order],
        joint_names=tuple(names),
        label=file.stem,
    )


def read_trajectory_message(file: Path) -> Any:
    """Return the one ``trajectory_msgs/JointTrajectory`` of a bag.

    Raises
    ------
    InvalidParameter
        For a file that is no bag, and another number of such messages.
    MissingTool
        Without the libraries that read a bag.
    """
    require("logs", f"A bag ({file.name})", "mcap", "mcap_ros2")
    from mcap.exceptions import McapError

    try:
        messages = [message for _, message in _messages(file, None, TRAJECTORIES, "trajectories")]
    except McapError as error:
        raise InvalidParameter(NO_BAG.format(file=file, error=error), "path") from None
    if len(messages) != 1:
        raise InvalidParameter(
            f"path: {file} has {len(messages)} trajectories; needs one. Track its joint states by the reference "
            "RecordedReference, or cut the bag",
            "path",
        )
    return messages[0]


def has_trajectory(file: Path) -> bool:
    """Whether a bag has a message on a topic of trajectories.

    Raises
    ------
    InvalidParameter
        For a file that is not there or no bag.
    MissingTool
        Without the libraries that read a bag.
    """
    require("logs", f"A bag ({file.name})", "mcap", "mcap_ros2")
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    if not file.is_file():
        raise InvalidParameter(f"path: no bag {str(file)!r}; looked for {file.resolve()}", "path")
    try:
        with file.open("rb") as stream:
            summary = make_reader(stream).get_summary()
    except McapError as error:
        raise InvalidParameter(NO_BAG.format(file=file, error=error), "path") from None
    if summary is None or summary.statistics is None:
        return False
    counts = summary.statistics.channel_message_counts
    channels = [channel for channel in summary.channels.values() if counts.get(channel.id)]
    return any(summary.schemas[channel.schema_id].name in TRAJECTORIES for channel in channels)


def _messages(file: Path, topic: str | None, types: Collection[str], label: str) -> Iterator[tuple[float, Any]]:
    """Yield time [s] and message of the one topic of some types, or of the named one."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        schemas = {} if summary is None else summary.schemas
        channels = [] if summary is None else summary.channels.values()
        topics = sorted({channel.topic for channel in channels if schemas[channel.schema_id].name in types})
        if topic is None and COMMON_TOPIC in topics:
            topic = COMMON_TOPIC
        if topic not in topics and (topic is not None or len(topics) != 1):
            wanted = f"one topic of {label}" if topic is None else f"the topic {topic}"
            hint = "; name it by columns.topic" if topic is None and types is JOINT_STATES else ""
            raise InvalidParameter(
                f"path: {file} has {', '.join(topics) or 'no topic'} with {label}; needs {wanted}{hint}", "path"
            )
        for _, _, message, decoded in reader.iter_decoded_messages(topics=[topic or topics[0]]):
            yield 1e-9 * message.log_time, decoded


def _table(messages: list[Any], field: str, names: list[str], file: Path) -> Array | None:
    """Return a field of all messages in the order of the joints, or None where no message has it."""
    if not any(len(getattr(message, field)) for message in messages):
        return None
    rows = np.full((len(messages), len(names)), np.nan)
    for row, message in zip(rows, messages, strict=True):
        values = dict(zip(message.name, getattr(message, field), strict=False))
        missing = [name for name in names if name not in message.name]
        if missing:
            raise InvalidParameter(
                f"path: a message of {file} has the joints {', '.join(message.name)}; it lacks {', '.join(missing)}. "
                "Name those to read by columns.joints",
                "path",
            )
        row[:] = [values.get(name, np.nan) for name in names]
    return rows
