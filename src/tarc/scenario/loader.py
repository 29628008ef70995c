"""Find, read and change the YAML of a scenario."""

import os
from importlib.resources import files
from math import floor
from pathlib import Path
from typing import Any

from tarc.core import validation as check
from tarc.core.errors import ScenarioError
from tarc.scenario.schema import parameters_of_law
from tarc.scenario.user_law import absolute_kind, is_user_law, relative_kind
from tarc.scenario.yaml_text import read_yaml
from tarc.signals.joint_trajectory import JointTrajectory
from tarc.signals.log_bag import has_trajectory
from tarc.signals.references import RecordedReference
from tarc.signals.trajectory_message import BAG, SUFFIXES

SHIPPED = Path(str(files("tarc.scenario"))) / "shipped"
"""Folder of the scenarios that come with the package, and of the files that they name."""


def shipped_scenarios() -> list[str]:
    """Return the names of the scenarios that come with the package."""
    return sorted(file.stem for file in SHIPPED.glob("*.yaml"))


def find_scenario(path: str | Path) -> Path:
    """Return the file itself, or that of a shipped scenario by name, in upper or lower case.

    Raises
    ------
    ScenarioError
        For a name that is neither.
    """
    file = Path(path).expanduser()
    if file.is_file():
        return file
    name = file.name.removesuffix(".yaml").lower()
    names = shipped_scenarios()
    if len(file.parts) == 1 and name in names:
        return SHIPPED / f"{name}.yaml"
    raise ScenarioError(
        f"scenario: {str(path)!r} not found; looked for {file.resolve()} and among the shipped scenarios "
        f"({', '.join(names)}).{check.did_you_mean(file.stem, names)}"
    )


def read_scenario(file: Path) -> dict[str, Any]:
    """Return the content of a scenario file; its own name stands for a missing ``name``.

    Raises
    ------
    ScenarioError
        For a file that cannot be read, is not YAML, or has no keys.
    """
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{file}: cannot be read: {error}") from None
    content = read_yaml(text, str(file))
    if not isinstance(content, dict):
        raise ScenarioError(f"{file}: holds no scenario; needs keys and values, such as robot: and law:")
    return {"name": file.stem, **content}


FILE_KEYS = (("robot", "file"), ("reference", "path"))
"""Section and key of each file that a scenario names."""

SHORTEST_DURATION = 0.01
"""Duration of a run on a reference that has hardly any of its own [s]."""

MODEL_KEYS = ("inertia", "feedforward")
"""Sections of a law that may have a model of the robot."""


def resolve_files(content: dict[str, Any], folder: Path) -> None:
    """Replace the names of files beside a scenario, or among the shipped ones, by their absolute paths."""
    for law in _user_laws(content):
        law["kind"] = absolute_kind(law["kind"], folder)
    for part, key in _parts_with_files(content):
        for place in (folder, SHIPPED):
            if (place / part[key]).is_file():
                part[key] = str((place / part[key]).resolve())
                break


def relative_files(content: dict[str, Any], folder: Path) -> None:
    """Replace absolute paths by shipped names or by paths from a folder: the reverse of `resolve_files`."""
    for law in _user_laws(content):
        law["kind"] = relative_kind(law["kind"], folder)
    for part, key in _parts_with_files(content):
        file = Path(part[key])
        if file.is_absolute():
            is_shipped = file.parent == SHIPPED.resolve()
            part[key] = file.name if is_shipped else Path(os.path.relpath(file, folder.resolve())).as_posix()


def _parts_with_files(content: dict[str, Any]) -> list[tuple[dict[str, Any], str]]:
    """Return the parts of a scenario that name a file, with the key of its name; models of laws included."""
    parts = [(content.get(section), key) for section, key in FILE_KEYS]
    laws = content.get("law")
    for law in laws if isinstance(laws, list) else [laws]:
        sections = [law.get(key) for key in MODEL_KEYS] if isinstance(law, dict) else []
        parts += [(section.get("model"), "file") for section in sections if isinstance(section, dict)]
    return [(part, key) for part, key in parts if isinstance(part, dict) and isinstance(part.get(key), str)]


def _user_laws(content: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the sections of the laws from a user's own file."""
    laws = content.get("law")
    parts = laws if isinstance(laws, list) else [laws]
    return [part for part in parts if isinstance(part, dict) and is_user_law(part.get("kind"))]


def use_reference(content: dict[str, Any], path: str | Path) -> None:
    """Replace the reference of a scenario's dictionary by that of a file, and the duration by its own.

    Raises
    ------
    InvalidParameter
        For a file that is not there or cannot be read.
    """
    file = Path(path).resolve()
    suffix = file.suffix.lower()
    is_message = suffix in SUFFIXES or (suffix == BAG and has_trajectory(file))
    kind = JointTrajectory if is_message else RecordedReference
    end_time = kind(path=file).end_time
    content["reference"] = {"kind": kind.__name__, "path": str(file)}
    content["duration"] = max(floor(1000 * end_time) / 1000, SHORTEST_DURATION)


def use_law(content: dict[str, Any], kind: str) -> None:
    """Replace the laws of a scenario's dictionary by one of another kind, with the parameters that it shares.

    The parameters come from the first law. A kind from a user's own file is sought in the working directory.
    """
    laws = content.get("law")
    first = laws[0] if isinstance(laws, list) and laws else laws
    kind = absolute_kind(kind, Path.cwd()) if is_user_law(kind) else kind
    allowed = {"estimator", *parameters_of_law(kind)}
    shared = {key: value for key, value in first.items() if key in allowed} if isinstance(first, dict) else {}
    content["law"] = {"kind": kind, **shared}


def apply_setting(content: dict[str, Any], setting: str) -> None:
    """Put ``section.key=value`` into a scenario's dictionary; ``law.key`` changes every law of a list.

    Raises
    ------
    ScenarioError
        For a setting without key or value, and for a path that leads nowhere.
    """
    path, equals, text = setting.partition("=")
    keys = path.strip().split(".")
    if not equals or not all(keys):
        raise ScenarioError(f"--set: got {setting!r}; needs key=value, such as law.natural_frequency=15")
    value = read_yaml(text, f"--set: {setting!r}")
    nodes: list[object] = [content]
    for depth, key in enumerate(keys[:-1]):
        expand_lists = not keys[depth + 1].isdigit()
        parent = ".".join(keys[:depth])
        nodes = [child for node in nodes for child in _children(node, key, expand_lists, setting, parent)]
    for node in nodes:
        if isinstance(node, list) and keys[-1].isdigit() and int(keys[-1]) < len(node):
            node[int(keys[-1])] = value
        elif isinstance(node, dict):
            node[keys[-1]] = value
        else:
            raise ScenarioError(f"--set: {setting!r}: {node!r} has no key {keys[-1]!r}")


def _children(node: object, key: str, expand_lists: bool, setting: str, parent: str) -> list[object]:
    """Return what stands under a key, or each item of it where it is a list that is not indexed."""
    if isinstance(node, list):
        if not key.isdigit() or int(key) >= len(node):
            raise ScenarioError(f"--set: {setting!r}: {parent} is a list of {len(node)}; use 0, 1, …")
        child = node[int(key)]
    elif isinstance(node, dict):
        child = node.setdefault(key, {})
    else:
        raise ScenarioError(f"--set: {setting!r}: {parent} is {node!r}, which has no keys")
    return child if isinstance(child, list) and expand_lists else [child]
