"""Writer of runs as ROS 2 bags in MCAP."""

from pathlib import Path
from typing import IO, Any

import numpy as np
import xarray as xr

from tarc.core.optional import require
from tarc.signals.ros2_messages import (
    DEFINITIONS,
    FLOAT_ARRAY,
    JOINT_STATE,
    JOINT_TRAJECTORY,
    nanoseconds_of,
    stamp_of,
)

EXCLUDED = ("position", "measured_position", "velocity", "velocity_estimate", "torque")
EXCLUDED += ("reference", "velocity_reference", "acceleration_reference")
"""Variables that are in joint states and trajectory, so that they have no topic of their own."""


def require_bag_writer() -> None:
    """Raise `MissingTool` without the libraries that write a bag."""
    require("logs", "A run as MCAP", "mcap", "mcap_ros2")


def write_bag(data: xr.Dataset, path: Path) -> None:
    """Write a run's dataset as a bag of ROS 2, stamped by the time of the run.

    ``/joint_states`` has measured positions, estimated velocities and torques. ``/true_joint_states`` has the
    position and velocity of the plant. ``/joint_trajectory`` is the reference as one message, which
    ``tarc run --reference`` follows. ``/tarc/<signal>`` has each other signal of the law.

    Raises
    ------
    MissingTool
        Without the libraries that write a bag.
    """
    require_bag_writer()
    with path.open("wb") as stream:
        _write(data, stream)


def _write(data: xr.Dataset, stream: IO[bytes]) -> None:
    from mcap_ros2.writer import Writer

    writer = Writer(stream)
    schemas = {kind: writer.register_msgdef(kind, text) for kind, text in DEFINITIONS.items()}
    times = data["time"].values.tolist()
    names = [str(name) for name in data["joint"].values]
    _write_trajectory(writer, schemas[JOINT_TRAJECTORY], data, names)
    states = {
        "/joint_states": ("measured_position", "velocity_estimate", "torque"),
        "/true_joint_states": ("position", "velocity", ""),
    }
    rows = {topic: [_rows(data, key) for key in keys] for topic, keys in states.items()}
    signals = {name: _rows(data, str(name)) for name in data.data_vars if _is_signal(data, str(name))}
    for k, time in enumerate(times):
        stamp, at = stamp_of(time), nanoseconds_of(time)
        for topic, (position, velocity, effort) in rows.items():
            message = {
                "header": {"stamp": stamp, "frame_id": ""},
                "name": names,
                "position": position[k],
                "velocity": velocity[k],
                "effort": effort[k],
            }
            writer.write_message(topic, schemas[JOINT_STATE], message, at, at, k)
        for name, values in signals.items():
            message = {"layout": {"dim": [], "data_offset": 0}, "data": values[k]}
            writer.write_message(f"/tarc/{name}", schemas[FLOAT_ARRAY], message, at, at, k)
    writer.finish()


def _write_trajectory(writer: Any, schema: Any, data: xr.Dataset, names: list[str]) -> None:
    """Write the reference as one message."""
    keys = ("reference", "velocity_reference", "acceleration_reference")
    positions, velocities, accelerations = (_rows(data, key) for key in keys)
    points = [
        {
            "positions": positions[k],
            "velocities": velocities[k],
            "accelerations": accelerations[k],
            "effort": [],
            "time_from_start": stamp_of(time),
        }
        for k, time in enumerate(data["time"].values.tolist())
    ]
    message = {"header": {"stamp": stamp_of(0), "frame_id": ""}, "joint_names": names, "points": points}
    writer.write_message("/joint_trajectory", schema, message, 0, 0, 0)


def _rows(data: xr.Dataset, key: str) -> list[list[float]]:
    """Return a variable as one list per time, empty where the run does not have it."""
    if key not in data:
        return [[]] * data.sizes["time"]
    return np.asarray(data[key].values, dtype=float).reshape(data.sizes["time"], -1).tolist()


def _is_signal(data: xr.Dataset, name: str) -> bool:
    """Whether a variable is a signal of the law, of numbers over time."""
    variable = data[name]
    return name not in EXCLUDED and variable.dims[:1] == ("time",) and variable.dtype.kind in "biuf"
