"""What to relax where nothing can be certified, and by how much."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from tarc.analysis.inertia_ratio import inertia_spread
from tarc.analysis.inertia_shape import best_inertia_shape
from tarc.analysis.workspace import Workspace
from tarc.core.errors import TarcError
from tarc.design.candidates import Candidate, assess_candidates, enumerate_candidates
from tarc.design.robustness import RobustnessSpec
from tarc.plants.base import Plant

BISECTIONS = 6
"""Bisections: to one part in 64 of the range."""
FREQUENCY_RATIO = 1.5
"""Ratio of natural frequencies tried one after the other."""
MAX_CANDIDATES = 50
"""Loops tried again where a requirement is relaxed."""
SAMPLES = 200
"""Postures sampled for a first answer."""


def remedies(
    plants: Sequence[Plant],
    workspace: Workspace,
    shape: np.ndarray,
    demand: RobustnessSpec,
    looked: Sequence[Candidate],
    natural_frequency: float | None,
    room: float,
) -> str:
    """Sentences: each requirement that would do if it alone were relaxed, with its number."""
    fits = partial(_bearable, looked, room)
    lines = []
    if natural_frequency is not None and looked:
        possible = largest_bandwidth(looked[0], demand, natural_frequency, room)
        if possible:
            lines.append(f"a natural frequency of at most {_down(possible):g} rad/s")
        elif needed := least_bandwidth(looked[0], demand, natural_frequency, room):
            lines.append(f"a natural frequency of at least {-_down(-needed):g} rad/s")
        rate = slowest_rate(looked[0], demand, natural_frequency, room)
        if rate:
            lines.append(f"a rate of at least {-_down(-rate, 4):g} Hz")
    if part := slower(plants, workspace, shape, looked, room):
        lines.append(f"{_down(100 * part, 2):g} % of the speed")
    lines += [text for find in (_payload, _armature, _reach) if (text := find(plants, workspace, fits))]
    if not lines:
        return "No single requirement that could be relaxed makes up for it: give rotor inertia and a smaller workspace"
    return "Any one of these would do: " + "; ".join(lines)


def largest_bandwidth(like: Candidate, demand: RobustnessSpec, above: float, room: float) -> float | None:
    """The largest natural frequency [rad/s] below one that is too large at which a loop bears a robot; None if none
    does.

    One that is far lower does not do either, where gravity asks for stiffness: so the steps down are small.
    """
    return _first(like, demand, above, room, [FREQUENCY_RATIO**-k for k in range(1, 15)])


def least_bandwidth(like: Candidate, demand: RobustnessSpec, below: float, room: float) -> float | None:
    """The least natural frequency [rad/s] above one that is too small at which a loop bears a robot; None if none
    does."""
    return _first(like, demand, below, room, [FREQUENCY_RATIO**k for k in range(1, 8)])


def _first(
    like: Candidate, demand: RobustnessSpec, asked: float, room: float, factors: Sequence[float]
) -> float | None:
    """The natural frequency nearest to the one asked for, in the direction of the factors, at which a loop bears a
    robot."""

    def fits(log: float) -> bool:
        return _bears(like, demand, float(np.exp(log)), like.period, room)

    bad = float(np.log(asked))
    for factor in factors:
        good = float(np.log(asked * factor))
        if fits(good):
            return float(np.exp(_bisect(fits, good, bad)))
        bad = good
    return None


def slowest_rate(like: Candidate, demand: RobustnessSpec, natural_frequency: float, room: float) -> float | None:
    """The slowest rate [Hz] above one that is too slow at which a loop of this natural frequency bears a robot."""

    def fits(log: float) -> bool:
        return _bears(like, demand, natural_frequency, float(np.exp(log)), room)

    low, high = np.log(like.period / 64), np.log(like.period)
    return float(np.exp(-_bisect(fits, low, high))) if fits(low) else None


def slower(
    plants: Sequence[Plant], workspace: Workspace, shape: np.ndarray, looked: Sequence[Candidate], room: float
) -> float | None:
    """The greatest share of the speed, and of the acceleration, at which one of the loops bears a robot; None if none
    does, or for any speed.
    """
    if workspace.speed is None or not looked:
        return None
    share = looked[0].robust_slope / looked[0].natural_frequency ** 2
    found = inertia_spread(plants, shape, workspace, samples=SAMPLES)
    trials = [
        replace(one, inertia_scale=0.0, spread_margin=0.0) for one in looked[:: -(-len(looked) // MAX_CANDIDATES)]
    ]

    def fits(log: float) -> bool:
        demand = RobustnessSpec.from_robot(
            plants, workspace.scale_speed(float(np.exp(log))), shape, found, search=False
        )
        return any(one.feasible for one in assess_candidates(trials, demand, min_margin=room, slope_ratio=share))

    low = np.log(0.01)
    return float(np.exp(_bisect(fits, low, 0.0))) if fits(low) else None


def _bears(like: Candidate, demand: RobustnessSpec, natural_frequency: float, period: float, room: float) -> bool:
    trials = enumerate_candidates(
        period,
        natural_frequencies=[natural_frequency],
        windows=(2, 3, 4, 5),
        damping_ratio=like.damping_ratio,
        computation_delay=like.computation_delay,
    )
    share = like.robust_slope / like.natural_frequency**2
    return any(
        one.feasible
        for trial in trials
        for one in assess_candidates([trial], demand, min_margin=room, slope_ratio=share)
    )


def _bisect(fits: Callable[[float], bool], good: float, bad: float) -> float:
    """The last value that fits, between one that does and one that does not."""
    for _ in range(BISECTIONS):
        middle = (good + bad) / 2
        good, bad = (middle, bad) if fits(middle) else (good, middle)
    return good


def _down(value: float, digits: int = 3) -> float:
    """The next number below with so many digits, so that what is said is not more than what was found."""
    if not value:
        return 0.0
    places = digits - 1 - int(np.floor(np.log10(abs(value))))
    return float(np.floor(value * 10.0**places) / 10.0**places)


Fits = Callable[[Sequence[Plant], Workspace], bool]
"""Whether one of the loops that were looked at bears robots over a workspace."""


def _bearable(looked: Sequence[Candidate], room: float, plants: Sequence[Plant], workspace: Workspace) -> bool:
    try:
        shape, ratio = best_inertia_shape(plants, workspace, samples=SAMPLES, tolerance=0.1)
    except TarcError:
        return False
    trials = [one for one in looked if one.max_spread >= (1 + room) * ratio]
    if not trials:
        return False
    found = inertia_spread(plants, shape, workspace, samples=SAMPLES)
    shape = shape / found.min_ratio
    demand = RobustnessSpec.from_robot(
        plants, workspace, shape, inertia_spread(plants, shape, workspace, samples=SAMPLES), search=False
    )
    share = trials[0].robust_slope / trials[0].natural_frequency ** 2
    # where the spread is small most of them will do
    some = trials[:: -(-len(trials) // MAX_CANDIDATES)]
    return any(
        one.feasible for trial in some for one in assess_candidates([trial], demand, min_margin=room, slope_ratio=share)
    )


def _payload(plants: Sequence[Plant], workspace: Workspace, bears: Fits) -> str | None:
    masses = [float(np.squeeze(one.parameters.get("payload", 0.0))) for one in plants]
    low, high = min(masses), max(masses)

    def fits(mass: float) -> bool:
        ends = [plants[0].with_parameters({"payload": one}) for one in (low, mass)]
        return bears(ends, workspace)

    if not high > low or not fits(low):
        return None
    return f"a payload of at most {_down(_bisect(fits, low, high)):g} kg"


def _armature(plants: Sequence[Plant], workspace: Workspace, bears: Fits) -> str | None:
    own = plants[0].parameters.get("armature")
    if own is None:
        return None

    def fits(log: float) -> bool:
        more = [one.with_parameters({"armature": own + np.exp(log)}) for one in plants]
        return bears(more, workspace)

    low, high = np.log(10.0), np.log(0.01)
    if not fits(low):
        return None
    return f"{-_down(-np.exp(_bisect(fits, low, high))):g} kg m² more rotor inertia on each joint"


def _reach(plants: Sequence[Plant], workspace: Workspace, bears: Fits) -> str | None:
    if workspace.reference is not None:
        return None
    middle, half = (workspace.low + workspace.high) / 2, (workspace.high - workspace.low) / 2

    def fits(share: float) -> bool:
        return bears(plants, replace(workspace, low=middle - share * half, high=middle + share * half))

    if not fits(0.05):
        return None
    return f"{_down(100 * _bisect(fits, 0.05, 1.0), 2):g} % of the workspace, about its middle"
