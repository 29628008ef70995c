"""A law as a C99 project."""

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from tarc.control.watch import Watch
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.version import __version__
from tarc.export import vectors
from tarc.export.c_source import CSource
from tarc.export.firmware import firmware_texts
from tarc.export.folder import write_folder
from tarc.export.parts import Parts
from tarc.export.project_files import texts
from tarc.export.realtime import realtime_texts
from tarc.export.traced_law import traced_law
from tarc.laws.base import Law
from tarc.signals.references import Reference
from tarc.signals.torque_limits import TorqueLimits

REALS = ("double", "float")
TORQUE_UNITS = ("N m", "N")
POSITION_UNITS = ("rad", "m")
VECTORS = 200
"""Recorded steps."""
SEED = 0
LICENCE = "SEE LICENSE"
NAME = re.compile(r"[a-z][a-z0-9_]*\Z")
RESERVED = frozenset({"auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else", "enum"})
RESERVED |= {"extern", "float", "for", "goto", "if", "inline", "int", "long", "register", "restrict", "return", "short"}
RESERVED |= {
    "signed",
    "sizeof",
    "static",
    "struct",
    "switch",
    "typedef",
    "union",
    "unsigned",
    "void",
    "volatile",
    "while",
}
"""Words of C that are no name, as far as they match `NAME`."""


@dataclass(frozen=True)
class Export:
    """What was exported.

    Attributes
    ----------
    folder, files
        Where it is.
    name
        Prefix of the names in C.
    real
        ``double`` or ``float``.
    digest
        SHA-256 of header and source together.
    """

    folder: Path
    files: tuple[Path, ...]
    name: str
    real: str
    digest: str


def export_c(
    law: Law,
    folder: str | Path,
    *,
    name: str | None = None,
    real: str = "double",
    torque_limits: TorqueLimits | None = None,
    joint_names: Sequence[str] = (),
    certificate: Mapping[str, Any] | None = None,
    scenario: Mapping[str, Any] | None = None,
    firmware: bool = False,
    watch: Watch | None = None,
    parts: bool = False,
    reference: Reference | None = None,
    commands: Sequence[str] = (),
    realtime: bool = False,
) -> Export:
    """Write a law as a C99 project: exactly the step that is simulated and certified.

    The same law gives the same bytes. Files in the folder that it did not write stay as they are.

    Parameters
    ----------
    law
        Any law of `tarc.laws`, or your own.
    folder
        Where to write.
    name
        Prefix of the names in C and of its files; None for the name of the folder.
    real
        ``double`` or ``float``.
    torque_limits
        Limits of the robot's interface, as for `Controller`.
    joint_names
        Names of the joints, in order.
    certificate
        Verdict and assumptions, for ``law.yaml``.
    scenario
        The scenario that the law is of, for ``law.yaml``; `verify_export` builds the law from it.
    firmware
        Also write ``firmware/``: a program for Cortex-M3, M4F and M7 that replays the recorded steps in QEMU.
    watch
        Ranges that the certificate assumes. The output of a step then has flags of what left them, and the input the
        time since the last sample. None to watch nothing.
    parts
        Also write ``src/NAME_parts.c``: the estimator alone, M̂(q) where the law has a model, and the reference.
    reference
        The reference among the parts; None to leave it out.
    commands
        Unit of what the law returns per joint, as ``plant.torque_units`` has it: ``rad`` for a `PositionServo`. Empty
        for torques.
    realtime
        Also write ``realtime/loop.c``: a program for Linux that runs the law on a robot over UDP. It follows the
        reference of the parts, or rests without.

    Raises
    ------
    InvalidParameter
        For a name that is none in C, and for files in the way. For a law that commands positions and whose safe torque
        is zero.
    UnsupportedLaw
        For a law that has no C: one that calls a library, or whose start is not affine in position and torque.

    Examples
    --------
    >>> import tempfile, tarc
    >>> law = tarc.laws.TDC(inertia=[0.1], natural_frequency=10.0, period=1e-3,
    ...                     estimator=tarc.estimators.Algebraic(window=0.010))
    >>> written = tarc.export.export_c(law, tempfile.mkdtemp(), name="joint")
    >>> sorted(file.name for file in written.files)[:3]
    ['CMakeLists.txt', 'CMakeLists.txt', 'LICENSE']
    """
    name = c_name(Path(folder).name if name is None else name, given=name is not None)
    source, content, digest = c_texts(
        law, name, real, torque_limits, joint_names, certificate, scenario, watch, parts, reference, commands
    )
    if firmware:
        content |= firmware_texts(source)
    if realtime:
        if source.commands:
            raise InvalidParameter(
                f"realtime: the law commands positions in {', '.join(dict.fromkeys(source.commands))}, and the loop "
                "writes torques; use the step in a loop of your own"
            )
        content |= realtime_texts(source, joint_names, follows_reference=parts and reference is not None)
    return Export(Path(folder), tuple(write_folder("folder", folder, content)), name, real, digest)


