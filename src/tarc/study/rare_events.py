"""Probabilities of rare events, down to 1e-6 and below, by importance splitting over levels."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter, NotConverged
from tarc.core.progress import Progress
from tarc.core.types import Array
from tarc.study.statistics import CONFIDENCE, Interval

Performance = Callable[[Array, Array], Array]
"""Values (k,), more is worse, of k runs at points (k, d) of standard normal numbers with seeds (k,)."""

TARGET_ACCEPTANCE = 0.44
"""Share of accepted steps at which a chain moves fastest in one dimension, and nearly so in more."""

MAX_ADAPTATIONS = 10
"""Largest number of groups of chains of a level, after each of which the size of the steps changes."""

CHAINS_PER_GROUP = 16
"""Least number of chains of a group: runs that an engine may have side by side."""

NEW_SEED = 0.5
"""Probability with which a step of a chain draws a new seed."""


@dataclass(frozen=True)
class SplittingLevel:
    """One level of one estimate.

    Attributes
    ----------
    threshold
        Value that the runs of the next level exceed.
    probability
        Share of the runs of this level that exceed it.
    acceptance
        Share of accepted steps of the chains; 1 for the first level, which has none.
    variation
        Coefficient of variation of the probability, by the correlation along the chains.
    """

    threshold: float
    probability: float
    acceptance: float
    variation: float


@dataclass(frozen=True)
class RareProbability:
    """Probability of a rare event.

    Attributes
    ----------
    threshold
        Value that defines the event.
    probability
        Mean of the repeated estimates, with its interval.
    estimates
        The estimates.
    levels
        Levels of each estimate.
    variation
        Coefficient of variation of one estimate by theory, with independent levels.
    n_runs
        Number of runs in all.
    worst_point
        Standard normal numbers of the worst run, shape (d,).
    worst_seed
        Its seed.
    """

    threshold: float
    probability: Interval
    estimates: tuple[float, ...]
    levels: tuple[tuple[SplittingLevel, ...], ...]
    variation: float
    n_runs: int
    worst_point: Array
    worst_seed: int


@dataclass
class _Sample:
    """Points (k, d), seeds (k,) and values (k,) of the runs of a level."""

    points: Array
    seeds: Array
    values: Array

    def at(self, chosen: Array) -> "_Sample":
        return _Sample(self.points[chosen], self.seeds[chosen], self.values[chosen])


def rare_probability(
    performance: Performance,
    dimension: int,
    threshold: float,
    *,
    samples: int = 1000,
    level_probability: float = 0.1,
    repetitions: int = 10,
    max_levels: int = 15,
    confidence: float = CONFIDENCE,
    seed: int = 0,
    progress: bool | None = None,
) -> RareProbability:
    """Estimate the probability that a performance reaches a threshold, by subset simulation.

    The event is the last of a sequence of nested events {g ≥ b_1} ⊃ {g ≥ b_2} ⊃ …, each of which has about the
    probability p₀ given the one before:

        P = P(g ≥ b_1) P(g ≥ b_2 | g ≥ b_1) …

    The first factor is by plain Monte Carlo. The others are by Markov chains that begin at the runs above the level and
    stay above it. A step is u⁺ = √(1 − σ²) u + σ ξ, which keeps the normal distribution. Half of the steps have a new
    seed of the noise as well. A step is taken where g(u⁺) ≥ b, and σ adapts to the share of those that are. Where the
    noise decides and not the draws, new seeds are seldom taken, and the estimates scatter more.

    The interval is that of the mean of independent repetitions, by Student's t on the logarithm of the mean. The levels
    are chosen from the same runs, so one estimate is too large by a share of about 1/samples.

    Parameters
    ----------
    performance
        Values of runs at points of standard normal numbers with seeds of their noise; finite, more is worse.
    dimension
        d, the number of draws.
    threshold
        Value from which on the event has happened.
    samples
        Runs per level.
    level_probability
        p₀, in [0.01, 0.5]; samples times p₀ must be a whole number.
    repetitions
        Number of independent estimates, at least three.
    max_levels
        Number of levels after which an estimate stops: at p₀ = 0.1 the probability is then below 10 to this power.
    confidence
        Probability with which the interval contains the true probability.
    seed
        Of all random numbers.
    progress
        Show a progress bar when it takes more than two seconds; None for when standard error is a terminal.

    Raises
    ------
    InvalidParameter
        For arguments out of range, and a performance that is not finite.
    NotConverged
        Where the levels do not rise, as with a performance of a few values, or do not reach the threshold.

    References
    ----------
    Au, Beck, Probabilistic Engineering Mechanics 16, 2001; Papaioannou et al., ibid. 41, 2015 (the steps).
    """
    check.integer("dimension", dimension, 1)
    check.integer("samples", samples, 20)
    check.integer("repetitions", repetitions, 3)
    check.number("level_probability", level_probability, 0.01, high=0.5)
    check.number("threshold", threshold)
    n_chains = round(samples * level_probability)
    if abs(n_chains - samples * level_probability) > 1e-9 or samples % n_chains:
        raise InvalidParameter(
            f"level_probability: got {level_probability:g} with {samples} samples; needs whole chains of equal length, "
            "such as 0.1 with 1000"
        )
    runs = []
    with Progress("splitting", repetitions * max_levels, progress) as bar:
        for child in np.random.SeedSequence(seed).spawn(repetitions):
            estimator = _Splitting(performance, dimension, threshold, samples, n_chains, np.random.default_rng(child))
            estimator.run(max_levels, bar)
            runs.append(estimator)
    estimates = tuple(estimator.probability for estimator in runs)
    worst = max(runs, key=lambda estimator: estimator.worst.values[0]).worst
    return RareProbability(
        threshold,
        log_mean_interval(estimates, confidence),
        estimates,
        tuple(tuple(estimator.levels) for estimator in runs),
        float(np.sqrt(np.mean([sum(level.variation**2 for level in estimator.levels) for estimator in runs]))),
        sum(estimator.n_runs for estimator in runs),
        worst.points[0],
        int(worst.seeds[0]),
    )


def log_mean_interval(estimates: tuple[float, ...], confidence: float = CONFIDENCE) -> Interval:
    """Return the mean of positive estimates, with the interval of Student's t for its logarithm.

    p̄ exp(± t s / (p̄ √r)),    s the standard deviation of the r estimates
    """
    from scipy.stats import t

    values = np.asarray(estimates)
    mean = float(values.mean())
    if mean == 0:
        return Interval(0.0, 0.0, 1.0)
    half = float(t.ppf((1 + confidence) / 2, values.size - 1) * values.std(ddof=1) / (mean * np.sqrt(values.size)))
    return Interval(mean, mean * float(np.exp(-half)), min(mean * float(np.exp(half)), 1.0))


class _Splitting:
    """One estimate."""

    def __init__(
        self,
        performance: Performance,
        dimension: int,
        threshold: float,
        samples: int,
        n_chains: int,
        rng: np.random.Generator,
    ):
        self.performance = performance
        self.dimension = dimension
        self.threshold = threshold
        self.samples = samples
        self.n_chains = n_chains
        self.rng = rng
        self.step_scale = 0.6
        self.n_runs = 0
        self.levels: list[SplittingLevel] = []

    @property
    def probability(self) -> float:
        """Product of the probabilities of all levels."""
        return float(np.prod([level.probability for level in self.levels]))

    def run(self, max_levels: int, bar: Progress) -> None:
        """Go from level to level until the threshold is reached."""
        sample = self._evaluate(self.rng.standard_normal((self.samples, self.dimension)), self._seeds(self.samples))
        chains, acceptance = None, 1.0
        while True:
            bar.advance()
            worst = sample.at(np.array([np.argmax(sample.values)]))
            self.worst = worst if not self.levels or worst.values[0] > self.worst.values[0] else self.worst
            level = min(float(np.sort(sample.values)[-self.n_chains]), self.threshold)
            above = sample.values >= level
            share = float(np.mean(above))
            self.levels.append(SplittingLevel(level, share, acceptance, self._variation(above, chains)))
            if level >= self.threshold:
                return
            if share == 1.0:
                raise NotConverged(
                    f"levels: all {self.samples} runs of level {len(self.levels)} have {level:.6g} or more, and none "
                    f"reaches {self.threshold:.6g}; use a performance that tells more runs from each other"
                )
            if len(self.levels) >= max_levels:
                raise NotConverged(
                    f"max_levels: got {max_levels}; the last level is {level:.6g} of {self.threshold:.6g}, at a "
                    f"probability of {self.probability:.2g}; raise max_levels, or take the event as less likely"
                )
            sample, chains, acceptance = self._next(sample.at(self._starts(above)), level)

    def _starts(self, above: Array) -> Array:
        """Return the runs at which the chains begin, all different; ties leave a choice."""
        return self.rng.permutation(np.flatnonzero(above))[: self.n_chains]

    def _next(self, starts: _Sample, level: float) -> tuple[_Sample, Array, float]:
        """Return the runs of the chains above a level, with the number of each chain, and the share of steps taken."""
        length = self.samples // self.n_chains
        groups = np.array_split(
            np.arange(self.n_chains), int(np.clip(self.n_chains // CHAINS_PER_GROUP, 1, MAX_ADAPTATIONS))
        )
        parts: list[_Sample] = []
        numbers: list[Array] = []
        taken = []
        for count, group in enumerate(groups, 1):
            current = starts.at(group)
            parts.append(current)
            numbers.append(group)
            accepted = 0
            for _ in range(length - 1):
                current, moved = self._step(current, level)
                parts.append(current)
                numbers.append(group)
                accepted += moved
            taken.append(accepted / max(len(group) * (length - 1), 1))
            change = (taken[-1] - TARGET_ACCEPTANCE) / np.sqrt(count)
            self.step_scale = float(np.clip(self.step_scale * np.exp(change), 0.01, 1.0))
        together = _Sample(
            np.concatenate([part.points for part in parts]),
            np.concatenate([part.seeds for part in parts]),
            np.concatenate([part.values for part in parts]),
        )
        return together, np.concatenate(numbers), float(np.mean(taken))

    def _step(self, current: _Sample, level: float) -> tuple[_Sample, int]:
        """Return the runs after one step of each chain, and how many moved."""
        count = len(current.values)
        scale = self.step_scale
        points = np.sqrt(1 - scale**2) * current.points + scale * self.rng.standard_normal(current.points.shape)
        seeds = np.where(self.rng.random(count) < NEW_SEED, self._seeds(count), current.seeds)
        proposed = self._evaluate(points, seeds)
        moves = proposed.values >= level
        return (
            _Sample(
                np.where(moves[:, None], proposed.points, current.points),
                np.where(moves, proposed.seeds, current.seeds),
                np.where(moves, proposed.values, current.values),
            ),
            int(moves.sum()),
        )

    def _variation(self, above: Array, chains: Array | None) -> float:
        """Return the coefficient of variation of a level's share: √((1 − p)(1 + γ)/(p N)).

        γ sums the autocorrelation of the indicator along the chains, by Au and Beck.
        """
        share = float(np.mean(above))
        if share in (0.0, 1.0):
            return 0.0
        gamma = 0.0
        if chains is not None:
            rows = above[np.argsort(chains, kind="stable")].reshape(self.n_chains, -1).astype(float)
            length = rows.shape[1]
            for lag in range(1, length):
                covariance = float(np.mean(rows[:, :-lag] * rows[:, lag:])) - share**2
                gamma += 2 * (1 - lag / length) * covariance / (share * (1 - share))
        return float(np.sqrt((1 - share) * max(1 + gamma, 0.0) / (share * above.size)))

    def _seeds(self, count: int) -> Array:
        return self.rng.integers(0, 2**63 - 1, count)

    def _evaluate(self, points: Array, seeds: Array) -> _Sample:
        """Run all points."""
        values = np.asarray(self.performance(points, seeds), dtype=float)
        self.n_runs += len(values)
        if values.shape != seeds.shape or not np.all(np.isfinite(values)):
            raise InvalidParameter(
                f"performance: returned shape {values.shape} for {len(seeds)} points, or numbers that are not finite; "
                "needs one finite value per point"
            )
        return _Sample(points, seeds, values)
