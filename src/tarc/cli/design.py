"""`tarc design`: from a robot's file to certified gains."""

import json
import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from tarc.cli.options import numbers_of

ROBOT, ASKED = "The robot", "What is asked for"


def design(
    ctx: typer.Context,
    robot: Annotated[str, typer.Argument(help="An MJCF or URDF file, or the name of a shipped robot.")],
    out: Annotated[
        Path,
        typer.Option("--out", "-o", help="The scenario to write; certificates and figures go beside it."),
    ] = Path("design.yaml"),
    joints: Annotated[
        str, typer.Option(metavar="A,B", help="Joints to drive; default all. Others are locked.", rich_help_panel=ROBOT)
    ] = "",
    armature: Annotated[
        str,
        typer.Option(
            metavar="NUMBERS",
            help="Rotor inertia at the joints, kg m²: of the rotor, times the gear ratio squared. One number, or one a "
            "joint with commas between. Most files have none, and without it light links make M(q) vary more than any "
            "loop bears.",
            rich_help_panel=ROBOT,
        ),
    ] = "",
    viscous: Annotated[
        str, typer.Option(metavar="NUMBERS", help="Viscous friction, N m s/rad.", rich_help_panel=ROBOT)
    ] = "",
    coulomb: Annotated[str, typer.Option(metavar="NUMBERS", help="Coulomb friction, N m.", rich_help_panel=ROBOT)] = "",
    torque_limit: Annotated[
        str,
        typer.Option(metavar="NUMBERS", help="In place of those in the file, N m or N.", rich_help_panel=ROBOT),
    ] = "",
    tool: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Link or site that carries the payload; default a site named tool, else the last link.",
            rich_help_panel=ROBOT,
        ),
    ] = "",
    payload: Annotated[
        tuple[float, float],
        typer.Option(metavar="LOW HIGH", help="Least and greatest load at the tool, kg.", rich_help_panel=ASKED),
    ] = (0.0, 0.0),
    encoder_bits: Annotated[
        int, typer.Option(help="Resolution of the encoders, bits a turn.", rich_help_panel=ASKED)
    ] = 17,
    control_rate: Annotated[
        float, typer.Option(help="Control periods per second, Hz.", rich_help_panel=ASKED)
    ] = 1000.0,
    computation_delay: Annotated[
        int, typer.Option(help="Periods between a measurement and its torque.", rich_help_panel=ASKED)
    ] = 0,
    joint_range: Annotated[
        float | None,
        typer.Option(
            help="Certify only for postures within ± so much of the home posture, rad (m for a slide), instead of all "
            "that the joints reach.",
            rich_help_panel=ASKED,
        ),
    ] = None,
    speed: Annotated[
        str,
        typer.Option(
            metavar="NUMBERS",
            help="Greatest speed of the joints, rad/s or m/s: the slower the robot, the better the gains that can be "
            "certified. Default: the velocity limits in the file, where it has them; inf for any speed.",
            rich_help_panel=ASKED,
        ),
    ] = "",
    acceleration: Annotated[
        str,
        typer.Option(
            metavar="NUMBERS",
            help="And their greatest acceleration, rad/s² or m/s². Default: four times the speed, a second.",
            rich_help_panel=ASKED,
        ),
    ] = "",
    noise: Annotated[
        float | None,
        typer.Option(
            help="Torque noise allowed: its RMS as a share of the torque limit, 0.02 for 2 %. Default: 0.01, or as "
            "little as can be certified, or as a given natural frequency allows.",
            rich_help_panel=ASKED,
        ),
    ] = None,
    natural_frequency: Annotated[
        float | None, typer.Option(help="In rad/s; default: as high as the noise allows.", rich_help_panel=ASKED)
    ] = None,
    damping_ratio: Annotated[float, typer.Option(help="Damping ratio of the error.", rich_help_panel=ASKED)] = 1.0,
    law: Annotated[
        str, typer.Option(metavar="tarc|tdc", help="With the adaptive gain or without.", rich_help_panel=ASKED)
    ] = "tarc",
    diagonal: Annotated[
        bool, typer.Option("--diagonal", help="Only a diagonal inertia M̂.", rich_help_panel=ASKED)
    ] = False,
    limits: Annotated[
        bool,
        typer.Option(
            "--limits",
            help="Say also how far the design can be pushed: payload, bits, rate, delay; takes minutes.",
        ),
    ] = False,
    samples: Annotated[int, typer.Option(help="Postures to sample, before a local search.")] = 500,
    seed: Annotated[int, typer.Option(help="Of the samples.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the results as JSON instead of a table.")] = False,
    figures: Annotated[bool, typer.Option(help="Draw figures.")] = True,
) -> None:
    """From a robot's file and its encoders to certified gains: a scenario ready to run, each choice with its reason.

    The inertia M̂ is shaped so that M(q)⁻¹M̂ varies least over all postures and
    payloads. Window, natural frequency and the rest are chosen so that the loop bears
    this, with as little error as the torque noise allowed permits. What cannot
    be certified is refused, with what to relax and by how much. Takes a minute
    or so.

    Example: tarc design ur5e --payload 0 5 --armature 0.1 -o design.yaml

    Then: tarc run design.yaml; tarc certify design.yaml --full-range
    """
    from tarc.cli import tables
    from tarc.core import validation as check
    from tarc.core.errors import TarcError
    from tarc.design import DesignRequirements, design_controller, stress_test
    from tarc.design.writer import check_writable
    from tarc.plants import MujocoPlant
    from tarc.signals import Encoder

    plant = MujocoPlant.from_file(
        robot,
        joints=[name.strip() for name in joints.split(",") if name.strip()] or None,
        armature=numbers_of("--armature", armature),
        viscous=numbers_of("--viscous", viscous),
        coulomb=numbers_of("--coulomb", coulomb),
        tool=tool or None,
    )
    if noise is not None and not 0 < noise <= 1:
        raise TarcError(f"--noise: got {noise:g}; needs a share of the torque limit, such as 0.02 for 2 %")
    requirements = DesignRequirements(
        period=1 / check.number("--control-rate", control_rate, 0, strict=True),
        sensor=Encoder(bits=check.integer("--encoder-bits", encoder_bits, 1, 52)),
        payload=payload,
        joint_range=joint_range,
        speed=numbers_of("--speed", speed),
        acceleration=numbers_of("--acceleration", acceleration),
        natural_frequency=natural_frequency,
        damping_ratio=damping_ratio,
        noise_budget=noise,
        torque_limits=numbers_of("--torque-limit", torque_limit),
        law=check.one_of("--law", law.lower(), ("tarc", "tdc")).upper(),
        diagonal=diagonal,
        computation_delay=computation_delay,
        samples=samples,
        seed=seed,
    )
    file = check_writable(out, "--out")
    result = design_controller(plant, requirements)
    drawn = {}
    if figures:
        from rich.console import Console

        from tarc.plotting.design import design_figures

        with Console(stderr=True).status("drawing figures"):
            drawn = design_figures(result)
    files = result.save(file, figures=drawn, command=shlex.join(["tarc", *sys.argv[1:]]))
    if not as_json:
        tables.print_design(result, files)
    found = {}
    if limits:
        found = stress_test(result)
    if as_json:
        print(json.dumps(tables.design_summary(result, files, found), indent=2, allow_nan=False))
    elif found:
        tables.print_limits(found)
