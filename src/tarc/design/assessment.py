"""Noise, error and tolerated spread of loops, for the robustness that a robot requires."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np

from tarc.analysis.uncertain_loop import FrequencyResponses, UncertainLoop
from tarc.certificates.iqc import best_multiplier
from tarc.design.candidates import Candidate, noise_and_change, step_error
from tarc.design.robustness import RobustnessSpec, radius_ratio_of, spread_of

CENTRES = np.geomspace(0.006, 1.5, 48)
"""Inertia ratios that are tried as the centre of the ball."""
MAX_CENTRES = 6
"""Largest number of centres per loop."""
MAX_CENTRES_EXHAUSTIVE = 16
"""Largest number of centres per loop in an exhaustive assessment."""
FIRST_CENTRE = 0.7
"""First centre for a bounded rate, on the logarithmic scale between those that constant ratios admit."""
LOWER_CENTRE = 0.4
"""Centre of less noise, tried where the first one is feasible."""
NEIGHBOUR_CENTRES = (0.9, 0.55)
"""Centres tried where the first one is not feasible."""
EXHAUSTIVE_CENTRES = (0.7, 0.55, 0.4, 0.85)
"""Centres of an exhaustive assessment, on the same scale."""
MIN_MARGIN_FOR_NEIGHBOURS = -0.35
"""Margin of the first centre below which no other is tried."""
MIN_MARGIN_FOR_MIDPOINT = -0.15
"""Margin of the better neighbour above which the centre between it and the first one is tried."""
FREQUENCY_COUNT = 200
"""Number of frequencies. It is small since the chosen loop is certified afterwards."""
RADIUS_TOLERANCE = 1.06
"""Largest factor from the radius found to the largest one, where the search for it ends."""
MAX_LIGHTER_WEIGHTS = 2
"""Largest number of stiffness weights that are tried per centre, for a bounded rate."""
MAX_FEASIBLE_PER_WINDOW = 2
"""Number of feasible loops of one window after which its lower natural frequencies are not assessed."""
MAX_STABILITY_TESTS = 5
"""Largest number of centres that are tested for stability at any rate, where the rate is bounded."""
MIN_RADIUS_RATIO = 0.2
"""Radius over centre below which a loop counts as tolerating no spread."""


def assess_candidates(
    candidates: Sequence[Candidate],
    spec: RobustnessSpec,
    *,
    slope_ratio: float = 0.0,
    min_margin: float = 0.1,
    exhaustive: bool = False,
    done: Callable[[], object] = lambda: None,
) -> list[Candidate]:
    """Return the loops with noise, error and tolerated spread; a feasible one once per useful scale of M̂.

    A loop is feasible at the scale c if the radius of its ball about ρ = c (1 + spread)/2 is at least the radius ratio
    times ρ. One of the stiffness weights η/c suffices, but for every slope of a robust term up to
    slope_ratio · ωn². The ball is that of `tarc.certificates.certify_robot` on a grid of frequencies; the chosen loop
    is certified afterwards.

    For a bounded rate the balls take longer. Then the lower natural frequencies of a window are not assessed where
    higher ones are feasible. Nor are those above the feasible ones of a shorter window.

    Parameters
    ----------
    candidates
        As `enumerate_candidates` gives them.
    spec
        The robustness that the robot requires.
    slope_ratio
        Largest slope of the robust term over the position gain K1.
    min_margin
        Least margin of the tolerated spread over the required one.
    exhaustive
        Try every scale of M̂ and return all feasible ones, instead of up to three.
    done
        Called after each candidate, to show progress.
    """
    skips = np.isfinite(spec.max_rate) and not exhaustive
    order = list(range(len(candidates)))
    if skips:
        order.sort(key=lambda i: (candidates[i].window, -candidates[i].natural_frequency))
    assessed: dict[int, list[Candidate]] = {}
    feasible = FeasibleLoops({})
    for i in order:
        candidate = candidates[i]
        max_spread = feasible.known_spread(candidate, spec.spread) if skips else None
        if max_spread is not None:
            slope = slope_ratio * candidate.natural_frequency**2
            assessed[i] = [replace(candidate, robust_slope=slope, required_spread=spec.spread, max_spread=max_spread)]
        else:
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")  # loops that rounding spoils are dropped below
                assessed[i] = _assess(candidate, spec, slope_ratio, min_margin, exhaustive)
            feasible.add(assessed[i])
        done()
    return [loop for i in range(len(candidates)) for loop in assessed[i]]


@dataclass(frozen=True)
class FeasibleLoops:
    """Feasible loops by kind and window, from short windows and high natural frequencies on."""

    by_kind: dict[tuple[int, int, bool], dict[int, list[Candidate]]]

    def add(self, assessed: Sequence[Candidate]) -> None:
        """Add a loop, where it is feasible."""
        if assessed and assessed[0].feasible:
            self._windows(assessed[0]).setdefault(assessed[0].window, []).append(assessed[0])

    def known_spread(self, candidate: Candidate, spread: float) -> float | None:
        """Return the tolerated spread of a loop that need not be assessed; None for one that must be."""
        windows = self._windows(candidate)
        shorter = [loops[0] for window, loops in windows.items() if window < candidate.window and loops]
        if shorter and candidate.natural_frequency > shorter[-1].natural_frequency:
            return spread
        same = windows.get(candidate.window, [])
        return same[-1].max_spread if len(same) >= MAX_FEASIBLE_PER_WINDOW else None

    def _windows(self, loop: Candidate) -> dict[int, list[Candidate]]:
        return self.by_kind.setdefault((loop.degree, loop.delay, loop.synchronised), {})


def _assess(
    candidate: Candidate, spec: RobustnessSpec, slope_ratio: float, min_margin: float, exhaustive: bool
) -> list[Candidate]:
    """Return a loop once per useful scale of M̂, or once without a scale where it is not feasible."""
    slope = slope_ratio * candidate.natural_frequency**2
    margins = LoopMargins.from_candidate(candidate, spec, slope, min_margin)
    radius_ratios = margins.radius_ratios_without_slope(candidate)
    max_spread = spread_of(float(np.max(radius_ratios)))
    if margins.is_rate_bounded:
        by_centre = margins.rate_bounded_margins(min_margin, exhaustive)
        max_spread = max(max_spread, (1 + max(by_centre.values(), default=-1.0)) * spec.spread)
        by_centre = {centre: margin for centre, margin in by_centre.items() if margin >= min_margin}
    else:
        by_centre = margins.margins(CENTRES[radius_ratios >= margins.min_radius_ratios.min()], exhaustive)
    candidate = replace(candidate, robust_slope=slope, required_spread=spec.spread, max_spread=max_spread)
    centres = sorted(by_centre)
    stable = stable_radius_ratios(margins.loop, np.array(centres), np.ones(len(centres)))
    centres = [centre for centre, ratio in zip(centres, stable, strict=True) if ratio]
    if not exhaustive and centres:
        centres = [centres[i] for i in sorted({0, len(centres) // 2, len(centres) - 1})]
    scaled = [at_scale(candidate, 2 * centre / (spec.spread + 1), by_centre[centre]) for centre in centres]
    return [loop for loop in scaled if np.isfinite(loop.noise) and np.isfinite(loop.error)] or [candidate]


def at_scale(candidate: Candidate, scale: float, margin: float) -> Candidate:
    """Return a loop at a scale of M̂, with its margin, noise, torque change and error."""
    channel, spread = candidate.channel(), candidate.required_spread
    ratios = scale, scale * spread**0.5, scale * spread
    noises, changes = zip(*(noise_and_change(channel, ratio) for ratio in ratios), strict=True)
    error = max(ratio / scale * step_error(channel, ratio) for ratio in ratios)
    return replace(
        candidate,
        inertia_scale=scale,
        spread_margin=margin,
        noise=scale * max(noises),
        change=scale * max(changes),
        error=error,
    )


@dataclass(frozen=True)
class LoopMargins:
    """Margins of a loop over the robustness that a robot requires, by the centre of the ball.

    Attributes
    ----------
    loop, responses
        The loop with its robust term, and its frequency responses.
    spec
        The robustness that the robot requires.
    min_radius_ratios
        Least radius over centre for each stiffness weight, margin included.
    period
        Control period [s].
    """

    loop: UncertainLoop
    responses: FrequencyResponses
    spec: RobustnessSpec
    min_radius_ratios: np.ndarray
    period: float

    @classmethod
    def from_candidate(
        cls, candidate: Candidate, spec: RobustnessSpec, slope: float, min_margin: float
    ) -> "LoopMargins":
        """Return the margins of a loop with a robust term of this slope [1/s²]."""
        loop = UncertainLoop.from_channel(
            candidate.channel(), slope, intersample=True, lead_periods=spec.velocity_weight / candidate.period
        )
        needed = [
            radius_ratio_of(spread_of(ratio) * (1 + min_margin)) if ratio < 1 else np.inf
            for ratio in spec.radius_ratios
        ]
        responses = FrequencyResponses(loop, count=FREQUENCY_COUNT)
        return cls(loop, responses, spec, np.array(needed), candidate.period)

    @property
    def is_rate_bounded(self) -> bool:
        """Whether the robot's inertia changes at a bounded rate."""
        return bool(np.isfinite(self.spec.max_rate))

    def radius_ratios_without_slope(self, candidate: Candidate) -> np.ndarray:
        """Return radius over centre at any rate for `CENTRES`, zero where unstable; one number for a bounded rate."""
        without = UncertainLoop.from_channel(candidate.channel(), 0.0, intersample=True)
        return_difference = 1 - CENTRES[:, None] * self.responses.from_torque[:, 0]
        sensitivity = np.linalg.norm(self.responses.from_mismatch[:, 0], axis=1)
        ratios = np.min(np.abs(return_difference) / sensitivity, axis=1) / CENTRES
        if self.is_rate_bounded:
            return np.array([max_stable_radius_ratio(without, CENTRES, ratios)])
        return stable_radius_ratios(without, CENTRES, ratios)

    def margins(self, centres: np.ndarray, exhaustive: bool) -> dict[float, float]:
        """Return the margin at each centre that is feasible at any rate."""
        count = MAX_CENTRES_EXHAUSTIVE if exhaustive else MAX_CENTRES
        if len(centres) > count:
            centres = centres[np.linspace(0, len(centres) - 1, count).round().astype(int)]
        margins = {float(centre): self._margin(float(centre), exhaustive) for centre in centres}
        return {centre: margin for centre, margin in margins.items() if margin is not None}

    def _margin(self, centre: float, exhaustive: bool) -> float | None:
        """Return the margin with the first weight that is feasible, or the best one; None where none is."""
        is_feasible, best = False, -1.0
        for number, needed in enumerate(self.min_radius_ratios):
            ratio = self._radius_ratio(centre, number)
            margin = self._margin_of(ratio, number)
            decreases = margin < best
            is_feasible, best = is_feasible or ratio >= needed, max(best, margin)
            if is_feasible and (decreases or not exhaustive):
                break
        return best if is_feasible else None

    def _weight(self, number: int, centre: float) -> float:
        """Return the stiffness weight η at a centre [1/s²]."""
        return float(self.spec.stiffness_weights[number] * (1 + self.spec.spread) / (2 * centre))

    def _radius_ratio(self, centre: float, number: int) -> float:
        """Return the largest radius over centre at any rate, with one of the weights."""
        return self.responses.best_scale(centre, self._weight(number, centre))[1] / centre

    def _margin_of(self, ratio: float, number: int) -> float:
        """Return the margin of a radius over centre, with one of the weights."""
        return spread_of(ratio) / spread_of(float(self.spec.radius_ratios[number])) - 1

    def rate_bounded_margins(self, min_margin: float, exhaustive: bool) -> dict[float, float]:
        """Return the margins at the centres that are tried, within the robot's rate; they are lower bounds."""
        low, high = self.constant_ratio_interval()
        needed = float(self.min_radius_ratios.min())
        low, high = low / (1 - needed) if needed < 1 else np.inf, high / (1 + needed)
        if not low < high:
            return {}

        def centre_at(place: float) -> float:
            return float(low * (high / low) ** place)

        @cache
        def margin_at(place: float) -> float:
            return self.rate_bounded_margin(centre_at(place))

        places = list(EXHAUSTIVE_CENTRES if exhaustive else (FIRST_CENTRE,))
        if not exhaustive and margin_at(FIRST_CENTRE) >= min_margin:
            places.append(LOWER_CENTRE)
        elif not exhaustive and margin_at(FIRST_CENTRE) > MIN_MARGIN_FOR_NEIGHBOURS:
            places += NEIGHBOUR_CENTRES
            best = max(NEIGHBOUR_CENTRES, key=margin_at)
            if MIN_MARGIN_FOR_MIDPOINT < margin_at(best) < min_margin:
                places.append((FIRST_CENTRE + best) / 2)
        return {centre_at(place): margin_at(place) for place in places}

    def rate_bounded_margin(self, centre: float) -> float:
        """Return the margin at a centre within the robot's rate, or an upper bound where it is not feasible.

        From the weight that is best at any rate, the weights are reduced while the margin grows.
        """
        numbers = [int(number) for number in np.flatnonzero(self.min_radius_ratios < 1)]
        if not numbers or not _is_stable(self.loop, centre):
            return -1.0

        @cache
        def margin_at_any_rate(i: int) -> float:
            return self._margin_of(self._radius_ratio(centre, numbers[i]), numbers[i])

        best, margin = _best_index(margin_at_any_rate, len(numbers)), -1.0
        for i in range(best, max(best - MAX_LIGHTER_WEIGHTS, -1), -1):
            number, needed = numbers[i], float(self.min_radius_ratios[numbers[i]])
            if self._radius_ratio(centre, number) >= needed:
                return margin_at_any_rate(i)
            radius, bound = self._rate_bounded_radius(centre, number)
            if radius / centre >= needed:
                return self._margin_of(min(radius / centre, 1 - 1e-9), number)
            previous, margin = margin, self._margin_of(min(bound / centre, (1 - 1e-6) * needed), number)
            if margin < previous:
                return previous
        return margin

    def _rate_bounded_radius(self, centre: float, number: int) -> tuple[float, float]:
        """Return the radius of the ball within the robot's rate, and an upper bound of it."""
        _, radius, bound = best_multiplier(
            self.loop,
            centre,
            self.spec.max_rate * self.period * (1 + self.spec.spread) / (2 * centre),
            position_weight=self._weight(number, centre),
            stiffness=self.spec.stiffness,
            responses=self.responses,
            enough=1.0001 * float(self.min_radius_ratios[number]) * centre,
            close=RADIUS_TOLERANCE,
        )
        return radius, bound

    def constant_ratio_interval(self) -> tuple[float, float]:
        """Return the widest stable interval of constant inertia ratios, up to the grid of frequencies."""
        response = self.responses.from_torque[:, 0]
        change = np.flatnonzero(np.diff(np.sign(response.imag)))
        part = response.imag[change] / (response.imag[change] - response.imag[change + 1])
        real = response.real[change] + part * (response.real[change + 1] - response.real[change])
        lowest, highest = CENTRES[0] / 100, 10 * CENTRES[-1]
        edges = np.sort([*(1 / real[real > 0]), lowest, highest])
        edges = edges[(edges >= lowest) & (edges <= highest)]
        widest = 1.0, 1.0
        for low, high in pairwise(edges):
            is_wider = high / low > widest[1] / widest[0]
            if is_wider and _is_stable(self.loop, float((low * high) ** 0.5)):
                widest = float(low), float(high)
        return widest


