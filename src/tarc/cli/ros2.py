"""`tarc ros2`: a law as a node of ROS 2, and a simulated robot to try it with, both without ROS."""

import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from tarc.cli.export import check_efforts
from tarc.cli.options import Json, ScenarioName, Set, numbers_of
from tarc.cli.run_live import finish

app = typer.Typer(help="ROS 2 without an installation of ROS, over DDS. Needs the extra ros2.", no_args_is_help=True)

LawName = Annotated[str, typer.Option("--law", metavar="NAME", help="Law of the scenario. Default: the first.")]
Controller = Annotated[str, typer.Option(help="Controller that takes efforts at /CONTROLLER/commands.")]
Domain = Annotated[int | None, typer.Option(help="DDS domain. Default: ROS_DOMAIN_ID, else 0.")]
Duration = Annotated[float, typer.Option(help="How long to run at most \\[s].")]
Timeout = Annotated[float, typer.Option(help="How long to wait for the first joint state \\[s].")]
LogFile = Annotated[Path | None, typer.Option("--log", help="File of the log, netCDF. Default: none.")]
Priority = Annotated[int, typer.Option(help="Of SCHED_FIFO, 1 to 99; 0 for the ordinary scheduler.")]
Watchdog = Annotated[float, typer.Option(help="Longest time without a joint state \\[s]; then a safe stop.")]
ErrorLimit = Annotated[
    str, typer.Option("--error-limit", help="Error beyond which it stops \\[rad or m]; empty for none.")
]


@app.command()
def run(
    scenario: ScenarioName,
    law: LawName = "",
    controller: Controller = "effort_controller",
    domain: Domain = None,
    duration: Duration = 3600.0,
    timeout: Timeout = 10.0,
    watchdog: Watchdog = 0.05,
    error_limit: ErrorLimit = "0.3",
    priority: Priority = 80,
    log: LogFile = None,
    set_: Set = None,
    as_json: Json = False,
) -> None:
    """Run a scenario's law as a node: joint states in, effort commands out.

    It holds the first position, and follows each JointTrajectory on
    /tarc/joint_trajectory. Joints are found by name. Ctrl-C stops it. At the
    end it sends zero torque: engage the brakes before. Exit status 1 after a
    safe stop.

    Example: tarc ros2 run ur5e --law TARC --controller effort_controller
    """
    from tarc.runtime import SafetyLimits, run_live
    from tarc.runtime.dds import DdsRobot
    from tarc.runtime.online import OnlineReference
    from tarc.runtime.real_time import real_time
    from tarc.scenario.deployment import law_of
    from tarc.scenario.model import Scenario

    loaded = Scenario.load(scenario, set_ or [])
    _, built, limits, names = law_of(loaded, law)
    check_efforts(loaded.build_plant().torque_units)
    with ExitStack() as stack:
        stack.enter_context(real_time(priority))  # which the threads of DDS inherit
        robot = DdsRobot(names, controller=controller, period=built.period, domain=domain, timeout=timeout)
        stack.enter_context(robot)
        robot.reference = OnlineReference(position=robot.newest)
        safety = SafetyLimits(
            torque=None if limits is None else limits.magnitude, error=numbers_of("--error-limit", error_limit)
        )
        result = run_live(
            built,
            robot,
            robot.reference,
            duration,
            limits=safety,
            watchdog=watchdog,
            priority=priority,
            log=log,
            joint_names=names,
            label=controller,
        )
        if robot.refusal:
            print(f"last refusal: {robot.refusal}", file=sys.stderr)
    finish(result, list(names), as_json)


@app.command()
def simulate(
    scenario: ScenarioName,
    controller: Controller = "effort_controller",
    domain: Domain = None,
    priority: Priority = 80,
    set_: Set = None,
) -> None:
    """Simulate a scenario's robot in MuJoCo, in real time, as a robot of ROS 2.

    It sends joint states at the rate of the scenario's first law, and takes
    effort commands. Brakes hold it until the first command. Ctrl-C ends it.

    Example: tarc ros2 simulate ur5e
    """
    from tarc.runtime.real_time import real_time
    from tarc.runtime.ros2_peer import ros2_peer
    from tarc.scenario.model import Scenario

    setup = Scenario.load(scenario, set_ or []).build()
    law = next(iter(setup.laws.values()))
    start = setup.reference.sample([0.0])[0][:, 0]
    with real_time(priority):
        peer = ros2_peer(setup.plant, law.period, position=start, controller=controller, domain=domain)
        print(f"joint states of {', '.join(setup.plant.joint_names)} at {1 / law.period:g} Hz", flush=True)
        peer.run()
