"""A law as a colcon package of ROS 2."""

from collections.abc import Mapping, Sequence
from itertools import takewhile
from pathlib import Path
from string import Template
from typing import Any

from tarc.control.watch import Watch
from tarc.core.errors import InvalidParameter
from tarc.core.version import __version__
from tarc.export import ros2_files, ros2_node, ros2_plugin, ros2_shared
from tarc.export.c_project import LICENCE, Export, c_name, c_texts
from tarc.export.folder import write_folder
from tarc.laws.base import Law
from tarc.signals.torque_limits import TorqueLimits

SHARED = ("LICENSE", "law.yaml", "test/replay.h", "test/replay.c", "test/vectors.h")
"""Files of a C project that the package has too."""
RATE_TOLERANCE = 1e-9
"""Largest relative distance of a rate from an integer that is rounding."""


def export_ros2(
    law: Law,
    folder: str | Path,
    *,
    name: str | None = None,
    real: str = "double",
    torque_limits: TorqueLimits | None = None,
    joint_names: Sequence[str] = (),
    certificate: Mapping[str, Any] | None = None,
    scenario: Mapping[str, Any] | None = None,
    watch: Watch | None = None,
) -> Export:
    """Write a law as a colcon package: a chainable controller of ros2_control, and a node, around the same C.

    The same law gives the same bytes. Files in the folder that it did not write stay as they are.

    Parameters
    ----------
    law
        Any law of `tarc.laws`, or your own.
    folder
        Where to write; the package is ``<name>_controller``.
    name, real, torque_limits, certificate, scenario, watch
        As for `export_c`.
    joint_names
        Names of the robot's joints in the law's order, by which ROS finds them.

    Raises
    ------
    InvalidParameter
        For a period whose rate is no integer in Hz, and joint names that do not fit or repeat. Also for a name that is
        none in C, and for files in the way.
    UnsupportedLaw
        For a law that has no C.

    Examples
    --------
    >>> import tempfile, tarc
    >>> law = tarc.laws.TDC(inertia=[0.1], natural_frequency=10.0, period=1e-3,
    ...                     estimator=tarc.estimators.Algebraic(window=0.010))
    >>> written = tarc.export.export_ros2(law, tempfile.mkdtemp(), name="arm", joint_names=["elbow"])
    >>> (written.folder / "config" / "arm.yaml").is_file()
    True
    """
    name = c_name(Path(folder).name if name is None else name, given=name is not None)
    rate = update_rate(law.period)
    names = _checked_names(joint_names, law.n_joints)
    source, content, digest = c_texts(law, name, real, torque_limits, names, certificate, scenario, watch)
    package = f"{name}_controller"
    values = {
        "name": name,
        "NAME": name.upper(),
        "package": package,
        "PACKAGE": package.upper(),
        "title": source.title,
        "version": __version__,
        "license": LICENCE,
        "rate": str(rate),
        "period": f"{law.period:g}",
        "joints": ", ".join(f'"{joint}"' for joint in names),
        "command_joints": ", ".join(f'"{package}/{joint}"' for joint in names),
        "joint_text": ", ".join(names),
        "law_parameters": _commented_parameters(content["law.yaml"]),
        "elapsed": f"in.elapsed = static_cast<{name}_real>(elapsed);" if watch else "(void)elapsed;  // not watched",
        "flags": "output_.flags_seen" if watch else "0u",
    }
    templates: dict[str, Template] = {
        "package.xml": ros2_files.PACKAGE,
        "CMakeLists.txt": ros2_files.CMAKE,
        f"{package}.xml": ros2_files.PLUGIN,
        "README.md": ros2_files.README,
        f"config/{name}.yaml": ros2_files.PARAMETERS,
        f"launch/{name}.launch.py": ros2_files.LAUNCH,
        "src/law.hpp": ros2_shared.LAW,
        "src/trajectory.hpp": ros2_shared.TRAJECTORY,
        "src/controller.hpp": ros2_plugin.HEADER,
        "src/controller.cpp": ros2_plugin.SOURCE,
        "src/node.hpp": ros2_node.HEADER,
        "src/node_main.cpp": ros2_node.MAIN,
    }
    texts = {path: content[path] for path in (f"src/{name}.h", f"src/{name}.c", *SHARED)}
    texts |= {path: template.substitute(values) for path, template in templates.items()}
    return Export(Path(folder), tuple(write_folder("folder", folder, texts)), name, real, digest)


def update_rate(period: float) -> int:
    """Return the rate of a period in Hz, which ROS takes as an integer.

    Raises
    ------
    InvalidParameter
        For a period whose rate is none.
    """
    rate = 1 / period
    if abs(rate - round(rate)) > RATE_TOLERANCE * rate:
        raise InvalidParameter(
            f"period: {period:g} s is a rate of {rate:.6g} Hz; update_rate of ros2_control is an integer. "
            f"{1 / round(rate):.6g} s would be {round(rate)} Hz"
            if round(rate)
            else f"period: {period:g} s is a rate below 1 Hz; update_rate of ros2_control is an integer",
            "period",
        )
    return round(rate)


def _checked_names(given: Sequence[str], n: int) -> tuple[str, ...]:
    names = tuple(given) or tuple(f"joint{i + 1}" for i in range(n))
    bad = [name for name in names if not name or set(name) & set('"\\/ \n')]
    if len(names) != n or len(set(names)) != n or bad:
        raise InvalidParameter(
            f"joint_names: got {', '.join(names)}; needs {n} different names without spaces, slashes and quotes",
            "joint_names",
        )
    return names


def _commented_parameters(law_yaml: str) -> str:
    """Return the law's parameters as lines of comments."""
    section = law_yaml.split("\nparameters:\n")[1].splitlines()
    return "\n".join(f"#   {line.strip()}" for line in takewhile(lambda line: line.startswith("  "), section))
