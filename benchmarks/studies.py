"""Time of a control period in studies, beside C by hand and MuJoCo: ``python -m benchmarks.studies``.

All ratios are medians over turns of one run.
"""

import argparse
import ctypes
import os
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

import tarc
from arm_study import SCENARIO, TARC
from benchmarks.agreement import agreement
from benchmarks.measure import Row
from tarc.control.digital_controller import DigitalController
from tarc.core.codegen import compiler
from tarc.core.lane_loop import processor_lanes
from tarc.plants import TwoLinkArm, load_robot
from tarc.plants.symbolic import SymbolicPlant
from tarc.scenario.yaml_text import write_yaml
from tarc.simulation.batch import BatchLoop
from tarc.simulation.batch_inputs import LoopCase, RunInputs
from tarc.simulation.casadi_backend import TracedLoop
from tarc.simulation.integration import Integration
from tarc.simulation.monitor import DivergenceMonitor

PERIOD, DURATION, START = 1e-3, 10.0, 1.0
METHOD = Integration("Runge–Kutta", 2)
MEASURES = (
    "rms_error",
    "peak_error",
    "torque_variation",
    "peak_torque",
    "rms_tde_error",
    "mean_gain",
    "peak_gain",
    "overestimation",
    "underestimation",
)
"""Measures of the C by hand, in its order."""
HERE = Path(__file__).parent


def two_link(count: int, bits: int = 16) -> list[LoopCase]:
    """Return cases of the two-link arm under TARC that differ in payload, friction and noise."""
    arm, rng = TwoLinkArm(viscous=(0.5, 0.5)), np.random.default_rng(0)
    law = tarc.laws.TARC(
        inertia=0.08 * arm.inertia([0.0, np.pi / 2]),
        natural_frequency=15.0,
        period=PERIOD,
        estimator=tarc.estimators.Algebraic(window=0.01, degree=2),
        rise_rate=2000.0,
        fall_rate=1000.0,
        boundary_layer=0.015,
        max_gain=5.0,
    )
    reference = tarc.signals.Sinusoid(amplitude=(0.3, 0.25), frequency=(1.0, 2.3), offset=(0.0, 1.5))
    return [
        LoopCase(
            arm,
            DigitalController(tarc.signals.Encoder(bits=bits, noise=rng.uniform(1e-6, 1e-5)), law),
            reference,
            initial_torque="rest",
            plant_parameters={"payload": rng.uniform(0.0, 1.0), "viscous": (rng.uniform(0.3, 0.8), 0.5)},
        )
        for _ in range(count)
    ]


class Handwritten:
    """The loop of `two_link` in C by hand, compiled with the flags of the others but for fused products."""

    def __init__(self, case: LoopCase):
        law, sensor = case.controller.law, case.controller.sensor
        assert isinstance(law, tarc.laws.TARC)
        assert isinstance(law.estimator, tarc.estimators.Algebraic)
        sums = law.estimator.sums
        numbers = {
            "SAMPLES": len(sums),
            "STEP": float(sensor.step_size),
            "THRESHOLD": 5.0,
            "LAYER": law.boundary_layer,
            "START_GAIN": law.start_gain,
            "MIN_GAIN": law.min_gain,
            "MAX_GAIN": law.max_gain,
            "RISE_RATE": law.rise_rate,
            "FALL_RATE": law.fall_rate,
            "PERIOD": law.period,
            "POSITION_GAIN": law.K1[0, 0],
            "VELOCITY_GAIN": law.K2[0, 0],
        }
        arrays = {"VELOCITY": sums[:, 1], "ACCELERATION": sums[:, 2], "INERTIA": law.M.ravel()}
        lines = [
            f"#define {name} {float(value)!r}" if name != "SAMPLES" else f"#define {name} {value}"
            for name, value in numbers.items()
        ]
        lines += [
            f"static const double {name}[] = {{{', '.join(repr(float(one)) for one in values)}}};"
            for name, values in arrays.items()
        ]
        folder = Path(tempfile.mkdtemp())
        (folder / "handwritten_loop.h").write_text("\n".join(lines) + "\n")
        library = folder / "loop.so"
        flags = ["-std=c99", "-O3", "-march=native", "-fno-math-errno", "-fPIC", "-shared", f"-I{folder}"]
        subprocess.run([*compiler(), *flags, str(HERE / "handwritten_loop.c"), "-lm", "-o", str(library)], check=True)
        self._run = ctypes.CDLL(str(library)).run
        self._run.argtypes = [ctypes.c_long, ctypes.c_long, *[ctypes.c_void_p] * 6]
        self._run.restype = ctypes.c_long

    def call(self, case: LoopCase, inputs: RunInputs, measured: int) -> tuple[Callable[[], object], np.ndarray]:
        """Return the call of a run and the array of its measures."""
        reference = np.ascontiguousarray(np.concatenate(inputs.sampled.reference).T)
        noise = np.ascontiguousarray(inputs.sampled.noise.T)
        initial = case.initial(inputs.sampled)
        start = np.concatenate([initial.position, initial.torque])
        p = case.parameters
        parameters = np.concatenate(
            [p["masses"], p["lengths"], p["centres"], [p["payload"].item(), p["gravity"].item()], p["viscous"]]
        )
        record, result = np.zeros((len(reference), 2)), np.zeros(len(MEASURES))
        arrays = reference, noise, start, parameters, record, result
        addresses = [array.ctypes.data for array in arrays]
        return lambda: self._run(len(arrays[0]), measured, *addresses), result