def c_texts(
    law: Law,
    name: str,
    real: str,
    torque_limits: TorqueLimits | None,
    joint_names: Sequence[str],
    certificate: Mapping[str, Any] | None,
    scenario: Mapping[str, Any] | None,
    watch: Watch | None,
    parts: bool = False,
    reference: Reference | None = None,
    commands: Sequence[str] = (),
) -> tuple[CSource, dict[str, str], str]:
    """Return the C of a law, the text of each file of its project by its path, and the hash of header and source.

    Raises
    ------
    InvalidParameter
        For another ``real``.
    UnsupportedLaw
        For a law that has no C.
    """
    check.one_of("real", real, REALS)
    inner = inner_loop_units(law, commands)
    title = f"{name}: {type(law).__name__}"
    source = CSource(traced_law(law, torque_limits, watch), name, real == "float", title, inner)
    recorded = vectors.record(source, *vectors.inputs_of(source, VECTORS, SEED))
    part = Parts(source, reference) if parts else None
    digest = hashlib.sha256((source.header + source.source).encode()).hexdigest()
    content = {
        f"src/{name}.h": source.header,
        f"src/{name}.c": source.source,
        "test/vectors.h": vectors.header(source, recorded),
        "law.yaml": law_yaml(law, name, real, digest, joint_names, certificate, scenario, watch, part, inner),
        "LICENSE": licence(),
        **texts(source, tuple(joint_names), VECTORS, LICENCE, part),
        **(part.texts() if part else {}),
    }
    return source, content, digest


def inner_loop_units(law: Law, commands: Sequence[str]) -> tuple[str, ...]:
    """Return the units of a law's commands where inner loops take them; empty for torques.

    Raises
    ------
    InvalidParameter
        For another number of units than joints, and for positions whose safe value is zero.
    """
    if not commands or all(unit in TORQUE_UNITS for unit in commands):
        return ()
    if len(commands) != law.n_joints:
        raise InvalidParameter(f"commands: got {len(commands)} units; needs one per joint, {law.n_joints}")
    if law.safe_torque == "zero" and any(unit in POSITION_UNITS for unit in commands):
        raise InvalidParameter(
            "safe_torque: got 'zero', and this law commands positions: after lost samples the robot would jump to the "
            "position zero; use safe_torque='hold' (--set law.safe_torque=hold)",
            "safe_torque",
        )
    return tuple(commands)


def c_name(text: str, given: bool = True) -> str:
    """Return a name as C takes it; of a folder the nearest one.

    Raises
    ------
    InvalidParameter
        For a given name that is none.
    """
    name = text if given else re.sub(r"[^a-z0-9_]+", "_", text.lower()).strip("_")
    if not given and (not name or not name[0].isalpha()):
        name = f"law_{name}".rstrip("_")
    if not NAME.match(name) or name in RESERVED:
        raise InvalidParameter(f"name: got {text!r}; needs small letters, digits and _, a letter first: it names C")
    return name


def law_yaml(
    law: Law,
    name: str,
    real: str,
    digest: str,
    joint_names: Sequence[str],
    certificate: Mapping[str, Any] | None,
    scenario: Mapping[str, Any] | None,
    watch: Watch | None,
    parts: Parts | None,
    commands: tuple[str, ...],
) -> str:
    """Return parameters, version, hash and verdict; values as JSON, which YAML reads."""
    parameters = {field.name: _plain(getattr(law, field.name)) for field in fields(law)}
    sections: dict[str, Any] = {
        "name": name,
        "law": type(law).__name__,
        "tarc": __version__,
        "real": real,
        "sha256": digest,
        "joints": list(joint_names),
        "parameters": parameters,
        "certificate": dict(certificate) if certificate else "none was given to the export; see tarc certify",
    }
    if watch is not None:
        sections["watch"] = {field.name: _plain(getattr(watch, field.name)) for field in fields(watch)}
    if commands:
        sections["commands"] = list(commands)
    if parts is not None:
        sections["parts"] = {"names": parts.names, "sha256": parts.digest}
    if scenario is not None:
        sections["scenario"] = dict(scenario)
    lines = []
    for key, value in sections.items():
        if isinstance(value, dict) and key not in ("scenario", "watch", "parts"):
            lines.append(f"{key}:")
            lines += [f"  {inner}: {json.dumps(entry, ensure_ascii=False)}" for inner, entry in value.items()]
        else:
            lines.append(f"{key}: {json.dumps(value, ensure_ascii=False)}")
    return "\n".join(lines) + "\n"


def _plain(value: Any) -> Any:
    """Return a parameter as numbers and text."""
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if np.isfinite(value) else str(value)
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(entry) for entry in np.asarray(value).tolist()]
    return str(value)


def licence() -> str:
    """Return what may be done with the files."""
    return (
        "The C in this folder was generated from your own design. Copy, change, compile and ship it as you like, in\n"
        "products as well. It comes without any warranty: whoever runs a robot with it is responsible for its safety.\n"
    )
