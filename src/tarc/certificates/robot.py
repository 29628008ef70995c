"""The verdict for a robot: the spread of its inertia over a workspace against what the loop bears."""

from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import numpy as np

from tarc.analysis.inertia_ratio import InertiaSpread, inertia_spread
from tarc.analysis.linearise import Channel, alike, decouple, whole
from tarc.analysis.operating_points import (
    NEGLIGIBLE,
    Instant,
    Mismatches,
    fastest,
    in_nominal,
    inertia_slopes,
    mismatches,
    rates,
    sampled,
    searched,
    tangent,
    with_stiffest,
)
from tarc.analysis.rest_stability import _at_rest, _growing
from tarc.analysis.stability import Witness
from tarc.analysis.uncertain_loop import Parts, Responses, parts_of
from tarc.analysis.workspace import Workspace
from tarc.certificates.base import JUDGES, Certificate, dict_certificate
from tarc.certificates.iqc import best_multiplier
from tarc.certificates.varying_ratio import Evidence, best_centre, recorded, widest
from tarc.certificates.varying_ratio import judge as judge_ball
from tarc.core.errors import TarcError
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.laws.pole_placement import PolePlacement
from tarc.laws.tarc import TARC
from tarc.numerics.matrix_tests import schur
from tarc.plants.base import Plant


