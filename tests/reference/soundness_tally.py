"""Verdicts counted, certified cases against adversaries, and the ratios at which designs are tried."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from reference.adversaries import AdversarialLoops, Adversary
from reference.constant_loop import loop_polynomials, peak_gain_of_pair, spectral_radius
from reference.law_parameters import PERIOD, LawParameters
from reference.uncertain_case import UncertainCase, growth_per_period
from tarc.analysis import stable_intervals

Array = np.ndarray

MIN_LOG_GROWTH = 3.0
"""Least logarithm of growth, or of decay, that shows which way a loop goes."""


INSIDE_SHARES = (0.25, 0.7, 0.05)
"""Shares of the ratios for what needs a stable loop to begin with."""


@dataclass
class Tally:
    """Verdicts counted; undecided are those that neither simulation nor roots can tell from the edge."""

    designs: int = 0
    certified: int = 0
    refuted: int = 0
    inconclusive: int = 0
    undecided: int = 0
    violations: list[str] = field(default_factory=list)
    seconds: float = 0.0

    def count(self, verdict: str) -> None:
        self.designs += 1
        setattr(self, verdict, getattr(self, verdict) + 1)


def draw_ratios(
    design: LawParameters, rng: np.random.Generator, count: int, shares: tuple[float, float, float] = (0.5, 0.3, 0.2)
) -> Array:
    """Ratios to try: these shares near where stability ends, between its ends, and anywhere."""
    found = stable_intervals(design.law, computation_delay=design.computation_delay)
    edges = np.array([edge for ends in found for edge in ends if 1e-6 < edge < 1e3])
    anywhere = np.exp(rng.uniform(np.log(2e-3), np.log(4.0), count))
    if not edges.size:
        return anywhere
    inside = np.exp(rng.uniform(np.log(edges.min()), np.log(edges.max()), count))
    near = rng.choice(edges, count) * np.exp(rng.choice([-1, 1], count) * 10 ** rng.uniform(-3.5, -0.5, count))
    return np.choose(rng.choice(3, count, p=shares), [near, inside, anywhere])


def find_instability(case: UncertainCase) -> str:
    """Return what is unstable of loops that a ball covers: constant ones, and those that turn at the worst rate."""
    turns = np.linspace(-np.pi, np.pi, 17) if case.stiffness_weight else np.arccos(np.linspace(-1, 1, 5))
    for kappa in (0.0, case.max_slope / 2, case.max_slope):
        for turn in turns:
            ratio = case.centre + case.radius * np.cos(turn)
            stiffness = np.clip(
                case.radius * case.stiffness_weight * np.sin(turn), -case.max_stiffness, case.max_stiffness
            )
            size = spectral_radius(loop_polynomials(case.law, ratio, kappa, stiffness).closed)
            if size > 1 + 1e-6:
                return f"radius {size!r} at ratio {ratio!r}, stiffness {stiffness!r}, slope {kappa!r}"
        known = loop_polynomials(case.law, case.centre, kappa)
        fastest = case.max_rate * PERIOD * (case.centre**2 - case.radius**2) / (2 * case.radius)  # of what E⁻¹ may turn
        rate = min(peak_gain_of_pair(known, case.stiffness_weight)[1], fastest if case.max_rate < np.inf else np.pi)
        alone = case if case.max_stiffness == np.inf else case._replace(stiffness_weight=0.0)
        size = growth_per_period(alone, kappa, np.array([rate / 2, rate])).max()
        if size > 1 + 1e-6:
            return f"multiplier {size!r} turning at {rate!r} rad a period, slope {kappa!r}"
    return ""


def try_adversaries(
    pairs: Sequence[tuple[LawParameters, UncertainCase]],
    adversaries: Sequence[Adversary],
    rng: np.random.Generator,
    tally: Tally,
    steps: int,
    intersample: bool,
    fleet: type[AdversarialLoops] = AdversarialLoops,
) -> None:
    """Certified cases against adversaries: what grows must do so four and sixteen times as long, or was a transient."""
    for start in range(0, len(pairs), 300):
        some = pairs[start : start + 300]
        growth = fleet([case for _, case in some], adversaries, int(rng.integers(2**31))).run(
            steps, intersample=intersample
        )
        suspects = np.flatnonzero(growth.max(axis=0) > 0.5)
        if not suspects.size:
            continue
        again = fleet([some[i][1] for i in suspects.tolist()], adversaries, 0).run(4 * steps, intersample=intersample)
        for i, log in zip(suspects.tolist(), again.T, strict=True):
            design, case = some[i]
            which = adversaries[int(np.argmax(log))]
            if (
                log.max() > MIN_LOG_GROWTH
                and fleet([case], [which], 0).run(16 * steps, intersample=intersample).max() > MIN_LOG_GROWTH
            ):
                tally.violations.append(f"{case[1:]} certified, but {which} makes log growth {log.max():.3g}: {design}")
            elif log.max() > 0.5:
                tally.undecided += 1
