"""The loop on a robot, in a process of its own."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from tarc.certificates.certified_gains import certify_gains
from tarc.core.errors import InvalidParameter, NotLinearisable, UnsupportedLaw
from tarc.laws.base import Law
from tarc.laws.pole_placement import PolePlacement
from tarc.runtime import DdsRobot, GainChanges, OnlineReference, Robot, run_live
from tarc.runtime.log import Log
from tarc.runtime.real_time import real_time
from tarc.runtime.scenario_parts import safety_limits, scenario_robot, start_up
from tarc.scenario.deployment import law_of
from tarc.scenario.model import Scenario, Setup
from tarc.studio.design_state import DesignState
from tarc.studio.jobs import Sender
from tarc.studio.results import LiveEnd, LiveGain, LiveGains, LiveLog, LiveRefusal, LiveStage
from tarc.studio.robots import Robots

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

WATCHDOG = 0.05
"""Longest time without a sample of a robot [s]."""
SIMULATED_WATCHDOG = 1.0
"""The same of a simulated one, which shares the computer with the page [s]."""
PRIORITY = 80
"""Real-time priority of a loop on a robot, where the system allows it."""


def send_live(
    send: Sender,
    state: DesignState,
    robots: Robots,
    connection: str,
    address: str,
    duration: float,
    commands: "Connection",
) -> None:
    """Run a design on a robot, for a `Job`.

    It sends a `LiveStage` now and then, a `LiveLog` and `LiveGains` when the loop starts, and a `LiveEnd`. Each mapping
    of gains that comes by ``commands`` is answered by `LiveGains` or a `LiveRefusal`. An interrupt lets the robot come
    to rest.

    Raises
    ------
    InvalidParameter
        For a robot that does not answer, and one without torque limits that is not simulated.
    """
    lock = threading.Lock()

    def send_one(message: object) -> None:
        with lock:
            send(message)

    try:
        content = state.to_content(robots.content(state.robot))
        _run_live(send_one, content, connection, address, duration, commands)
    except KeyboardInterrupt:
        send_one(LiveEnd("stopped before the loop ran", is_safe_stop=False))


def _run_live(
    send: Sender, content: dict[str, Any], connection: str, address: str, duration: float, commands: "Connection"
) -> None:
    scenario = Scenario.parse(content)
    _, law, interface, names = law_of(scenario)
    setup = scenario.build()
    if any(unit not in ("N m", "N") for unit in setup.plant.torque_units):
        raise InvalidParameter("robot: its joints take positions, and the loop writes torques")
    changes, reason = _changes(send, scenario, setup, law)
    send(LiveStage("connecting"))

    def announce(log: Log) -> None:
        send(LiveLog(str(log.folder)))
        send(_gains(changes, reason))
        if changes is not None:
            threading.Thread(target=_serve, args=(send, changes, commands), daemon=True).start()

    is_simulated = connection.startswith("mujoco")
    priority = 0 if is_simulated else PRIORITY
    # the threads of DDS inherit the priority
    with real_time(priority), _robot(connection, address, scenario, setup, law.period) as robot:
        online = robot.reference if isinstance(robot, DdsRobot) else None
        result = run_live(
            law,
            robot,
            setup.reference if online is None else online,
            duration,
            limits=safety_limits(setup, interface),
            start_up=None
            if online is not None
            else start_up(scenario, setup, robot, push=0.0 if is_simulated else 0.2),
            allow_unlimited_torque=is_simulated,
            watchdog=SIMULATED_WATCHDOG if is_simulated else WATCHDOG,
            overrun="shift" if is_simulated else "bridge",
            priority=priority,
            joint_names=names,
            units=setup.plant.units,
            label=setup.plant.label,
            changes=changes,
            on_log=announce,
        )
    send(LiveEnd(f"{result.ended}; {result.n_periods} periods run, {result.overruns} missed", result.is_safe_stop))


def _changes(send: Sender, scenario: Scenario, setup: Setup, law: Law) -> tuple[GainChanges | None, str]:
    """Return the gains that may change within what is certified; None and the reason where no certificate applies."""
    workspace, plants = scenario.certified_region(setup)
    if not isinstance(law, PolePlacement):
        return None, "no certificate applies to this law, so that no gain of it may change while it runs"
    send(LiveStage("certifying the law, then its gains"))
    try:
        certified = certify_gains(
            law,
            plants,
            workspace,
            computation_delay=scenario.computation_delay,
            on_certificate=lambda count, most: send(LiveStage(f"certifying gains: {count} of at most {most}")),
        )
    except (UnsupportedLaw, NotLinearisable) as error:
        return None, f"no gain may change while it runs: {error}"
    return GainChanges(certified), certified.reason


def _gains(changes: GainChanges | None, reason: str) -> LiveGains:
    if changes is None:
        return LiveGains({}, reason)
    gains = {}
    for name, gain in changes.ranges.items():
        value = float(np.ravel(getattr(changes.law, name))[0])
        text = f"{len(gain.values)} values, {gain.low:g} to {gain.high:g}" if gain.values else str(gain)
        gains[name] = LiveGain(value, gain.low, gain.high, gain.values, text)
    return LiveGains(gains, reason)


def _serve(send: Sender, changes: GainChanges, commands: "Connection") -> None:
    """Answer each change of gains, until the page ends."""
    while True:
        try:
            gains = commands.recv()
        except (EOFError, OSError):
            return
        try:
            changes.change(**gains)
        except InvalidParameter as error:
            send(LiveRefusal(str(error)))
        else:
            send(_gains(changes, ""))


@contextmanager
def _robot(connection: str, address: str, scenario: Scenario, setup: Setup, period: float) -> Iterator[Robot]:
    """Open a robot and close it; a simulated one shares the computer with the page, so it waits for the loop."""
    if connection == "dds":
        with DdsRobot(
            tuple(setup.plant.joint_names), controller=address or "effort_controller", period=period
        ) as robot:
            robot.reference = OnlineReference(position=robot.newest)
            yield robot
        return
    name = f"udp://{address.removeprefix('udp://')}" if connection == "udp" else connection
    with scenario_robot(name, scenario, setup, period, in_step=True) as robot:
        yield robot
