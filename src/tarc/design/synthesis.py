"""From requirements and a robot to certified gains."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, TypedDict, overload

import numpy as np

from tarc.analysis.inertia_ratio import InertiaSpread, inertia_spread
from tarc.analysis.inertia_shape import best_inertia_shape
from tarc.certificates.base import Certificate
from tarc.certificates.known_inertia import certify_known_inertia
from tarc.certificates.robot import certify_robot, strengthen_robot
from tarc.certification import certify_law
from tarc.core.errors import InfeasibleDesign, InvalidParameter, UnsupportedLaw
from tarc.core.progress import Progress
from tarc.design.adaptation import Adaptation, choose_adaptation, expected_step
from tarc.design.affine_assessment import MAX_PROOFS, AffineAssessment
from tarc.design.assessment import assess_candidates
from tarc.design.candidates import Candidate, enumerate_candidates
from tarc.design.choice import DesignChoice
from tarc.design.infeasible import infeasible_design
from tarc.design.known_model import KnownModel
from tarc.design.link_lengths import with_lengths
from tarc.design.noise import torque_noise
from tarc.design.problem import DesignProblem, with_payloads
from tarc.design.reasons import explain_adaptation, explain_certificate, explain_inertia, explain_loop
from tarc.design.requirements import DesignRequirements
from tarc.design.result import Design
from tarc.design.robot_facts import GravityLoad, assumptions, gravity_load
from tarc.design.robustness import RobustnessSpec
from tarc.design.selection import MIN_SPREAD_MARGIN, LoopSelection
from tarc.design.stress import try_design
from tarc.laws.tarc import TARC
from tarc.laws.tdc import TDC
from tarc.laws.tde import TDE
from tarc.plants.base import Plant
from tarc.scenario.user_law import check_user_law, load_law

MAX_REFINEMENTS = 5
"""Most times that the neighbours of the best loop are assessed."""
EXTRA_MARGINS = (0.03, 0.06, 0.12, 0.25)
"""Additions to the margin where the certificate finds worse postures than those sampled."""
MAX_TRIALS = 5
"""Most designs that are tried against a limit of the torque's rate."""


@overload
def design_controller(
    plant: Plant, requirements: DesignRequirements | None = None, *, progress: bool | None = None
) -> Design: ...


@overload
def design_controller(plant: Plant, *, progress: bool | None = None, **keywords: Any) -> Design: ...


def design_controller(
    plant: Plant,
    requirements: DesignRequirements | None = None,
    *,
    progress: bool | None = None,
    **keywords: Any,
) -> Design:
    """Choose M̂, window, degree, natural frequency, delay, synchronisation and adaptation for a robot; certify them.

    The shape of M̂ minimises the spread of the eigenvalues of M(q)⁻¹M̂ over workspace and payload. Of the loops that
    tolerate this spread with a margin, the one of least error within a budget of torque noise is taken. Without a
    budget, at a given natural frequency, it is the one of least noise.

    Parameters
    ----------
    plant
        The robot. Its rotor inertia counts: without it, light links make the spread too large for any loop.
    requirements
        The requirements; None for those that the keywords give.
    progress
        Show a progress bar when it takes more than two seconds; None for when standard error is a terminal.
    keywords
        Parameters of `DesignRequirements`, instead of requirements.

    Returns
    -------
    Design
        Certified.

    Raises
    ------
    InfeasibleDesign
        When nothing can be certified; ``relaxations`` are the changes that admit a design.
    InvalidParameter
        For conflicting or missing requirements.
    """
    if requirements is None:
        requirements = DesignRequirements(**keywords)
    elif keywords:
        raise InvalidParameter(f"requirements: given together with {', '.join(keywords)}; use dataclasses.replace")
    if np.ptp(plant.command_gain) > 0:
        plant.require_fully_driven("a design")
        return _for_commands(plant, requirements, progress)
    if requirements.model != "none":
        return _with_model(plant, requirements, progress)
    problem = DesignProblem.from_plant(plant, requirements)
    load = gravity_load(problem.plants, problem.workspace, problem.torque_limits, requirements.seed)
    trials = _initial_candidates(requirements)
    with Progress("designing", len(trials) + 60 + 2 * MAX_PROOFS, progress) as bar:
        shape, spread = _inertia_shape(problem)
        spec = RobustnessSpec.from_robot(problem.plants, problem.workspace, shape, spread, seed=requirements.seed)
        bar.advance(20)
        assessed = assess_candidates(
            trials, spec, slope_ratio=requirements.slope_ratio, min_margin=MIN_SPREAD_MARGIN, done=bar.advance
        )
        selection = LoopSelection(problem, shape, spec, assessed)
        bar.advance(20)
        selection = _with_affine(selection, trials, spread, bar.advance)
        design = _slow_enough(selection, spread, load)
        bar.advance(20)
    return design