def _best_index(value: Callable[[int], float], count: int) -> int:
    """Return the index of the largest value; the values rise to it and fall from there."""
    best, previous = count // 2, -1
    while best != previous:
        previous = best
        best = max((i for i in (best, best - 1, best + 1) if 0 <= i < count), key=value)
    return best


def _is_stable(loop: UncertainLoop, ratio: float) -> bool:
    return bool(np.abs(np.linalg.eigvals(loop.closed_loop(ratio)[0])).max() < 1)


def stable_radius_ratios(loop: UncertainLoop, centres: np.ndarray, ratios: np.ndarray) -> np.ndarray:
    """Return radius over centre, zero where it is small or the loop is not stable at the centre."""
    result = np.where(ratios > MIN_RADIUS_RATIO, ratios, 0.0)
    large = np.flatnonzero(result)
    if len(large):
        loops = np.stack([loop.closed_loop(float(centre))[0] for centre in centres[large]])
        result[large[np.abs(np.linalg.eigvals(loops)).max(axis=1) >= 1]] = 0.0
    return result


def max_stable_radius_ratio(loop: UncertainLoop, centres: np.ndarray, ratios: np.ndarray) -> float:
    """Return the largest radius over centre with a stable loop, of the `MAX_STABILITY_TESTS` largest; zero for none."""
    for i in np.argsort(ratios)[::-1][:MAX_STABILITY_TESTS]:
        if ratios[i] > MIN_RADIUS_RATIO and _is_stable(loop, float(centres[i])):
            return float(ratios[i])
    return 0.0
