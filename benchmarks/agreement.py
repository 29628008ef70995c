"""Random scenarios in lanes, one by one, and in the virtual machine: how far the results differ."""

from typing import Any, NamedTuple

import numpy as np

import tarc
from benchmarks.measure import Row
from tarc.control.digital_controller import DigitalController
from tarc.laws.base import Law
from tarc.plants import NLinkArm, TwoLinkArm
from tarc.simulation.batch import BatchLoop
from tarc.simulation.batch_inputs import LoopCase, RunInputs
from tarc.simulation.casadi_backend import TracedLoop
from tarc.simulation.integration import Integration
from tarc.simulation.measures import compute_measures
from tarc.simulation.monitor import DivergenceMonitor

METHOD = Integration("Runge–Kutta", 2)
DURATION, START, PERIOD = 10.0, 1.0, 1e-3
WIDTH = 8
"""Runs of one structure, which differ in the robot and the noise."""
THRESHOLD = 5.0
BITS = 16
"""Of the quantised encoders."""
FLIP = 1e-9
"""Difference of the torque, over its peak, beyond which a rounding or a sign has flipped."""
LIMIT, QUANTISED_LIMIT = 1e-6, 1e-3
"""Relative difference of the measures that counts as small."""


class Differences(NamedTuple):
    """Of one run: of the torque, over its peak, and relative ones of the measures by name, to the virtual machine.

    Then whether lanes and single runs have the same bits.
    """

    torque: float
    measures: dict[str, float]
    same_bits: bool


def random_law(rng: np.random.Generator, arm: TwoLinkArm | NLinkArm) -> Law:
    """Return one of five laws with random gains, that tracks."""
    common: dict[str, Any] = {
        "period": PERIOD,
        "estimator": tarc.estimators.Algebraic(window=PERIOD * rng.choice([8, 10, 14]), degree=2),
        "inertia": rng.uniform(0.04, 0.08) * arm.inertia(np.full(arm.n_joints, 0.7)),
        "natural_frequency": rng.uniform(8.0, 15.0),
        "synchronised": bool(rng.integers(2)),
    }
    adaptive: dict[str, Any] = {
        "rise_rate": rng.uniform(500, 3000),
        "fall_rate": rng.uniform(500, 2000),
        "max_gain": 5.0,
    }
    layer: dict[str, Any] = {"boundary_layer": rng.uniform(0.01, 0.03)}
    kinds = (
        lambda: tarc.laws.TDC(**common),
        lambda: tarc.laws.TARC(**common, **adaptive, **layer),
        lambda: tarc.laws.TARC(**common, **adaptive, **layer, growth="window"),
        lambda: tarc.laws.SlidingMode(**common, gain=rng.uniform(1.0, 4.0), boundary_layer=rng.uniform(0.2, 0.5)),
        lambda: tarc.laws.ComputedTorque(
            period=PERIOD,
            estimator=common["estimator"],
            model=arm,
            natural_frequency=common["natural_frequency"],
        ),
    )
    return kinds[rng.integers(len(kinds))]()


def random_cases(rng: np.random.Generator, bits: int | None) -> list[LoopCase]:
    """Return cases of one random robot, law and reference, which differ in payload, friction and noise."""
    friction = rng.uniform(0.5, 2.0)
    arm = TwoLinkArm(viscous=friction) if rng.integers(2) else NLinkArm(viscous=friction)
    n = arm.n_joints
    law = random_law(rng, arm)
    reference = tarc.signals.Sinusoid(
        amplitude=rng.uniform(0.1, 0.4, n), frequency=rng.uniform(0.5, 3.0, n), offset=rng.uniform(-1.0, 1.0, n)
    )
    return [
        LoopCase(
            arm,
            DigitalController(tarc.signals.Encoder(bits=bits, noise=rng.uniform(1e-7, 1e-5)), law),
            reference,
            initial_torque="rest",
            plant_parameters={"payload": rng.uniform(0.0, 0.5), "viscous": tuple(rng.uniform(0.5, 2.0, n))},
        )
        for _ in range(WIDTH)
    ]


