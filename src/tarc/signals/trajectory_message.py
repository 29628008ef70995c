"""Readers of the ROS message ``trajectory_msgs/JointTrajectory``, as YAML, as CSV or in a bag."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.optional import require
from tarc.core.types import Array
from tarc.signals.log_bag import read_trajectory_message
from tarc.signals.trajectory_file import read_record

QUANTITIES = ("position", "velocity", "acceleration")
"""Position and its two derivatives, as columns of a CSV file name them."""


WRAPPERS = ("joint_trajectory", "trajectory")
"""Keys that hold the message in ``moveit_msgs/RobotTrajectory`` and in a goal of ``FollowJointTrajectory``."""

SUFFIXES = (".yaml", ".yml", ".json")
"""Endings of files in YAML, of which JSON is a part."""


BAG = ".mcap"
"""Ending of a bag."""


class TrajectoryPoints(NamedTuple):
    """Points of a trajectory with k points and n joints.

    Attributes
    ----------
    joint_names
        Name of each joint.
    times
        [s], shape (k,).
    positions, velocities, accelerations
        [rad or m, /s, /s²], each of shape (k, n); NaN in the rows of points without velocity or acceleration.
    """

    joint_names: list[str]
    times: Array
    positions: Array
    velocities: Array
    accelerations: Array


def read_points(given: str | Path) -> TrajectoryPoints:
    """Read the points of a file by its suffix: ``.yaml``, ``.yml``, ``.json``, a bag ``.mcap``, else CSV.

    Raises
    ------
    InvalidParameter
        For a file that is not there, and for points that are not as ROS describes them.
    MissingTool
        For YAML and bags without the libraries that read them.
    """
    path = Path(given)
    if not path.is_file():
        raise InvalidParameter(f"path: no trajectory file {str(given)!r}; looked in {path.resolve().parent}", "path")
    suffix = path.suffix.lower()
    points = _from_yaml(path) if suffix in SUFFIXES else _from_bag(path) if suffix == BAG else _from_csv(path)
    repeated = sorted({name for name in points.joint_names if points.joint_names.count(name) > 1})
    if repeated:
        raise InvalidParameter(f"path: {path} names {', '.join(repeated)} twice; needs each joint once", "path")
    if len(points.times) < 2 or np.any(np.diff(points.times) <= 0):
        raise InvalidParameter(
            f"path: {path} has {len(points.times)} points, at {_span(points.times)}; needs two or more, at times that "
            "increase",
            "path",
        )
    has_velocity = np.isfinite(points.velocities[:, 0])
    if np.any(np.isfinite(points.accelerations[:, 0]) & ~has_velocity):
        raise InvalidParameter(f"path: {path} has points with accelerations but no velocities; needs both", "path")
    return points


def _span(times: Array) -> str:
    return f"{times[0]:g} … {times[-1]:g} s" if len(times) else "no time"


def _from_yaml(path: Path) -> TrajectoryPoints:
    """Return the points of the one message in a YAML file."""
    require("cli", f"A trajectory in YAML ({path.name})", "ruamel.yaml")
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        documents = list(YAML(typ="safe", pure=True).load_all(path.read_text(encoding="utf-8")))
    except (YAMLError, UnicodeDecodeError) as error:
        raise InvalidParameter(f"path: {path} is no valid YAML: {error}", "path") from None
    messages = [document for document in documents if document is not None]
    if len(messages) != 1 or not isinstance(messages[0], Mapping):
        raise InvalidParameter(
            f"path: {path} has {len(messages)} messages; needs one trajectory_msgs/JointTrajectory, such as "
            "`ros2 topic echo --once --full-length` prints",
            "path",
        )
    message = next((messages[0][key] for key in WRAPPERS if isinstance(messages[0].get(key), Mapping)), messages[0])
    return _from_message(message, path)


def _from_bag(path: Path) -> TrajectoryPoints:
    """Return the points of the one message in a bag."""
    message = read_trajectory_message(path)
    points = [
        {
            "positions": list(point.positions),
            "velocities": list(point.velocities),
            "accelerations": list(point.accelerations),
            "time_from_start": {"sec": point.time_from_start.sec, "nanosec": point.time_from_start.nanosec},
        }
        for point in message.points
    ]
    return _from_message({"joint_names": list(message.joint_names), "points": points}, path)


def _from_message(message: Mapping[str, Any], path: Path) -> TrajectoryPoints:
    """Return the points of a message."""
    names = _listed(message, "joint_names", path)
    points = _listed(message, "points", path)
    if not names or not all(isinstance(point, Mapping) for point in points):
        raise InvalidParameter(f"path: {path} lacks joint_names or has points without keys", "path")
    rows = [_point(point, number, len(names), path) for number, point in enumerate(points)]
    table = np.array(rows, dtype=float).reshape(-1, 1 + 3 * len(names))
    positions, velocities, accelerations = np.hsplit(table[:, 1:], 3)
    return TrajectoryPoints([str(name) for name in names], table[:, 0], positions, velocities, accelerations)


def _listed(part: Mapping[str, Any], key: str, path: Path, where: str = "") -> list[Any]:
    """Return a list of a message, empty where it is missing."""
    values = part.get(key)
    values = [] if values is None else values
    if not isinstance(values, Sequence) or isinstance(values, str):
        raise InvalidParameter(f"path: {path}: {where}{key}: got {values!r}; needs a list", "path")
    if "..." in values:
        raise InvalidParameter(
            f"path: {path}: {where}{key} ends in '...': ros2 has cut it; print it with --full-length", "path"
        )
    return list(values)


def _point(point: Mapping[str, Any], number: int, n_joints: int, path: Path) -> list[float]:
    """Return time, positions, velocities and accelerations of a point as one row."""
    where = f"points[{number}]."
    row = [_seconds(point.get("time_from_start"), f"path: {path}: {where}time_from_start")]
    for key in ("positions", "velocities", "accelerations"):
        values = check.array(f"path: {path}: {where}{key}", _listed(point, key, path, where))
        if values.size == 0 and key != "positions":
            values = np.full(n_joints, np.nan)
        if values.shape != (n_joints,):
            raise InvalidParameter(
                f"path: {path}: {where}{key}: got {values.size} numbers for {n_joints} joints; needs one per joint",
                "path",
            )
        row.extend(values.tolist())
    return row


def _seconds(stamp: object, label: str) -> float:
    """Return a duration of ROS 2 (``sec``, ``nanosec``) or ROS 1 (``secs``, ``nsecs``), or one number, in seconds."""
    if isinstance(stamp, Mapping):
        whole = stamp.get("sec", stamp.get("secs", 0))
        nanoseconds = stamp.get("nanosec", stamp.get("nsecs", 0))
        return check.number(f"{label}.sec", whole) + 1e-9 * check.number(f"{label}.nanosec", nanoseconds)
    return check.number(label, stamp)


def _from_csv(path: Path) -> TrajectoryPoints:
    """Return the points of a CSV file: time, then for each joint position and, where known, its derivatives."""
    record = read_record(path, min_rows=2)
    if record.columns is None:
        raise InvalidParameter(
            f"path: {path} has no header; needs the columns time, elbow, elbow/velocity, elbow/acceleration, …", "path"
        )
    numbers: dict[str, dict[str, Array]] = {quantity: {} for quantity in QUANTITIES}
    for label, column in zip(record.columns, record.table.T[1:], strict=True):
        name, quantity = _joint_and_quantity(label)
        if name in numbers[quantity]:
            raise InvalidParameter(f"path: {path} has the {quantity} of {name} twice; needs each column once", "path")
        numbers[quantity][name] = column
    names = list(numbers["position"])
    for quantity in QUANTITIES[1:]:
        given = list(numbers[quantity])
        if given and sorted(given) != sorted(names):
            raise InvalidParameter(
                f"path: {path} has the position of {', '.join(names) or 'no joint'}, and the {quantity} of "
                f"{', '.join(given)}; needs the {quantity} of all or of none",
                "path",
            )
    missing = np.full(len(record.table), np.nan)
    tables = [np.column_stack([numbers[key].get(name, missing) for name in names]) for key in QUANTITIES]
    return TrajectoryPoints(names, record.table[:, 0], *tables)


def _joint_and_quantity(label: str) -> tuple[str, str]:
    """Return the joint and the quantity of a column such as ``elbow/velocity``; no quantity means position."""
    match = re.fullmatch(rf"(.+)[/.]({'|'.join(QUANTITIES)})", label)
    return (match[1], match[2]) if match else (label, "position")
