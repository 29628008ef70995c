"""`tarc design`: from a robot's file to certified gains."""

import json
import shlex
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tarc.cli.design_options import requirement_options, requirements_of
from tarc.cli.options import Figures, Json, drawing_figures, names_of, names_or_positions, numbers_of, posture_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tarc.analysis.workspace import Workspace
    from tarc.design.requirements import DesignRequirements
    from tarc.design.result import Design
    from tarc.design.stress_case import StressRun
    from tarc.plants.base import Plant

PANEL = "The robot"
MOTION_PANEL = "The motion"
Robot = Annotated[str, typer.Argument(help="An MJCF or URDF file, or the name of a shipped robot.")]
DesignFile = Annotated[
    Path,
    typer.Option("--out", "-o", help="The scenario to write, or an existing folder; results are written beside it."),
]
Joints = Annotated[
    str,
    typer.Option(
        metavar="A,B",
        help="Joints to drive; the others are locked, or passive if the file has actuators but none for them. Default: "
        "those with an actuator, or all.",
        rich_help_panel=PANEL,
    ),
]
Lock = Annotated[
    str,
    typer.Option(
        metavar="A,B",
        help="Joints to lock in the home posture, or at positions \\[rad or m]: A=0.3,B=0. Default: those that "
        "are not driven.",
        rich_help_panel=PANEL,
    ),
]
Home = Annotated[
    str,
    typer.Option(
        metavar="NUMBERS",
        help="Home posture \\[rad or m]: one number per joint with commas between, or by name, A=0.3,B=1. Default: the "
        "keyframe home of the file, else zero or the middle of a range, else where the torque limits hold the robot.",
        rich_help_panel=PANEL,
    ),
]
Armature = Annotated[
    str,
    typer.Option(
        metavar="NUMBERS",
        help="Inertia of the rotors at the joints \\[kg m²]: rotor inertia times the gear ratio squared. One number, "
        "or one per joint with commas between. Default: that of the file. Most files have none; without it M(q) of "
        "light links varies more than any loop tolerates.",
        rich_help_panel=PANEL,
    ),
]
Viscous = Annotated[
    str,
    typer.Option(
        metavar="NUMBERS", help="Viscous friction \\[N m s/rad]. Default: that of the file.", rich_help_panel=PANEL
    ),
]
Coulomb = Annotated[
    str,
    typer.Option(metavar="NUMBERS", help="Coulomb friction \\[N m]. Default: that of the file.", rich_help_panel=PANEL),
]
Tool = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="Link or site that carries the payload. Default: a site named tool, else the last link.",
        rich_help_panel=PANEL,
    ),
]
BalanceInertia = Annotated[
    bool,
    typer.Option(
        "--balance-inertia",
        help="Replace the moments of an inertia that no body has by their mean, and say of which links.",
        rich_help_panel=PANEL,
    ),
]
Actuators = Annotated[
    str,
    typer.Option(
        metavar="file|torque",
        help="What the joints take: that of the file's actuators, which may be positions, or torques.",
        rich_help_panel=PANEL,
    ),
]
Trajectory = Annotated[
    Path | None,
    typer.Option(
        help="A motion to design for, instead of all that the joints reach: a CSV file of time, q1, q2, … or a ROS "
        "JointTrajectory as YAML. Its speeds, times 1.2, are the largest, unless --speed gives others.",
        rich_help_panel=MOTION_PANEL,
    ),
]
Tube = Annotated[
    float,
    typer.Option(help="Largest distance of each joint from the trajectory \\[rad or m].", rich_help_panel=MOTION_PANEL),
]
StressTest = Annotated[
    bool,
    typer.Option(
        "--stress-test",
        help="Find the largest payload, speed and delay, the lowest rate and the fewest bits with which the finished "
        "design stays certified. Takes minutes.",
    ),
]


