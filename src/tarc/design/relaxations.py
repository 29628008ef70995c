"""Requirements to relax where nothing can be certified, and by how much."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tarc.analysis.inertia_ratio import inertia_spread
from tarc.analysis.inertia_shape import best_inertia_shape
from tarc.analysis.workspace import Workspace
from tarc.core.errors import NotConverged, Relaxation
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

    Parameters
    ----------
    problem, shape, spec, candidates
        The requirements on the robot, X, the robustness that it requires and the loops that do not meet it.
    min_margin
        Least margin of the tolerated spread over the robot's.
    """
    robots = RelaxedRobots(problem, shape, candidates, min_margin)
    relaxations: list[Relaxation | None] = []
    frequency = problem.requirements.natural_frequency
    if frequency is not None and candidates:
        loops = RelaxedLoops(candidates[0], spec, frequency, min_margin)
        relaxations += [loops.natural_frequency(), loops.period()]
    relaxations += [robots.speed(), robots.payload(), robots.armature(), robots.workspace()]
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
        """Return the largest speeds, all in proportion, at which a loop is feasible."""
        plants, workspace, candidates = self.problem.plants, self.problem.workspace, self.candidates
        if workspace.speed is None or not candidates:
            return None
        ratio = candidates[0].robust_slope / candidates[0].natural_frequency ** 2
        spread = inertia_spread(plants, self.shape, workspace, samples=SAMPLES)
        trials = [replace(trial, inertia_scale=0.0, spread_margin=0.0) for trial in thin_out(candidates)]

        def is_feasible(log: float) -> bool:
            slower = workspace.scale_speed(float(np.exp(log)))
            spec = RobustnessSpec.from_robot(plants, slower, self.shape, spread, search=False)
            assessed = assess_candidates(trials, spec, min_margin=self.min_margin, slope_ratio=ratio)
            return any(candidate.feasible for candidate in assessed)

        low = np.log(0.01)
        if not is_feasible(low):
            return None
        percent = round_down(100 * float(np.exp(bisect(is_feasible, low, 0.0))), 2)
        if not percent:
            return None
        return Relaxation("speed", (percent / 100 * workspace.speed).tolist(), f"{percent:g} % of the speed")

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
