"""Certificates of random designs against roots and simulations of independent loops."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from reference.adversaries import MISMATCHES, SLOPES, Adversary
from reference.constant_loop import (
    frequency_response,
    log_growth_after_kick,
    loop_polynomials,
    most_negative_real_part,
    peak_gain_of_pair,
    root_uncertainty,
    spectral_radius,
)
from reference.law_parameters import PERIOD, LawParameters, draw_parameters
from reference.law_recurrence import recurrence
from reference.slow_adversaries import SLOW_MISMATCHES, SlowAdversarialLoops
from reference.soundness_tally import (
    INSIDE_SHARES,
    MIN_LOG_GROWTH,
    Tally,
    draw_ratios,
    find_instability,
    try_adversaries,
)
from reference.uncertain_case import UncertainCase
from tarc.analysis.linearise import decoupled_channels
from tarc.analysis.uncertain_loop import UncertainLoop
from tarc.certificates import certify_affine, certify_constant_ratio, certify_sector, certify_varying_ratio
from tarc.certificates.ball_radius import max_radius, max_radius_any_rate
from tarc.core.progress import Progress

N_STEPS = 4000


def check_ratio(design: LawParameters, rng: np.random.Generator, tally: Tally) -> None:
    """One ratio, simulated after a kick."""
    ratio = float(draw_ratios(design, rng, 1)[0])
    verdict = certify_constant_ratio(design.law, ratio, computation_delay=design.computation_delay).verdict
    tally.count(verdict)
    if verdict == "inconclusive":
        return
    closed = loop_polynomials(recurrence(design), ratio).closed
    size = spectral_radius(closed)
    way = log_growth_after_kick(closed, size)
    if np.isnan(way) and abs(size - 1) > root_uncertainty(closed):
        way = np.copysign(np.inf, size - 1)
    if design.alternates and verdict == "certified":
        way = 0.0  # by construction, whatever rounding makes of it
    elif np.isnan(way) or abs(way) < MIN_LOG_GROWTH:
        tally.undecided += 1
        return
    if (way < -MIN_LOG_GROWTH) != (verdict == "certified"):
        tally.violations.append(f"loop {verdict} at {ratio!r}, but log growth {way:.3g}: {design}")


def check_range(design: LawParameters, rng: np.random.Generator, tally: Tally) -> None:
    """Return a range of ratios, by roots at ratios that it holds."""
    hand = recurrence(design)
    low, high = (float(end) for end in np.sort(draw_ratios(design, rng, 2)))
    found = certify_constant_ratio(design.law, (low, high), computation_delay=design.computation_delay)
    tally.count(found.verdict)
    if found.verdict == "inconclusive":
        return
    if found.witness:
        size = spectral_radius(loop_polynomials(hand, found.witness.ratio).closed)
        wrong = not low <= found.witness.ratio <= high or size < 1 - 1e-6
        tally.undecided += abs(size - 1) <= 1e-6
    else:
        size = max(spectral_radius(loop_polynomials(hand, one).closed) for one in np.geomspace(low, high, 25))
        wrong = size > 1 + 1e-6 or design.alternates
    if wrong:
        tally.violations.append(f"loop {found.verdict} from {low!r} to {high!r}, but radius {size!r}: {design}")


def check_balls(
    designs: Sequence[LawParameters], rng: np.random.Generator, tally: Tally, steps: int, advance: Callable[[], None]
) -> None:
    """Balls about random centres, or to hold random ranges, half of them with a slope, against adversaries."""
    cases: dict[bool, list[tuple[LawParameters, UncertainCase]]] = {False: [], True: []}
    for design in designs:
        hand = recurrence(design)
        centre = float(draw_ratios(design, rng, 1, INSIDE_SHARES)[0])
        known = loop_polynomials(hand, centre)
        options: dict[str, Any] = {
            "intersample": bool(rng.random() < 0.5),
            "computation_delay": design.computation_delay,
        }
        if rng.random() < 0.5 and spectral_radius(known.closed) < 1:
            reach = max(most_negative_real_part(known.w_to_q, known.closed)[0], 1e-9)
            options["slope"] = float(rng.uniform(0.02, 1.2) / reach)
        if rng.random() < 0.4:
            spread = np.exp(10 ** rng.uniform(-2, 0.3))
            options["ratio_range"] = centre / spread, centre * spread
        found = certify_varying_ratio(design.law, None if "ratio_range" in options else centre, **options)
        tally.count(found.verdict)
        if found.certified:
            ball = found.evidence
            case = UncertainCase(hand, ball.centre, ball.radius, ball.slope)
            cases[options["intersample"]].append((design, case))
        advance()
    both = [(mismatch, SLOPES[i % len(SLOPES)]) for i, mismatch in enumerate(MISMATCHES)]
    for within, pairs in cases.items():
        for design, case in pairs:
            wrong = find_instability(case)
            if wrong:
                tally.violations.append(f"ball {case[1:]}, but {wrong}: {design}")
        try_adversaries(pairs, [Adversary(*one) for one in both], rng, tally, steps, within)


def check_balls_with_stiffness(
    designs: Sequence[LawParameters], rng: np.random.Generator, tally: Tally, steps: int, advance: Callable[[], None]
) -> None:
    """Balls of pairs of mismatch and the robot's own stiffness, half of them with a slope, against adversaries."""
    pairs = []
    for design in designs:
        hand, centre = recurrence(design), float(draw_ratios(design, rng, 1, INSIDE_SHARES)[0])
        known = loop_polynomials(hand, centre)
        steep = weight = 0.0
        if spectral_radius(known.closed) < 1:
            where = peak_gain_of_pair(known, 0.0)[1] * np.exp(rng.uniform(-4, 0))
            v, q = (
                np.abs(frequency_response(top, known.closed, np.array(where))) for top in (known.a_to_v, known.a_to_q)
            )
            weight = float(v / q * np.exp(rng.uniform(-2, 2)))
            if rng.random() < 0.5:
                steep = float(
                    rng.uniform(0.02, 1.0) / max(most_negative_real_part(known.w_to_q, known.closed)[0], 1e-9)
                )
        parts = UncertainLoop.from_channel(
            decoupled_channels(design.law, design.computation_delay)[0], steep, intersample=True
        )
        reach = max_radius_any_rate(parts, centre, weight)[1]
        tally.count("certified" if reach > 0 else "inconclusive")
        if reach > 0:
            case = UncertainCase(hand, centre, reach, steep, weight)
            pairs.append((design, case))
            wrong = find_instability(case)
            if wrong:
                tally.violations.append(f"pairs {case[1:]}, but {wrong}: {design}")
        advance()
    both = [Adversary(mismatch, SLOPES[i % len(SLOPES)]) for i, mismatch in enumerate(MISMATCHES)]
    try_adversaries(pairs, both, rng, tally, steps, intersample=True)


