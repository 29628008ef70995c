"""A design as the content of a scenario, as commented YAML and as files."""

import tempfile
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from ruamel.yaml.comments import CommentedMap

from tarc.analysis.workspace import Workspace
from tarc.certificates.base import Certificate
from tarc.core.errors import InvalidParameter
from tarc.core.files import writing
from tarc.core.formatting import format_per_joint
from tarc.core.validation import Numbers
from tarc.design.choice import DesignChoice
from tarc.design.robot_facts import joint_workspace
from tarc.design.trial_motion import DURATION, slow_sines
from tarc.estimators.base import Estimator
from tarc.laws.nominal_inertia import ModelTerms, NominalInertia
from tarc.laws.tarc import TARC
from tarc.laws.tdc import TDC
from tarc.plants.base import Plant
from tarc.plants.robot_file import find_robot, shipped_robots
from tarc.scenario.user_law import kind_of
from tarc.scenario.yaml_text import write_yaml
from tarc.signals.sensors import Encoder

if TYPE_CHECKING:
    from _typeshed import DataclassInstance
    from matplotlib.figure import Figure

Value: TypeAlias = "bool | int | float | str | list[Value] | dict[str, Value] | None"
"""What a YAML file holds."""
Content: TypeAlias = dict[str, Value]
"""A section of a YAML file."""

COMMENT_WIDTH = 110
"""Largest number of characters per line of a comment."""
MAX_LINE_WIDTH = 10**6
"""Largest number of characters per line of a value: a row of a matrix stays on one line."""
SECTION_ORDER = ("name", "robot", "law", "estimator", "sensor", "torque_limits", "reference", "disturbance")
LAW_ORDER = ("kind", "inertia", "natural_frequency", "damping_ratio", "synchronised", "delay")


def plant_name(plant: Plant) -> str:
    """Return the name of a robot: that of its file without the ending, or of its class."""
    return Path(plant.label).stem


def scenario_content(
    law: TDC | TARC,
    plants: Sequence[Plant],
    workspace: Workspace,
    sensor: Encoder,
    torque_noise: np.ndarray,
    duration: float = DURATION,
    torque_rate: Numbers | None = None,
) -> Content:
    """Return the keys of a scenario that runs a law on the first robot.

    Where the last robot has another payload, it is picked up at half-time.
    """
    if workspace.reference is not None:
        duration = min(duration, float(workspace.high[0]))
    content: Content = {
        "name": f"{plant_name(plants[0])} designed",
        "robot": robot_section(plants[0]),
        "law": law_section(law, plants[0]),
        "estimator": estimator_section(law.estimator),
        "sensor": {key: value for key, value in _non_defaults(sensor).items() if value is not None},
        "reference": reference_section(law, plants, workspace, torque_noise),
    }
    if len(plants) > 1:
        mass = float(np.squeeze(plants[-1].parameters["payload"]))
        content["disturbance"] = [{"kind": "Payload", "mass": mass, "start_time": duration / 2}]
    if torque_rate is not None:
        content["torque_limits"] = {"rate": _plain(torque_rate)}
    content["initial_torque"] = "rest"
    content["period"] = law.period
    content["computation_delay"] = law.actuation_delay
    content["duration"] = duration
    content["metrics_start"] = min(1.0, duration / 4)
    return content


def robot_section(plant: Plant) -> Content:
    """Return a robot's section of a scenario. Its file is found from any folder.

    Raises
    ------
    InvalidParameter
        For a robot that a scenario cannot name.
    """
    if plant.file_options:
        options = {key: _plain(value) for key, value in plant.file_options.items()}
        return {**options, "file": _find_path(str(plant.file_options["file"]))}
    if type(plant).__module__.startswith("tarc.plants") and is_dataclass(plant):
        return {"kind": type(plant).__name__, **_non_defaults(plant)}
    raise InvalidParameter(
        f"scenario: {type(plant).__name__} is neither from a file nor one of tarc.plants; run it with tarc.simulate"
    )


def _find_path(name: str) -> str:
    """Return the name of a shipped robot, or the whole path of a file."""
    file = find_robot(name)
    if not Path(name).is_file() and file.name in shipped_robots():
        return file.stem
    return str(file.resolve())


def relative_path(file: Path, folder: Path) -> str:
    """Return the path from a folder where the file is in it, else the path as it is."""
    parent = folder.resolve()
    return str(file.relative_to(parent) if file.is_relative_to(parent) else file)


