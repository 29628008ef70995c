"""The MuJoCo closed loop against MuJoCo alone."""

import time

import mujoco
import numpy as np

import tarc
from benchmarks.measure import Row, Stopwatch, law
from tarc.control.digital_controller import DigitalController
from tarc.simulation.casadi_backend import run_casadi
from tarc.simulation.closed_loop import ClosedLoop
from tarc.simulation.integration import Integration, integration_error, max_error
from tarc.simulation.mujoco_backend import run_mujoco
from tarc.simulation.sampled_inputs import initial_conditions, sample_inputs

ENGINES = {True: "compiled", False: "in the virtual machine"}


def closed_loop() -> list[Row]:
    """In the virtual machine, and compiled."""
    return [_closed_loop(False), _closed_loop(True)]


def _closed_loop(native: bool) -> Row:
    """TARC on a UR5e against replaying its torque: one assignment and one `mj_step` a period, in a Python loop.

    The two take turns on stretches of the same motion, which must come out the same to the last bit.
    """
    arm = tarc.plants.MujocoPlant.from_file("ur5e", coulomb=2.0, viscous=1.0, armature=0.1)
    n = arm.n_joints
    drive = DigitalController(tarc.signals.Encoder(bits=17), law(np.full(n, 0.1), 10, 50.0, arm.torque_limits))
    reference = tarc.signals.Sinusoid(amplitude=0.2, frequency=np.linspace(1.0, 2.0, n), offset=arm.home)
    plan = sample_inputs(arm, drive.law.period, reference, 40.0, drive.sensor, [], 1, 0)
    begin = initial_conditions(arm, plan, None, 0.0, "rest")
    record = run_mujoco(arm, drive, begin, plan, Stopwatch(plan), native).arrays
    torque = np.ascontiguousarray(record["torque"])

    model = arm.copy_model()
    model.opt.timestep = drive.law.period
    data = mujoco.MjData(model)
    data.qpos[:] = begin.position
    applied, advance = data.qfrc_applied, mujoco.mj_step
    bare: list[float] = []
    at = 0

    def replay(end: int) -> None:
        nonlocal at
        if not np.array_equal(data.qpos, record["position"][at]):
            raise RuntimeError(f"the replayed motion differs from the closed loop's at period {at}")
        start = time.perf_counter()
        for row in torque[at:end]:
            applied[:] = row
            advance(model, data)
        bare.append((time.perf_counter() - start) / (end - at))
        at = end

    watch = Stopwatch(plan, replay)
    run_mujoco(arm, drive, begin, plan, watch, native)
    ratio = float(np.median(np.divide(bare[1:], watch.times)))
    what = "UR5e in MuJoCo under TARC, window 10, 17-bit encoder, 1 kHz: a control period, "
    what += "compiled" if native else "virtual machine"
    against = f"bare Python loop of mj_step: {1e6 * min(bare):.2f} µs"
    return Row(what, f"{1e6 * min(watch.times):.2f} µs", against, ratio, "≥ 0.8×", ratio >= 0.8)


def symbolic() -> list[Row]:
    """Compare a control period of the UR5e as expressions and in MuJoCo, in turns, and give the error of a period.

    The targets are those of the cheapest method whose error suffices, which a run takes.
    """
    stepped = tarc.plants.MujocoPlant.from_file("ur5e", viscous=1.0, armature=0.1)
    arm = tarc.plants.RigidBody(stepped)
    n = arm.n_joints
    drive = DigitalController(tarc.signals.Encoder(bits=17), law(np.full(n, 0.1), 10, 50.0, arm.torque_limits))
    reference = tarc.signals.Sinusoid(amplitude=0.2, frequency=np.linspace(1.0, 2.0, n), offset=arm.home)
    plan = sample_inputs(arm, drive.law.period, reference, 10.0, drive.sensor, [], 1, 0)
    begin = initial_conditions(arm, plan, None, 0.0, "rest")
    rows: list[Row] = []
    is_enough = False
    for integrator in ("midpoint", "Runge–Kutta"):
        loop = ClosedLoop(arm, drive, 1, integrator)
        record = run_casadi(loop, begin, plan, Stopwatch(plan), True)
        method = Integration(integrator, 1)
        error = integration_error(arm, record, plan.disturbance[:, :, 0], drive.law.period, method)
        has_target = not is_enough
        is_enough = is_enough or error <= max_error(drive.sensor)
        for ours, theirs in ((True, False), (True, True), (False, False)):
            times: dict[str, list[float]] = {"ours": [], "theirs": []}
            for _ in range(5):
                watch = Stopwatch(plan)
                run_casadi(loop, begin, plan, watch, ours)
                times["ours"].append(min(watch.times))
                watch = Stopwatch(plan)
                run_mujoco(stepped, drive, begin, plan, watch, theirs)
                times["theirs"].append(min(watch.times))
            ratio = float(np.median(np.divide(times["theirs"], times["ours"])))
            least = 3.0 if ours else 1.0
            rows.append(
                Row(
                    f"UR5e in symbols, one step of {integrator}, {ENGINES[ours]}; a period adds {error:.0e} rad",
                    f"{1e6 * min(times['ours']):.2f} µs",
                    f"the MuJoCo loop, law {ENGINES[theirs]}: {1e6 * min(times['theirs']):.2f} µs",
                    ratio,
                    f"≥ {least:g}×" if has_target else "",
                    ratio >= least if has_target else None,
                )
            )
    return rows
