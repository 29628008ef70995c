"""What loops are to be had: rejection of disturbances against torque noise, for a spread of inertia to be borne."""

import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from tarc import check
from tarc.certificates.linear import Channel, decouple
from tarc.certificates.loop import from_disturbance, from_noise
from tarc.certificates.mismatch import Responses, parts_of, system
from tarc.certificates.norms import h2_norm
from tarc.certificates.postures import joint_norms
from tarc.certificates.slow import best_multiplier
from tarc.errors import TarcError
from tarc.estimators.algebraic import Algebraic
from tarc.laws.tdc import TDC

WINDOWS = (3, 4, 5, 6, 8, 10, 12, 15, 20, 25, 30)
"""Windows tried, in periods."""
BANDWIDTHS = (2.0, 3.0, 4.0, 5.0, 7.0, 10.0, 14.0, 20.0, 28.0, 40.0, 60.0, 90.0, 130.0)
"""Bandwidths tried [rad/s] at a period of 1 ms; at another they scale with the rate."""
TRIED = 6
"""Most centres at which a loop is looked at on the first pass."""
CLOSELY = 16
"""And on a second."""
CENTRES = np.geomspace(0.006, 1.5, 48)
"""Centres of the ball tried: inertia ratios."""
SLOW_TRIED = 0.7, 0.9, 0.4
"""For a robot of bounded speed: where centres are tried, on the logarithmic scale between those that constant ratios
allow."""
SLOW_ENOUGH = 2
"""And after how many bandwidths that bear it, from the highest down, the lower ones are not looked at."""
HOPELESS = -0.3
"""Room at which no other centre is tried."""
FEW = 5
"""Centres at which a loop is looked at for any speed, where what counts is a bounded one."""
LIGHT = 1.15
"""How much more than the least spread a weight may demand to be the one that is tried."""


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A loop: its law but for the scale of M̂, and what it can do.

    With X the shape of M̂, scaled so that the eigenvalues of M(q)⁻¹X lie between 1 and the spread, M̂ = scale X.

    Attributes
    ----------
    window, delay
        [periods].
    degree, synchronised, bandwidth, damping
        As in the laws; bandwidth in [rad/s].
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
    bandwidth: float
    damping: float
    period: float
    computation_delay: int = 0
    slope: float = 0.0
    spread: float = 1.0
    reach: float = 0.0
    scale: float = 0.0
    room: float = 0.0
    noise: float = np.inf
    error: float = np.inf

    @property
    def feasible(self) -> bool:
        """Whether it bears the spread."""
        return self.scale > 0

    @property
    def estimator(self) -> Algebraic:
        """The estimator."""
        return Algebraic(window=self.window * self.period, degree=self.degree)

    def options(self) -> dict[str, Any]:
        """What a law on time-delay estimation takes, but for the inertia and the estimator."""
        late = None if self.delay == 1 else self.delay * self.period
        return {
            "bandwidth": self.bandwidth,
            "damping": self.damping,
            "period": self.period,
            "synchronised": self.synchronised,
            "delay": late,
            "actuation_delay": self.computation_delay,
        }

    def channel(self) -> Channel:
        """The loop of one joint of unit inertia."""
        return decouple(TDC(inertia=1.0, estimator=self.estimator, **self.options()), self.computation_delay)[0]


@dataclass(frozen=True)
class Demand:
    """What a robot asks of a loop.

    Attributes
    ----------
    spread
        Greatest over least eigenvalue of M(q)⁻¹X.
    shares
        With weights η: radius over centre of the ball that holds [E − ρ0 I, H/η] for all postures, for M̂ = X and
        ρ0 = (1 + spread)/2; E and H as in `tarc.certificates.robot`. Just one share, without weight, for no gravity.
    weights
        The η [1/s²].
    rate
        Greatest ‖dE⁻¹/dt‖ for M̂ = X [1/s]; infinite for a robot of any speed.
    stiffness
        Greatest ‖H‖ [1/s²].
    """

    spread: float
    shares: np.ndarray
    weights: np.ndarray
    rate: float = np.inf
    stiffness: float = 0.0

    @classmethod
    def plain(cls, spread: float, rate: float = np.inf) -> "Demand":
        """Of a robot without gravity."""
        spread = check.number("spread", spread, 1)
        return cls(spread, np.array([_share(spread)]), np.zeros(1), rate)

    @classmethod
    def of(cls, spread: float, E: np.ndarray, H: np.ndarray, rate: float = np.inf) -> "Demand":
        """Of a robot with these mismatches (k, n, n) and greatest rate, for M̂ = X."""
        sizes = np.linalg.norm(H, 2, axis=(1, 2))
        centre = (1 + spread) / 2
        if not sizes.max() > 1e-9:
            return cls.plain(spread, rate)
        weights = sizes.max() / centre * np.geomspace(0.3, 30.0, 6)
        norms = np.array([joint_norms(E, H, centre, float(weight)).max() for weight in weights])
        return cls(spread, np.maximum(norms / centre, _share(spread)), weights, rate, float(sizes.max()))


