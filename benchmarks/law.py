"""One step of a law, from Python and in C."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

import tarc
from benchmarks.measure import Row, best
from benchmarks.measure import law as tarc_law
from tarc.core.codegen import CompiledLoop
from tarc.core.tracing import CompiledStep, trace
from tarc.core.trees import pack
from tarc.laws import TARC, LawInput


def step() -> list[Row]:
    """TARC for six joints with a window of 16 periods: over fixed memory, by `Controller`, and the NumPy function."""
    position, rest = np.full(6, 0.1), np.zeros(6)
    law = tarc_law(np.full(6, 0.1), 16, 50.0, np.full(6, 100.0))
    state, example = law.example()
    buffered = CompiledStep(trace(law.step, state, example)[0])
    buffered.reset(pack(state))
    buffered.value[:6] = position
    controller = tarc.Controller(law)
    controller.reset(rest)
    value = LawInput(position, rest, rest, rest)
    fixed, face = best([buffered.step, lambda: controller.step(position, rest, rest, rest)], 5000)
    (plain,) = best([lambda: law.step(state, value)], 50, 7)
    what, against = "law step from Python, TARC, 6 joints, window 16: ", f"as NumPy: {1e6 * plain:.0f} µs"
    return [
        Row(what + "over fixed memory", f"{1e6 * fixed:.2f} µs", against, plain / fixed, "≤ 1.5 µs", fixed <= 1.5e-6),
        Row(what + "Controller.step", f"{1e6 * face:.2f} µs", against, plain / face),
    ]


PERIODS = 20_000
"""Periods in one call of the C loop."""


def with_model() -> list[Row]:
    """TARC on a UR5e in C: with M̂ constant, with M̂(q), and with the whole model fed forward along the reference."""
    arm = tarc.plants.RigidBody(tarc.plants.MujocoPlant.from_file("ur5e", viscous=1.0, armature=0.1))
    constant = tarc_law(np.full(arm.n_joints, 0.1), 16, 50.0, arm.torque_limits)
    known = replace(constant, inertia=tarc.NominalInertia(arm, 0.06))
    kinds = {
        "M̂(q)": known,
        "M̂(q) with gravity and Coriolis": replace(
            constant, inertia=tarc.NominalInertia(arm, 0.06, gravity=True, coriolis=True)
        ),
        "M̂(q) and feed-forward of the model": replace(known, feedforward=tarc.Feedforward(arm)),
    }
    motion = arm.home + 1e-4 * np.random.default_rng(0).standard_normal((PERIODS, arm.n_joints)).cumsum(axis=0)
    times = best([_c_step(law, motion) for law in (constant, *kinds.values())], 1, 15)
    first, *others = (one / PERIODS for one in times)
    what, against = "law step in C, TARC, UR5e, window 16: ", f"M̂ constant: {1e9 * first:.0f} ns"
    return [
        Row(what + name, f"{1e9 * one:.0f} ns", against, first / one, "≤ 1.5 µs", one <= 1.5e-6)
        for name, one in zip(kinds, others, strict=True)
    ]


def _c_step(law: TARC, motion: np.ndarray) -> Callable[[], object]:
    """Return a call that steps a law once for each position, with a reference at rest."""
    state, example = law.example()
    loop, start = CompiledLoop(trace(law.step, state, example)[0]), pack(state)
    inputs = np.zeros((len(motion), pack(example).size))
    n = motion.shape[1]
    inputs[:, :n], inputs[:, n : 2 * n] = motion, motion[0]
    return lambda: loop.run(start.copy(), inputs)
