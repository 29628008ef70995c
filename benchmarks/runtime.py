"""The loop on the machine, in one run: ``python -m benchmarks.runtime``, or ``make bench-export``.

A UR5e in MuJoCo runs in a second process, in real time at 1 kHz, over shared memory and over UDP. Its loop is Python
with and without a real-time priority, and exported C. Percentiles of lateness and computation time are printed, and
missed periods. Then the robot's process is stopped, and killed, in the middle of a run. Last, packets and samples that
make no sense are given to the loop.
"""

import argparse
import os
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import tarc
from benchmarks.__main__ import machine
from tarc.core.types import Array
from tarc.export import export_c
from tarc.plants.base import Plant
from tarc.runtime import LiveRun, MujocoRobot, PacketRobot, Robot, SafetyLimits, SimulatedClock, StartUp, run_live
from tarc.runtime.live_run import PERCENTILES
from tarc.runtime.packets import Kind, encode
from tarc.runtime.transports import UdpTransport

PERIOD = 1e-3
HOME = np.array([0.0, -1.5707963, 1.5707963, -1.5707963, -1.5707963, 0.0])
WATCHDOG = 0.1
NONSENSE = 0.05
"""Share of samples that make no sense."""
BATCH = 32
"""Packets that are sent before the loop reads."""
FUZZ_PERIODS = 5000
"""Periods of one run on a robot that makes no sense."""


def robot_model() -> Plant:
    """Return the UR5e with friction."""
    return tarc.plants.load_robot("ur5e", armature=0.1, viscous=1.0, coulomb=2.0)


def example_law(robot: Plant, max_missing: int = 50) -> tarc.laws.TARC:
    """Return the law of the shipped scenario."""
    return tarc.laws.TARC(
        inertia=0.08 * robot.inertia(HOME),
        natural_frequency=20.0,
        rise_rate=1e4,
        fall_rate=5e3,
        boundary_layer=0.015,
        max_gain=6.4,
        period=PERIOD,
        estimator=tarc.estimators.Algebraic(window=0.010, degree=2),
        torque_limit=robot.torque_limits,
        max_missing=max_missing,
    )


REFERENCE = tarc.signals.Sinusoid(
    amplitude=[0.5, 0.4, 0.5, 0.5, 0.5, 0.5],
    frequency=[1.0, 1.3, 1.6, 1.9, 2.2, 2.5],
    phase=np.pi / 2,
    offset=HOME,
)


def peer(model: Plant, udp: int | None, priority: int) -> MujocoRobot:
    """Return the robot in its process."""
    return MujocoRobot(model, PERIOD, position=HOME, udp=udp, priority=priority, step_size=2 * np.pi / 2**17)


def live(console: Console, seconds: float) -> None:
    """Print the timing of runs in real time."""
    model = robot_model()
    table = Table("loop", "", *(f"{p:g} %" for p in PERCENTILES), "missed", "RMS error [mrad]", "ended")
    with tempfile.TemporaryDirectory() as folder:
        for name, udp, priority in (
            ("Python, shared memory", None, 80),
            ("Python, UDP", 0, 80),
            ("Python, UDP, ordinary scheduler", 0, 0),
        ):
            with peer(model, udp, 80) as robot:
                log = Path(folder) / "log.nc"
                result = run_live(
                    example_law(model), robot, REFERENCE, seconds, watchdog=WATCHDOG, priority=priority, log=log
                )
            add_rows(table, name, result)
            facts = result.facts
        console.print(f"{seconds:g} s at 1 kHz; times in µs; {facts['law']}", highlight=False)
        console.print(table)
        if shutil.which("gcc"):
            console.print(f"C, UDP: {loop_in_c(model, Path(folder), seconds)}", highlight=False, markup=False)


def add_rows(table: Table, name: str, result: LiveRun) -> None:
    """Add a run to the table."""
    data = result.load()
    start = float(data.data.attrs["tracking_start"]) + 0.1
    has_tracked = start < float(data.data["time"].values[-1])  # else a safe stop came before
    error = f"{1e3 * data.metrics(start)['rms_error']:.2f}" if has_tracked else "–"
    ends = [f"{result.overruns} of {result.n_periods}", error, result.ended]
    for key, values in result.percentiles().items():
        table.add_row(name, key.replace("_", " "), *(f"{1e6 * value:.0f}" for value in values), *ends)
        name, ends = "", ["", "", ""]


