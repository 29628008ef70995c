"""The process that reads an upload, within limits of time and memory."""

import json
import sys
import warnings
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from tarc.core.errors import InvalidParameter, RobotFileError
from tarc.core.types import Array
from tarc.plants.base import Plant
from tarc.plants.geometry import robot_geometry
from tarc.plants.load import load_robot
from tarc.studio.upload_files import UploadLimits, unpack
from tarc.studio.upload_xml import check_robot_files

MAX_ANGLE = 0.4
"""Largest amplitude of a joint that turns [rad]."""
MAX_SLIDE = 0.1
"""Largest amplitude of a joint that slides [m]."""


def main() -> None:
    """Read a request from the standard input, and write robot or error to the standard output, both in JSON."""
    request = json.load(sys.stdin)
    limits = UploadLimits(**request["limits"])
    _limit_process(limits)
    try:
        answer = read_robot(request, limits)
    except (RobotFileError, InvalidParameter) as error:
        answer = {"error": str(error)}
    except MemoryError:
        answer = {"error": f"upload: reading it takes more than {limits.memory >> 20} MB; simplify the meshes"}
    json.dump(answer, sys.stdout)


def read_robot(request: Mapping[str, Any], limits: UploadLimits) -> dict[str, Any]:
    """Unpack, check and load a robot, and return its file, joints and warnings.

    Parameters
    ----------
    request
        Where each uploaded file is (``files``), the empty ``folder``, the robot's ``file`` or None, and ``options`` of
        `tarc.plants.load_robot`.
    limits
        Those of the upload.
    """
    folder = Path(request["folder"])
    files = {name: Path(file) for name, file in request["files"].items()}
    robots = check_robot_files(folder, unpack(files, folder, limits))
    path = _choose(robots, request["file"])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        plant = load_robot(folder / path, **request["options"])
    plant.inertia(plant.home)
    robot_geometry(plant)
    offsets, amplitudes = small_motion(plant)
    return {
        "file": str(path),
        "joint_names": list(plant.joint_names),
        "offsets": offsets.tolist(),
        "amplitudes": amplitudes.tolist(),
        "warnings": [str(warning.message) for warning in caught],
    }


def small_motion(plant: Plant) -> tuple[Array, Array]:
    """Return middle and amplitude of a motion about the home posture, within 90 % of each joint's range.

    a = min(A, 0.3 (q_max − q_min)),    c = clip(q_home, q_min + a/0.9, q_max − a/0.9)
    """
    low, high = plant.position_limits.T
    largest = np.where([unit == "rad" for unit in plant.units], MAX_ANGLE, MAX_SLIDE)
    amplitudes = np.minimum(largest, 0.3 * (high - low))
    return np.clip(plant.home, low + amplitudes / 0.9, high - amplitudes / 0.9), amplitudes


def _choose(robots: list[PurePosixPath], file: str | None) -> PurePosixPath:
    """Return the robot to load."""
    names = [str(robot) for robot in robots]
    if file is not None and file in names:
        return PurePosixPath(file)
    if len(robots) == 1 and file is None:
        return robots[0]
    if not robots:
        raise RobotFileError("upload: has no robot; needs a file with root <robot> (URDF) or <mujoco> (MJCF)")
    raise RobotFileError(f"upload: has the robots {', '.join(names)}; upload one of them alone, or name it")


def _limit_process(limits: UploadLimits) -> None:
    """Limit time, memory and the size of files; without effect where the system has no such limits."""
    try:
        import resource
    except ImportError:  # Windows; the parent ends the process when its time is over
        return
    time = int(limits.time) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (time, time))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (limits.unpacked_size, limits.unpacked_size))
    statistics = Path("/proc/self/statm")
    if statistics.exists():
        used = int(statistics.read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + limits.memory, used + limits.memory))


if __name__ == "__main__":
    main()