def _with_model(plant: Plant, requirements: DesignRequirements, progress: bool | None) -> Design:
    """Return the design with M̂(q) of a model."""
    problem = DesignProblem.from_plant(plant, requirements)
    load = gravity_load(problem.plants, problem.workspace, problem.torque_limits, requirements.seed)
    trials = _initial_candidates(requirements)
    with Progress("designing with a model", 30 + 4 * MAX_PROOFS, progress) as bar:
        known = KnownModel.from_problem(problem)
        bar.advance(20)
        selection = LoopSelection(problem, known.shape, known.assessment.spec, [])
        selection = _with_best(selection, known.assessment, trials, bar.advance)
        if not selection.has_feasible:
            raise infeasible_design(
                f"design: no loop with M̂(q) was found for eigenvalues of M(q)⁻¹M̂(q) that spread by {known.spread:.3g}; "
                "use a lower speed, smaller intervals, a higher control rate, or more noise_budget",
                [],
            )
        design = _complete_with_model(selection, known, load)
        bar.advance(10)
    return design


def _complete_with_model(selection: LoopSelection, known: KnownModel, load: GravityLoad | None) -> Design:
    """Certify the best loop with M̂(q), or the next ones where it is not certified, and return the design."""
    problem = selection.problem
    requirements, sampling = problem.requirements, _sampling(problem.requirements)
    while True:
        best = selection.pick()
        law, adaptation = _build_law(problem, known.law_options(best), best)
        certificate = certify_known_inertia(law, known.robots, problem.workspace, worst=known.worst, **sampling)
        certificate = with_lengths(certificate, known.robots[0], requirements.length_error)
        if certificate.certified:
            break
        selection = replace(selection, candidates=[loop for loop in selection.candidates if loop != best])
        if not selection.has_feasible:
            raise InfeasibleDesign(
                f"design: the loop with M̂(q) is {certificate.verdict} on the robot; use more samples, a lower speed "
                "or smaller intervals"
            )
    given = assumptions(
        problem.plants, problem.workspace, problem.torque_limits, load, own=requirements.torque_limits is None
    )
    reasons = [known.choice(best), *explain_loop(selection, best)]
    if adaptation is not None:
        reasons += explain_adaptation(best, *adaptation)
    return Design(
        requirements=requirements,
        law=law,
        plants=problem.plants,
        workspace=problem.workspace,
        certificates={"robot": certificate},
        choices=(*given, *reasons),
        shape=selection.shape,
        spread=known.spread,
        candidates=tuple(selection.candidates),
        candidate=best,
        torque_noise=torque_noise(best.noise, selection.shape, requirements.sensor),
    )


