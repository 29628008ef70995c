"""The MuJoCo closed loop against MuJoCo alone."""

import time

import mujoco
import numpy as np

import tarc
from benchmarks.measure import Row, Stopwatch, law
from tarc.control.digital_controller import DigitalController
from tarc.simulation.mujoco_backend import run_mujoco
from tarc.simulation.sampled_inputs import initial_conditions, sample_inputs


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
    plan = sample_inputs(arm, drive.law, reference, 40.0, drive.sensor, [], 1, 0)
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
