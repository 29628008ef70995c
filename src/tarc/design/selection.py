"""The choice among the assessed loops."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tarc.certificates.affine import AffineProof
from tarc.core.errors import InfeasibleDesign, Relaxation
from tarc.design.candidates import Candidate, pareto_front
from tarc.design.infeasible import infeasible_design
from tarc.design.problem import DesignProblem
from tarc.design.relaxations import suggest_changes
from tarc.design.robustness import RobustnessSpec

MAX_BUDGET_FACTOR = 2.0
"""Largest factor by which torque noise may exceed the default budget, provided noise² × error falls. Where the least
noise of all loops is above the budget, the factor is over that."""
MIN_SPREAD_MARGIN = 0.1
"""Least margin of the tolerated spread over the robot's."""


@dataclass(frozen=True, eq=False)
class LoopSelection:
    """Assessed loops of a problem, of which one is picked.

    Attributes
    ----------
    problem
        The requirements on the robot.
    shape
        X [kg m² or kg], shape (n, n).
    spec
        The robustness that the robot requires.
    candidates
        The loops.
    max_change
        Largest torque change of a loop [1/s²], where a trial run with more was too fast for a limit of the torque's
        rate. Without such a loop, the one of least change is taken.
    proofs
        The Lyapunov functions of those loops that have one.
    """

    problem: DesignProblem
    shape: np.ndarray
    spec: RobustnessSpec
    candidates: Sequence[Candidate]
    max_change: float = np.inf
    proofs: Mapping[Candidate, AffineProof] = field(default_factory=dict)

    def with_proofs(self, proofs: Mapping[Candidate, AffineProof]) -> "LoopSelection":
        """Return the selection with more loops and their Lyapunov functions."""
        return replace(self, candidates=[*self.candidates, *proofs], proofs={**self.proofs, **proofs})

    @property
    def min_noise_ratio(self) -> float:
        """Least torque noise over the torque limit of all feasible loops."""
        return self.noise_ratio(pareto_front(self.candidates)[0])

    @property
    def free_noise_ratio(self) -> float:
        """Torque noise over the limit up to which only the error counts: the budget, or the least there is."""
        requirements = self.problem.requirements
        if requirements.noise_budget is not None:
            return requirements.noise_budget
        return max(requirements.noise_target, self.min_noise_ratio)

    @property
    def has_feasible(self) -> bool:
        """Whether a loop tolerates the robot."""
        return any(candidate.feasible for candidate in self.candidates)

    def cost(self, candidate: Candidate) -> float:
        """Return noise² × error, infinite beyond the largest noise; at a given natural frequency the noise."""
        requirements, noise = self.problem.requirements, self.noise_ratio(candidate)
        if requirements.noise_budget is not None and noise > requirements.noise_budget:
            return np.inf
        if requirements.natural_frequency is not None:
            return noise
        is_limited = requirements.noise_budget is None and self.has_feasible
        if is_limited and noise > MAX_BUDGET_FACTOR * self.free_noise_ratio:
            return np.inf
        return max(noise, requirements.noise_target) ** 2 * candidate.error

    def noise_ratio(self, candidate: Candidate) -> float:
        """Return the largest RMS torque change per period by noise over the torque limit, of all joints."""
        return self.problem.noise_ratio(candidate, self.shape)

    def pick(self) -> Candidate:
        """Return the loop of least noise² × error within the budget; at a given natural frequency that of least noise.

        Raises
        ------
        InfeasibleDesign
            Where no loop meets the requirements.
        """
        front = pareto_front(self.candidates)
        if not front:
            raise self._no_feasible_loop()
        if np.isfinite(self.max_change):
            slow = [loop for loop in self.candidates if loop.feasible and loop.change <= (1 + 1e-9) * self.max_change]
            front = pareto_front(slow or [self.slowest()])
        if self.problem.requirements.natural_frequency is not None:
            return self._quietest(front)
        free = self.free_noise_ratio
        is_strict = self.problem.requirements.noise_budget is not None
        limit = free if is_strict else MAX_BUDGET_FACTOR * free
        quiet = [candidate for candidate in front if self.noise_ratio(candidate) <= limit]
        if not quiet:
            raise self._too_noisy(front[0])
        return min(quiet, key=lambda candidate: max(self.noise_ratio(candidate), free) ** 2 * candidate.error)

    def _quietest(self, front: Sequence[Candidate]) -> Candidate:
        requirements, quietest = self.problem.requirements, front[0]
        if requirements.noise_budget is not None and self.noise_ratio(quietest) > requirements.noise_budget:
            raise self._too_noisy(quietest)
        return quietest

    def _too_noisy(self, quietest: Candidate) -> InfeasibleDesign:
        requirements, ratio = self.problem.requirements, self.noise_ratio(quietest)
        relaxations = [
            Relaxation("noise_budget", float(f"{1.005 * ratio:.3g}"), f"a noise_budget of {1.005 * ratio:.3g}")
        ]
        if requirements.sensor.bits is not None:
            more = int(np.ceil(np.log2(ratio / requirements.noise_target)))
            bits = (np.asarray(requirements.sensor.bits) + more).tolist()
            relaxations.append(Relaxation("sensor", bits, f"an encoder of {bits} bits"))
        frequency = requirements.natural_frequency
        where = "" if frequency is None else f" at {frequency:g} rad/s"
        return infeasible_design(
            f"noise_budget: needed {100 * ratio:.3g} % of the torque limit, the least of all certified loops{where}; "
            f"available {100 * requirements.noise_target:.3g} %",
            relaxations,
        )

    def slowest(self) -> Candidate:
        """Return the feasible loop whose torque changes least from period to period by noise."""
        return min((loop for loop in self.candidates if loop.feasible), key=lambda loop: loop.change)

    def too_fast(self, torque_rate: np.ndarray, limits: np.ndarray) -> InfeasibleDesign:
        """Return the error where every loop tried changes its torque faster (n,) than the limits (n,) allow."""
        requirements = self.problem.requirements
        joint = int(np.argmax(torque_rate / limits))
        ratio = torque_rate[joint] / limits[joint]
        rate = float(f"{1.005 * torque_rate[joint]:.3g}")
        unit = self.problem.plants[0].torque_units[joint]
        relaxations = [Relaxation("torque_rate", rate, f"a torque_rate of {rate:g} {unit}/s")]
        if requirements.sensor.bits is not None:
            bits = (np.asarray(requirements.sensor.bits) + int(np.ceil(np.log2(ratio)))).tolist()
            relaxations.append(Relaxation("sensor", bits, f"an encoder of {bits} bits"))
        return infeasible_design(
            f"torque_rate: the slowest of the loops tried reached {torque_rate[joint]:.4g} {unit}/s at "
            f"{self.problem.plants[0].joint_names[joint]} in its trial run; available {limits[joint]:.4g} {unit}/s",
            relaxations,
        )

    def _no_feasible_loop(self) -> InfeasibleDesign:
        available = max((candidate.max_spread for candidate in self.candidates), default=1.0)
        frequency = self.problem.requirements.natural_frequency
        where = "" if frequency is None else f" at {frequency:g} rad/s"
        needed = (1 + MIN_SPREAD_MARGIN) * self.spec.spread
        cause = ", but not together with gravity and motion" if available >= needed else ""
        relaxations = suggest_changes(self.problem, self.shape, self.spec, self.candidates, MIN_SPREAD_MARGIN)
        return infeasible_design(
            f"design: nothing can be certified{where}. The eigenvalues of M(q)⁻¹M̂ spread by {self.spec.spread:.3g}, "
            f"which requires a loop that tolerates {needed:.3g}, a margin of {100 * MIN_SPREAD_MARGIN:.0f} % included; "
            f"the loops tolerate at most {available:.3g}{cause}",
            relaxations,
        )