def _for_commands(plant: Plant, requirements: DesignRequirements, progress: bool | None) -> Design:
    """Return the design for inner loops whose gains differ: one of torques with a diagonal M̂, in units of commands."""
    gain = plant.command_gain
    given = {"torque_limits": requirements.torque_limits, "torque_rate": requirements.torque_rate}
    if given["torque_limits"] is None and np.all(np.isfinite(plant.torque_limits)):
        given["torque_limits"] = plant.torque_limits
    scaled = {name: None if value is None else np.asarray(value) * gain for name, value in given.items()}
    torques = replace(requirements, diagonal=True, **scaled)
    design = design_controller(plant.in_torque_units(), torques, progress=progress)
    limit = design.law.torque_limit
    law = replace(
        design.law,
        inertia=np.diag(design.law.M) / gain,
        torque_limit=None if limit is None else np.asarray(limit) / gain,
    )
    note = DesignChoice(
        ("law", "inertia"),
        "commands",
        "in the units of the joints' inner loops",
        "the gains of the loops differ, so M̂ is diagonal, and in these reasons a torque is a command times its gain: "
        f"{', '.join(f'{number:.4g}' for number in gain)}",
    )
    return replace(
        design,
        requirements=requirements,
        law=law,
        plants=with_payloads(plant, requirements.payload),
        choices=(*design.choices, note),
        shape=design.shape / gain[:, None],
        torque_noise=design.torque_noise / gain,
    )


def _slow_enough(selection: LoopSelection, spread: InertiaSpread, load: GravityLoad | None) -> Design:
    """Return the best design whose trial run keeps to the limits of the torque's rate.

    Where a run is too fast, a loop is tried whose torque changes less by noise, down to the slowest. What is tried does
    not depend on the limits, so that a rate that was reached is one that admits a design.
    """
    limits = selection.problem.torque_rates
    if not np.any(np.isfinite(limits)):
        return _complete(*_refine(selection), spread, load)
    reached: list[np.ndarray] = []
    for trials_left in reversed(range(MAX_TRIALS)):
        selection, best = _refine(selection)
        design = _complete(selection, best, spread, load)
        rate = try_design(design).torque_rate
        if not np.any(rate > limits):
            return _with_rate(design, rate)
        reached.append(rate)
        change, least = design.candidate.change, selection.slowest().change
        if trials_left:
            selection = replace(selection, max_change=change * (least / change) ** (1 / trials_left))
    raise selection.too_fast(min(reached, key=lambda rate: np.max(rate / limits)), limits)


def _with_rate(design: Design, rate: np.ndarray) -> Design:
    """Return a design with the torque rate of its trial run among its choices."""
    plant = design.plants[0]
    joint = int(np.argmax(rate))
    choice = DesignChoice(
        ("torque_limits",),
        "torque rate",
        f"at most {rate[joint]:.4g} {plant.torque_units[joint]}/s, at {plant.joint_names[joint]}",
        "reached in the trial run, on the motion of the scenario; it is no bound for other motions, on which the "
        "limit cuts the torque",
    )
    return replace(design, choices=(*design.choices, choice))


def _complete(selection: LoopSelection, best: Candidate, spread: InertiaSpread, load: GravityLoad | None) -> Design:
    """Certify the best loop and return its design."""
    problem = selection.problem
    requirements = problem.requirements
    best, law, adaptation, certificate = _certified_law(selection, best)
    certificates = certify_law(
        law, problem.plants, problem.workspace, **_sampling(requirements), robot_certificate=certificate
    ).certificates
    own_limits = requirements.torque_limits is None
    given = assumptions(problem.plants, problem.workspace, problem.torque_limits, load, own=own_limits)
    reasons = [explain_inertia(selection, best, spread), *explain_loop(selection, best)]
    if adaptation is not None:
        reasons += explain_adaptation(best, *adaptation)
    reasons.append(explain_certificate(certificate))
    return Design(
        requirements=requirements,
        law=law,
        plants=problem.plants,
        workspace=problem.workspace,
        certificates=certificates,
        choices=(*given, *reasons),
        shape=selection.shape,
        spread=spread.ratio,
        candidates=tuple(dict.fromkeys([*selection.candidates, best])),
        candidate=best,
        torque_noise=torque_noise(best.noise, selection.shape, requirements.sensor),
    )


