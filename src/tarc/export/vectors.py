"""Recorded steps of a law, which its C must repeat to the last bit."""

from dataclasses import dataclass

import numpy as np

from tarc.core import array_ops as ops
from tarc.core.c_constants import SINGLE_HUGE
from tarc.core.tracing import CompiledStep
from tarc.core.types import Array
from tarc.export.c_source import CSource
from tarc.export.single_precision import SinglePrecision
from tarc.export.traced_law import TracedLaw

BAD_SHARE = 0.02
"""Share of the inputs in which something is missing, infinite or huge."""
BAD_VALUES = (np.nan, np.inf, -np.inf, 1e200)


@dataclass(frozen=True)
class Vectors:
    """Steps of a law from one start.

    Attributes
    ----------
    position, torque
        The start, each (n,).
    inputs
        Position, reference, its two derivatives and the applied torque in each step, shape (k, 5n); with a watch the
        elapsed time too, shape (k, 5n + 1).
    outputs
        Torque and signals after each step, shape (k, m).
    """

    position: Array
    torque: Array
    inputs: Array
    outputs: Array


def random_inputs(n: int, count: int, seed: int, period: float | None = None) -> tuple[Array, Array, Array]:
    """Return a start, and inputs of a joint that wanders about a reference, with missing and absurd numbers.

    Returns
    -------
    position, torque, inputs
        Of shapes (n,), (n,) and (count, 5n); with a period (count, 5n + 1), the last column the elapsed time.
    """
    rng = np.random.default_rng(seed)
    position, torque = rng.uniform(-1, 1, n), rng.uniform(-0.5, 0.5, n)
    time = 1e-3 * np.arange(1, count + 1)[:, None]
    rate = rng.uniform(0.5, 3.0, n)
    offset = np.sin(rate * time)
    reference = np.hstack([position + 0.2 * offset, 0.2 * rate * np.cos(rate * time), -0.2 * rate**2 * offset])
    measured = position + 0.2 * offset + 1e-3 * np.cumsum(rng.standard_normal((count, n)), axis=0) / 10
    applied = np.where(rng.random((count, 1)) < 0.7, np.nan, rng.uniform(-5, 5, (count, n)))
    inputs = np.hstack([measured, reference, applied])
    bad = np.flatnonzero(rng.random(count) < BAD_SHARE)
    inputs[bad, rng.integers(0, 4 * n, len(bad))] = rng.choice(BAD_VALUES, len(bad))
    lost = slice(count // 2, count // 2 + min(5, count // 8))
    inputs[lost, :n] = np.nan  # a gap that the law bridges
    if period is not None:
        elapsed = period * (1 + 0.03 * rng.standard_normal(count))
        odd = rng.random(count) < BAD_SHARE
        elapsed[odd] = rng.choice([0.0, 2 * period, *BAD_VALUES], int(np.sum(odd)))
        inputs = np.column_stack([inputs, elapsed])
    return position, torque, inputs


def inputs_of(source: CSource, count: int, seed: int) -> tuple[Array, Array, Array]:
    """Return `random_inputs` that fit a law."""
    traced = source.traced
    return random_inputs(traced.n_joints, count, seed, None if traced.watch is None else traced.law.period)


def record(source: CSource, position: Array, torque: Array, inputs: Array) -> Vectors:
    """Return the outputs for a start and inputs: in the virtual machine, or in single precision."""
    traced = source.traced
    torque = np.clip(torque, -traced.start_limits, traced.start_limits)
    if source.single:
        return _record_single(traced, position, torque, inputs)
    start = np.array(traced.start(position, torque)).ravel()
    step = CompiledStep(traced.step)
    step.reset(start)
    n, outputs = traced.n_joints, []
    place = slice(traced.past_torque, traced.past_torque + n)
    for row in inputs:
        applied = row[4 * n : 5 * n]
        is_reported = np.abs(applied) <= ops.HUGE
        step.state[place][is_reported] = applied[is_reported]
        step.value[: 4 * n] = row[: 4 * n]
        step.value[4 * n :] = row[5 * n :]
        step.step()
        outputs.append(step.output.copy())
    return Vectors(position, torque, inputs, np.array(outputs))


def _record_single(traced: TracedLaw, position: Array, torque: Array, inputs: Array) -> Vectors:
    with np.errstate(over="ignore"):
        position, torque, inputs = (part.astype(np.float32) for part in (position, torque, inputs))
    (state,) = SinglePrecision(traced.start)(position, torque)
    step, n, outputs = SinglePrecision(traced.step), traced.n_joints, []
    place = slice(traced.past_torque, traced.past_torque + n)
    for row in inputs:
        applied = row[4 * n : 5 * n]
        is_reported = np.abs(applied) <= np.float32(SINGLE_HUGE)
        state[place][is_reported] = applied[is_reported]
        state, output = step(state, np.concatenate([row[: 4 * n], row[5 * n :]]))
        outputs.append(output)
    return Vectors(position, torque, inputs, np.array(outputs))


def bit_rows(values: Array, single: bool) -> str:
    """Return rows of numbers in C, as bit patterns."""
    bits, real = (np.uint32, np.float32) if single else (np.uint64, np.float64)
    digits, suffix = (8, "u") if single else (16, "ull")
    patterns = np.atleast_2d(values).astype(real).view(bits)
    return ",\n".join(
        "  {" + ", ".join(f"0x{int(pattern):0{digits}x}{suffix}" for pattern in row) + "}" for row in patterns
    )


def header(source: CSource, vectors: Vectors) -> str:
    """Return the vectors in C, as bit patterns."""
    kind = "uint32_t" if source.single else "uint64_t"

    def rows(values: Array) -> str:
        return bit_rows(values, source.single)

    count, n_inputs = vectors.inputs.shape
    start = np.concatenate([vectors.position, vectors.torque])
    return f"""/* Steps of the law as {"single precision" if source.single else "CasADi"} computes them, as bits. */
#ifndef VECTORS_H
#define VECTORS_H

#include <stdint.h>

typedef {kind} bits;

#define VECTORS {count}
#define VECTOR_INPUTS {n_inputs}
#define VECTOR_OUTPUTS {vectors.outputs.shape[1]}
/* 1 where every C library must give these bits; 0 for a law with functions that libraries round differently */
#define VECTORS_EXACT {int(not source.uses_library)}

static const bits vector_start[1][{len(start)}] = {{
{rows(start)}
}};

static const bits vector_inputs[VECTORS][VECTOR_INPUTS] = {{
{rows(vectors.inputs)}
}};

static const bits vector_outputs[VECTORS][VECTOR_OUTPUTS] = {{
{rows(vectors.outputs)}
}};

#endif
"""
