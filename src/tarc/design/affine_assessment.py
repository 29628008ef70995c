"""Loops that a Lyapunov function affine in the inertia certifies, beyond those that balls certify."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from tarc.analysis.inertia_rate import max_rate_point
from tarc.analysis.inertia_ratio import InertiaSpread
from tarc.analysis.operating_points import UncertaintySamples
from tarc.analysis.uncertain_loop import UncertainLoop
from tarc.analysis.worst_points import SampledPoints
from tarc.certificates.affine import AffineProof, find_proof
from tarc.certificates.affine_cover import force_points, robot_ratios
from tarc.certificates.affine_form import RatioSet
from tarc.certificates.robot_evidence import MaxRatePoint
from tarc.design.assessment import LoopMargins, at_scale
from tarc.design.candidates import Candidate
from tarc.design.problem import DesignProblem
from tarc.design.robustness import RobustnessSpec
from tarc.design.selection import LoopSelection

FIRST_SCALE = 0.7
"""The one that is tested first; a loop that decays too slowly there is not tried."""
SCALES = 0.4, 0.5, 0.6, 0.7, 0.8, 0.9
"""Scales of M̂ that are tried, on the logarithmic scale between those that constant ratios admit."""
MAX_SCALES = 2
"""Largest number of scales per loop, from the least that decays fast enough."""
MIN_DECAY = 0.45
"""Least decay rate of the slowest constant ratio, stiffness and damping, over the relative rate of the inertia. Of
40 loops of a UR5e the certificate failed below 0.45 and held above 0.6, up to the highest natural frequencies. With
M̂(q), whose rate counts twice, it failed below 0.41 and held above, literal loops above 0.8."""
N_RATIOS = 4
"""Number of ratios at which the decay rate is computed."""
MAX_PROOFS = 5
"""Most loops of a list for which a Lyapunov function is searched."""


LOWER_SLOPE = 0.25
"""Slope of the robust term, over the largest, that is tried where the largest has no proof. Of five loops of a TIAGo
with viscous friction none was proven with the largest, and two without."""
MAX_PROGRAMS = 3
"""Most semidefinite programs per loop; most proofs need one or two."""
MAX_FORM_PROGRAMS = 2
"""The same with a form of the forces, whose programs take longer."""
ORDERS = (14,)
"""Numbers of states to which a loop is reduced; the certificate of the chosen one tries more."""


def scaled_ratios(ratios: RatioSet, scale: float) -> RatioSet:
    """Return what a Lyapunov function must tolerate for M̂ of another scale.

    E is proportional to the scale, E⁻¹ and its rate to the inverse, and ‖E^−p [H, C/θ]‖ to its power −p.
    """
    return replace(
        ratios,
        min_ratio=scale * ratios.min_ratio,
        max_ratio=scale * ratios.max_ratio,
        rate=ratios.rate / scale,
        stiffness=ratios.stiffness * scale**-ratios.powers,
    )


@dataclass(frozen=True, eq=False)
class AffineAssessment:
    """Assessment of loops by the affine certificate.

    Attributes
    ----------
    ratios
        What a Lyapunov function must tolerate for M̂ = X.
    spec
        The robustness that the robot requires.
    slope_ratio
        Largest slope of the robust term over K1.
    samples
        Operating points for M̂ = X, whose forces a form covers in place of the norms in the ratios; None for norms.
    """

    ratios: RatioSet
    spec: RobustnessSpec
    slope_ratio: float
    samples: UncertaintySamples | None = None

    @classmethod
    def from_robot(
        cls, problem: DesignProblem, shape: np.ndarray, spread: InertiaSpread, spec: RobustnessSpec
    ) -> "AffineAssessment":
        """Return the assessment for a robot whose workspace has speeds.

        Parameters
        ----------
        problem
            The requirements on the robot.
        shape
            X [kg m² or kg], shape (n, n), with eigenvalues of M(q)⁻¹X of 1 and above.
        spread
            Their spread.
        spec
            The robustness that the robot requires.
        """
        plants, workspace, requirements = problem.plants, problem.workspace, problem.requirements
        scaled = replace(spread, min_ratio=1.0, max_ratio=spread.ratio)
        sampled = SampledPoints.from_robot(plants, scaled, shape, workspace, spread.samples, requirements.seed)
        found = [
            max_rate_point(plants, nominal, workspace, spread.samples, requirements.seed) for nominal in (shape, None)
        ]
        points = tuple(MaxRatePoint.from_point(point, workspace) for point in found)
        ratios, norms, sampled = robot_ratios(scaled, sampled, points, requirements.period)
        return cls(ratios, spec, requirements.slope_ratio, sampled.uncertainty if len(norms) else None)

    @property
    def min_rate(self) -> float:
        """Relative rate of the inertia, and twice that of M̂(q) [1/s], with which a decay rate is compared."""
        return self.ratios.relative_rate + 2 * self.ratios.nominal_rate

    def candidates(self, loops: Sequence[Candidate]) -> list[Candidate]:
        """Return loops whose Lyapunov function is worth a search, each at the scales that are tried."""
        return [candidate for loop in loops for candidate in self._scaled(loop)]

    def _scaled(self, loop: Candidate) -> list[Candidate]:
        slope, spread = self.slope_ratio * loop.natural_frequency**2, self.spec.spread
        low, high = LoopMargins.from_candidate(loop, self.spec, slope, 0.0).constant_ratio_interval()
        low, high = low / self.ratios.min_ratio, high / self.ratios.max_ratio
        if not low < high:
            return []
        matrices = loop.channel().closed_loop(0.0)[:3]

        def is_fast(share: float) -> bool:
            return self.decay_rate(matrices, low * (high / low) ** share) >= MIN_DECAY * self.min_rate

        if not is_fast(FIRST_SCALE):
            return []
        margin = self.ratios.max_ratio / (self.ratios.min_ratio * spread) - 1
        loop = replace(loop, robust_slope=slope, required_spread=spread, max_spread=spread, is_affine=True)
        shares = islice((share for share in SCALES if share == FIRST_SCALE or is_fast(share)), MAX_SCALES)
        found = [at_scale(loop, low * (high / low) ** share, margin) for share in shares]
        return [candidate for candidate in found if np.isfinite(candidate.noise) and np.isfinite(candidate.error)]

    def decay_rate(self, matrices: tuple[np.ndarray, np.ndarray, np.ndarray], scale: float) -> float:
        """Return the slowest decay rate [1/s] at constant ratios, with stiffness or damping of either sign.

        The certificate needs a positive one, since it covers these constants.

        Parameters
        ----------
        matrices
            A, B, C of the loop, opened at its inertia ratio.
        scale
            Scale of M̂.
        """
        A, B, C = matrices
        ratios = scaled_ratios(self.ratios, scale)
        rows = []
        for ratio in np.geomspace(ratios.min_ratio, ratios.max_ratio, N_RATIOS):
            bounds = ratios.stiffness * ratio**ratios.powers
            stiffness = float(np.min(bounds, initial=np.inf)) if len(bounds) else 0.0
            damping = float(np.min(bounds * ratios.lead_times)) / ratios.period if len(bounds) else 0.0
            for column, force in ((0, 0.0), (0, stiffness), (0, -stiffness), (1, damping), (1, -damping)):
                row = ratio * C
                row[0, column] -= force
                rows.append(row)
        radius = np.abs(np.linalg.eigvals(A + B @ np.array(rows))).max()
        return -float(np.log(radius)) / ratios.period

    def proof(self, loop: Candidate, on_program: Callable[[], object] = lambda: None) -> AffineProof | None:
        """Return a Lyapunov function for a loop at its scale; None where none is found and proven."""
        uncertain = UncertainLoop.from_channel(loop.channel(), loop.robust_slope, intersample=True)
        ratios, forces, max_programs = scaled_ratios(self.ratios, loop.inertia_scale), None, MAX_PROGRAMS
        if self.samples is not None:
            ratios, max_programs = ratios.without_norms(), MAX_FORM_PROGRAMS
            forces = force_points(self.samples.for_scaled_inertia(loop.inertia_scale))
        delay = loop.computation_delay
        options = {"orders": ORDERS, "max_programs": max_programs, "computation_delay": delay}
        return find_proof(uncertain, ratios, on_program, forces=forces, first=True, **options)

    def best(
        self, loops: Sequence[Candidate], selection: LoopSelection, done: Callable[[], object]
    ) -> dict[Candidate, AffineProof]:
        """Return the loop of least cost that is proven, if it costs less than the one that the selection picks.

        Parameters
        ----------
        loops
            As `enumerate_candidates` gives them.
        selection
            Loops that are certified otherwise.
        done
            Called after each search for a Lyapunov function, to show progress.
        """
        best = selection.pick() if selection.has_feasible else None
        limit = np.inf if best is None else selection.cost(best)
        pending = sorted((loop for loop in self.candidates(loops) if selection.cost(loop) < limit), key=selection.cost)
        slopes = [1.0, LOWER_SLOPE] if self.slope_ratio else [1.0]
        if best is not None and best.is_affine and self.slope_ratio:
            slopes = [best.robust_slope / (self.slope_ratio * best.natural_frequency**2)]
        for _ in range(2 * MAX_PROOFS if best is None else MAX_PROOFS):
            if not pending:
                break
            first = pending[0]
            for share in slopes:
                trial = replace(first, robust_slope=share * first.robust_slope)
                proof = self.proof(trial)
                done()
                if proof is not None:
                    return {trial: proof}
            slopes = slopes[-1:]  # loops that cost more fail at the largest slope as well, with few exceptions
            pending = [loop for loop in pending[1:] if not _is_harder(loop, first)]
        return {}


def _is_harder(loop: Candidate, other: Candidate) -> bool:
    """Return whether a loop has at least the window and natural frequency of another of its kind."""
    is_same = (loop.degree, loop.delay, loop.synchronised) == (other.degree, other.delay, other.synchronised)
    return is_same and loop.window >= other.window and loop.natural_frequency >= other.natural_frequency