def _initial_candidates(requirements: DesignRequirements) -> list[Candidate]:
    frequency = requirements.natural_frequency
    trials = enumerate_candidates(
        requirements.period,
        natural_frequencies=None if frequency is None else [frequency],
        damping_ratio=requirements.damping_ratio,
        computation_delay=requirements.computation_delay,
        windows=None if frequency is None else range(2, 31),
    )
    # literal loops of degree 3 have more noise and more error than others
    return [trial for trial in trials if trial.synchronised or trial.degree == 2]


def _inertia_shape(problem: DesignProblem) -> tuple[np.ndarray, InertiaSpread]:
    """Return X, so that the eigenvalues of M(q)⁻¹X are 1 and above, and their spread before this scaling."""
    requirements = problem.requirements
    shape, _ = best_inertia_shape(
        problem.plants,
        problem.workspace,
        samples=requirements.samples,
        diagonal=requirements.diagonal,
        tolerance=0.03,
        seed=requirements.seed,
    )
    spread = inertia_spread(
        problem.plants, shape, problem.workspace, samples=requirements.samples, seed=requirements.seed
    )
    return shape / spread.min_ratio, spread


class _Sampling(TypedDict):
    """Options of the certificates of a robot."""

    computation_delay: int
    samples: int
    seed: int


def _sampling(requirements: DesignRequirements) -> _Sampling:
    return {
        "computation_delay": requirements.computation_delay,
        "samples": requirements.samples,
        "seed": requirements.seed,
    }


def _refine(selection: LoopSelection) -> tuple[LoopSelection, Candidate]:
    """Assess the neighbours of the best loop until none is better; those of an affine one are assessed already."""
    best = selection.pick()
    assessed: set[Candidate] = set()
    for _ in range(0 if best.is_affine else MAX_REFINEMENTS):
        trials = [trial for trial in _neighbours(selection, best) if trial not in assessed]
        assessed.update(trials)
        neighbours = _assess_neighbours(selection, trials, MIN_SPREAD_MARGIN)
        selection = replace(selection, candidates=[*selection.candidates, *neighbours])
        previous, best = best, selection.pick()
        if best == previous:
            break
    return selection, best


def _with_affine(
    selection: LoopSelection, trials: Sequence[Candidate], spread: InertiaSpread, done: Callable[[], object]
) -> LoopSelection:
    """Add the best loop that a Lyapunov function affine in the inertia certifies, if any is better; then a neighbour.

    It needs a workspace with speeds.
    """
    problem = selection.problem
    if problem.workspace.speed is None or not np.all(np.isfinite(problem.workspace.speed)):
        return selection
    affine = AffineAssessment.from_robot(problem, selection.shape, spread, selection.spec)
    return _with_best(selection, affine, trials, done)


def _with_best(
    selection: LoopSelection, affine: AffineAssessment, trials: Sequence[Candidate], done: Callable[[], object]
) -> LoopSelection:
    """Add the best loop that is proven, if any is better than those that are there; then the best neighbour."""
    found = affine.best(trials, selection, done)
    selection = selection.with_proofs(found)
    if found:
        selection = selection.with_proofs(affine.best(_neighbours(selection, selection.pick()), selection, done))
    return selection


def _neighbours(selection: LoopSelection, best: Candidate) -> list[Candidate]:
    """Return the neighbours of a loop, closer than the grid."""
    frequencies = [best.natural_frequency]
    if selection.problem.requirements.natural_frequency is None:
        frequencies = [float(f"{factor * best.natural_frequency:.3g}") for factor in (0.85, 1.0, 1.18)]
    windows = {window for window in (best.window - 1, best.window, best.window + 1) if window >= best.degree}
    return enumerate_candidates(
        best.period,
        natural_frequencies=frequencies,
        windows=sorted(windows),
        degrees=[best.degree],
        delays=[best.delay],
        synchronised=[best.synchronised],
        damping_ratio=best.damping_ratio,
        computation_delay=best.computation_delay,
    )