def certify_robot(
    law: Law,
    plant: Plant | Sequence[Plant],
    workspace: Workspace,
    *,
    computation_delay: int = 0,
    samples: int = 2000,
    seed: int = 0,
) -> Certificate:
    """Certify a law on a robot: however its posture changes inside a workspace, and however fast, or within a speed.

    A small error about a motion obeys, in coordinates x = M̂^½ q, ẍ = E v − H x − C ẋ with E = M̂^½ M⁻¹ M̂^½ and

        H = M̂^½ M⁻¹ (∂(M q̈ + N)/∂q) M̂^−½,    C = M̂^½ M⁻¹ (∂N/∂q̇) M̂^−½,

    the stiffness and damping that gravity, springs and the motion itself make. Certified if the robust ball, of all
    ‖[E − ρ0 I, H/η, C/(η θ)]‖ ≤ δ with the weight η and the lead θ that leave it the most room, holds those of all
    postures of the workspace, together with every slope of the robust term up to that at its cap. Where the workspace
    has a speed, they are those of all motions up to it and its acceleration, and the ball is that for ‖dE⁻¹/dt‖ up to
    the greatest at this speed, which holds far more. Without a speed E may change at any rate, and of H and C there is
    only what is there at rest. Refuted if in one of the worst postures the robot held at rest, linearised with its
    inertia, gravity and viscous friction, is unstable. Inconclusive between the two, and for gains that differ between
    the joints, which the ball does not cover.

    Parameters
    ----------
    law
        A law on time-delay estimation.
    plant
        The robot, or several, such as one without and one with its payload.
    workspace
        The postures that it takes.
    computation_delay
        Periods between a measurement and its torque.
    samples, seed
        Of the workspace; local searches start from the best samples.

    Returns
    -------
    Certificate
        Its matrices hold ``posture_low``, ``posture_high`` and ``posture_stiff`` (n,), where the least and the greatest
        ratio and the greatest stiffness at rest were found, with the robot linearised there, and ``posture_moving``
        with ``velocity_moving`` and ``acceleration_moving`` where a motion asks for the widest ball; its numbers the
        ratios (``least ratio``, ``greatest ratio``), their ``spread``, the ``stiffness`` ‖[H, C/θ]‖ [1/s²], how many
        ``samples`` were taken, the ball's centre and radius, and with a speed the ``rate`` ‖dE⁻¹/dt‖ [1/s] that it may
        reach, in ``posture_fast``. The margin is the ball's radius over the one that is needed, less 1; where refuted,
        1 less the spectral radius.

    Raises
    ------
    TarcError
        For joints that do not match, a singular inertia matrix, a law without an inertia.
    """
    if not isinstance(law, PolePlacement):
        raise TarcError(f"law: got {type(law).__name__}; the robot certificate needs a law with an inertia M̂")
    plants = [plant] if isinstance(plant, Plant) else list(plant)
    found = inertia_spread(plants, law.M, workspace, samples=samples, seed=seed)
    ends = (plants[found.min_plant], found.min_posture), (plants[found.max_plant], found.max_posture)
    units = workspace.units(min(samples, STIFF_SAMPLES), seed)
    instants = [Instant.at_rest(*one) for one in ends]
    instants += sampled(plants, workspace, min(samples, STIFF_SAMPLES), seed)
    mismatch = mismatches(law.M, instants)
    bounded = bool(np.isfinite(law.robust_slope_bound))
    slope = law.robust_slope_bound if bounded else 0.0
    matrices = {"nominal": law.M}
    numbers = {"period": law.period, "alike": float(alike(law)), "bounded": float(bounded)}
    step, lead, weight, centre = None, 0.0, 0.0, 1.0
    if numbers["alike"]:
        channel, moving = decouple(law, computation_delay)[0], {}
        if workspace.speed is not None:
            fast = fastest(plants, law.M, workspace, min(samples, STIFF_SAMPLES), seed)
            slopes = inertia_slopes(fast.plant, fast.position)
            moving = {"posture_fast": fast.position, "slopes_fast": slopes, "speed": workspace.speed}
            step = law.period * float(rates(law.M, slopes[None], workspace.speed)[0])
        plain = parts_of(channel, slope, intersample=True)
        tries = {best_centre(plain, (found.min_ratio, found.max_ratio), step), (found.min_ratio + found.max_ratio) / 2}
        instants, mismatch = hardest(min(tries), instants, mismatch, law.M, workspace, units)
        best, evidence, radius = best_ball(channel, slope, tries, mismatch, step)
        step, lead, weight, centre = best.step, best.lead, best.weight, best.centre
        if weight:  # once more, for the very ball
            instants, mismatch = searched(instants, mismatch, workspace, units, law.M, centre, weight, lead)
        parts = parts_of(channel, slope, intersample=True, lead=lead / law.period)
        evidence_matrices, evidence_numbers = recorded(evidence)
        matrices |= parts._asdict() | evidence_matrices | ({} if step is None else moving)
        numbers |= {"centre": best.centre, "radius": radius, "weight": best.weight} | evidence_numbers
        numbers |= {} if step is None else {"step": step, "rate": step / law.period}
    else:
        loop = whole(law, computation_delay).around(0.0)[:3]
        matrices |= dict(zip(Parts._fields[:3], loop, strict=True))
    numbers["stiffness"] = float(mismatch.sizes(lead).max())
    resting, swift = ([one.moves == way for one in instants] for way in (False, True))
    sizes, norms = mismatch.sizes(lead), mismatch.joint_norms(centre, weight, lead) if weight else mismatch.sizes(lead)
    for name, which, values in (
        ("stiff", resting, sizes),
        ("joint", resting, norms),
        ("swift", swift, sizes),
        ("moving", swift, norms),
    ):
        if any(which):
            matrices |= _described(name, instants[int(np.argmax(np.where(which, values, -1.0)))])
    for name, one in zip(("low", "high"), instants, strict=False):
        matrices |= _described(name, one)
    verdict, margin, witness = judge(matrices, numbers)
    numbers |= {
        "least ratio": found.min_ratio,
        "greatest ratio": found.max_ratio,
        "spread": found.ratio,
        "slope": slope,
    }
    numbers["samples"] = float(found.samples)
    return dict_certificate(
        kind="robot",
        claim=f"{type(law).__name__} keeps the robot stable however it moves in the workspace"
        + ("." if workspace.speed is None else ", at the joints' speeds and accelerations given or less."),
        problem=(
            "‖[E − ρ0 I, H/η, C/(η θ)]‖ ≤ δ for all motions in the workspace, ‖dE⁻¹/dt‖ within a rate, and a ball of "
            "radius δ that the loop bears at this rate"
            if step is not None
            else "‖[E − ρ0 I, H/η, C/(η θ)]‖ ≤ δ < 1/‖[T_v; η T_q; η θ T_q̇]‖∞ for all motions in the workspace"
        )
        + (f", with every slope of the robust term up to {slope:.4g} 1/s²" if slope else ""),
        verdict=verdict,
        margin=margin,
        margin_meaning="1 less the spectral radius in that posture"
        if verdict == "refuted"
        else "radius of the ball over the one needed, less 1",
        assumptions=_assumptions(law, found, numbers, workspace, computation_delay),
        matrices=matrices,
        numbers=numbers,
        witness=witness,
    )


def _described(name: str, one: Instant) -> dict[str, Array]:
    """An instant and the robot linearised there, as matrices of a certificate; with viscous friction at rest alone."""
    M, D, G = tangent(one) if one.moves else one.plant.linearised(one.position)
    found = {f"posture_{name}": one.position, f"inertia_{name}": M, f"damping_{name}": D, f"stiffness_{name}": G}
    moving = {f"velocity_{name}": one.velocity, f"acceleration_{name}": one.acceleration}
    return found | moving if one.moves else found