def candidates(
    period: float,
    *,
    bandwidths: Iterable[float] | None = None,
    windows: Iterable[int] = WINDOWS,
    degrees: Iterable[int] = (2, 3),
    delays: Iterable[int] | None = None,
    synchronised: Iterable[bool] = (False, True),
    damping: float = 1.0,
    computation_delay: int = 0,
) -> list[Candidate]:
    """All combinations that make a law, not yet looked at.

    Where no delays are given, literal laws take one period, the shortest, and two where the computation delay is odd:
    one would leave a torque that alternates from period to period undamped. Synchronised laws have that of the window.
    """
    if delays is None:
        delays = (1, 2) if computation_delay % 2 else (1,)
    rate = 1e-3 / check.number("period", period, 0, strict=True)
    speeds = [rate * one for one in BANDWIDTHS] if bandwidths is None else list(bandwidths)
    return [
        Candidate(
            window=window, degree=degree, delay=delay, synchronised=both,
            bandwidth=float(speed), damping=damping, period=period, computation_delay=computation_delay,
        )
        for both in synchronised
        for delay in delays
        if delay == 1 or not both
        for degree in degrees
        for window in windows
        if window >= degree
        for speed in speeds
    ]  # fmt: skip


def assess(
    trials: Sequence[Candidate],
    demand: Demand,
    *,
    slope_share: float = 0.0,
    room: float = 0.1,
    closely: bool = False,
    done: Callable[[], object] = lambda: None,
) -> list[Candidate]:
    """What each candidate can do; those that bear the robot come once for each scale of M̂ worth having.

    A loop bears the robot at the scale c if the robust ball about c(1 + spread)/2 has the share of it as radius that
    the robot demands for one of the weights, which is η/c there, next to a robust term of any slope up to slope_share ·
    bandwidth². The ball is that of `tarc.certificates.robot`, here on a grid of frequencies; the choice is certified
    afterwards. For a robot of bounded speed, whose balls take longer, the lower bandwidths of a loop are not looked at
    where some higher ones bear the robot.

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
    slow = np.isfinite(demand.rate)
    order = list(range(len(trials)))
    if slow and not closely:
        order.sort(key=lambda i: -trials[i].bandwidth)
    found: dict[int, list[Candidate]] = {}
    bearing: dict[tuple, list[float]] = {}
    for i in order:
        one = trials[i]
        higher = bearing.setdefault((one.window, one.degree, one.delay, one.synchronised), [])
        if slow and not closely and len(higher) >= SLOW_ENOUGH:
            found[i] = [replace(one, slope=slope_share * one.bandwidth**2, spread=demand.spread, reach=higher[-1])]
        else:
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")  # what rounding spoils is thrown out below, not trusted
                found[i] = _assess(one, demand, slope_share, room, closely)
            if found[i] and found[i][0].feasible:
                higher.append(found[i][0].reach)
        done()
    return [one for i in range(len(trials)) for one in found[i]]


def _assess(one: Candidate, demand: Demand, slope_share: float, room: float, closely: bool) -> list[Candidate]:
    try:
        channel = one.channel()
    except TarcError:  # gains that are not Hurwitz, a window that is too short
        return []
    spread = demand.spread
    needed = np.array([_share(_spread(share) * (1 + room)) if share < 1 else np.inf for share in demand.shares])
    slope = slope_share * one.bandwidth**2
    parts = parts_of(channel, slope, intersample=True)
    responses = Responses(parts)
    free = 1 - CENTRES[:, None] * responses.held[:, 0]
    plain = np.min(np.abs(free) / np.linalg.norm(responses.mismatch[:, 0], axis=1), axis=1) / CENTRES
    loop, without = _Loop(parts, responses, demand, needed, one.period), parts_of(channel, 0.0, intersample=True)
    slow = np.isfinite(demand.rate)
    plain = np.array([_first_stable(without, CENTRES, plain)]) if slow else _where_stable(without, CENTRES, plain)
    one = replace(one, slope=slope, spread=spread, reach=_spread(float(np.max(plain))))
    if slow:
        rooms = loop.slow_rooms(closely)
        widest = max(rooms.values(), default=-1.0)
        one = replace(one, reach=max(one.reach, (1 + widest) * spread))
        rooms = {centre: spare for centre, spare in rooms.items() if spare >= room}
    else:
        rooms = loop.rooms(CENTRES[plain >= needed.min()], closely)
    able = sorted(rooms)
    stable = _where_stable(parts, np.array(able), np.ones(len(able))) if able else np.zeros(0)
    able = [centre for centre, fine in zip(able, stable, strict=True) if fine]
    result = []
    if not closely and able:
        able = [able[i] for i in sorted({0, len(able) // 2, len(able) - 1})]
    for centre in able:
        scale = 2 * centre / (spread + 1)
        ratios = scale, scale * spread**0.5, scale * spread
        noise = scale * max(h2_norm(*from_noise(channel, ratio)) for ratio in ratios)
        error = max(ratio / scale * settling(channel, ratio) for ratio in ratios)
        if np.isfinite(noise) and np.isfinite(error):
            result.append(replace(one, scale=scale, room=rooms[centre], noise=noise, error=error))
    return result or [one]


@dataclass(frozen=True)
class _Loop:
    """A loop against a demand: at which centres of the ball it bears the robot, and with how much room."""

    parts: tuple[np.ndarray, ...]
    responses: Responses
    demand: Demand
    needed: np.ndarray
    period: float

    def weight(self, number: int, centre: float) -> float:
        """η of the demand at this centre."""
        return float(self.demand.weights[number] * (1 + self.demand.spread) / (2 * centre))

    def rooms(self, centres: np.ndarray, closely: bool) -> dict[float, float]:
        """By centre, of those that bear the robot however fast it moves."""
        most = CLOSELY if closely else TRIED
        if len(centres) > most:
            centres = centres[np.linspace(0, len(centres) - 1, most).round().astype(int)]
        found = {}
        for centre in centres:
            enough, spare = False, -1.0
            for number, (share, least) in enumerate(zip(self.demand.shares, self.needed, strict=True)):
                borne = self.responses.best(float(centre), self.weight(number, centre))[1] / centre
                now = _spread(borne) / _spread(float(share)) - 1
                past = now < spare
                enough, spare = enough or borne >= least, max(spare, now)
                if enough and (past or not closely):  # the first weight that does, or all up to the best
                    break
            if enough:
                found[float(centre)] = spare
        return found

    def slow_rooms(self, closely: bool) -> dict[float, float]:
        """By centre, within the speed, of those that were tried; enough room, or less, and not how much exactly."""
        low, high = self.constant()
        least = float(self.needed.min())
        low, high = low / (1 - least) if least < 1 else np.inf, high / (1 + least)
        if not low < high:
            return {}
        places = (0.3, 0.5, 0.7, 0.85) if closely else SLOW_TRIED
        found: dict[float, float] = {}
        for place in places:
            centre = float(low * (high / low) ** place)
            found[centre] = self.slow_room(centre)
            if found[centre] < HOPELESS:
                break
        return found

    def slow_room(self, centre: float) -> float:
        """The room at a centre, for the lightest weight that takes little of it, or the next."""
        spare, scale = -1.0, 2 * centre / (1 + self.demand.spread)
        if np.abs(np.linalg.eigvals(system(self.parts, centre)[0])).max() >= 1:
            return spare
        light = int(np.argmax(self.needed <= _share(LIGHT * _spread(float(self.needed.min())))))
        for number in range(light, min(light + 2, len(self.needed))):
            share, least = float(self.demand.shares[number]), float(self.needed[number])
            if least >= 1:
                break
            weight = self.weight(number, centre)
            borne = self.responses.best(centre, weight)[1] / centre
            if borne < least:  # at any speed
                borne = best_multiplier(
                    self.parts, centre, self.demand.rate * self.period / scale, weight=weight,
                    stiffness=self.demand.stiffness, responses=self.responses, enough=1.0001 * least * centre,
                )[1] / centre  # fmt: skip
            spare = max(spare, _spread(min(borne, 1 - 1e-9)) / _spread(share) - 1)
            if borne >= least or spare < HOPELESS:
                break
        return spare

    def constant(self) -> tuple[float, float]:
        """The widest interval of constant ratios with which the loop is stable, up to the grid of frequencies."""
        held = self.responses.held[:, 0]
        change = np.flatnonzero(np.diff(np.sign(held.imag)))
        part = held.imag[change] / (held.imag[change] - held.imag[change + 1])
        real = held.real[change] + part * (held.real[change + 1] - held.real[change])
        edges = np.sort([*(1 / real[real > 0]), CENTRES[0] / 100, 10 * CENTRES[-1]])
        edges = edges[(edges >= CENTRES[0] / 100) & (edges <= 10 * CENTRES[-1])]
        best = 1.0, 1.0
        for low, high in pairwise(edges):
            if high / low > best[1] / best[0]:
                stable = np.abs(np.linalg.eigvals(system(self.parts, float((low * high) ** 0.5))[0])).max() < 1
                best = (float(low), float(high)) if stable else best
        return best


def _share(spread: float) -> float:
    """Radius over centre of the interval whose ends have this ratio."""
    return (spread - 1) / (spread + 1)


def _spread(share: float) -> float:
    """The reverse of `_share`."""
    return (1 + share) / (1 - share) if share < 1 else np.inf


def _where_stable(parts: tuple[np.ndarray, ...], centres: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Radius of the ball over its centre, zero where it is small or the loop not stable."""
    result = np.where(shares > 0.2, shares, 0.0)
    worth = np.flatnonzero(result)
    if len(worth):
        loops = np.stack([system(parts, float(centre))[0] for centre in centres[worth]])
        result[worth[np.abs(np.linalg.eigvals(loops)).max(axis=1) >= 1]] = 0.0
    return result


