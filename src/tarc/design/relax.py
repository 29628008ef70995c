"""What to relax where nothing can be certified, and by how much."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tarc.certificates.workspace import Workspace, best_shape
from tarc.design.front import Candidate, Demand, assess, candidates
from tarc.errors import TarcError
from tarc.plants.base import Plant

STEPS = 6
"""Bisections: to one part in 64 of the range."""
QUICK = 200
"""Postures sampled for a first answer."""


def remedies(
    plants: Sequence[Plant],
    workspace: Workspace,
    demand: Demand,
    looked: Sequence[Candidate],
    bandwidth: float | None,
    room: float,
) -> str:
    """Sentences: each requirement that would do if it alone were relaxed, with its number."""
    bearable = max((one.reach for one in looked), default=1.0) / (1 + room)
    lines = []
    if bandwidth is not None and looked:
        possible = largest_bandwidth(looked[0], demand, bandwidth, room)
        if possible:
            lines.append(f"a bandwidth of at most {possible:.3g} rad/s")
        rate = slowest_rate(looked[0], demand, bandwidth, room)
        if rate:
            lines.append(f"a rate of at least {rate:.4g} Hz")
    lines += [text for find in (_payload, _armature, _reach) if (text := find(plants, workspace, bearable))]
    if not lines:
        return "No single requirement that could be relaxed makes up for it: give rotor inertia and a smaller workspace"
    return "Any one of these would do: " + "; ".join(lines)


def largest_bandwidth(like: Candidate, demand: Demand, above: float, room: float) -> float | None:
    """The largest bandwidth [rad/s] below one that is too large at which a loop bears a robot; None if none does."""

    def fits(log: float) -> bool:
        return _bears(like, demand, float(np.exp(log)), like.period, room)

    low, high = np.log(above) - np.log(256), np.log(above)
    return float(np.exp(_bisect(fits, low, high))) if fits(low) else None


def slowest_rate(like: Candidate, demand: Demand, bandwidth: float, room: float) -> float | None:
    """The slowest rate [Hz] above one that is too slow at which a loop of this bandwidth bears a robot."""

    def fits(log: float) -> bool:
        return _bears(like, demand, bandwidth, float(np.exp(log)), room)

    low, high = np.log(like.period / 64), np.log(like.period)
    return float(np.exp(-_bisect(fits, low, high))) if fits(low) else None


def _bears(like: Candidate, demand: Demand, bandwidth: float, period: float, room: float) -> bool:
    trials = candidates(
        period, bandwidths=[bandwidth], windows=(2, 3, 4, 5), damping=like.damping,
        computation_delay=like.computation_delay,
    )  # fmt: skip
    return any(one.feasible for one in assess(trials, demand, room=room, slope_share=like.slope / like.bandwidth**2))


def _bisect(fits: Callable[[float], bool], good: float, bad: float) -> float:
    """The last value that fits, between one that does and one that does not."""
    for _ in range(STEPS):
        middle = (good + bad) / 2
        good, bad = (middle, bad) if fits(middle) else (good, middle)
    return good


def _narrow(plants: Sequence[Plant], workspace: Workspace, bearable: float) -> bool:
    try:
        return best_shape(plants, workspace, samples=QUICK, tolerance=0.1)[1] <= bearable
    except TarcError:
        return False


def _payload(plants: Sequence[Plant], workspace: Workspace, bearable: float) -> str | None:
    masses = [float(np.squeeze(one.parameters.get("payload", 0.0))) for one in plants]
    low, high = min(masses), max(masses)

    def fits(mass: float) -> bool:
        ends = [plants[0].with_parameters({"payload": one}) for one in (low, mass)]
        return _narrow(ends, workspace, bearable)

    if not high > low or not fits(low):
        return None
    return f"a payload of at most {_bisect(fits, low, high):.3g} kg"


def _armature(plants: Sequence[Plant], workspace: Workspace, bearable: float) -> str | None:
    own = plants[0].parameters.get("armature")
    if own is None:
        return None

    def fits(log: float) -> bool:
        more = [one.with_parameters({"armature": own + np.exp(log)}) for one in plants]
        return _narrow(more, workspace, bearable)

    low, high = np.log(10.0), np.log(0.01)
    if not fits(low):
        return None
    return f"{np.exp(_bisect(fits, low, high)):.3g} kg m² more rotor inertia on each joint"


def _reach(plants: Sequence[Plant], workspace: Workspace, bearable: float) -> str | None:
    if workspace.reference is not None:
        return None
    middle, half = (workspace.low + workspace.high) / 2, (workspace.high - workspace.low) / 2

    def fits(share: float) -> bool:
        return _narrow(plants, replace(workspace, low=middle - share * half, high=middle + share * half), bearable)

    if not fits(0.05):
        return None
    return f"{100 * _bisect(fits, 0.05, 1.0):.0f} % of the workspace, about its middle"