def check_slow_balls(
    designs: Sequence[LawParameters], rng: np.random.Generator, tally: Tally, steps: int, advance: Callable[[], None]
) -> None:
    """Balls of a mismatch that changes slowly, half of them with a slope, a third with a stiffness."""
    pairs = []
    for design in designs:
        hand, centre = recurrence(design), float(draw_ratios(design, rng, 1, INSIDE_SHARES)[0])
        rate = float(np.exp(rng.uniform(np.log(0.1), np.log(300.0)))) / centre
        known = loop_polynomials(hand, centre)
        steep = weight = stiffness = 0.0
        if spectral_radius(known.closed) < 1:
            if rng.random() < 0.5:
                steep = float(
                    rng.uniform(0.02, 1.0) / max(most_negative_real_part(known.w_to_q, known.closed)[0], 1e-9)
                )
            if rng.random() < 1 / 3:
                # a constant stiffness that the loop tolerates or nearly does: a pole at one has v = h/ρ0 q
                stiffness = float(centre * design.natural_frequency**2 * np.exp(rng.uniform(-3, 0.5)))
                weight = float(stiffness / centre * np.exp(rng.uniform(-1, 3)))
        if weight:
            parts = UncertainLoop.from_channel(
                decoupled_channels(design.law, design.computation_delay)[0], steep, intersample=True
            )
            reach = max_radius(parts, centre, weight, max_change=rate * PERIOD, stiffness=stiffness)[1]
        else:
            found = certify_varying_ratio(
                design.law, centre, slope=steep, rate=rate, computation_delay=design.computation_delay
            )
            reach = found.evidence.radius if found.certified else 0.0
        tally.count("certified" if reach > 0 else "inconclusive")
        if reach > 0:
            case = UncertainCase(hand, centre, reach, steep, weight, rate, stiffness if weight else np.inf)
            pairs.append((design, case))
            wrong = find_instability(case)
            if wrong:
                tally.violations.append(f"slow {case[1:]}, but {wrong}: {design}")
        advance()
    both = [Adversary(mismatch, SLOPES[i % len(SLOPES)]) for i, mismatch in enumerate(SLOW_MISMATCHES)]
    try_adversaries(pairs, both, rng, tally, steps, intersample=True, fleet=SlowAdversarialLoops)