def loop_in_c(model: Plant, folder: Path, seconds: float) -> str:
    """Return what the exported loop prints."""
    root = folder / "arm"
    law, names = example_law(model), model.joint_names
    export_c(law, root, name="arm", joint_names=names, parts=True, reference=REFERENCE, realtime=True)
    subprocess.run(["make", "-s", "-C", str(root / "realtime"), "CC=gcc"], check=True)
    with peer(model, 0, 80) as robot:
        port = robot.release_port()
        command = [str(root / "realtime" / "loop"), "127.0.0.1", str(port), f"{seconds:g}"]
        return subprocess.run(command, capture_output=True, text=True, check=False).stdout.replace("\n", "; ")


def harm(console: Console) -> None:
    """Print what happens where the robot's process is stopped, and killed."""
    model = robot_model()
    for udp in (None, 0):
        for harmful in (signal.SIGSTOP, signal.SIGKILL):
            with tempfile.TemporaryDirectory() as folder, peer(model, udp, 80) as robot:
                timer = threading.Timer(2.0, os.kill, (robot.process.pid, harmful))
                timer.start()
                # the law alone would bridge on, so that the watchdog must act
                law, log = example_law(model, 100_000), Path(folder) / "log.nc"
                result = run_live(law, robot, REFERENCE, 30.0, watchdog=WATCHDOG, log=log)
                data = result.load().data
            starts = data["period_start"].values
            last = starts[np.isfinite(data["measured_position"].values[:, 0])][-1]
            stop = starts[data["phase"].values == 5][0]
            way = "shared memory" if udp is None else "UDP"
            console.print(
                f"{harmful.name} over {way}: {result.ended}; safe stop {1e3 * (stop - last):.1f} ms after the last "
                f"sample, watchdog {1e3 * WATCHDOG:g} ms; the log has {data.sizes['time']} periods",
                highlight=False,
            )


class SenselessRobot(Robot):
    """Two masses that send nonsense now and then, late and with false stamps.

    Attributes
    ----------
    violations
        Torques that were not finite, or beyond the limits.
    n_read
        Samples that were read.
    """

    def __init__(self, clock: SimulatedClock, limits: Array, seed: int):
        self._clock, self._limits, self._rng = clock, limits, np.random.default_rng(seed)
        self._position, self._velocity = np.array([0.3, -0.2]), np.zeros(2)
        self._is_moving = False
        self.sample_time = 0.0
        self.applied_torque = self._nonsense()
        self.violations = self.n_read = 0

    def _nonsense(self) -> Array:
        values = [np.nan, np.inf, -np.inf, 1e200, -1e200, 1e308, 5e-324, 0.0, self._rng.normal(), 100.0]
        return self._rng.choice(np.array(values), 2)

    def read(self) -> Array:
        """Return a position, or nonsense in one or both joints."""
        self.n_read += 1
        draw = self._rng.random()
        self.sample_time = self._clock.now() if draw > NONSENSE else float(self._nonsense()[0])
        if draw < 0.01:
            self._clock.advance(float(self._rng.exponential(2e-3)))
        if self.n_read == 1 or self._rng.random() > NONSENSE:
            return self._position.copy()
        return np.where(self._rng.random(2) < 0.7, self._nonsense(), self._position)

    def write(self, torque: Array) -> None:
        """Move, and look at the torque."""
        if not np.all(np.abs(torque) <= self._limits):
            self.violations += 1
        if self._is_moving:
            self._velocity += PERIOD * (torque / np.array([0.5, 0.2]) - self._velocity)
            self._position += PERIOD * self._velocity

    def release_brakes(self) -> None:
        """Let it move."""
        self._is_moving = True