def _assumptions(
    law: PolePlacement, found: InertiaSpread, numbers: dict[str, float], workspace: Workspace, computation_delay: int
) -> tuple[str, ...]:
    def listed(values: Array) -> str:
        return "(" + ", ".join(f"{one:.3g}" for one in values) + ")"

    speed, acceleration = workspace.speed, workspace.acceleration
    lines = [
        f"the eigenvalues of M(q)⁻¹M̂ lie between {found.min_ratio:.4g}, found at q = {listed(found.min_posture)}, and "
        f"{found.max_ratio:.4g}, at {listed(found.max_posture)}; {found.samples} samples and local search found "
        f"no others",
        f"gravity and springs{'' if speed is None else ', and the motion itself,'} have a stiffness, in these "
        f"coordinates, of at most {numbers['stiffness']:.3g} 1/s², which with the inertia is taken from "
        f"{min(found.samples, STIFF_SAMPLES)} samples, the two postures above and local search",
        "the robot stays in the workspace; friction disturbs only, viscous friction apart where the robot is at rest; "
        "dry friction may hold back what is refuted",
        "no torque limit is reached and no sample is lost",
        f"the torque reaches the joints {computation_delay} periods late and is held for a period; over a period what "
        "stiffness and damping do is taken from the position and the mean velocity",
    ]
    if speed is None or acceleration is None:
        lines.append(
            "Coriolis forces disturb only: what stiffness and damping fast motion makes is left out, which a bound on "
            "the joints' speeds would count"
        )
    else:
        rate = numbers.get("rate")
        changes = (
            ""
            if rate is None
            else (
                f"; so M̂^−½ M M̂^−½ changes by at most {rate:.3g} 1/s, the greatest that samples and local search found"
            )
        )
        lines.append(
            f"no joint is faster than {listed(speed)} rad/s or m/s, or accelerates by more than {listed(acceleration)} "
            f"rad/s² or m/s²{changes}; the payload stays the same, or changes so seldom that the loop has settled in "
            "between"
        )
    if isinstance(law, TARC) and law.max_gain is None:
        lines.append("the gain has no cap, so that nothing bounds the robust term; give one to have it certified")
    elif not np.isfinite(law.robust_slope_bound):
        lines.append("left out: the robust term, which is no bounded slope over the error; without it the rest holds")
    if not alike(law):
        lines.append("gains that differ between the joints: only the loop at rest in the worst postures was tested")
    return tuple(lines)


def judge(matrices: dict[str, Array], numbers: dict[str, Any]) -> tuple[str, float, Witness | None]:
    """Verdict, margin and witness from the stored matrices: both worst postures at rest, then the ball."""
    loop = tuple(matrices[name] for name in Parts._fields[:3])
    least, greatest = np.inf, 0.0
    worst, witness = 1.0, None
    for name in RESTING:
        rest = tuple(matrices[f"{part}_{name}"] for part in ("inertia", "damping", "stiffness"))
        ratios = np.linalg.eigvals(np.linalg.solve(rest[0], matrices["nominal"])).real
        least, greatest = min(least, ratios.min()), max(greatest, ratios.max())
        answer, radius, mode = schur(_at_rest(loop, matrices["nominal"], rest, numbers["period"]))
        if answer == "refuted" and radius > worst:
            ratio = ratios.max() if name == "high" else ratios.min()
            worst, witness = radius, _growing(ratio, radius, mode, numbers["period"])
            witness["posture"] = matrices[f"posture_{name}"].tolist()
    if witness:
        return "refuted", float(1 - worst), witness
    if not numbers["alike"]:
        return "inconclusive", 0.0, None
    centre, weight, lead = numbers["centre"], numbers["weight"], matrices["lead"].item() * numbers["period"]
    needed = max(greatest - centre, centre - least)
    found = _kept(matrices)
    stiffest = float(found.sizes(lead).max())
    if not np.isfinite(lead) or (lead <= 0 and float(np.abs(found.damping).max()) > NEGLIGIBLE):
        return "inconclusive", 0.0, None
    if weight > 0:
        needed = max(needed, float(found.joint_norms(centre, weight, lead).max()))
    elif not stiffest <= NEGLIGIBLE:  # which the loop without its weight leaves out
        return "inconclusive", 0.0, None
    if "step" in numbers:
        rate = float(rates(matrices["nominal"], matrices["slopes_fast"][None], matrices["speed"])[0])
        more = rate * numbers["period"] / (1 + 1e-9) > numbers["step"]
        if more or not stiffest <= (1 + 1e-9) * numbers["stiffness"]:
            return "inconclusive", 0.0, None
    verdict, margin, _ = judge_ball(matrices, {**numbers, "needed": needed})
    return (verdict if numbers["bounded"] else "inconclusive"), margin, None