def law_section(law: TDC | TARC, plant: Plant) -> Content:
    """Return a law's section of a scenario, without its estimator and period.

    Every chosen value is included, also where it is the default.

    Parameters
    ----------
    law
        The law.
    plant
        The scenario's robot, of which a model of the law is named by the parameters that differ.
    """
    options = _non_defaults(law, without=("period", "estimator", "inertia", "feedforward"))
    if law.torque_limit is not None and not np.all(np.isfinite(law.torque_limit)):
        options.pop("torque_limit", None)
    if law.feedforward is not None:
        options["feedforward"] = _model_section(law.feedforward, plant)
    content: Content = {
        "kind": kind_of(law),
        **options,
        "inertia": _inertia_section(law, plant),
        "damping_ratio": _plain(law.damping_ratio),
        "synchronised": law.synchronised,
        "delay": None if law.synchronised else _plain(law.delay_periods * law.period),
    }
    return {key: content[key] for key in (*LAW_ORDER, *content)}


def _inertia_section(law: TDC | TARC, plant: Plant) -> Value:
    """Return M̂ as numbers, its diagonal where it is diagonal, or M̂(q) as a model."""
    if isinstance(law.inertia, NominalInertia):
        return _model_section(law.inertia, plant)
    is_diagonal = np.count_nonzero(law.M - np.diag(np.diag(law.M))) == 0
    return _plain(np.diag(law.M) if is_diagonal else law.M)


def _model_section(terms: ModelTerms, plant: Plant) -> Content:
    """Return a model by the parameters in which it differs from the robot, and its terms."""
    own = plant.parameters
    values = {name: value for name, value in terms.model.parameters.items() if not _equal(value, own[name])}
    return {"model": _plain(values) if values else True, **_non_defaults(terms, without=("model",))}


def estimator_section(estimator: Estimator) -> Content:
    """Return an estimator's section of a scenario, its degree also where it is the default."""
    options = _non_defaults(estimator, without=("period",))
    return {"kind": type(estimator).__name__, **options, "degree": _plain(getattr(estimator, "degree", None))}


def reference_section(
    law: TDC | TARC, plants: Sequence[Plant], workspace: Workspace, torque_noise: np.ndarray
) -> Content:
    """Return the section of the workspace's own reference, or of `slow_sines`."""
    if workspace.reference is not None:
        return {"kind": type(workspace.reference).__name__, **_non_defaults(workspace.reference, without=("robot",))}
    sines = slow_sines(law, plants, workspace, torque_noise)
    return {
        "kind": "Sinusoid",
        "amplitude": np.asarray(sines.amplitude).tolist(),
        "frequency": np.asarray(sines.frequency).tolist(),
        "phase": float(np.max(sines.phase)),
        "offset": np.asarray(sines.offset).tolist(),
    }


def _non_defaults(part: "DataclassInstance", without: Sequence[str] = ()) -> Content:
    """Return the parameters of a component that are not at their default, except those named."""
    chosen = [field for field in fields(part) if field.name not in without]
    values = {field.name: (getattr(part, field.name), field.default) for field in chosen}
    return {name: _plain(value) for name, (value, default) in values.items() if not _equal(value, default)}


def _equal(value: object, default: object) -> bool:
    return np.shape(np.asarray(value)) == np.shape(np.asarray(default)) and bool(np.all(value == default))


def _plain(value: object) -> Value:
    """Return lists and numbers of eight digits instead of arrays."""
    if isinstance(value, dict):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, float):
        return float(f"{value:.8g}")
    if value is None or isinstance(value, bool | int | str):
        return value
    raise InvalidParameter(f"scenario: {type(value).__name__} is no value of a YAML file")


def to_commented_yaml(content: Content, choices: Sequence[DesignChoice], header: Sequence[str] = ()) -> str:
    """Return YAML with the reason of each choice above its key. The comments survive a reload by ruamel.yaml.

    Parameters
    ----------
    content
        The scenario.
    choices
        Each is written above the key that it names, or above the nearest section that exists.
    header
        Paragraphs on top of the file. Choices without a key follow them.
    """
    comments: dict[tuple[str, ...], list[str]] = {}
    for choice in choices:
        key = choice.key
        while key and not _has_key(content, key):
            key = key[:-1]
        comments.setdefault(key, []).append(f"{choice.label}: {choice.value}; {choice.reason}")
    ordered = [key for key in SECTION_ORDER if key in content]
    sections = {key: content[key] for key in (*ordered, *content)}
    top = "\n".join(f"# {line}".rstrip() for line in _wrap([*header, *comments.get((), [])], 0))
    return f"{top}\n\n{write_yaml(_commented_map(sections, comments), MAX_LINE_WIDTH)}"


