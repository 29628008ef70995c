"""Reader of ROS 2 bags in MCAP."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.core.optional import require
from tarc.core.types import Array
from tarc.signals.log_columns import LogColumns
from tarc.signals.robot_log import RobotLog

JOINT_STATES = ("sensor_msgs/msg/JointState", "sensor_msgs/JointState")
"""Type of the message that is read."""


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
        messages = list(_messages(file, columns.topic))
    except McapError as error:
        raise InvalidParameter(f"path: {file} does not read as MCAP ({error})", "path") from None
    if not messages:
        raise InvalidParameter(f"path: {file} has no message on that topic", "path")
    names = [str(name) for name in columns.joints or messages[0][1].name]
    tables = {
        quantity: _table([message for _, message in messages], field, names, file)
        for quantity, field in (("position", "position"), ("velocity", "velocity"), ("torque", "effort"))
    }
    if tables["position"] is None:
        raise InvalidParameter(f"path: {file} has joint states without positions", "path")
    log_times = np.array([time for time, _ in messages])
    stamps = np.array([message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec for _, message in messages])
    times = stamps if np.all(stamps > 0) else log_times
    order = np.argsort(times, kind="stable")
    scaled = {
        quantity: None if table is None else columns.scale(quantity) * table[order]
        for quantity, table in tables.items()
    }
    return RobotLog(
        times=times[order] - times[order[0]],
        joint_names=tuple(names),
        label=file.stem,
        **scaled,  # pyright: ignore[reportArgumentType]
    )


def _messages(file: Path, topic: str | None) -> Iterator[tuple[float, Any]]:
    """Yield time [s] and message of the joint states."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        schemas = {} if summary is None else summary.schemas
        channels = [] if summary is None else summary.channels.values()
        topics = sorted({channel.topic for channel in channels if schemas[channel.schema_id].name in JOINT_STATES})
        if topic not in topics and (topic is not None or len(topics) != 1):
            wanted = "one topic of joint states; name it by columns.topic" if topic is None else f"the topic {topic}"
            raise InvalidParameter(
                f"path: {file} has the topics {', '.join(topics) or 'without joint states'}; needs {wanted}", "path"
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
