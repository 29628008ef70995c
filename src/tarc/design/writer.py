"""A design as a scenario, ready to run, and as files."""

import json
import tempfile
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from tarc.core.errors import TarcError
from tarc.plants.base import Plant
from tarc.plants.mujoco import MujocoPlant
from tarc.plants.robot_file import find_robot, shipped_robots
from tarc.scenario.model import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tarc.design.selection import Design


MAX_AMPLITUDE = 0.4
"""Greatest amplitude of the sines [rad or m]."""
BASE_FREQUENCY = 1.5
"""Frequency of the first joint's sine [rad/s]; the others are a fifth apart."""
MAX_SPEED_SHARE = 0.8
"""Share of the joints' greatest speed that the sines may reach."""
DURATION = 10.0
"""Of the scenario [s]."""
MAX_GRAVITY_SHARE = 0.7
"""Share of the torque limit that the weight may take along the sines; where it takes more they are made smaller."""
WIDTH = 110
"""Columns of the file."""

COMMENT_KEYS = {
    "robot": ("robot", "file"),
    "workspace": ("reference",),
    "speed": ("reference",),
    "payload": ("disturbance",),
    "torque limit": ("law", "torque_limit"),
    "weight": ("law", "torque_limit"),
    "inertia": ("law", "inertia"),
    "window": ("estimator", "window"),
    "natural_frequency": ("law", "natural_frequency"),
    "synchronised": ("law", "synchronised"),
    "delay": ("law", "delay"),
    "torque noise": ("sensor",),
    "boundary, cap": ("law", "boundary_layer"),
    "rise, fall": ("law", "rise_rate"),
    "min_gain": ("law", "min_gain"),
}
"""The key of the scenario beside which a choice is explained, by the choice's name."""


def scenario_of(design: "Design", duration: float = DURATION) -> Scenario:
    """See `Design.scenario`."""
    return Scenario.parse(sections(design, duration))


def plant_name(plant: Plant) -> str:
    """A robot by its file, without the ending, or by its class."""
    return Path(plant.label).stem


def sections(design: "Design", duration: float = DURATION) -> dict[str, Any]:
    """The scenario as plain data."""
    low, high = design.payload
    reference = design.workspace.reference
    if reference is not None:
        duration = min(duration, float(design.workspace.high[0]))
    content: dict[str, Any] = {
        "name": f"{plant_name(design.plants[0])} designed",
        "robot": robot_section(design.plants[0]),
        "law": law_section(design.law),
        "estimator": {
            "kind": "Algebraic",
            "window": round(design.candidate.window * design.law.period, 9),
            "degree": design.candidate.degree,
        },
        "reference": reference_section(design),
        "sensor": _plain({key: value for key, value in _non_defaults(design.sensor).items() if value is not None}),
        "initial_torque": "rest",
        "period": design.law.period,
        "computation_delay": design.candidate.computation_delay,
        "duration": duration,
        "metrics_start": min(1.0, duration / 4),
    }
    if high > low:
        content["disturbance"] = [{"kind": "Payload", "mass": high, "start_time": duration / 2}]
    return content


def robot_section(plant: Plant) -> dict[str, Any]:
    """A robot as a scenario writes it, its file found from any folder."""
    if isinstance(plant, MujocoPlant):
        return {**_plain(plant.options), "file": _located(str(plant.options["file"]))}
    if type(plant).__module__.startswith("tarc.plants"):
        return {"kind": type(plant).__name__, **_plain(_non_defaults(plant))}
    raise TarcError(
        f"scenario: {type(plant).__name__} is neither from a file nor one of tarc.plants; run it with tarc.simulate"
    )


def _located(name: str) -> str:
    """A shipped robot's name, or the whole path of a file."""
    file = find_robot(name)
    if not Path(name).is_file() and file.name in shipped_robots():
        return file.stem
    return str(file.resolve())


def law_section(law: Any) -> dict[str, Any]:
    """A law as a scenario writes it, without its estimator and period."""
    options = {name: value for name, value in _non_defaults(law).items() if name not in ("period", "estimator")}
    limit = options.get("torque_limit")
    if limit is not None and not np.all(np.isfinite(limit)):
        options.pop("torque_limit")
    return {"kind": type(law).__name__, **_plain(options)}


