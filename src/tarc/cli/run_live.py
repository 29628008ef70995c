"""`tarc run-live`: run a scenario's law on a robot."""

import json
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tarc.cli.export import stored_certificate
from tarc.cli.options import FullRange, Json, ScenarioName, Set, Speed, Tube, file_stem, numbers_of
from tarc.core.errors import InvalidParameter
from tarc.core.files import make_folder

if TYPE_CHECKING:
    from tarc.runtime import LiveRun, SafetyLimits
    from tarc.runtime.log import Log
    from tarc.scenario.parts import Setup
    from tarc.signals.torque_limits import TorqueLimits

RobotName = Annotated[
    str,
    typer.Option(
        "--robot",
        metavar="ROBOT",
        help="mujoco: the scenario's robot in a second process, over shared memory; mujoco:udp over UDP. "
        "udp://host:port: a robot that speaks the packets of tarc.",
    ),
]
LawName = Annotated[
    str, typer.Option("--law", metavar="NAME", help="Law of the scenario, or FILE.py:CLASS. Default: the first.")
]
Duration = Annotated[
    float | None, typer.Option(help="How long to follow the reference \\[s]. Default: the scenario's.")
]
LogFile = Annotated[
    Path | None,
    typer.Option(
        "--log",
        "-o",
        help="File of the log, netCDF; .mcap for a bag beside it. Default: runs/, the scenario and the law.",
    ),
]
PushShare = Annotated[
    float, typer.Option("--push", help="Push of each joint at the start, as a share of its torque limit; 0 for none.")
]
ErrorLimit = Annotated[str, typer.Option("--error-limit", help="Error beyond which the run stops \\[rad or m].")]
SpeedLimit = Annotated[
    str, typer.Option("--speed-limit", help="Speed beyond which the run stops. Default: that of the robot's file.")
]
MaxStep = Annotated[str, typer.Option("--max-step", help="Step between samples beyond which one counts as missing.")]
TorqueRate = Annotated[str, typer.Option("--torque-rate", help="Largest rate of the torque \\[N m/s]; it is clipped.")]
WatchdogTime = Annotated[float, typer.Option("--watchdog", help="Longest time without a sample \\[s].")]
Overrun = Annotated[str, typer.Option(help="What a missed period is: bridge, skip, stop or shift.")]
RampSpeed = Annotated[float, typer.Option(help="Speed of the ramp to the start of the reference \\[rad/s or m/s].")]
Priority = Annotated[int, typer.Option(help="Real-time priority, 1 to 99; 0 for none.")]
Unlimited = Annotated[
    bool, typer.Option("--unlimited-torque", help="Start although a joint has no torque limit. Mind your hands.")
]


def run_live(
    scenario: ScenarioName,
    robot: RobotName = "mujoco",
    law: LawName = "",
    duration: Duration = None,
    log: LogFile = None,
    push: PushShare = 0.2,
    error_limit: ErrorLimit = "0.3",
    speed_limit: SpeedLimit = "",
    max_step: MaxStep = "",
    torque_rate: TorqueRate = "",
    watchdog: WatchdogTime = 0.05,
    overrun: Overrun = "bridge",
    ramp_speed: RampSpeed = 0.25,
    priority: Priority = 80,
    unlimited_torque: Unlimited = False,
    tube: Tube = 0.01,
    full_range: FullRange = False,
    speed: Speed = "",
    set_: Set = None,
    as_json: Json = False,
) -> None:
    """Run a scenario's law on a robot, live in the terminal.

    The torque of the brakes is taken over, each joint is pushed a little, and
    a ramp leads to the reference. Ctrl-C lets the robot come to rest; a second
    one stops it at once. Position, error and torque are shown meanwhile. The
    log is a run with its timing. Exit status 1 after a safe stop.

    Example: tarc run-live ur5e --robot mujoco --duration 5
    """
    from tarc.runtime import run_live as run
    from tarc.runtime.scenario_parts import scenario_robot, start_up
    from tarc.scenario.deployment import law_of
    from tarc.scenario.model import Scenario
    from tarc.scenario.user_law import is_user_law

    is_own = is_user_law(law)
    loaded = Scenario.load(scenario, set_ or [], law=law if is_own else "")
    chosen, built, interface, names = law_of(loaded, "" if is_own else law)
    setup = loaded.build()
    if any(unit not in ("N m", "N") for unit in setup.plant.torque_units):
        raise InvalidParameter("robot: its joints take positions, and run-live writes torques; give actuators: torque")
    limits = _limits(setup, interface, error_limit, speed_limit, max_step, torque_rate)
    with ExitStack() as stack:
        machine = stack.enter_context(scenario_robot(robot, loaded, setup, built.period, priority))
        display = stack.enter_context(_Display(not as_json))
        result = run(
            built,
            machine,
            setup.reference,
            loaded.duration if duration is None else duration,
            limits=limits,
            start_up=start_up(loaded, setup, machine, push, ramp_speed),
            watchdog=watchdog,
            overrun=overrun,
            watch=loaded.watch(chosen, tube=tube, full_range=full_range, speed=numbers_of("--speed", speed)),
            priority=priority,
            allow_unlimited_torque=unlimited_torque,
            log=log or _log_file(loaded.name, chosen),
            joint_names=names,
            units=setup.plant.units,
            label=setup.plant.label,
            scenario={"law": chosen, "content": loaded.model_dump(mode="json", exclude_defaults=True)},
            certificate=stored_certificate(Path(scenario), chosen),
            on_log=display.start,
        )
    finish(result, list(names), as_json)


def finish(result: "LiveRun", names: list[str], as_json: bool) -> None:
    """Print the result; exit status 1 after a safe stop."""
    from tarc.cli.tables import run_live as tables

    if as_json:
        print(json.dumps(tables.summary(result), indent=2))
    else:
        tables.print_result(result, names)
    if result.is_safe_stop:
        raise typer.Exit(1)


class _Display:
    """The process that shows the run; Ctrl-C and the loop's end end it."""

    def __init__(self, is_wanted: bool):
        self._is_wanted = is_wanted
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> "_Display":
        return self

    def start(self, log: "Log") -> None:
        """Show what comes into a log."""
        if self._is_wanted:
            sys.stdout.flush()
            self._process = subprocess.Popen([sys.executable, "-m", "tarc.cli.live_display", str(log.folder)])

    def __exit__(self, *_: object) -> None:
        if self._process is not None:
            try:
                self._process.wait(5)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()


def _limits(
    setup: "Setup", interface: "TorqueLimits | None", error: str, speed: str, max_step: str, torque_rate: str
) -> "SafetyLimits":
    """Return the limits of the options, of the scenario's interface and of the robot's file."""
    from tarc.runtime.scenario_parts import safety_limits

    return safety_limits(
        setup,
        interface,
        error=numbers_of("--error-limit", error),
        speed=numbers_of("--speed-limit", speed),
        max_step=numbers_of("--max-step", max_step),
        torque_rate=numbers_of("--torque-rate", torque_rate),
    )


def _log_file(scenario: str, law: str) -> Path:
    """Return the file of the log in a folder in runs/, named after scenario and law."""
    return make_folder("--log", Path("runs") / file_stem(scenario)) / f"{file_stem(law)}-live.nc"
