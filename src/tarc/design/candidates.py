"""What loops are to be had: rejection of disturbances against torque noise, for a spread of inertia to be borne."""

import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np

from tarc.analysis.linearise import Channel, decoupled_channels
from tarc.analysis.stability import disturbance_to_error, noise_to_torque
from tarc.analysis.uncertain_loop import FrequencyResponses, UncertainLoop
from tarc.certificates.iqc import best_multiplier
from tarc.core import validation as check
from tarc.design.robustness import RobustnessSpec, radius_ratio_of, spread_of
from tarc.estimators.algebraic import Algebraic
from tarc.laws.tdc import TDC
from tarc.numerics.norms import h2_norm

WINDOWS = (3, 4, 5, 6, 8, 10, 12, 15, 20, 25, 30)
"""Windows tried, in periods."""
NATURAL_FREQUENCIES = (2.0, 3.0, 4.0, 5.0, 7.0, 10.0, 14.0, 20.0, 28.0, 40.0, 60.0, 90.0, 130.0)
"""Bandwidths tried [rad/s] at a period of 1 ms; at another they scale with the rate."""
MAX_CENTRES = 6
"""Most centres at which a loop is looked at on the first pass."""
MAX_CENTRES_EXHAUSTIVE = 16
"""And on a second."""
CENTRES = np.geomspace(0.006, 1.5, 48)
"""Centres of the ball tried: inertia ratios."""
FIRST_CENTRE, LOWER_CENTRE, NEIGHBOUR_CENTRES = 0.7, 0.4, (0.9, 0.55)
"""For a robot of bounded speed: where centres are tried, on the logarithmic scale between those that constant ratios
allow. First one, then where it bears the robot a lower one, of less noise, and else those beside it."""
EXHAUSTIVE_CENTRES = 0.7, 0.55, 0.4, 0.85
"""And on a second pass."""
FREQUENCY_COUNT = 200
"""At which a loop is looked at: few, since the choice is certified afterwards."""
RADIUS_TOLERANCE = 1.06
"""How near to the widest ball the search for one ends."""
MAX_LIGHTER_WEIGHTS = 2
"""Most weights of the position at which a centre is looked at."""
MIN_MARGIN_FOR_MIDPOINT = -0.15
"""Room at which the place between is tried too."""
MAX_FEASIBLE_PER_WINDOW = 2
"""And after how many natural frequencies that bear it, from the highest down, the lower ones are not looked at."""
MIN_MARGIN_FOR_NEIGHBOURS = -0.35
"""Room at which no other centre is tried."""
MAX_STABILITY_TESTS = 5
"""Centres at which a loop is looked at for any speed, where what counts is a bounded one."""


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A loop: its law but for the scale of M̂, and what it can do.

    With X the shape of M̂, scaled so that the eigenvalues of M(q)⁻¹X lie between 1 and the spread, M̂ = scale X.

    Attributes
    ----------
    window, delay
        [periods].
    degree, synchronised, natural_frequency, damping_ratio
        As in the laws; natural frequency in [rad/s].
    period
        [s].
    computation_delay
        Periods between a measurement and its torque, which the law knows of.
    slope
        Of a robust term that the ball bears beside the spread [1/s²].
    spread
        Greatest over least eigenvalue of M(q)⁻¹X that it was looked at for.
    reach
        The widest spread that the loop bears.
    scale
        Of the shape, in the middle of those that bear the spread; zero where none does.
    room
        The spread that the ball bears at this scale over the one asked for, less 1.
    noise
        Torque over X for white measurement noise, both as root mean squares [1/s²]: torque noise = noise · ‖X_i‖ · σ.
    error
        Root of the integral of the squared error that a step of torque leaves, over X⁻¹ [s^2.5]: the RMS error [rad]
        where one step of 1 N m comes a second, for an X of 1 kg m². The worst over the spread.
    """

    window: int
    degree: int
    delay: int
    synchronised: bool
    natural_frequency: float
    damping_ratio: float
    period: float
    computation_delay: int = 0
    robust_slope: float = 0.0
    required_spread: float = 1.0
    max_spread: float = 0.0
    inertia_scale: float = 0.0
    spread_margin: float = 0.0
    noise: float = np.inf
    error: float = np.inf

    @property
    def feasible(self) -> bool:
        """Whether it bears the spread."""
        return self.inertia_scale > 0

    @property
    def estimator(self) -> Algebraic:
        """The estimator."""
        return Algebraic(window=self.window * self.period, degree=self.degree)

    def law_options(self) -> dict[str, Any]:
        """What a law on time-delay estimation takes, but for the inertia and the estimator."""
        late = None if self.delay == 1 else self.delay * self.period
        return {
            "natural_frequency": self.natural_frequency,
            "damping_ratio": self.damping_ratio,
            "period": self.period,
            "synchronised": self.synchronised,
            "delay": late,
            "actuation_delay": self.computation_delay,
        }

    def channel(self) -> Channel:
        """The loop of one joint of unit inertia."""
        return decoupled_channels(
            TDC(inertia=1.0, estimator=self.estimator, **self.law_options()), self.computation_delay
        )[0]


def enumerate_candidates(
    period: float,
    *,
    natural_frequencies: Iterable[float] | None = None,
    windows: Iterable[int] | None = None,
    degrees: Iterable[int] = (2, 3),
    delays: Iterable[int] | None = None,
    synchronised: Iterable[bool] = (False, True),
    damping_ratio: float = 1.0,
    computation_delay: int = 0,
) -> list[Candidate]:
    """All combinations that make a law, not yet looked at.

    Where no delays are given, literal laws take one period, the shortest, and two where the computation delay is odd:
    one would leave a torque that alternates from period to period undamped. Synchronised laws have that of the window.
    """
    check.number("damping_ratio", damping_ratio, 0, strict=True)
    if delays is None:
        delays = (1, 2) if computation_delay % 2 else (1,)
    rate = 1e-3 / check.number("period", period, 0, strict=True)
    speeds = [rate * one for one in NATURAL_FREQUENCIES] if natural_frequencies is None else list(natural_frequencies)
    windows = WINDOWS if windows is None else list(windows)
    return [
        Candidate(
            window=window,
            degree=degree,
            delay=delay,
            synchronised=both,
            natural_frequency=float(speed),
            damping_ratio=damping_ratio,
            period=period,
            computation_delay=computation_delay,
        )
        for both in synchronised
        for delay in delays
        if delay == 1 or not both
        for degree in degrees
        for window in windows
        if window >= degree
        for speed in speeds
    ]


def assess_candidates(
    candidates: Sequence[Candidate],
    spec: RobustnessSpec,
    *,
    slope_ratio: float = 0.0,
    min_margin: float = 0.1,
    exhaustive: bool = False,
    done: Callable[[], object] = lambda: None,
) -> list[Candidate]:
    """What each candidate can do; those that bear the robot come once for each scale of M̂ worth having.

    A loop bears the robot at the scale c if the robust ball about c(1 + spread)/2 has the share of it as radius that
    the robot demands for one of the weights, which is η/c there, next to a robust term of any slope up to slope_share ·
    bandwidth². The ball is that of `tarc.certificates.certify_robot`, here on a grid of frequencies; the choice is
    certified
    afterwards. For a robot of bounded speed, whose balls take longer, the lower natural frequencies of a loop are
    not looked at
    where some higher ones bear the robot, nor are those that a shorter window does not bear.

    Parameters
    ----------
    trials
        From `candidates`.
    demand
        What the robot asks for.
    slope_share
        Slope of the robust term over the stiffness K1.
    room
        By which share the spread that it bears must exceed the one asked for.
    closely
        Try every scale of M̂ and give all that do, instead of a few.
    done
        Called after each candidate, to show progress.
    """
    quick = np.isfinite(spec.max_rate) and not exhaustive
    order = list(range(len(candidates)))
    if quick:
        order.sort(key=lambda i: (candidates[i].window, -candidates[i].natural_frequency))
    found: dict[int, list[Candidate]] = {}
    bearing: dict[tuple, dict[int, list[Candidate]]] = {}
    for i in order:
        one = candidates[i]
        windows = bearing.setdefault((one.degree, one.delay, one.synchronised), {})
        able = windows.setdefault(one.window, [])
        shorter = [most[0] for window, most in windows.items() if window < one.window and most]
        alike = able[-1] if len(able) >= MAX_FEASIBLE_PER_WINDOW else None
        if shorter and one.natural_frequency > shorter[-1].natural_frequency:  # what a shorter window does not bear
            alike = replace(shorter[-1], max_spread=spec.spread)
        if quick and alike is not None:
            slope = slope_ratio * one.natural_frequency**2
            found[i] = [replace(one, robust_slope=slope, required_spread=spec.spread, max_spread=alike.max_spread)]
        else:
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")  # what rounding spoils is thrown out below, not trusted
                found[i] = _assess(one, spec, slope_ratio, min_margin, exhaustive)
            if found[i] and found[i][0].feasible:
                able.append(found[i][0])
        done()
    return [one for i in range(len(candidates)) for one in found[i]]


def _assess(one: Candidate, demand: RobustnessSpec, slope_share: float, room: float, closely: bool) -> list[Candidate]:
    channel = one.channel()
    spread = demand.spread
    needed = np.array(
        [radius_ratio_of(spread_of(share) * (1 + room)) if share < 1 else np.inf for share in demand.radius_ratios]
    )
    slope = slope_share * one.natural_frequency**2
    parts = UncertainLoop.from_channel(
        channel, slope, intersample=True, lead_periods=demand.velocity_weight / one.period
    )
    responses = FrequencyResponses(parts, count=FREQUENCY_COUNT)
    free = 1 - CENTRES[:, None] * responses.from_torque[:, 0]
    plain = np.min(np.abs(free) / np.linalg.norm(responses.from_mismatch[:, 0], axis=1), axis=1) / CENTRES
    loop, without = (
        LoopMargins(parts, responses, demand, needed, one.period),
        UncertainLoop.from_channel(channel, 0.0, intersample=True),
    )
    slow = np.isfinite(demand.max_rate)
    plain = (
        np.array([max_stable_radius_ratio(without, CENTRES, plain)])
        if slow
        else stable_radius_ratios(without, CENTRES, plain)
    )
    one = replace(one, robust_slope=slope, required_spread=spread, max_spread=spread_of(float(np.max(plain))))
    if slow:
        rooms = loop.rate_bounded_margins(room, closely)
        widest = max(rooms.values(), default=-1.0)
        one = replace(one, max_spread=max(one.max_spread, (1 + widest) * spread))
        rooms = {centre: spare for centre, spare in rooms.items() if spare >= room}
    else:
        rooms = loop.margins(CENTRES[plain >= needed.min()], closely)
    able = sorted(rooms)
    stable = stable_radius_ratios(parts, np.array(able), np.ones(len(able))) if able else np.zeros(0)
    able = [centre for centre, fine in zip(able, stable, strict=True) if fine]
    result = []
    if not closely and able:
        able = [able[i] for i in sorted({0, len(able) // 2, len(able) - 1})]
    for centre in able:
        scale = 2 * centre / (spread + 1)
        ratios = scale, scale * spread**0.5, scale * spread
        noise = scale * max(h2_norm(*noise_to_torque(channel, ratio)) for ratio in ratios)
        error = max(ratio / scale * step_error(channel, ratio) for ratio in ratios)
        if np.isfinite(noise) and np.isfinite(error):
            result.append(replace(one, inertia_scale=scale, spread_margin=rooms[centre], noise=noise, error=error))
    return result or [one]


@dataclass(frozen=True)
class LoopMargins:
    """A loop against a demand: at which centres of the ball it bears the robot, and with how much room."""

    parts: UncertainLoop
    responses: FrequencyResponses
    spec: RobustnessSpec
    min_radius_ratios: np.ndarray
    period: float

    def weight(self, number: int, centre: float) -> float:
        """η of the demand at this centre."""
        return float(self.spec.stiffness_weights[number] * (1 + self.spec.spread) / (2 * centre))

    def margins(self, centres: np.ndarray, closely: bool) -> dict[float, float]:
        """By centre, of those that bear the robot however fast it moves."""
        most = MAX_CENTRES_EXHAUSTIVE if closely else MAX_CENTRES
        if len(centres) > most:
            centres = centres[np.linspace(0, len(centres) - 1, most).round().astype(int)]
        found = {}
        for centre in centres:
            enough, spare = False, -1.0
            for number, (share, least) in enumerate(zip(self.spec.radius_ratios, self.min_radius_ratios, strict=True)):
                borne = self.responses.best_scale(float(centre), self.weight(number, centre))[1] / centre
                now = spread_of(borne) / spread_of(float(share)) - 1
                past = now < spare
                enough, spare = enough or borne >= least, max(spare, now)
                if enough and (past or not closely):  # the first weight that does, or all up to the best
                    break
            if enough:
                found[float(centre)] = spare
        return found

    def rate_bounded_margins(self, room: float, closely: bool) -> dict[float, float]:
        """By centre, within the speed, of those that were tried; enough room, or less, and not how much exactly."""
        low, high = self.constant_ratio_interval()
        least = float(self.min_radius_ratios.min())
        low, high = low / (1 - least) if least < 1 else np.inf, high / (1 + least)
        if not low < high:
            return {}
        found: dict[float, float] = {}

        def look(place: float) -> float:
            found[place] = self.rate_bounded_margin(float(low * (high / low) ** place))
            return found[place]

        if closely:
            for place in EXHAUSTIVE_CENTRES:
                look(place)
        elif look(FIRST_CENTRE) >= room:
            look(LOWER_CENTRE)
        elif found[FIRST_CENTRE] > MIN_MARGIN_FOR_NEIGHBOURS:
            best = max(NEIGHBOUR_CENTRES, key=look)
            if MIN_MARGIN_FOR_MIDPOINT < found[best] < room:
                look((FIRST_CENTRE + best) / 2)
        return {float(low * (high / low) ** place): spare for place, spare in found.items()}

    def rate_bounded_margin(self, centre: float) -> float:
        """The room at a centre, with the weight that serves best at any speed, or a lighter one while that is better.

        Where it is not enough, a bound on it.
        """
        able = [int(number) for number in np.flatnonzero(self.min_radius_ratios < 1)]
        if not able or np.abs(np.linalg.eigvals(self.parts.closed_loop(centre)[0])).max() >= 1:
            return -1.0
        shares = [float(one) for one in self.spec.radius_ratios[able]]

        @cache
        def borne(i: int) -> float:
            return self.responses.best_scale(centre, self.weight(able[i], centre))[1] / centre

        def room(i: int) -> float:
            return spread_of(borne(i)) / spread_of(shares[i]) - 1

        first, before = len(able) // 2, -1
        while first != before:  # it rises to one best weight and falls from there
            before = first
            first = max((i for i in (first, first - 1, first + 1) if 0 <= i < len(able)), key=room)
        spare = -1.0
        for i in range(first, max(first - MAX_LIGHTER_WEIGHTS, -1), -1):
            number, least = able[i], float(self.min_radius_ratios[able[i]])
            if borne(i) >= least:  # at any speed
                return room(i)
            _, radius, bound = best_multiplier(
                self.parts,
                centre,
                self.spec.max_rate * self.period * (1 + self.spec.spread) / (2 * centre),
                weight=self.weight(number, centre),
                stiffness=self.spec.stiffness,
                responses=self.responses,
                enough=1.0001 * least * centre,
                close=RADIUS_TOLERANCE,
            )
            if radius / centre >= least:
                return spread_of(min(radius / centre, 1 - 1e-9)) / spread_of(shares[i]) - 1
            now = spread_of(min(bound / centre, (1 - 1e-6) * least)) / spread_of(shares[i]) - 1
            if now < spare:
                break
            spare = now
        return spare

    def constant_ratio_interval(self) -> tuple[float, float]:
        """The widest interval of constant ratios with which the loop is stable, up to the grid of frequencies."""
        held = self.responses.from_torque[:, 0]
        change = np.flatnonzero(np.diff(np.sign(held.imag)))
        part = held.imag[change] / (held.imag[change] - held.imag[change + 1])
        real = held.real[change] + part * (held.real[change + 1] - held.real[change])
        edges = np.sort([*(1 / real[real > 0]), CENTRES[0] / 100, 10 * CENTRES[-1]])
        edges = edges[(edges >= CENTRES[0] / 100) & (edges <= 10 * CENTRES[-1])]
        best = 1.0, 1.0
        for low, high in pairwise(edges):
            if high / low > best[1] / best[0]:
                stable = np.abs(np.linalg.eigvals(self.parts.closed_loop(float((low * high) ** 0.5))[0])).max() < 1
                best = (float(low), float(high)) if stable else best
        return best


def stable_radius_ratios(parts: UncertainLoop, centres: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Radius of the ball over its centre, zero where it is small or the loop not stable."""
    result = np.where(shares > 0.2, shares, 0.0)
    worth = np.flatnonzero(result)
    if len(worth):
        loops = np.stack([parts.closed_loop(float(centre))[0] for centre in centres[worth]])
        result[worth[np.abs(np.linalg.eigvals(loops)).max(axis=1) >= 1]] = 0.0
    return result


