"""Robots that a user uploads: read in a process of their own, within limits, in the folder of the session."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tarc.core.errors import RobotFileError
from tarc.studio.upload_files import UploadLimits

MAX_READERS = 2
"""Uploads that are read at the same time."""
MAX_KEPT = 4
"""Uploads that a session keeps; the oldest is removed first."""
_PREFIX = "upload-"
_READERS = threading.BoundedSemaphore(MAX_READERS)


@dataclass(frozen=True)
class UploadedRobot:
    """A robot that was uploaded, checked and read.

    Attributes
    ----------
    file
        For `tarc.plants.load_robot`; it names no file outside its folder.
    joint_names
        Of the joints that a law drives.
    offsets, amplitudes
        Middle and amplitude of a small motion within the joints' ranges [rad or m].
    warnings
        What was replaced, or taken as unknown.
    """

    file: Path
    joint_names: tuple[str, ...]
    offsets: tuple[float, ...]
    amplitudes: tuple[float, ...]
    warnings: tuple[str, ...]


def read_upload(
    files: Mapping[str, bytes],
    folder: Path,
    *,
    file: str | None = None,
    options: Mapping[str, Any] | None = None,
    limits: UploadLimits | None = None,
) -> UploadedRobot:
    """Read an uploaded robot in a process of its own, and keep its files in a new folder of the session.

    The process unpacks archives, refuses XML with entities and paths outside the upload, and loads the robot with its
    meshes. The files that it leaves are those that it checked. It ends at the limits of time and memory.

    Parameters
    ----------
    files
        Content by name: a URDF or MJCF, with its meshes, or a zip archive of them.
    folder
        Of the session.
    file
        The robot's path in the upload, where there are several; None for the only one.
    options
        Of `tarc.plants.load_robot`, such as ``armature``.
    limits
        Of size, time and memory; None for those of `UploadLimits`.

    Raises
    ------
    RobotFileError
        For an upload that is too large, or takes too long or too much memory. Also for paths outside it, entities, and
        robots that the package does not read.
    """
    limits = limits or UploadLimits()
    size = sum(map(len, files.values()))
    if not files or size > limits.size or len(files) > limits.n_files:
        raise RobotFileError(
            f"upload: got {len(files)} files with {size / (1 << 20):.3g} MB; needs 1 to {limits.n_files} files with at "
            f"most {limits.size >> 20} MB"
        )
    with _READERS, tempfile.TemporaryDirectory(dir=folder) as incoming:
        paths = {}
        for number, (name, content) in enumerate(files.items()):
            paths[name] = Path(incoming) / str(number)
            paths[name].write_bytes(content)
        target = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=folder))
        request = {
            "files": {name: str(path) for name, path in paths.items()},
            "folder": str(target),
            "file": file,
            "options": dict(options or {}),
            "limits": asdict(limits),
        }
        answer = _read(request, Path(incoming), limits)
    if "error" in answer:
        shutil.rmtree(target)
        raise RobotFileError(answer["error"].replace(f"{target}/", "").replace(str(target), "the upload"))
    _remove_oldest(folder)
    lists = {key: tuple(answer[key]) for key in ("joint_names", "offsets", "amplitudes", "warnings")}
    return UploadedRobot(target / answer["file"], **lists)


def _read(request: Mapping[str, Any], incoming: Path, limits: UploadLimits) -> dict[str, Any]:
    """Return the answer of the process that reads the upload."""
    environment = {
        "HOME": str(incoming),
        "TMPDIR": str(incoming),
        "PATH": os.environ.get("PATH", ""),
        "PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
    # -P: no module is imported from the folder of the upload
    command = [sys.executable, "-P", "-m", "tarc.studio.upload_worker"]
    try:
        done = subprocess.run(
            command,
            input=json.dumps(request),
            capture_output=True,
            text=True,
            cwd=incoming,
            env=environment,
            timeout=limits.time,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return {"error": f"upload: reading it takes more than {limits.time:g} s; simplify the robot or its meshes"}
    if done.returncode == 0:
        return json.loads(done.stdout)
    lines = done.stderr.strip().splitlines() or [f"it ended with code {done.returncode}"]
    return {"error": f"upload: cannot be read ({lines[-1][:300]}); check the file in another program"}


def _remove_oldest(folder: Path) -> None:
    """Remove the oldest uploads of a session, but the newest few."""
    uploads = sorted(folder.glob(f"{_PREFIX}*"), key=lambda path: path.stat().st_mtime)
    for path in uploads[:-MAX_KEPT]:
        shutil.rmtree(path)
