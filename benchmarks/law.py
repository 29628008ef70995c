"""One step of a law from Python."""

import numpy as np

import tarc
from benchmarks.measure import Row, best
from benchmarks.measure import law as tarc_law
from tarc.core.tracing import CompiledStep, trace
from tarc.core.trees import pack
from tarc.laws import LawInput


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
