"""The fused loop: time of a control period, and against the NumPy loop of a peer."""

import time
from collections.abc import Callable

import numpy as np
from opensmc.controllers.pid import PID
from opensmc.plants import TwoLinkArm as PeerArm
from opensmc.simulator import Simulator

import tarc
from benchmarks.measure import Row, Stopwatch, law
from tarc.control.digital_controller import DigitalController
from tarc.plants import TwoLinkArm
from tarc.simulation.casadi_backend import run_casadi
from tarc.simulation.closed_loop import ClosedLoop
from tarc.simulation.sampled_inputs import initial_conditions, sample_inputs


def fused(
    arm: TwoLinkArm, substeps: int, between: Callable[[int], object] = lambda at: None, native: bool = False
) -> list[float]:
    """Measure a control period [s]: law, plant and recording; one a stretch."""
    drive = DigitalController(tarc.signals.Encoder(), law(0.05 * arm.inertia([0.0, np.pi / 2]), 10, 2000.0))
    reference = tarc.signals.Sinusoid(amplitude=0.6, frequency=[2.0, 2.5])
    plan = sample_inputs(arm, drive.law.period, reference, 50.0, drive.sensor, [], substeps, 0)
    begin, watch = initial_conditions(arm, plan, None, 0.0, "rest"), Stopwatch(plan, between)
    run_casadi(ClosedLoop(arm, drive, substeps), begin, plan, watch, native)
    return watch.times


def period() -> list[Row]:
    """Measure a control period of the default two-link arm."""
    least = 1e6 * min(fused(TwoLinkArm(), 2))
    machine = 1e6 * min(fused(TwoLinkArm(), 2, native=True))
    what = "two-link arm under TARC, window 10, 1 kHz, 2 RK4 substeps: a control period, virtual machine"
    return [
        Row(what, f"{least:.2f} µs", target="≤ 5 µs", met=least <= 5),
        Row("the same, compiled", f"{machine:.2f} µs"),
    ]


def peer() -> list[Row]:
    """Return a step of `opensmc` on its two-link arm; the one controller of it that drives two joints is its PID.

    It takes one Runge–Kutta step a control step; ours is compared at one too, and shown at its default of two.
    """
    theirs = PeerArm()
    ours = TwoLinkArm(
        masses=(theirs.m1, theirs.m2),
        lengths=(theirs.l1, theirs.l2),
        centres=(theirs.lc1, theirs.lc2),
        inertias=(theirs.I1, theirs.I2),
    )
    pid, steps = PID(Kp=200.0, Kd=40.0, Ki=50.0, dt=1e-3, n_channels=2), 100

    def reference(t: float) -> np.ndarray:
        return 0.6 * np.array([np.sin(2 * t), 2 * np.cos(2 * t), np.sin(2.5 * t), 2.5 * np.cos(2.5 * t)])

    rows = []
    for substeps in (2, 1):
        theirs_took: list[float] = []

        def run(at: int, times: list[float] = theirs_took) -> None:
            begin = time.perf_counter()
            Simulator(dt=1e-3, T=steps * 1e-3, method="rk4").run(pid, theirs, reference)
            times.append((time.perf_counter() - begin) / (steps + 1))

        periods = fused(ours, substeps, run)
        ratio = float(np.median(np.divide(theirs_took[1:], periods)))
        what = f"the same on the arm of opensmc, {substeps} RK4 substep{'s'[: substeps - 1]}"
        against = f"opensmc's PID and 1 RK4 step: {1e6 * min(theirs_took):.0f} µs"
        target, met = ("≥ 40×", ratio >= 40) if substeps == 1 else ("", None)
        rows.append(Row(what, f"{1e6 * min(periods):.2f} µs", against, ratio, target, met))
    return rows
