"""What a design with M̂(q) takes from a robot's model: its uncertainty, M̂(q) and what loops must tolerate."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from tarc.analysis.workspace import Workspace
from tarc.certificates.known_forces import known_ratios
from tarc.certificates.known_inertia import certify_known_inertia
from tarc.certificates.known_inertia_evidence import KNOWN_PARTS, KnownInertiaEvidence
from tarc.certificates.known_points import WorstKnownPoints
from tarc.core.errors import InvalidParameter
from tarc.design.affine_assessment import AffineAssessment, scaled_ratios
from tarc.design.candidates import Candidate
from tarc.design.choice import DesignChoice
from tarc.design.link_lengths import robots_with_lengths
from tarc.design.noise import measurement_deviation
from tarc.design.problem import DesignProblem
from tarc.design.requirements import DesignRequirements
from tarc.design.robustness import RobustnessSpec
from tarc.estimators.algebraic import Algebraic
from tarc.laws.nominal_inertia import MAX_FRACTION, Feedforward, NominalInertia
from tarc.laws.tdc import TDC
from tarc.plants.base import Plant
from tarc.plants.symbolic import SymbolicPlant

PAYLOAD_SHARES = 0.0, 0.25, 0.5
"""Payloads of the model that are tried, between the smallest and the largest."""
N_POSTURES = 100
"""Sampled postures at which the spread is compared."""
FIELDS = {"armature": "armature_error", "masses": "mass_error", "lengths": "length_error"}
"""Requirement by the parameter of the robot for which it is an interval."""
FRICTION = "coulomb", "viscous"
"""Friction parameters of a robot that a design can take as known."""


def uncertain_robots(
    plants: Sequence[Plant], requirements: DesignRequirements, workspace: Workspace
) -> tuple[Plant, ...]:
    """Return the robots at the ends of all intervals: payload, rotor inertia, masses and lengths of the links.

    M is linear in payload, rotor inertia and masses, and grows with them. So for robots within these intervals the
    eigenvalues of M⁻¹M̂ lie between those of the ends, and each link may have an error of its own.

    In lengths M is a convex polynomial of degree two, see `robots_with_lengths`. What lies between is left to the
    certificate's margin, and so are stiffness and damping.

    Raises
    ------
    InvalidParameter
        For an interval of a parameter that the robot does not have, and for lengths of too many links or too uncertain.
    """
    shares = {"armature": requirements.armature_error, "masses": requirements.mass_error}
    shares = {name: share for name, share in shares.items() if share}
    has_lengths = bool({"lengths", "length_factors"} & set(plants[0].parameters))
    missing = [name for name in shares if name not in plants[0].parameters]
    missing += ["lengths"] if requirements.length_error and not has_lengths else []
    for name in missing:
        raise InvalidParameter(
            f"{FIELDS[name]}: {plants[0].label} has no parameter {name}; leave it out, or use a robot from a file",
            FIELDS[name],
        )
    corners = list(product(*[(1 - share, 1 + share) for share in shares.values()]))
    robots = []
    for plant in plants:
        for factors in corners:
            values = {name: f * np.asarray(plant.parameters[name]) for name, f in zip(shares, factors, strict=True)}
            robots.append(plant.with_parameters(values) if values else plant)
    if requirements.length_error:
        robots = robots_with_lengths(robots, requirements.length_error, workspace, requirements.seed)
    return tuple(robots)


@dataclass(frozen=True, eq=False)
class KnownModel:
    """The model of a robot in a law, and what the true robots differ from it.

    Attributes
    ----------
    model
        The nominal robot M_m.
    robots
        The true robots, at the ends of all intervals.
    terms
        Options of `NominalInertia` besides model and fraction.
    worst
        Where the robots are worst for M̂(q) of this model.
    evidence
        Their ratios, rates and forces for M̂(q) = M_m(q).
    assessment
        Assessment of loops for M̂(q) = X(q), the multiple of M_m(q) with eigenvalues of M(q)⁻¹X(q) of 1 and above.
    row_norms
        Largest norm of each row of X(q) [kg m² or kg], weighted by the noise of the encoders, shape (n,).
    """

    model: SymbolicPlant
    robots: tuple[Plant, ...]
    terms: dict[str, Any]
    worst: WorstKnownPoints
    evidence: KnownInertiaEvidence
    assessment: AffineAssessment
    row_norms: np.ndarray

    @classmethod
    def from_problem(cls, problem: DesignProblem) -> "KnownModel":
        """Return the model and the robots of a problem.

        Raises
        ------
        InvalidParameter
            For a robot that is not in symbols, a singular M_m, dry friction without a width, and a workspace without
            speeds.
        """
        requirements, workspace = problem.requirements, problem.workspace
        terms = _terms(problem.plants[0], requirements)
        if workspace.speed is None or not np.all(np.isfinite(workspace.speed)):
            raise InvalidParameter(
                f"speed: model={requirements.model!r} needs the largest joint speed, which bounds how fast M̂(q) "
                "changes; give it, by --speed",
                "speed",
            )
        robots = uncertain_robots(problem.plants, requirements, workspace)
        postures = workspace.sample(N_POSTURES, requirements.seed)
        model = _best_model(problem.plants, robots, requirements, terms, postures)
        inertia = NominalInertia(model, 1.0, **terms)
        trial = TDC(
            inertia=inertia,
            natural_frequency=10.0,
            period=requirements.period,
            estimator=Algebraic(window=10 * requirements.period),
            actuation_delay=requirements.computation_delay,
        )
        worst = WorstKnownPoints.search(inertia, robots, workspace, requirements.samples, requirements.seed)
        evidence = certify_known_inertia(
            trial,
            robots,
            workspace,
            computation_delay=requirements.computation_delay,
            samples=requirements.samples,
            seed=requirements.seed,
            quick=True,
            worst=worst,
        ).evidence
        points = evidence.points
        linearised = [[getattr(point.robot, name) for point in points] for name in ("inertia", "damping", "stiffness")]
        known = [[getattr(point, name) for point in points] for name in KNOWN_PARTS]
        M, D, G, nominal, own = (np.array(part) for part in (*linearised, *known))
        ratios = known_ratios(evidence, (nominal, M, D, G + own, own))  # G without the model's own stiffness
        spec = RobustnessSpec.from_spread(evidence.ratio_spread)
        assessment = AffineAssessment(scaled_ratios(ratios, 1 / evidence.min_ratio), spec, requirements.slope_ratio)
        sigma = measurement_deviation(requirements.sensor, model.n_joints)
        weighted = model.inertia_matrices(postures.T) / evidence.min_ratio * sigma
        norms = np.linalg.norm(weighted, axis=2).max(axis=0) / np.where(sigma > 0, sigma, 1.0)
        return cls(model, robots, terms, worst, evidence, assessment, norms)

    @property
    def spread(self) -> float:
        """Largest over smallest eigenvalue of M(q)⁻¹M̂(q)."""
        return self.evidence.ratio_spread

    @property
    def shape(self) -> np.ndarray:
        """A diagonal matrix with the row norms of X(q) in its worst posture, for the torque noise, shape (n, n)."""
        return np.diag(self.row_norms)

    def fraction(self, loop: Candidate) -> float:
        """Return ρ of a loop, to four digits."""
        return min(float(f"{loop.inertia_scale / self.evidence.min_ratio:.4g}"), MAX_FRACTION)

    def law_options(self, loop: Candidate) -> dict[str, Any]:
        """Return M̂(q) and the feed-forward of a law."""
        options: dict[str, Any] = {"inertia": NominalInertia(self.model, self.fraction(loop), **self.terms)}
        if self.terms:
            off = {"gravity": False, "coriolis": False, "friction": False}
            options["feedforward"] = Feedforward(self.model, **off)
        return options

    def choice(self, loop: Candidate) -> DesignChoice:
        """Return the choice of M̂(q) with its reason."""
        parts = [name for name in ("gravity", "coriolis", "friction") if self.terms.get(name)]
        with_terms = f", with {', '.join(parts)} of the model and feed-forward of its inertia" if parts else ""
        ratios = self.fraction(loop) * self.evidence.min_ratio, self.fraction(loop) * self.evidence.max_ratio
        payload = float(np.squeeze(self.model.parameters.get("payload", 0.0)))
        return DesignChoice(
            ("law", "inertia"),
            "inertia",
            f"{self.fraction(loop):.4g} times M(q) of the model{with_terms}",
            f"over {len(self.robots)} robots at the ends of the intervals the eigenvalues of M(q)⁻¹M̂(q) lie between "
            f"{ratios[0]:.3g} and {ratios[1]:.3g}, a spread of {self.spread:.3g}; the model has {payload:.3g} kg at "
            "the tool, for which it is least",
        )


def _terms(plant: Plant, requirements: DesignRequirements) -> dict[str, Any]:
    """Return the options of `NominalInertia`: all terms for a known model, none for a known inertia."""
    if requirements.model == "inertia":
        return {}
    has_friction = any(np.any(plant.parameters.get(name, 0.0)) for name in FRICTION)
    terms: dict[str, Any] = {"gravity": True, "coriolis": True, "friction": has_friction}
    if has_friction and np.any(plant.parameters.get("coulomb", 0.0)):
        if requirements.friction_width is None:
            raise InvalidParameter(
                "friction_width: missing; model='known' has dry friction, whose sign is smoothed by tanh(q̇ᵈ/w). Give w "
                "[rad/s or m/s], such as 0.05, or model='inertia'",
                "friction_width",
            )
        terms["friction_width"] = requirements.friction_width
    return terms


def _best_model(
    plants: Sequence[Plant],
    robots: Sequence[Plant],
    requirements: DesignRequirements,
    terms: dict[str, Any],
    postures: np.ndarray,
) -> SymbolicPlant:
    """Return the nominal robot: of some payloads the one of least spread, with the low end of known friction."""
    low, high = requirements.payload
    known = 1 - requirements.friction_error
    friction = {name: known * np.asarray(plants[0].parameters[name]) for name in FRICTION if terms.get("friction")}
    masses = [low + share * (high - low) for share in PAYLOAD_SHARES] if high > low else [None]
    models = [plants[0].with_parameters({**friction, **({} if mass is None else {"payload": mass})}) for mass in masses]
    first = NominalInertia(models[0], 1.0, **terms)  # refuses what is no model
    assert isinstance(first.model, SymbolicPlant)
    inertias = [np.array([robot.inertia(posture) for posture in postures]) for robot in robots]

    def spread(model: Plant) -> float:
        nominal = np.array([model.inertia(posture) for posture in postures])
        ratios = np.array([np.linalg.eigvals(np.linalg.solve(M, nominal)).real for M in inertias])
        return float(ratios.max() / ratios.min())

    best = min(models, key=spread)
    assert isinstance(best, SymbolicPlant)
    return best