def take_turns(
    calls: dict[str, Callable[[], object]], rounds: int, clock: Callable[[], float] = time.thread_time
) -> dict[str, np.ndarray]:
    """Return the time of each call in each round [s], by default that of the processor in this thread."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            begin = clock()
            call()
            times[name].append(clock() - begin)
    return {name: np.array(values) for name, values in times.items()}


def in_virtual_machine(case: LoopCase, inputs: RunInputs) -> Callable[[], object]:
    """Return the call of a run in the virtual machine, of a loop that is traced once, as studies have it."""
    initial, plant = case.initial(inputs.sampled), case.actual_plant
    loop = TracedLoop(case.loop(METHOD), initial, inputs.sampled, case.plant_parameters)

    def call() -> None:
        loop.run(plant, initial, inputs.sampled, DivergenceMonitor(inputs.sampled, 5.0, False), native=False)

    return call


REPETITIONS = 40
"""Calls of a thread on each of two cores."""


def machine_call(batch: BatchLoop, cases: Sequence[LoopCase], inputs: Sequence[RunInputs]) -> Callable[[], object]:
    """Return the call that runs as many cases as there are lanes, from sampled inputs to sums."""
    arrays = batch.lane_arrays(cases[: batch.lanes], inputs[: batch.lanes])
    return lambda: batch.machine.run(*arrays)


def repeated(call: Callable[[], object]) -> Callable[[], object]:
    """Return a call that lasts long against the start of a thread, as a part of a study does."""

    def several() -> None:
        for _ in range(REPETITIONS):
            call()

    return several


def two_threads(calls: Sequence[Callable[[], object]]) -> Callable[[], object]:
    """Return a call of several functions at once; machine code runs beside the interpreter."""

    def call() -> None:
        threads = [threading.Thread(target=one) for one in calls]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    return call


def period(rounds: int = 15) -> list[Row]:
    """Measure a control period of the two-link arm: by hand, compiled, in lanes, in the virtual machine, two cores."""
    cases = two_link(8)
    widths = [n for n in (4, 8) if n <= processor_lanes()]
    batches = {n: BatchLoop(cases[:3], METHOD, DURATION, metrics_start=START, lanes=n) for n in (1, *widths)}
    inputs = batches[1].sample(cases, range(len(cases)))
    _, measured, *_ = batches[1].lane_arrays(cases[:1], inputs[:1])
    by_hand = Handwritten(cases[0])
    hand, _ = by_hand.call(cases[0], inputs[0], measured)
    calls = {"hand": hand, "virtual machine": in_virtual_machine(cases[0], inputs[0])}
    calls |= {str(n): machine_call(batch, cases, inputs) for n, batch in batches.items()}
    widest = max(batches)
    times = take_turns(calls, rounds)
    both_cores = two_threads([repeated(machine_call(batches[widest], cases, inputs)) for _ in range(2)])
    cores = take_turns({"one": repeated(calls[str(widest)]), "two": both_cores}, rounds, time.perf_counter)
    runs = {"hand": 1, "virtual machine": 1} | {str(n): n for n in batches}
    per_period = {name: values / runs[name] / (DURATION / PERIOD) for name, values in times.items()}
    check_measures(max(batches))
    against = f"C by hand: {1e9 * np.median(per_period['hand']):.0f} ns"

    def row(what: str, name: str, target: float) -> Row:
        ratio = float(np.median(per_period["hand"] / per_period[name]))
        nanoseconds = f"{1e9 * np.median(per_period[name]):.0f} ns"
        return Row(what, nanoseconds, against, ratio, f"≥ {target:g}×", ratio >= target)

    targets = {4: 2.5, 8: 4.0}
    one, two = (
        cores[name] / REPETITIONS / count / widest / (DURATION / PERIOD) for name, count in (("one", 1), ("two", 2))
    )
    both = float(np.median(one / two))
    return [
        row("two-link arm under TARC, noise and all measures: a control period and run, compiled", "1", 0.9),
        *(row(f"the same in {n} lanes", str(n), targets[n]) for n in widths),
        row("the same in the virtual machine", "virtual machine", 0.1),
        Row(
            f"the same in {widest} lanes on two cores",
            f"{1e9 * np.median(two):.0f} ns",
            f"one core: {1e9 * np.median(one):.0f} ns",
            both,
            "≥ 1.8×",
            both >= 1.8,
        ),
    ]


def check_measures(lanes: int) -> None:
    """Refuse a comparison of loops that do not compute the same; encoders so fine that no last bit decides."""
    cases = two_link(2, bits=44)
    batch = BatchLoop(cases, METHOD, DURATION, metrics_start=START, lanes=lanes)
    inputs = batch.sample(cases, [0, 1])
    _, measured, *_ = batch.lane_arrays(cases, inputs)
    call, result = Handwritten(cases[0]).call(cases[0], inputs[0], measured)
    call()
    measures = batch.run(cases[:1], inputs[:1]).measures
    np.testing.assert_allclose([measures[name][0] for name in MEASURES], result, rtol=1e-6)


def ur5e(rounds: int = 3) -> list[Row]:
    """Measure a control period of a UR5e in symbols and in lanes, against MuJoCo in this process."""
    duration = 1.0
    arm, mujoco_arm = (
        load_robot("ur5e", armature=0.1, viscous=1.0, coulomb=2.0, backend=backend) for backend in ("auto", "mujoco")
    )
    assert isinstance(arm, SymbolicPlant)
    law = tarc.laws.TARC(
        inertia=0.08 * arm.inertia(arm.home),
        natural_frequency=20.0,
        period=PERIOD,
        estimator=tarc.estimators.Algebraic(window=0.01, degree=2),
        rise_rate=1e4,
        fall_rate=5e3,
        boundary_layer=0.015,
        max_gain=6.4,
    )
    reference = tarc.signals.Sinusoid(amplitude=0.3, frequency=(1.0, 1.3, 1.6, 1.9, 2.2, 2.5), offset=arm.home)
    sensor = tarc.signals.Encoder(bits=17, noise=1e-6)
    cases = [
        LoopCase(
            arm,
            DigitalController(sensor, law),
            reference,
            initial_torque="rest",
            plant_parameters={"payload": 0.1 * number},
        )
        for number in range(8)
    ]
    begin = time.perf_counter()
    batch = BatchLoop(cases[:2], METHOD, duration, metrics_start=0.5)
    built = time.perf_counter() - begin
    lanes = machine_call(batch, cases, batch.sample(cases, range(len(cases))))

    def in_mujoco() -> None:
        tarc.simulate(mujoco_arm, law, reference, duration, sensor=sensor, initial_torque="rest", progress=False)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        in_mujoco()
        times = take_turns({"lanes": lanes, "mujoco": in_mujoco}, rounds)
    n_periods = duration / PERIOD
    one, theirs = times["lanes"] / n_periods / batch.lanes, times["mujoco"] / n_periods
    ratio = float(np.median(theirs / one))
    return [
        Row(
            f"UR5e in symbols under TARC, {batch.lanes} lanes: a control period and run",
            f"{1e6 * np.median(one):.2f} µs",
            f"MuJoCo loop: {1e6 * np.median(theirs):.1f} µs",
            ratio,
            "≥ 15×",
            ratio >= 15,
        ),
        Row("traced and compiled, or from the cache", f"{built:.1f} s", target="≤ 20 s", met=built <= 20),
    ]


STUDY: dict[str, Any] = {
    "scenario": {
        **{key: value for key, value in SCENARIO.items() if key != "substeps"},
        "law": TARC,
        "sensor": {"bits": 16, "noise": 1e-5},
        "duration": 10.0,
        "metrics_start": 1.0,
    },
    "draws": {
        "robot.payload": {"uniform": [0.0, 1.0]},
        "robot.viscous.0": {"uniform": [0.3, 0.8]},
        "sensor.noise": {"log_uniform": [1e-6, 1e-4]},
    },
}
"""A study of the two-link arm with three varied parameters, encoder noise and all measures."""


def command(runs: int = 10_000) -> list[Row]:
    """Measure `tarc study` from the command to the report, after a study that has compiled the loop."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "study.yaml").write_text(write_yaml(STUDY))
        took = []
        for count in (64, runs):
            begin = time.perf_counter()
            options = ["study", "study.yaml", "--runs", str(count), "--out", f"{count}.study"]
            subprocess.run([sys.executable, "-m", "tarc", *options], cwd=folder, check=True, capture_output=True)
            took.append(time.perf_counter() - begin)
    what = f"tarc study, {runs:,} runs of 10 s on {len(os.sched_getaffinity(0))} cores, to the report"
    return [Row(what, f"{took[1]:.1f} s", f"64 runs, compilation: {took[0]:.1f} s", None, "≤ 15 s", took[1] <= 15)]


BENCHMARKS = {"command": command, "period": period, "ur5e": ur5e, "agreement": agreement}


def main() -> None:
    """Run some or all benchmarks and print one table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.studies", description=__doc__)
    parser.add_argument("names", nargs="*", choices=[*BENCHMARKS, []], help="some of the benchmarks")
    names = parser.parse_args().names or list(BENCHMARKS)
    table = Table("what", "time", "against", "ratio", "target", "met", caption=f"load {os.getloadavg()[0]:.1f}")
    for name in names:
        for row in BENCHMARKS[name]():
            ratio = "" if row.ratio is None else f"{row.ratio:.2f}"
            table.add_row(
                row.what, row.measured, row.against, ratio, row.target, "" if row.met is None else str(row.met)
            )
    Console(width=160).print(table)


if __name__ == "__main__":
    main()