def differences(seed: int, bits: int | None) -> list[Differences]:
    """Return the differences of the runs of one random scenario."""
    cases = random_cases(np.random.default_rng(seed), bits)
    wide, narrow = (BatchLoop(cases[:3], METHOD, DURATION, metrics_start=START, lanes=n) for n in (WIDTH, 1))
    inputs = wide.sample(cases, range(seed, seed + WIDTH))
    torques = wide.machine.run(*wide.lane_arrays(cases, inputs)).record
    ours, alone = wide.run(cases, inputs), narrow.run(cases, inputs)
    loop = TracedLoop(
        cases[0].loop(METHOD), cases[0].initial(inputs[0].sampled), inputs[0].sampled, cases[0].plant_parameters
    )
    found = []
    for i, (case, one) in enumerate(zip(cases, inputs, strict=True)):
        same = ours.end_time[i] == alone.end_time[i] and all(
            np.array_equal(ours.measures[name][i], alone.measures[name][i], equal_nan=True) for name in ours.measures
        )
        torque, measures = _in_virtual_machine(loop, case, one)
        relative = {
            name: abs(ours.measures[name][i] - value) / max(abs(value), 1e-9) for name, value in measures.items()
        }
        count = len(torque)
        peak = np.max(np.abs(torque))
        found.append(Differences(float(np.max(np.abs(torques[:count, :, i] - torque)) / peak), relative, same))
    return found


def _in_virtual_machine(loop: TracedLoop, case: LoopCase, inputs: RunInputs) -> tuple[np.ndarray, dict[str, float]]:
    """Return torques (k, n) and measures of a run in the virtual machine."""
    sampled, law = inputs.sampled, case.controller.law
    monitor = DivergenceMonitor(sampled, THRESHOLD, False)
    arrays = loop.run(case.actual_plant, case.initial(sampled), sampled, monitor, native=False).arrays
    torque = arrays["torque"]
    first = round(START / PERIOD)
    if len(torque) < first + 2:
        return torque, {}
    reference = sampled.reference[0].T[: len(torque)]
    signals = {"position": arrays["position"], "reference": reference, "torque": torque}
    if "auxiliary" in arrays:
        signals["tde_error"] = arrays["acceleration"] - arrays["auxiliary"]
    if "gain" in arrays:
        signals["gain"] = arrays["gain"]
    later = {name: array[first:] for name, array in signals.items()}
    return torque, compute_measures(later, PERIOD, law.torque_limits, case.plant.units)


def agreement(count: int = 1000) -> list[Row]:
    """Compare random scenarios: lanes with single runs, and with the virtual machine, with and without quantisation."""
    rows = []
    for bits, label in ((None, "no quantisation"), (BITS, f"{BITS}-bit encoders")):
        limit = LIMIT if bits is None else QUANTISED_LIMIT
        rows += _rows(label, summarise(all_differences(count, bits), limit), limit)
    return rows


def all_differences(count: int, bits: int | None) -> list[Differences]:
    """Return the differences of the runs of random scenarios."""
    return [one for seed in range(0, count, WIDTH) for one in differences(seed, bits)]


class Agreement(NamedTuple):
    """How many of some runs have the same bits, how far they are from the virtual machine, and by which measure."""

    n_runs: int
    n_same: int
    median: float
    n_flipped: int
    worst: float
    culprit: str
    share_within: float


def summarise(found: list[Differences], limit: float) -> Agreement:
    """Summarise the differences of some runs; a share has all measures within a limit."""
    torque = np.array([one.torque for one in found])
    worst = np.array([max(one.measures.values(), default=0.0) for one in found])
    names = {name for one in found for name in one.measures}
    largest = {name: max(one.measures.get(name, 0.0) for one in found) for name in names}
    return Agreement(
        len(found),
        sum(one.same_bits for one in found),
        float(np.median(torque)),
        int(np.sum(torque > FLIP)),
        float(np.max(worst)),
        max(largest, key=lambda name: largest[name]),
        float(np.mean(worst <= limit)),
    )


def _rows(label: str, found: Agreement, limit: float) -> list[Row]:
    """Return the rows of all runs with or without quantisation."""
    same, within = found.n_same == found.n_runs, found.worst <= limit
    return [
        Row(
            f"{label}: runs in lanes with the bits of single runs",
            f"{found.n_same} of {found.n_runs}",
            target="all",
            met=same,
        ),
        Row(
            f"{label}: torque against the virtual machine, median",
            f"{found.median:.1e}",
            target=f"≤ {FLIP:g}",
            met=found.median <= FLIP,
        ),
        Row(
            f"{label}: runs in which it differs by more than {FLIP:g}",
            f"{found.n_flipped} of {found.n_runs}",
        ),
        Row(
            f"{label}: measures against the virtual machine, worst ({found.culprit})",
            f"{found.worst:.1e}",
            target=f"≤ {limit:g}",
            met=within,
        ),
        Row(f"{label}: runs with all measures within {limit:g}", f"{found.share_within:.1%}"),
    ]
