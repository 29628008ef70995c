"""`tarc diagnose`: what a log of a control loop says about encoders, delay, limits and the certificate."""

import json
from pathlib import Path
from typing import Annotated

import typer

from tarc.cli.options import Json, drawing_figures
from tarc.core.files import file_in_folder, writing

LoopLogFile = Annotated[Path, typer.Argument(metavar="LOG", help="The netCDF of tarc run, or of a loop on a machine.")]
Design = Annotated[
    str,
    typer.Option(
        "--scenario",
        metavar="SCENARIO",
        help="Scenario of the design, for its encoders, delay and robot. Default: that in the log, or scenario.yaml "
        "beside it.",
    ),
]
LawName = Annotated[str, typer.Option("--law", metavar="NAME", help="Law of the scenario. Default: that of the log.")]
StartTime = Annotated[
    float | None, typer.Option(help="First time to use \\[s]. Default: when the machine's loop began to track.")
]
Tube = Annotated[float, typer.Option(help="Distance from the reference that was certified \\[rad or m].")]
FigureFile = Annotated[Path | None, typer.Option("--figure", metavar="FILE", help="Write a figure, such as log.png.")]


def diagnose(
    log: LoopLogFile,
    scenario: Design = "",
    law: LawName = "",
    start_time: StartTime = None,
    tube: Tube = 0.01,
    figure: FigureFile = None,
    as_json: Json = False,
) -> None:
    """Diagnose the log of a loop: what is wrong, and what to change.

    It measures step and noise of the encoders, missing and stale samples, and
    jitter of the sampling times. It finds limit cycles, counts saturation, and
    holds speed and error against the certificate. With the scenario of the
    design it also finds the real delay from the torque to the motion. Noise
    and delay are then compared with those that the design assumes.

    Exit status 1 where there is a finding.

    Example: tarc diagnose runs/ur5e/TDC.nc --start-time 1 --figure log.png
    """
    from tarc.cli.tables import diagnose as tables
    from tarc.logs.diagnosis import diagnose as diagnose_log

    if figure is not None:
        file_in_folder("--figure", figure)
    diagnosis = diagnose_log(log, scenario or None, law=law, start_time=start_time, tube=tube)
    if figure is not None:
        with drawing_figures(), writing("--figure", figure):
            diagnosis.plot().savefig(figure, dpi=110)
    if as_json:
        print(json.dumps(diagnosis.summary(), indent=2, allow_nan=False))
    else:
        tables.print_diagnosis(diagnosis, [] if figure is None else [figure])
    if not diagnosis.is_clean:
        raise typer.Exit(1)