def _commented_map(
    content: Content, comments: Mapping[tuple[str, ...], Sequence[str]], path: tuple[str, ...] = ()
) -> CommentedMap:
    indent = 2 * len(path)
    result = CommentedMap()
    result.fa.set_block_style()
    for key, value in content.items():
        place = (*path, key)
        result[key] = _commented_map(value, comments, place) if isinstance(value, dict) else value
        if place in comments:
            text = "\n".join(_wrap(comments[place], indent))
            result.yaml_set_comment_before_after_key(key, before=text, indent=indent)
    return result


def _has_key(content: Value, path: Sequence[str]) -> bool:
    for key in path:
        if not isinstance(content, dict) or key not in content:
            return False
        content = content[key]
    return True


def _wrap(texts: Sequence[str], indent: int) -> list[str]:
    """Return the lines of paragraphs; the items of a list keep their indent."""
    lines: list[str] = []
    for text in texts:
        following = "  " if text.startswith("- ") else ""
        width = COMMENT_WIDTH - indent - 2
        lines += textwrap.wrap(text, width, subsequent_indent=following, break_long_words=False, break_on_hyphens=False)
    return lines


def header_lines(verdict: Certificate, options: str, command: str = "", file: Path | None = None) -> list[str]:
    """Return the paragraphs on top of a design's file: its origin, the verdict and how to repeat it.

    Parameters
    ----------
    verdict
        The robot's certificate.
    options
        As `certify_options` gives them.
    command
        The command that made the design.
    file
        The file to be written.
    """
    name = "this file" if file is None else file.name
    lines = [
        f"Made by: {command or 'tarc.design.design_controller'}",
        verdict.claim,
        f"Verdict: {verdict.verdict}; {verdict.margin_meaning}: {verdict.margin:.4g}. Assumed:",
        *(f"- {assumption}" for assumption in verdict.assumptions),
    ]
    if file is not None:
        lines.append(f"Certificates: {certificates_path(file).name}")
    lines.append(f"Run it: tarc run {name}. Certify it again: tarc certify {name} {options}")
    return lines


def certify_options(plant: Plant, workspace: Workspace) -> str:
    """Return the options of ``tarc certify`` that certify a workspace, or the part of it that the scenario uses."""
    limits = ""
    if workspace.speed is not None and workspace.acceleration is not None:
        limits = f" --speed {_option(workspace.speed)}"
        usual = workspace.with_speed_limits(workspace.speed).acceleration
        if usual is not None and not np.allclose(usual, workspace.acceleration):
            limits += f" --acceleration {_option(workspace.acceleration)}"
    if workspace.reference is not None:
        return f"--tube {float(workspace.high[1:].max()):g}{limits}"
    try:
        whole = joint_workspace(plant)
    except InvalidParameter:  # a slide without a range
        return f"--tube 0.01{limits}"
    is_whole = np.allclose(whole.low, workspace.low) and np.allclose(whole.high, workspace.high)
    return f"--full-range{limits}" if is_whole else f"--tube 0.01{limits}"


def _option(values: np.ndarray) -> str:
    """Return numbers as an option of a command takes them."""
    return format_per_joint(values, digits=6).replace(" ", "")


def certificates_path(file: Path) -> Path:
    """Return the file of the certificates that belong to a design's YAML file."""
    return file.with_name(f"{file.stem}-certificates.json")


def check_writable(path: str | Path, name: str = "save") -> Path:
    """Return the YAML file to write; for a folder, ``design.yaml`` in it. Missing folders are made.

    Parameters
    ----------
    path
        The file or folder.
    name
        The parameter that holds it, for the message.

    Raises
    ------
    InvalidParameter
        For a name that is not of YAML, and a folder or file that cannot be written.
    """
    file = Path(path).expanduser()
    if file.is_dir():
        file = file / "design.yaml"
    if file.suffix not in (".yaml", ".yml"):
        raise InvalidParameter(
            f"{name}: got {str(path)!r}; needs the name of a YAML file, such as {file.with_suffix('.yaml')}, or an "
            "existing folder"
        )
    with writing(name, file):
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=file.parent):
            pass
        if file.exists():
            with file.open("a", encoding="utf-8"):
                pass
    return file


def write_files(file: Path, texts: Mapping[Path, str], figures: "Mapping[str, Figure]") -> list[Path]:
    """Write texts, and figures beside a file under its name and theirs; return all files.

    Raises
    ------
    InvalidParameter
        For a file that cannot be written.
    """
    written = list(texts)
    with writing("save", file):
        for path, text in texts.items():
            path.write_text(text, encoding="utf-8")
        for kind, figure in figures.items():
            written.append(file.with_name(f"{file.stem}-{kind}.png"))
            figure.savefig(written[-1], dpi=110)
    return written
