"""Requirements to relax where nothing can be certified, and by how much."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tarc.analysis.inertia_ratio import InertiaSpread, inertia_spread
from tarc.analysis.inertia_shape import best_inertia_shape
from tarc.analysis.workspace import Workspace
from tarc.core.errors import NotConverged, Relaxation
from tarc.core.formatting import format_per_joint
from tarc.core.units import unit_for_joints
from tarc.design.assessment import assess_candidates
from tarc.design.candidates import Candidate, enumerate_candidates
from tarc.design.problem import DesignProblem
from tarc.design.robustness import RobustnessSpec
from tarc.plants.base import Plant

BISECTIONS = 6
"""Bisections: to one part in 64 of the range."""
FREQUENCY_RATIO = 1.5
"""Ratio of consecutive natural frequencies that are tried."""
MAX_CANDIDATES = 50
"""Most loops assessed again per relaxed requirement."""
MAX_SPEED = 100.0
"""Speed [rad/s or m/s] below which one is sought where none is given."""
MIN_SPEED_EXPONENT = -6
"""Power of ten of the lowest share of the speed that is tried."""
SPEED_REDUCTIONS = (1.0, 0.9, 0.75, 0.5, 0.25, 0.1)
"""Factors on the speed found on samples, of which the first that is confirmed is taken."""
SAMPLES = 200
"""Postures sampled per relaxed requirement."""


def suggest_changes(
    problem: DesignProblem,
    shape: np.ndarray,
    spec: RobustnessSpec,
    candidates: Sequence[Candidate],
    min_margin: float,
) -> list[Relaxation]:
    """Return the single requirements of which one relaxed admits a certified loop, each with its value.

    A speed that the robot's file states, or that nobody states, comes first.

    Parameters
    ----------
    problem, shape, spec, candidates
        The requirements on the robot, X, the robustness that it requires and the loops that do not meet it.
    min_margin
        Least margin of the tolerated spread over the robot's.
    """
    robots = RelaxedRobots(problem, shape, candidates, min_margin)
    speed = robots.speed()
    relaxations: list[Relaxation | None] = [speed] if problem.has_own_speed else []
    frequency = problem.requirements.natural_frequency
    if frequency is not None and candidates:
        loops = RelaxedLoops(candidates[0], spec, frequency, min_margin)
        relaxations += [loops.natural_frequency(), loops.period()]
    relaxations += [] if problem.has_own_speed else [speed]
    relaxations += [robots.payload(), robots.armature(), robots.workspace()]
    return [relaxation for relaxation in relaxations if relaxation is not None]


@dataclass(frozen=True, eq=False)
class RelaxedLoops:
    """Loops at another natural frequency or control rate.

    Attributes
    ----------
    candidate
        A loop with the required period, damping ratio and delay.
    spec
        The robustness that the robot requires.
    frequency
        Natural frequency required [rad/s].
    min_margin
        Least margin of the tolerated spread over the robot's.
    """

    candidate: Candidate
    spec: RobustnessSpec
    frequency: float
    min_margin: float

    def natural_frequency(self) -> Relaxation | None:
        """Return the nearest natural frequency at which a loop is feasible: a lower one, or else a higher one."""
        lower = self._nearest_frequency([FREQUENCY_RATIO**-k for k in range(1, 15)])
        if lower is not None:
            value = round_down(lower)
            return Relaxation("natural_frequency", value, f"a natural frequency of at most {value:g} rad/s")
        higher = self._nearest_frequency([FREQUENCY_RATIO**k for k in range(1, 8)])
        if higher is None:
            return None
        value = -round_down(-higher)
        return Relaxation("natural_frequency", value, f"a natural frequency of at least {value:g} rad/s")

    def period(self) -> Relaxation | None:
        """Return the longest control period at which a loop of the required natural frequency is feasible."""
        period = self.candidate.period
        low, high = np.log(period / 64), np.log(period)

        def is_feasible(log: float) -> bool:
            return self._is_feasible(self.frequency, float(np.exp(log)))

        if not is_feasible(low):
            return None
        rate = -round_down(-float(np.exp(-bisect(is_feasible, low, high))), 4)
        return Relaxation("period", 1 / rate, f"a control rate of at least {rate:g} Hz")

    def _nearest_frequency(self, factors: Sequence[float]) -> float | None:
        """Return the feasible natural frequency [rad/s] nearest to the required one, in the direction of the factors.

        The steps are small, since a far lower one may lack the stiffness that gravity requires.
        """

        def is_feasible(log: float) -> bool:
            return self._is_feasible(float(np.exp(log)), self.candidate.period)

        bad = float(np.log(self.frequency))
        for factor in factors:
            good = float(np.log(self.frequency * factor))
            if is_feasible(good):
                return float(np.exp(bisect(is_feasible, good, bad)))
            bad = good
        return None

    def _is_feasible(self, natural_frequency: float, period: float) -> bool:
        trials = enumerate_candidates(
            period,
            natural_frequencies=[natural_frequency],
            windows=(2, 3, 4, 5),
            damping_ratio=self.candidate.damping_ratio,
            computation_delay=self.candidate.computation_delay,
        )
        ratio = self.candidate.robust_slope / self.candidate.natural_frequency**2
        return any_feasible(trials, self.spec, self.min_margin, ratio)


@dataclass(frozen=True, eq=False)
class RelaxedRobots:
    """The assessed loops on a slower, lighter or smaller robot.

    Attributes
    ----------
    problem
        The requirements on the robot.
    shape
        X [kg m² or kg], shape (n, n).
    candidates
        The loops.
    min_margin
        Least margin of the tolerated spread over the robot's.
    """

    problem: DesignProblem
    shape: np.ndarray
    candidates: Sequence[Candidate]
    min_margin: float

    def speed(self) -> Relaxation | None:
        """Return the largest speeds, all in proportion, at which a loop is feasible.

        Where the speed is not bounded, they are a share of `MAX_SPEED`.
        """
        workspace = self.problem.workspace
        if workspace.speed is None:
            workspace = workspace.with_speed_limits(MAX_SPEED)
        if workspace.speed is None or not np.any(workspace.speed) or not self.candidates:
            return None
        share = self._largest_speed_share(workspace)
        if share is None:
            return None
        speeds = [round_down(share * speed) for speed in workspace.speed]
        unit = unit_for_joints("rad/s", self.problem.plants[0].units)
        numbers = format_per_joint(speeds)
        text = f"at most {numbers} {unit} (--speed {numbers.replace(' ', '')})"
        bounded = self.problem.workspace.speed is not None
        text = f"{100 * share:g} % of the speed, {text}" if bounded else f"a speed of {text}"
        return Relaxation("speed", speeds, text)

    def _largest_speed_share(self, workspace: Workspace) -> float | None:
        """Return the largest share of a workspace's speed at which a loop is feasible; None for none.

        It is found on samples and confirmed with the search for worse postures, as a design has it.
        """
        plants, candidates, requirements = self.problem.plants, self.candidates, self.problem.requirements
        ratio = candidates[0].robust_slope / candidates[0].natural_frequency ** 2
        trials = [replace(trial, inertia_scale=0.0, spread_margin=0.0) for trial in thin_out(candidates)]
        few, many = (
            inertia_spread(plants, self.shape, workspace, samples=samples, seed=requirements.seed)
            for samples in (SAMPLES, requirements.samples)
        )

        def is_feasible(log: float, spread: InertiaSpread = few, search: bool = False) -> bool:
            slower = workspace.scale_speed(float(np.exp(log)))
            spec = RobustnessSpec.from_robot(plants, slower, self.shape, spread, seed=requirements.seed, search=search)
            return any_feasible(trials, spec, self.min_margin, ratio)

        decades = np.log(10.0) * np.arange(0, MIN_SPEED_EXPONENT - 1, -1)
        good = next((number for number, log in enumerate(decades) if number and is_feasible(float(log))), None)
        if good is None:
            return None
        largest = bisect(is_feasible, float(decades[good]), float(decades[good - 1]))
        for reduction in SPEED_REDUCTIONS:
            share = round_down(reduction * float(np.exp(largest)), 2)
            if is_feasible(float(np.log(share)), many, True):
                return share
        return None

    def payload(self) -> Relaxation | None:
        """Return the largest payload with which a loop is feasible."""
        plants = self.problem.plants
        masses = [float(np.squeeze(plant.parameters.get("payload", 0.0))) for plant in plants]
        low, high = min(masses), max(masses)

        def is_feasible(mass: float) -> bool:
            ends = [plants[0].with_parameters({"payload": end}) for end in (low, mass)]
            return self._is_feasible(ends, self.problem.workspace)

        if not high > low or not is_feasible(low):
            return None
        mass = round_down(bisect(is_feasible, low, high))
        return Relaxation("payload", [low, mass], f"a payload of at most {mass:g} kg")

    def armature(self) -> Relaxation | None:
        """Return the least rotor inertia with which a loop is feasible."""
        plants = self.problem.plants
        own = plants[0].parameters.get("armature")
        if own is None:
            return None

        def is_feasible(log: float) -> bool:
            heavier = [plant.with_parameters({"armature": own + np.exp(log)}) for plant in plants]
            return self._is_feasible(heavier, self.problem.workspace)

        low, high = np.log(10.0), np.log(0.01)
        if not is_feasible(low):
            return None
        more = -round_down(-np.exp(bisect(is_feasible, low, high)))
        text = f"{more:g} kg m² more rotor inertia on each joint"
        return Relaxation("armature", (np.asarray(own) + more).tolist(), text)

    def workspace(self) -> Relaxation | None:
        """Return the largest share of the workspace, about its middle, on which a loop is feasible."""
        workspace = self.problem.workspace
        if workspace.reference is not None:
            return None
        middle, half = (workspace.low + workspace.high) / 2, (workspace.high - workspace.low) / 2

        def smaller(share: float) -> Workspace:
            return replace(workspace, low=middle - share * half, high=middle + share * half)

        def is_feasible(share: float) -> bool:
            return self._is_feasible(self.problem.plants, smaller(share))

        if not is_feasible(0.05):
            return None
        percent = round_down(100 * bisect(is_feasible, 0.05, 1.0), 2)
        text = f"{percent:g} % of the workspace, about its middle"
        return Relaxation("workspace", smaller(percent / 100), text)

    def _is_feasible(self, plants: Sequence[Plant], workspace: Workspace) -> bool:
        """Return whether one of the loops is feasible on these robots over a workspace."""
        try:
            shape, ratio = best_inertia_shape(plants, workspace, samples=SAMPLES, tolerance=0.1)
        except NotConverged:
            return False
        trials = [candidate for candidate in self.candidates if candidate.max_spread >= (1 + self.min_margin) * ratio]
        if not trials:
            return False
        shape = shape / inertia_spread(plants, shape, workspace, samples=SAMPLES).min_ratio
        spread = inertia_spread(plants, shape, workspace, samples=SAMPLES)
        spec = RobustnessSpec.from_robot(plants, workspace, shape, spread, search=False)
        slope_ratio = trials[0].robust_slope / trials[0].natural_frequency ** 2
        return any_feasible(thin_out(trials), spec, self.min_margin, slope_ratio)


def any_feasible(trials: Sequence[Candidate], spec: RobustnessSpec, min_margin: float, slope_ratio: float) -> bool:
    """Return whether one of the loops is feasible; the loops after it are not assessed."""
    return any(
        candidate.feasible
        for trial in trials
        for candidate in assess_candidates([trial], spec, min_margin=min_margin, slope_ratio=slope_ratio)
    )


def thin_out(candidates: Sequence[Candidate]) -> Sequence[Candidate]:
    """Return at most `MAX_CANDIDATES` loops, evenly spaced."""
    return candidates[:: -(-len(candidates) // MAX_CANDIDATES)]


def bisect(is_feasible: Callable[[float], bool], good: float, bad: float) -> float:
    """Return the last feasible value between a feasible and an infeasible one."""
    for _ in range(BISECTIONS):
        middle = (good + bad) / 2
        if is_feasible(middle):
            good = middle
        else:
            bad = middle
    return good


def round_down(value: float, digits: int = 3) -> float:
    """Return the next number below with this many significant digits, so that no limit is overstated."""
    if not value:
        return 0.0
    places = digits - 1 - int(np.floor(np.log10(abs(value))))
    return float(np.floor(value * 10.0**places) / 10.0**places)