def senseless_runs(inputs: int) -> tuple[int, int, Counter[str]]:
    """Return samples that were read, torques that violate the limits, and how the runs ended."""
    limits = np.array([20.0, 10.0])
    law = tarc.laws.TARC(
        inertia=[0.05, 0.02],
        natural_frequency=15.0,
        rise_rate=5e3,
        fall_rate=3e3,
        max_gain=6.0,
        period=PERIOD,
        estimator=tarc.estimators.Algebraic(window=0.010),
        torque_limit=limits,
    )
    reference = tarc.signals.Sinusoid(amplitude=0.2, frequency=[3.0, 4.0], phase=np.pi / 2)
    duration = FUZZ_PERIODS * PERIOD
    read = violations = seed = 0
    ended: Counter[str] = Counter()
    while read < inputs:
        clock = SimulatedClock()
        robot = SenselessRobot(clock, limits * (1 + 1e-9), seed)
        strict = seed % 2 == 1
        result = run_live(
            law,
            robot,
            reference,
            min(duration, (inputs - read) * PERIOD),
            limits=SafetyLimits(error=1.0, speed=50.0, max_step=0.05) if strict else SafetyLimits(torque_rate=1e4),
            start_up=StartUp(ramp_time=0.1, patience=1.0),
            watchdog=0.05,
            clock=clock,
            native=False,
        )
        read, violations, seed = read + robot.n_read, violations + robot.violations, seed + 1
        ended["completed" if result.ended == "completed" else "safe stop"] += 1
    return read, violations, ended


def senseless_packets(inputs: int) -> tuple[int, int, dict[str, int], bool]:
    """Return packets sent, malformed ones among them, the robot's counts, and whether all positions were valid."""
    rng = np.random.default_rng(0)
    sender = UdpTransport(None, ("127.0.0.1", 0))
    receiver = UdpTransport(("127.0.0.1", sender.port), ("127.0.0.1", 0))
    receiver.send(encode(Kind.COMMAND, 0, 0.0, [np.zeros(2)]))
    sender.receive()
    sender.send(encode(Kind.NAMES, 0, 0.0, names=["first", "second"]))
    sender.send(encode(Kind.STATE, 1, 0.0, [np.zeros(2), np.zeros(2)]))
    robot = PacketRobot(receiver)
    sequence, malformed, is_valid = 1, 0, True
    for start in range(0, inputs, BATCH):
        for _ in range(min(BATCH, inputs - start)):
            sequence += 1
            data = encode(Kind.STATE, sequence, PERIOD * sequence, [rng.normal(size=2), np.zeros(2)])
            changed = mutated(data, rng)
            malformed += changed != data
            sender.send(changed)
        position = robot.read()
        is_valid &= position.shape == (2,) and bool(np.all(np.abs(position) < 10) or np.all(np.isnan(position)))
    counts = robot.counts
    robot.close()
    sender.close()
    return inputs, malformed, counts, is_valid


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """Return a packet as it is, or changed, cut, lengthened, or replaced."""
    kind = rng.integers(6)
    if kind == 0:
        return data
    if kind == 1:
        return rng.bytes(int(rng.integers(0, 120)))
    if kind == 2:
        return data[: int(rng.integers(0, len(data)))]
    if kind == 3:
        return data + rng.bytes(int(rng.integers(1, 20)))
    changed = bytearray(data)
    for place in rng.integers(0, len(data), 1 if kind == 4 else 8):
        changed[place] ^= int(rng.integers(1, 256))
    return bytes(changed)


def fuzz(console: Console, inputs: int) -> None:
    """Print what nonsense does."""
    start = time.perf_counter()
    read, violations, ended = senseless_runs(inputs)
    ends = ", ".join(f"{count} {name}" for name, count in ended.items())
    console.print(
        f"{read} samples with {NONSENSE:.0%} nonsense: {violations} torques not finite or beyond the limits; "
        f"{sum(ended.values())} runs: {ends} ({time.perf_counter() - start:.0f} s)",
        highlight=False,
    )
    start = time.perf_counter()
    sent, malformed, counts, is_valid = senseless_packets(inputs)
    console.print(
        f"{sent} packets by UDP, {malformed} malformed: counted {counts['malformed']}; positions "
        f"{'all valid' if is_valid else 'NOT all valid'} ({time.perf_counter() - start:.0f} s)",
        highlight=False,
    )


def main() -> None:
    """Print everything; it reports, so that it exits with 0 whatever the numbers are."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.runtime", description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="duration of each run in real time")
    parser.add_argument("--fuzz", type=int, default=1_000_000, help="samples and packets that make no sense")
    arguments = parser.parse_args()
    console = Console(width=None if Console().is_terminal else 160)
    console.print(machine(), highlight=False)
    parts: list[Callable[[], None]] = [
        lambda: live(console, arguments.seconds),
        lambda: harm(console),
        lambda: fuzz(console, arguments.fuzz),
    ]
    for part in parts:
        part()


if __name__ == "__main__":
    main()