def _first_stable(parts: tuple[np.ndarray, ...], centres: np.ndarray, shares: np.ndarray) -> float:
    """The largest of `_where_stable`, of the few that are looked at."""
    for i in np.argsort(shares)[::-1][:FEW]:
        if shares[i] > 0.2 and np.abs(np.linalg.eigvals(system(parts, float(centres[i]))[0])).max() < 1:
            return float(shares[i])
    return 0.0


def settling(channel: Channel, ratio: float) -> float:
    """Root of the integral of the squared error after a step of 1 rad/s² [rad s^½]: (T Σ e_k²)^½.

    The step's response settles at x∞ = (I − A)⁻¹B, with no error; e_k = −C Aᵏ x∞.
    """
    A, B, C, D = from_disturbance(channel, ratio)
    settled = np.linalg.solve(np.eye(len(A)) - A, B)
    return float(np.sqrt(channel.period) * h2_norm(A, settled, C, 0 * D))


def peak(channel: Channel, ratio: float, horizon: int = 4000) -> float:
    """Greatest error after a step of 1 rad/s² [rad], within so many periods."""
    A, B, C, _ = from_disturbance(channel, ratio)
    state, greatest = np.zeros((len(A), 1)), 0.0
    for _ in range(horizon):
        state = A @ state + B
        now = abs((C @ state).item())
        greatest = max(greatest, now)
        if now < 0.05 * greatest:
            break
    return greatest


def front(found: Sequence[Candidate]) -> list[Candidate]:
    """Those that bear the spread and that no other beats in both noise and error, by noise."""
    best, result = np.inf, []
    for one in sorted((one for one in found if one.feasible), key=lambda one: (one.noise, one.error)):
        if one.error < best:
            best = one.error
            result.append(one)
    return result
