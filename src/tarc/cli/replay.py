"""`tarc replay`: hold the log of a real robot against estimators, model and law."""

import json
from pathlib import Path
from typing import Annotated

import typer

from tarc.cli.options import Figures, Json, Out, drawing_figures, file_stem, numbers_of
from tarc.core.files import make_folder, writing

Log = Annotated[
    str,
    typer.Argument(
        metavar="LOG",
        help="A CSV with a header, a MATLAB file, a ROS 2 bag in MCAP, the netCDF of tarc run-live, or a folder with a "
        "text file per quantity.",
    ),
]
Robot = Annotated[
    str,
    typer.Argument(metavar="ROBOT", help="A URDF or MJCF file, or a shipped robot, for the torque of its model."),
]
Columns = Annotated[
    Path | None,
    typer.Option(
        "--columns",
        metavar="FILE",
        help="YAML that names the log's columns, such as position: \\[a, b]. Default: names such as q1, dq1, tau1.",
    ),
]
ShadowLaw = Annotated[
    str,
    typer.Option(
        "--law",
        metavar="SCENARIO",
        help="A scenario, such as tarc design writes. Its first law is run beside the log, and its robot is used.",
    ),
]
Window = Annotated[
    str, typer.Option(metavar="NUMBERS", help="Windows of the acceleration \\[s]. Default: the law's, or 0.010.")
]
Fraction = Annotated[float, typer.Option(help="M̂ of time-delay estimation, over the robot's mean inertia.")]
Period = Annotated[
    float | None, typer.Option(help="Period of the robot's clock \\[s]. Default: found from stamps and motion.")
]
StartTime = Annotated[float | None, typer.Option(help="First time to use, after the first row \\[s].")]
StopTime = Annotated[float | None, typer.Option(help="Last time to use, after the first row \\[s].")]
Cutoff = Annotated[float, typer.Option(help="Frequency up to which motion counts as true, above as noise \\[Hz].")]


def replay(
    log: Log,
    robot: Robot = "",
    columns: Columns = None,
    law: ShadowLaw = "",
    window: Window = "",
    inertia_fraction: Fraction = 0.1,
    period: Period = None,
    start_time: StartTime = None,
    stop_time: StopTime = None,
    cutoff: Cutoff = 25.0,
    out: Out = None,
    as_json: Json = False,
    figures: Figures = True,
) -> None:
    """Compare the log of a real robot with estimators, model and law.

    It reports rate, jitter, stale and missing samples, and finds the true
    time of each row from the motion that all joints share. On these times
    it compares the acceleration of a window with the motion: its delay and
    noise should be as predicted.

    With ROBOT and recorded torque: how much of the torque the model explains,
    joint by joint, and what time-delay estimation would have left over.
    With --law: what the law would have commanded, and whether its design
    assumed the noise that the log has.

    Columns are known by names: time, q1, dq1, tau1, q_ref1, or elbow/position
    and elbow/effort. Others are named in YAML, for --columns:

        time: clock

        position: \\[a, b]        # in MATLAB the path of an array: rec.angle

        torque: \\[fa, fb]

        units: {time: ms, position: deg}

    Example: tarc replay log.csv my_arm.urdf --law design.yaml
    """
    from tarc.cli.tables import replay as tables
    from tarc.logs.replayed import replay as replay_log

    folder = make_folder("--out", out or Path("runs") / file_stem(Path(log).stem))
    replayed = replay_log(
        log,
        robot or None,
        law=law or None,
        columns=columns,
        window=numbers_of("--window", window),
        inertia_fraction=inertia_fraction,
        period=period,
        start_time=start_time,
        stop_time=stop_time,
        cutoff=cutoff,
    )
    files: list[Path] = []
    if figures:
        with drawing_figures(), writing("--out", folder):
            files = [folder / "replay.png", folder / "replay.html"]
            replayed.plot().savefig(files[0], dpi=110)
            replayed.save_report(files[1])
    if as_json:
        print(json.dumps({**replayed.summary(), "files": [str(file) for file in files]}, indent=2, allow_nan=False))
    else:
        tables.print_replay(replayed, files)