def check_affine(
    designs: Sequence[LawParameters], rng: np.random.Generator, tally: Tally, steps: int, advance: Callable[[], None]
) -> None:
    """Ranges that an affine Lyapunov function covers at a rate, half of them with a slope."""
    pairs = []
    for design in designs:
        hand, middle = recurrence(design), float(draw_ratios(design, rng, 1, INSIDE_SHARES)[0])
        spread = float(np.exp(rng.uniform(0.1, 2.5)))
        low, high = middle * spread**-0.5, middle * spread**0.5
        rate = float(np.exp(rng.uniform(np.log(0.1), np.log(300.0)))) / middle
        steep = 0.0
        known = loop_polynomials(hand, middle)
        if rng.random() < 0.5 and spectral_radius(known.closed) < 1:
            steep = float(rng.uniform(0.02, 0.6) / max(most_negative_real_part(known.w_to_q, known.closed)[0], 1e-9))
        found = certify_affine(design.law, (low, high), rate, slope=steep, computation_delay=design.computation_delay)
        tally.count(found.verdict)
        if found.certified:
            case = UncertainCase(hand, (low + high) / 2, (high - low) / 2, steep, 0.0, rate)
            for ratio in np.geomspace(low, high, 9):
                if spectral_radius(loop_polynomials(hand, ratio).closed) >= 1:
                    tally.violations.append(f"affine {(low, high)}, but unstable at {ratio}: {design}")
            pairs.append((design, case))
        advance()
    both = [Adversary(mismatch, SLOPES[i % len(SLOPES)]) for i, mismatch in enumerate(SLOW_MISMATCHES)]
    try_adversaries(pairs, both, rng, tally, steps, intersample=True, fleet=SlowAdversarialLoops)


def check_slopes(
    designs: Sequence[LawParameters], rng: np.random.Generator, tally: Tally, steps: int, advance: Callable[[], None]
) -> None:
    """Caps on the gain of TARC from below the circle criterion to beyond the frozen limit, against adversaries."""
    pairs = []
    for design in designs:
        hand, ratio = recurrence(design), float(draw_ratios(design, rng, 1, INSIDE_SHARES)[0])
        known = loop_polynomials(hand, ratio)
        reach = most_negative_real_part(known.w_to_q, known.closed)[0] if spectral_radius(known.closed) < 1 else 1e-2
        kappa = float(np.exp(rng.uniform(-0.7, 1.2)) / max(reach, 1e-9))
        robust = replace(design, slope=kappa, ratio=ratio)
        found = certify_sector(
            robust.law, ratio, max_gain=robust.frozen_gain, computation_delay=design.computation_delay
        )
        tally.count(found.verdict)
        if found.witness:
            shown = found.witness.gain * design.gain_factor * design.P2 / design.boundary_layer
            size = spectral_radius(loop_polynomials(hand, ratio, shown).closed)
            tally.undecided += abs(size - 1) <= 1e-6
            if size < 1 - 1e-6 or shown > kappa * (1 + 1e-9):
                tally.violations.append(f"slope refuted at {shown!r}, but radius {size!r}: {robust}")
        if found.certified:
            pairs.append((robust, UncertainCase(hand, ratio, 0.0, kappa)))
            size = max(
                spectral_radius(loop_polynomials(hand, ratio, kappa * share).closed) for share in np.linspace(0, 1, 9)
            )
            if size > 1 + 1e-6 or design.alternates:
                tally.violations.append(f"slope certified, but radius {size!r}: {robust}")
        advance()
    try_adversaries(pairs, [Adversary("none", kind) for kind in SLOPES], rng, tally, steps, intersample=False)


def tally_certificates(
    count: int, seed: int = 0, show: bool | None = False, steps: int = N_STEPS, kinds: Sequence[str] | None = None
) -> dict[str, Tally]:
    """Return a tally for each kind of certificate, or for some of them.

    There are ``count`` loops, a quarter as many balls and slopes, and an eighth as many of each other kind.
    """
    rng = np.random.default_rng(seed)
    plan = {
        "constant_ratio": count,
        "constant_ratio, a range": count // 8,
        "varying_ratio": count // 4,
        "sector": count // 4,
    }
    plan |= {"varying_ratio, stiffness": count // 8, "varying_ratio, slow": count // 8, "affine": count // 8}
    checks = {
        "varying_ratio": check_balls,
        "sector": check_slopes,
        "varying_ratio, stiffness": check_balls_with_stiffness,
        "varying_ratio, slow": check_slow_balls,
        "affine": check_affine,
    }
    tallies = {}
    for name in kinds or plan:
        designs = plan[name]
        tally = tallies[name] = Tally()
        begin = time.perf_counter()
        drawn = [draw_parameters(rng, name == "sector") for _ in range(designs)]
        with Progress(name, designs, show) as progress:
            if name.startswith("constant_ratio"):
                for design in drawn:
                    (check_ratio if name == "constant_ratio" else check_range)(design, rng, tally)
                    progress.advance()
            else:
                checks[name](drawn, rng, tally, steps, progress.advance)
        tally.seconds = time.perf_counter() - begin
    return tallies