def _assess_neighbours(selection: LoopSelection, trials: Sequence[Candidate], min_margin: float) -> list[Candidate]:
    slope_ratio = selection.problem.requirements.slope_ratio
    return assess_candidates(trials, selection.spec, slope_ratio=slope_ratio, min_margin=min_margin, exhaustive=True)


def _certified_law(
    selection: LoopSelection, best: Candidate
) -> tuple[Candidate, TDC | TARC, tuple[Adaptation, float] | None, Certificate]:
    """Return the best loop whose law is certified; its margin grows where the certificate finds worse postures."""
    problem = selection.problem

    def certify(law: TDC | TARC, loop: Candidate) -> Certificate:
        sampling = _sampling(problem.requirements)
        certificate = certify_robot(law, problem.plants, problem.workspace, **sampling)
        if certificate.certified:
            return certificate
        proof = selection.proofs.get(loop)
        start = None if proof is None or proof.ratios.form is None else proof
        return strengthen_robot(certificate, law, problem.plants, problem.workspace, **sampling, start=start)

    def build(best: Candidate) -> tuple[TDC | TARC, tuple[Adaptation, float] | None]:
        return _build_law(problem, {"inertia": best.inertia_scale * selection.shape}, best)

    law, adaptation = build(best)
    certificate = certify(law, best)
    while best.is_affine and not certificate.certified:
        selection = replace(selection, candidates=[loop for loop in selection.candidates if loop != best])
        best = selection.pick()
        law, adaptation = build(best)
        certificate = certify(law, best)
    for extra in EXTRA_MARGINS:
        if certificate.certified:
            break
        margin = MIN_SPREAD_MARGIN + extra
        candidates = _assess_neighbours(selection, _neighbours(selection, best), margin)
        candidates += [candidate for candidate in selection.candidates if candidate.spread_margin >= margin]
        if not any(candidate.feasible for candidate in candidates):
            break
        best = replace(selection, candidates=candidates).pick()
        law, adaptation = build(best)
        certificate = certify(law, best)
    if not certificate.certified:
        raise InfeasibleDesign(
            f"design: the loop of sufficient spread is {certificate.verdict} on the robot, margin "
            f"{certificate.margin:.3g}; use more samples, or a smaller workspace"
        )
    return best, law, adaptation, certificate


def _build_law(
    problem: DesignProblem, inertia: dict[str, Any], best: Candidate
) -> tuple[TDC | TARC, tuple[Adaptation, float] | None]:
    """Return the law of a loop with M̂ or M̂(q); for TARC also its adaptation and the expected step [rad/s²]."""
    options = {**best.law_options(), **inertia, "estimator": best.estimator}
    if np.isfinite(problem.torque_limits).any():
        options["torque_limit"] = problem.torque_limits
    if problem.requirements.has_own_law:
        return _own_law(problem.requirements.law, options), None
    if problem.requirements.law == "TDC":
        return TDC(**options), None
    step = expected_step(problem.plants, problem.workspace)
    adaptation = choose_adaptation(best, step, noise=float(np.linalg.norm(problem.sigma)))
    return TARC(**{**options, **adaptation.law_options()}), (adaptation, step)


def _own_law(kind: str, options: dict[str, Any]) -> Any:
    """Return a law from a user's own file, with the gains of a loop.

    Raises
    ------
    UnsupportedLaw
        For a law without time-delay estimation, for which no loop is known.
    """
    own = load_law(kind, "law")
    if not issubclass(own, TDE):
        raise UnsupportedLaw(f"law: {own.__name__} extends no time-delay estimation; a design needs a subclass of TDE")
    law: TDE = own(**options)
    check_user_law(law, "law")
    return law
