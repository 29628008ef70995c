"""`tarc identify`: rotor inertia, friction, payload, delay and noise of a real robot from its log."""

import json
from typing import Annotated

import typer

from tarc.cli.options import Json
from tarc.cli.replay import Columns, Cutoff, Log, Period, StartTime, StopTime

Robot = Annotated[
    str,
    typer.Argument(metavar="ROBOT", help="A URDF or MJCF file, or a shipped robot. Without one: its inertia M̂ alone."),
]
Links = Annotated[
    bool | None,
    typer.Option(
        "--links/--no-links",
        help="Identify mass, centre and inertia of each link too. Default: where they explain more.",
        show_default=False,
    ),
]


def identify(
    log: Log,
    robot: Robot = "",
    columns: Columns = None,
    links: Links = None,
    period: Period = None,
    start_time: StartTime = None,
    stop_time: StopTime = None,
    cutoff: Cutoff = 25.0,
    as_json: Json = False,
) -> None:
    """Identify what the file of a robot does not know, from a log of the real one.

    Rotor inertia and friction of each joint, the load, the delay of the
    torque and the noise of the encoders, each with its 95 % interval.
    The log needs torques; the columns are named as for tarc replay.

    The model is fitted to the beginning of the record and tried on its end:
    the explained share says how far to trust it. The last line has the
    options with which tarc design takes the numbers over.

    Without ROBOT it looks for the inertia M̂ that time-delay estimation
    needs, and says which motion is missing where the log does not show it.

    Example: tarc identify log.csv my_arm.urdf
    """
    from tarc.cli.tables import identify as tables
    from tarc.logs.identified_model import identify_model, inertia_from_log

    part = {"period": period, "start_time": start_time, "stop_time": stop_time, "cutoff": cutoff}
    if not robot:
        inertia = inertia_from_log(log, columns=columns, **part)
        if as_json:
            print(json.dumps(tables.inertia_numbers(inertia), indent=2))
        else:
            tables.print_inertia(inertia)
        return
    model = identify_model(log, robot, columns=columns, links=links, **part)
    if as_json:
        numbers = {**model.summary(), "remarks": model.remarks(), "design_options": model.design_options()}
        print(json.dumps(numbers, indent=2))
    else:
        tables.print_model(model, f"tarc design {robot}")
