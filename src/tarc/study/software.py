"""The software that computes a study: on two machines the same numbers need the same software."""

import hashlib
import platform
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from tarc.core.errors import InvalidParameter
from tarc.core.version import __version__

LIBRARIES = ("casadi", "mujoco", "numpy", "scipy")
"""Libraries whose versions decide on the last bits."""


@cache
def software() -> dict[str, str]:
    """Return the version of each package that computes, by its name; of this one also a hash of its source."""
    python = ".".join(platform.python_version_tuple()[:2])
    versions = {"tarc-control": f"{__version__}, source {_source_hash()}", "Python": python}
    for name in LIBRARIES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:  # of an extra that the study may not need
            continue
    return versions


def check_same_software(worker: str, theirs: Mapping[str, str], ours: Mapping[str, str]) -> None:
    """Check that a worker has the software of the process that starts the study.

    Parameters
    ----------
    worker
        Its address, for the message.
    theirs, ours
        What `software` returns there and here. A library that one of them lacks is not compared.

    Raises
    ------
    InvalidParameter
        When a version differs.
    """
    shared = [name for name in ours if name in theirs]
    differences = [f"{name} {theirs[name]} there, {ours[name]} here" for name in shared if theirs[name] != ours[name]]
    if differences:
        raise InvalidParameter(
            f"scheduler: the worker {worker} has other software: {'; '.join(differences)}; "
            "install the same versions on all workers and start them again"
        )


def _source_hash() -> str:
    """Return a short hash of the package's source: two versions in development have one number."""
    folder = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for file in sorted(folder.rglob("*.py")):
        digest.update(file.relative_to(folder).as_posix().encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()[:8]
