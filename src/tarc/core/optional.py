"""Libraries that come with an extra of the package."""

import sys
from importlib.util import find_spec
from pathlib import Path

from tarc.core.errors import MissingTool

_CERTIFY = ("clarabel", "cvxpy", "flint", "highspy")
_PLOT = ("matplotlib",)
_ROBOTS = ("mujoco",)
_SIM = (*_ROBOTS, "flint", "h5netcdf", "h5py", "xarray")
_CLI = (*_SIM, *_CERTIFY, *_PLOT, "pydantic", "rich", "ruamel.yaml", "typer")

_STUDY = (*_CLI, "bokeh", "cmaes", "dask", "distributed", "optuna", "zarr")
_IK = (*_CLI, "daqp", "mink")

EXTRAS = {
    "certify": _CERTIFY,
    "cli": _CLI,
    "control": (*_SIM, "control"),
    "gym": (*_SIM, "gymnasium"),
    "ik": _IK,
    "logs": (*_CLI, "mcap", "mcap_ros2"),
    "plot": _PLOT,
    "robots": _ROBOTS,
    "ros2": (*_CLI, "mcap", "mcap_ros2", "cyclonedds", "rosbags"),
    "ship": ("fmpy", "ziglang"),
    "sim": _SIM,
    "studio": (*_STUDY, "collada", "nicegui", "trimesh"),
    "study": _STUDY,
    "view": (*_SIM, "collada", "trimesh", "viser"),
}
"""Modules that each extra of ``pyproject.toml`` installs."""


def is_installed(module: str) -> bool:
    """Return whether a module can be imported, without importing it."""
    try:
        return module in sys.modules or find_spec(module) is not None
    except ModuleNotFoundError:  # of the package that a dotted name is in
        return False


def install_command(extra: str) -> str:
    """Return the command that installs an extra, from the repository where the package runs in one."""
    root = Path(__file__).resolve().parents[3]
    return (
        f"pip install -e '{root}[{extra}]'"
        if (root / "pyproject.toml").is_file()
        else f"pip install 'tarc-control[{extra}]'"
    )


def require(extra: str, part: str, *modules: str) -> None:
    """Check that the modules of an extra are installed.

    Parameters
    ----------
    extra
        A key of ``EXTRAS``.
    part
        Part of the package that needs them, for the message.
    modules
        Those of the extra that the part needs; by default all.

    Raises
    ------
    MissingTool
        When at least one module is missing.
    """
    missing = [module for module in modules or EXTRAS[extra] if not is_installed(module)]
    if missing:
        raise MissingTool(f"{part} needs {', '.join(missing)}; {install_command(extra)}")