@requirement_options
def design(
    robot: Robot,
    out: DesignFile = Path("design.yaml"),
    joints: Joints = "",
    lock: Lock = "",
    home: Home = "",
    armature: Armature = "",
    viscous: Viscous = "",
    coulomb: Coulomb = "",
    tool: Tool = "",
    balance_inertia: BalanceInertia = False,
    actuators: Actuators = "file",
    trajectory: Trajectory = None,
    tube: Tube = 0.05,
    stress_test: StressTest = False,
    as_json: Json = False,
    figures: Figures = True,
    **requirements: Any,
) -> None:
    """Design certified gains from a robot's file and its encoders; write a scenario that is ready to run.

    The shape of the inertia M̂ minimises the spread of the eigenvalues of
    M(q)⁻¹M̂ over postures and payloads. Window, natural frequency and the
    other parameters are chosen so that the loop tolerates this spread, with
    the least error within the noise budget. What cannot be certified is
    refused, with the requirement to relax and its new value. A design takes
    about a minute.

    Example: tarc design ur5e --payload 0 5 --armature 0.1 --speed 1

    With --model inertia or known the law has M̂(q) of the file, and the
    design without a model is made too, to compare.

    Example: tarc design ur5e --payload 0 5 --armature 0.1 --speed 1 --model inertia --armature-error 0.2

    Example: tarc design arm.urdf --trajectory motion.csv --armature 0.1

    Then: tarc run design.yaml; tarc certify design.yaml --full-range
    """
    from tarc.cli.tables import design as tables
    from tarc.design import design_controller, predict_design_error, try_design
    from tarc.design import stress_test as find_limits
    from tarc.design.writer import check_writable
    from tarc.plants import load_robot

    plant = load_robot(
        robot,
        joints=names_of(joints) or None,
        lock=names_or_positions("--lock", lock),
        home=posture_of("--home", home),
        armature=numbers_of("--armature", armature),
        viscous=numbers_of("--viscous", viscous),
        coulomb=numbers_of("--coulomb", coulomb),
        tool=tool or None,
        balance_inertia=balance_inertia,
        actuators=actuators,
    )
    required = requirements_of(requirements, None if trajectory is None else workspace_of(trajectory, tube, plant))
    file = check_writable(out, "--out")
    result = design_controller(plant, required)
    trial, predicted = try_design(result), predict_design_error(result)
    files = result.save(file, figures=_draw(result) if figures else {}, command=shlex.join(["tarc", *sys.argv[1:]]))
    designs = {}
    if required.model != "none":
        designs = {"none": _without_model(plant, required), required.model: (result, trial, predicted)}
    if not as_json:
        tables.print_design(result, trial, predicted, files)
    if designs and not as_json:
        tables.print_comparison(designs)
    limits = find_limits(result) if stress_test else {}
    if as_json:
        summary = tables.design_summary(result, trial, predicted, files, limits)
        if designs:
            summary["models"] = tables.comparison_summary(designs)
        print(json.dumps(summary, indent=2, allow_nan=False))
    elif limits:
        tables.print_limits(limits)


def _without_model(plant: "Plant", required: "DesignRequirements") -> "tuple[Design, StressRun, float] | str":
    """Return the design without a model, its trial and its predicted error; the reason where there is none."""
    from tarc.core.errors import InfeasibleDesign
    from tarc.design import design_controller, predict_design_error, try_design

    try:
        design = design_controller(plant, replace(required, model="none"))
    except InfeasibleDesign as error:
        return str(error)
    return design, try_design(design), predict_design_error(design)


def workspace_of(trajectory: Path, tube: float, plant: "Plant") -> "Workspace":
    """Return the postures about the motion of a file, with its speeds."""
    from tarc.analysis.workspace import Workspace
    from tarc.signals import JointTrajectory, RecordedReference

    file = trajectory.expanduser()
    kind = JointTrajectory if file.suffix.lower() in (".yaml", ".yml") or _has_velocities(file) else RecordedReference
    reference = kind(path=str(file.resolve()))
    workspace = Workspace.from_reference(reference, reference.end_time, tube=tube).for_joints(plant.joint_names)
    return workspace.with_reference_speeds()


def _has_velocities(file: Path) -> bool:
    """Return whether the head of a text file has columns such as ``elbow/velocity``, as a JointTrajectory does."""
    try:
        with file.open(encoding="utf-8") as text:
            return "/velocity" in text.readline()
    except (OSError, UnicodeDecodeError):
        return False  # the reader of the file says what is wrong


def _draw(result: "Design") -> "dict[str, Figure]":
    from tarc.plotting.design import design_figures

    with drawing_figures():
        return design_figures(result)