def max_stable_radius_ratio(parts: UncertainLoop, centres: np.ndarray, shares: np.ndarray) -> float:
    """The largest of `_where_stable`, of the few that are looked at."""
    for i in np.argsort(shares)[::-1][:MAX_STABILITY_TESTS]:
        if shares[i] > 0.2 and np.abs(np.linalg.eigvals(parts.closed_loop(float(centres[i]))[0])).max() < 1:
            return float(shares[i])
    return 0.0


def step_error(channel: Channel, ratio: float) -> float:
    """Root of the integral of the squared error after a step of 1 rad/s² [rad s^½]: (T Σ e_k²)^½.

    The step's response settles at x∞ = (I − A)⁻¹B, with no error; e_k = −C Aᵏ x∞.
    """
    A, B, C, D = disturbance_to_error(channel, ratio)
    settled = np.linalg.solve(np.eye(len(A)) - A, B)
    return float(np.sqrt(channel.period) * h2_norm(A, settled, C, 0 * D))


def peak_error(channel: Channel, ratio: float, horizon: int = 4000) -> float:
    """Greatest error after a step of 1 rad/s² [rad], within so many periods."""
    A, B, C, _ = disturbance_to_error(channel, ratio)
    state, greatest = np.zeros((len(A), 1)), 0.0
    for _ in range(horizon):
        state = A @ state + B
        now = abs((C @ state).item())
        greatest = max(greatest, now)
        if now < 0.05 * greatest:
            break
    return greatest


def pareto_front(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Those that bear the spread and that no other beats in both noise and error, by noise."""
    best, result = np.inf, []
    for one in sorted((one for one in candidates if one.feasible), key=lambda one: (one.noise, one.error)):
        if one.error < best:
            best = one.error
            result.append(one)
    return result