def reference_section(design: "Design") -> dict[str, Any]:
    """Sines about the home posture, that begin at rest and leave torque to move with; or the workspace's reference.

    At most a quarter of the workspace's width, and smaller where the weight alone would take most of the torque; slower
    where a joint would be near its greatest speed or acceleration.
    """
    n, speed, acceleration = design.law.n_joints, design.workspace.speed, design.workspace.acceleration
    if design.workspace.reference is not None:
        given = design.workspace.reference
        return {"kind": type(given).__name__, **_plain(_non_defaults(given))}
    low, high = design.workspace.low, design.workspace.high
    section: dict[str, Any] = {}
    for share in (1.0, 0.5, 0.25, 0.1):
        amplitude = share * np.minimum(MAX_AMPLITUDE, (high - low) / 4)
        middle = np.clip(np.clip(design.plants[0].home, low, high), low + amplitude, high - amplitude)
        frequency = BASE_FREQUENCY * (1 + 0.2 * np.arange(n))
        if speed is not None and acceleration is not None:
            wide = np.maximum(amplitude, 1e-9)
            frequency = np.minimum(frequency, MAX_SPEED_SHARE * np.minimum(speed / wide, (acceleration / wide) ** 0.5))
        section = {
            "kind": "Sinusoid",
            "amplitude": amplitude.round(4).tolist(),
            "frequency": frequency.round(3).tolist(),
            "phase": float(np.pi / 2),
            "offset": middle.round(4).tolist(),
        }
        if _holds(design, section):
            break
    return section


def _holds(design: "Design", section: dict[str, Any]) -> bool:
    """Whether holding the heaviest robot along the sines leaves torque to move with."""
    from tarc.signals.references import Sinusoid

    limit, plant = design.law.torque_limits, design.plants[-1]
    path = Sinusoid(**{key: value for key, value in section.items() if key != "kind"})
    postures = path.sample(np.linspace(0, DURATION, 100))[0].T
    return all(np.all(np.abs(np.asarray(plant.gravity_torque(one))) <= MAX_GRAVITY_SHARE * limit) for one in postures)


def _non_defaults(part: Any) -> dict[str, Any]:
    """Parameters of a component that are not at their default."""
    return {one.name: value for one in fields(part) if not _same(value := getattr(part, one.name), one.default)}


def _same(one: Any, other: Any) -> bool:
    return np.shape(one) == np.shape(other) and bool(np.all(one == other))


def _plain(content: Any) -> Any:
    """Lists and numbers instead of arrays, to eight digits."""
    if isinstance(content, dict):
        return {key: _plain(value) for key, value in content.items()}
    if isinstance(content, np.ndarray | np.generic):
        return _plain(content.tolist())
    if isinstance(content, list | tuple):
        return [_plain(one) for one in content]
    return float(f"{content:.8g}") if isinstance(content, float) else content


def to_commented_yaml(design: "Design", *, command: str = "", file: Path | None = None) -> str:
    """The scenario as YAML with the reasons as comments.

    Parameters
    ----------
    design
        What to write.
    command
        What made it, for the first line.
    file
        Where it will be, with its certificates beside it; a robot's file in the same folder is named from there.
    """
    content = sections(design)
    if file is not None and "file" in content["robot"]:
        robot, folder = Path(content["robot"]["file"]), file.parent.resolve()
        content["robot"]["file"] = str(robot.relative_to(folder) if robot.is_relative_to(folder) else robot)
    content["law"] = _whole(design, content["law"])
    notes: dict[tuple[str, ...], list[str]] = {}
    for one in design.choices:
        where = COMMENT_KEYS.get(one.name, ())
        while where and not _holds_key(content, where):
            where = where[:-1]
        notes.setdefault(where, []).append(f"{one.name}: {one.value}; {one.reason}")
    order = ("name", "robot", "law", "estimator", "sensor", "reference", "disturbance")
    content = {key: content[key] for key in (*(one for one in order if one in content), *content)}
    head = [*_verdict(design, command, file), *notes.pop((), [])]
    return "\n".join([*_comments(head, 0), "", *_lines(content, notes)]) + "\n"


def _whole(design: "Design", law: dict[str, Any]) -> dict[str, Any]:
    """The law's section in a fixed order, with what was chosen even where it is the default."""
    made = design.law
    late = None if made.synchronised else float(f"{made.delay_periods * made.period:.8g}")
    M = made.M
    content = {
        **law,
        "inertia": _plain(np.diag(M) if np.count_nonzero(M - np.diag(np.diag(M))) == 0 else M),
        "damping_ratio": design.candidate.damping_ratio,
        "synchronised": made.synchronised,
        "delay": late,
    }
    first = ("kind", "inertia", "natural_frequency", "damping_ratio", "synchronised", "delay")
    return {key: content[key] for key in (*first, *content)}


def _holds_key(content: Any, where: Sequence[str]) -> bool:
    for key in where:
        if not isinstance(content, dict) or key not in content:
            return False
        content = content[key]
    return True


def _verdict(design: "Design", command: str, file: Path | None) -> list[str]:
    """What stands on top of the file."""
    verdict = design.certificates["robot"]
    lines = [f"Made by: {command or 'tarc.design.design_controller'}", verdict.claim]
    lines.append(f"Verdict: {verdict.verdict}; {verdict.margin_meaning}: {verdict.margin:.4g}. Assumed:")
    lines += [f"- {one}" for one in verdict.assumptions]
    if file is not None:
        lines.append(f"Certificates: {certificates_path(file).name}")
    name = "this file" if file is None else file.name
    lines.append(f"Run it: tarc run {name}. Certify it again: tarc certify {name} {certify_options(design)}")
    return lines