def _kept(matrices: dict[str, Array]) -> Mismatches:
    """The mismatches of the instants that a certificate holds, without the viscous friction of those at rest."""
    names = [*RESTING, *(name for name in MOVING if f"inertia_{name}" in matrices)]
    M, D, G = (np.array([matrices[f"{part}_{name}"] for name in names]) for part in ("inertia", "damping", "stiffness"))
    D[: len(RESTING)] = 0
    return in_nominal(matrices["nominal"], M, D, G)


RESTING, MOVING = ("low", "high", "stiff", "joint"), ("swift", "moving")
"""Names of the instants that a certificate holds: at rest of the least and the greatest ratio, the stiffest and that
which needs the widest ball; moving, the last two."""
LEADS = 0.5, 1.0
"""Leads that are tried, over that for which damping counts as much as stiffness."""
TRIALS = 4
"""Most balls that are tried on all frequencies."""
STIFF_SAMPLES = 500
"""Postures whose stiffness is computed; it changes little beside the inertia's eigenvalues."""


class Trial(NamedTuple):
    """A ball: its room, radius over the one needed, as a grid of frequencies has it; and what makes it."""

    room: float
    needed: float
    weight: float
    lead: float
    centre: float
    step: float | None


def hardest(
    centre: float, instants: list[Instant], found: Mismatches, nominal: Array, workspace: Workspace, units: Array
) -> tuple[list[Instant], Mismatches]:
    """Instants with their `mismatches`, and those that local searches add; the worst one moves with the weight."""
    for factor in LEADS if float(found.sizes(0.0).max()) > NEGLIGIBLE or found.lead() else ():
        lead = factor * found.lead()
        instants, found = with_stiffest(instants, found, workspace, units, nominal, lead)
    lead = found.lead()
    for weight in found.weights(centre, lead)[::2]:
        instants, found = searched(instants, found, workspace, units, nominal, centre, weight, lead)
    return instants, found


def best_ball(
    channel: Channel, slope: float, tries: Collection[float], found: Mismatches, step: float | None
) -> tuple[Trial, Evidence, float]:
    """The ball with the most room, what shows it, and its radius.

    Several are looked at: what holds on a grid of frequencies need not hold on all, and a ball for any speed may do
    better than one for a bounded speed.
    """
    leads = dict.fromkeys(factor * found.lead() for factor in LEADS)
    kinds = {lead: parts_of(channel, slope, intersample=True, lead=lead / channel.period) for lead in leads}
    trials = [
        one
        for centre in tries
        for lead, parts in kinds.items()
        for kind in {step, None}
        for one in best_weights(parts, centre, found, lead, kind)
    ]
    trials.sort(reverse=True, key=lambda one: one.room)
    best, evidence, radius = trials[0], None, -1.0
    for one in trials[:TRIALS]:
        if one.room > radius / best.needed:
            stiffness = float(found.sizes(one.lead).max())
            shown, reach = widest(kinds[one.lead], one.centre, one.weight, step=one.step, stiffness=stiffness)
            if reach / one.needed > radius / best.needed:
                best, evidence, radius = one, shown, reach
    return best, evidence, radius


def best_weights(parts: Parts, centre: float, found: Mismatches, lead: float, step: float | None = None) -> list[Trial]:
    """The weights η of the position beside v with the most room, the best first; zero where there is no stiffness.

    With a step E⁻¹ changes by no more than that in a period.
    """
    responses, stiffness = Responses(parts), float(found.sizes(lead).max())

    def radius(weight: float) -> float:
        if step is None:
            return responses.best(centre, weight)[1]
        return best_multiplier(parts, centre, step, weight=weight, stiffness=stiffness, responses=responses)[1]

    trials = []
    for weight in found.weights(centre, lead) or [0.0]:
        needed = found.needed(centre, weight, lead) if weight else max(found.needed(centre, np.inf), 0.1 * centre)
        trials.append(Trial(radius(weight) / needed, needed, weight, lead, centre, step))
    return sorted(trials, reverse=True, key=lambda one: one.room)[:2]


JUDGES["robot"] = judge
