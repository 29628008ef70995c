"""The loop that runs: stability of the law's own code around q̈ = ρ M̂⁻¹ τ, for one inertia ratio ρ or a range."""

from itertools import pairwise
from typing import Any

import numpy as np

from tarc.analysis.linearise import Channel, decouple
from tarc.analysis.stability import Witness, _delay_margin, _radius, _split, crossings, from_disturbance, from_noise
from tarc.certificates.base import JUDGES, Certificate, dict_certificate
from tarc.core import validation as check
from tarc.laws.base import Law
from tarc.numerics.matrix_tests import schur
from tarc.numerics.norms import h2_norm, hinf_norm


def certify_constant_ratio(
    law: Law, ratio: float | tuple[float, float] = 1.0, *, computation_delay: int = 0, gain: float = 0.0
) -> Certificate:
    """Certify the loop that the law makes, for a constant inertia ratio.

    The plant is q̈ = ρ M̂⁻¹ τ under zero-order hold, the controller the Jacobian of the very function that is simulated,
    with the switching gain frozen. For that linear time-invariant loop the test is exact.

    Parameters
    ----------
    law
        A law on time-delay estimation.
    ratio
        ρ, the eigenvalue of M⁻¹M̂; a pair for every constant ρ in a range.
    computation_delay
        Periods between a measurement and its torque.
    gain
        Frozen switching gain ĉ [rad/s²].

    Returns
    -------
    Certificate
        Its margin is 1 less the largest spectral radius at the ends of the range. Its numbers: the spectral radius, the
        decay rate [1/s], the ringing frequency [rad/s] and the further computation delay that the loop bears
        [periods], at the worse end; and for a stable loop the gain from a disturbing acceleration to the error [s²] and
        from measurement noise to M̂⁻¹τ [1/s²], as largest gain (``h_infinity``) and as root mean square for white noise
        (``h2``).

    Raises
    ------
    TarcError
        For a law without an inertia, and ratios that are not positive.
    """
    low, high = (ratio, ratio) if np.ndim(ratio) == 0 else tuple(np.ravel(ratio))
    low = check.number("ratio", low, 0, strict=True)
    high = check.number("ratio", high, low)
    channels = decouple(law, computation_delay, gain)
    matrices, numbers = _evidence(channels), {"low": low, "high": high, "period": law.period, "gain": gain}
    numbers["loops"] = float(len(channels))
    verdict, margin, witness = judge(matrices, numbers)
    worst = low if low == high else max((low, high), key=lambda end: _radius(channels, end))
    numbers |= _describe(channels, worst, stable=verdict == "certified")
    span = f"ρ = {low:g}" if low == high else f"every constant ρ from {low:g} to {high:g}"
    return dict_certificate(
        kind="loop",
        claim=f"The loop of {type(law).__name__} around q̈ = ρ M̂⁻¹τ is stable for {span}.",
        verdict=verdict,
        margin=margin,
        margin_meaning="1 less the largest spectral radius at the ends",
        assumptions=(
            "the robot's M(q)⁻¹M̂ is a constant multiple ρ of the identity; Coriolis, gravity and friction disturb only",
            "no torque limit is reached and no sample is lost",
            f"the switching gain is frozen at {gain:g} rad/s² and the error inside its boundary layer"
            if gain
            else "the switching gain is zero",
            "eigenvalues are computed in floating point, and judged with room for rounding",
            f"the torque reaches the joints {computation_delay} periods late and is held for a period",
        ),
        matrices=matrices,
        numbers=numbers,
        witness=witness,
    )


def judge(matrices: dict[str, np.ndarray], numbers: dict[str, Any]) -> tuple[str, float, Witness | None]:
    """Verdict, margin and witness from the stored matrices: stable at both ends, and no crossing between them."""
    low, high, period = numbers["low"], numbers["high"], numbers["period"]
    count = int(numbers["loops"])
    verdict, margin, witness = "certified", np.inf, None
    for i in range(count):
        A, b, c = (matrices[f"{letter}{i}"] for letter in "Abc")
        trials = {low, high}
        if low < high:
            inner = [edge for edge in crossings(A, b, c) if low < edge < high]
            trials |= {(one + two) / 2 for one, two in pairwise([low, *inner, high])}
            trials |= set(np.geomspace(low, high, 8)[1:-1].tolist())
        for trial in sorted(trials):
            answer, radius, mode = schur(A + trial * b @ c)
            if trial in (low, high):
                margin = min(margin, 1 - radius)
            if answer == "refuted":
                rate = np.log(radius) / period
                found = {"ratio": trial, "growth rate [1/s]": rate, "frequency [rad/s]": abs(np.angle(mode)) / period}
                return "refuted", min(margin, 1 - radius), found
            if answer == "inconclusive":
                verdict = "inconclusive"
    return verdict, float(margin), witness


JUDGES["loop"] = judge


def _evidence(channels: list[Channel]) -> dict[str, np.ndarray]:
    return {
        f"{letter}{i}": part
        for i, channel in enumerate(channels)
        for letter, part in zip("Abc", _split(channel), strict=True)
    }


def _describe(channels: list[Channel], ratio: float, *, stable: bool) -> dict[str, float]:
    """What else an engineer asks of the loop at this ratio."""
    values = np.concatenate([np.linalg.eigvals(channel.closed(ratio)) for channel in channels])
    lead = values[np.argmax(np.abs(values))]
    period = channels[0].period
    result = {
        "spectral radius": float(abs(lead)),
        "decay rate": float(-np.log(abs(lead)) / period),
        "ringing frequency": float(abs(np.angle(lead)) / period),
    }
    if not stable:
        return result
    result["delay margin"] = float(min(_delay_margin(channel, ratio) for channel in channels))
    for name, system in (("disturbance to error", from_disturbance), ("noise to torque", from_noise)):
        systems = [system(channel, ratio) for channel in channels]
        result[f"{name} h_infinity"] = max(hinf_norm(*one) for one in systems)
        result[f"{name} h2"] = max(h2_norm(*one) for one in systems)
    return result