def certificates_path(file: Path) -> Path:
    """Where the certificates are that belong to a design's YAML file."""
    return file.with_name(f"{file.stem}-certificates.json")


def certify_options(design: "Design") -> str:
    """Options with which ``tarc certify`` looks at the workspace of a design, or at the part that it moves in."""
    from tarc.design.robot_facts import joint_workspace

    workspace = design.workspace
    pace = ""
    if workspace.speed is not None and workspace.acceleration is not None:
        pace = f" --speed {_short(workspace.speed)}"
        usual = workspace.with_speed_limits(workspace.speed).acceleration
        if usual is not None and not np.allclose(usual, workspace.acceleration):
            pace += f" --acceleration {_short(workspace.acceleration)}"
    if workspace.reference is not None:
        return f"--tube {float(workspace.high[1:].max()):g}{pace}"
    try:
        reach = joint_workspace(design.plants[0])
    except TarcError:
        return f"--tube 0.01{pace}"
    full = np.allclose(reach.low, workspace.low) and np.allclose(reach.high, workspace.high)
    return f"--full-range{pace}" if full else f"--tube 0.01{pace}"


def _short(values: np.ndarray) -> str:
    """With commas between, or one number for all where they are the same."""
    return ",".join(f"{one:.6g}" for one in (values[:1] if np.ptp(values) == 0 else values))


def _comments(texts: Sequence[str], indent: int) -> list[str]:
    """Each text wrapped, behind the sign of a comment; a list's items keep their indent."""
    lines = []
    for text in texts:
        lines += textwrap.wrap(
            text,
            WIDTH - indent,
            initial_indent="# ",
            subsequent_indent="#   " if text.startswith("- ") else "# ",
            break_long_words=False,
            break_on_hyphens=False,
        )
    return [" " * indent + line for line in lines]


def _lines(content: dict[str, Any], notes: dict[tuple[str, ...], list[str]], where: tuple[str, ...] = ()) -> list[str]:
    """YAML of a section, lists in brackets, with the notes above their keys."""
    lines, indent = [], 2 * len(where)
    margin = " " * indent
    for key, value in content.items():
        path = (*where, key)
        lines += _comments(notes.get(path, []), indent)
        if isinstance(value, dict) and value:
            lines += [f"{margin}{key}:", *_lines(value, notes, path)]
        elif isinstance(value, list) and value and isinstance(value[0], list | dict):
            lines += [f"{margin}{key}:", *(f"{margin}  - {_inline(row)}" for row in value)]
        else:
            lines.append(f"{margin}{key}: {_inline(value)}")
    return lines


def _inline(value: Any) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, width=10**6, allow_unicode=True, sort_keys=False)
    return text.removesuffix("...\n").strip()


def check_writable(path: str | Path) -> Path:
    """Where a design may be written: the YAML file itself, in a folder that is there and can be written.

    Raises
    ------
    TarcError
        For a name that is not of YAML, and a folder or file that cannot be written.
    """
    here = Path(path).expanduser()
    if here.is_dir():
        here = here / "design.yaml"
    if here.suffix not in (".yaml", ".yml"):
        raise TarcError(
            f"out: got {str(path)!r}; needs the name of a YAML file, such as {here.with_suffix('.yaml')}, or a folder "
            "that exists"
        )
    try:
        here.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=here.parent):
            pass
        if here.exists():
            with here.open("a", encoding="utf-8"):
                pass
    except OSError as error:
        raise _unwritable(here, error) from None
    return here


def _unwritable(path: Path, error: OSError) -> TarcError:
    return TarcError(f"out: cannot write {path}: {error.strerror or error}; choose another folder")


def save(
    design: "Design", path: str | Path = "design.yaml", figures: "Mapping[str, Figure] | None" = None, command: str = ""
) -> list[Path]:
    """See `Design.save`; ``command`` is what made the design, for the first line of the file."""
    here = check_writable(path)
    proof = certificates_path(here)
    text = to_commented_yaml(design, command=command, file=here)
    content = {kind: json.loads(one.to_json()) for kind, one in design.certificates.items()}
    files = [here, proof]
    try:
        here.write_text(text, encoding="utf-8")
        proof.write_text(json.dumps(content), encoding="utf-8")
        for kind, figure in (figures or {}).items():
            files.append(here.with_name(f"{here.stem}-{kind}.png"))
            figure.savefig(files[-1], dpi=110)
    except OSError as error:
        raise _unwritable(here, error) from None
    return files
