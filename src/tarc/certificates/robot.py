"""The verdict for a robot: the spread of its inertia over a workspace against what the loop bears."""

from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from tarc.certificates.ball import Evidence, ball, best_centre, recorded, widest
from tarc.certificates.ball import judge as judge_ball
from tarc.certificates.base import JUDGES, Certificate, Witness, schur
from tarc.certificates.linear import Channel, alike, decouple, whole
from tarc.certificates.loop import stable_intervals
from tarc.certificates.mismatch import Parts, Responses, parts_of
from tarc.certificates.postures import (
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
from tarc.certificates.slow import best_multiplier
from tarc.certificates.spread import Spread, inverse_ratios, spread
from tarc.certificates.workspace import Workspace
from tarc.errors import TarcError
from tarc.laws.base import Law
from tarc.laws.poles import PolePlacement
from tarc.laws.tarc import TARC
from tarc.laws.tde import TDE
from tarc.plants.base import Plant

Array = np.ndarray


def robot(
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
    found = spread(plants, law.M, workspace, samples=samples, seed=seed)
    ends = (plants[found.plant_low], found.where_low), (plants[found.plant_high], found.where_high)
    units = workspace.units(min(samples, STIFF_SAMPLES), seed)
    instants = [Instant.at_rest(*one) for one in ends]
    instants += sampled(plants, workspace, min(samples, STIFF_SAMPLES), seed)
    mismatch = mismatches(law.M, instants)
    bounded = bool(np.isfinite(law.robust_slope))
    slope = law.robust_slope if bounded else 0.0
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
        tries = {best_centre(plain, (found.low, found.high), step), (found.low + found.high) / 2}
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
        ("stiff", resting, sizes), ("joint", resting, norms), ("swift", swift, sizes), ("moving", swift, norms)
    ):  # fmt: skip
        if any(which):
            matrices |= _described(name, instants[int(np.argmax(np.where(which, values, -1.0)))])
    for name, one in zip(("low", "high"), instants, strict=False):
        matrices |= _described(name, one)
    verdict, margin, witness = judge(matrices, numbers)
    numbers |= {"least ratio": found.low, "greatest ratio": found.high, "spread": found.ratio, "slope": slope}
    numbers["samples"] = float(found.samples)
    return Certificate(
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
    law: PolePlacement, found: Spread, numbers: dict[str, float], workspace: Workspace, computation_delay: int
) -> tuple[str, ...]:
    def listed(values: Array) -> str:
        return "(" + ", ".join(f"{one:.3g}" for one in values) + ")"

    speed, acceleration = workspace.speed, workspace.acceleration
    lines = [
        f"the eigenvalues of M(q)⁻¹M̂ lie between {found.low:.4g}, found at q = {listed(found.where_low)}, and "
        f"{found.high:.4g}, at {listed(found.where_high)}; {found.samples} samples and local search found no others",
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
        changes = "" if rate is None else (
            f"; so M̂^−½ M M̂^−½ changes by at most {rate:.3g} 1/s, the greatest that samples and local search found"
        )  # fmt: skip
        lines.append(
            f"no joint is faster than {listed(speed)} rad/s or m/s, or accelerates by more than {listed(acceleration)} "
            f"rad/s² or m/s²{changes}; the payload stays the same, or changes so seldom that the loop has settled in "
            "between"
        )
    if isinstance(law, TARC) and law.cap is None:
        lines.append("the gain has no cap, so that nothing bounds the robust term; give one to have it certified")
    elif not np.isfinite(law.robust_slope):
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
) -> tuple[list[Instant], Mismatches]:  # fmt: skip
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


def _at_rest(loop: tuple[Array, ...], nominal: Array, rest: tuple[Array, ...], period: float) -> Array:
    """State matrix of the law around M δq̈ + D δq̇ + G δq = δτ, the torque held over each period.

    The loop is that of all joints, or one that they share: free, into, out with the double integrator still in it.
    """
    from scipy.linalg import expm

    free, _, out = loop
    M, D, G = rest
    n, width = len(M), len(out)
    joints = np.eye(n if width == 1 else 1)
    F, H = np.kron(free[2 * width :, 2 * width :], joints), np.kron(free[2 * width :, :width], joints)
    C, E = np.kron(out[:, 2 * width :], joints), np.kron(out[:, :width], joints)
    motion = np.zeros((3 * n, 3 * n))
    motion[:n, n : 2 * n] = np.eye(n)
    motion[n : 2 * n] = np.linalg.solve(M, np.hstack([-G, -D, nominal]))
    held = expm(motion * period)[: 2 * n]
    scale = np.repeat([1.0, period], n)  # the velocity in q̇ T
    A, B = held[:, : 2 * n] * scale[:, None] / scale, held[:, 2 * n :] * scale[:, None]
    A[:, :n] += B @ E
    return np.block([[A, B @ C], [H, np.zeros((len(F), n)), F]])


def _growing(ratio: float, radius: float, mode: complex, period: float) -> Witness:
    rate, turn = np.log(radius) / period, abs(np.angle(mode)) / period
    return {"ratio": float(ratio), "growth rate [1/s]": float(rate), "frequency [rad/s]": float(turn)}


def unstable_posture(law: Law, plant: Plant, positions: Array, computation_delay: int = 0) -> Witness | None:
    """The mode that grows fastest where a robot is held at rest in one of some positions (n, k); None if none does.

    Quick: one linearisation of the law, the inertia in each position, and the robot linearised where the ratio of
    inertias alone makes the loop unstable. Only for laws whose gains are the same on every joint; None for others.
    """
    if not alike(law) or not isinstance(law, PolePlacement):
        return None
    try:
        free, into, out = decouple(law, computation_delay)[0].around(0.0)[:3]
    except TarcError:  # no linearisation, and so nothing to warn of
        return None
    inertias = np.array([plant.inertia(q) for q in np.asarray(positions).T])
    ratios = 1 / inverse_ratios(inertias, law.M)
    found = None
    for ratio in (ratios.min(), ratios.max()):
        loop = free + ratio * into @ out
        if np.max(np.abs(np.linalg.eigvals(loop))) <= 1:  # the full test only where there is something to show
            continue
        posture = np.asarray(positions)[:, int(np.argwhere(ratios == ratio)[0, 0])]
        answer, radius, mode = schur(_at_rest((free, into, out), law.M, plant.linearised(posture), law.period))
        if answer == "refuted" and (found is None or radius > found[0]):
            found = radius, _growing(ratio, radius, mode, law.period) | {"posture": posture.tolist()}
    return found[1] if found else None


def advice(law: PolePlacement, verdict: Certificate, computation_delay: int = 0) -> str:
    """What to change in a design that was not certified, with numbers; empty for one that was."""
    if verdict.witness:
        return remedy(law, verdict.witness, computation_delay)
    if verdict.certified:
        return ""
    if not alike(law):
        return "Give all joints the same bandwidth and damping, which the ball needs"
    if isinstance(law, TARC) and law.cap is None:
        return "Give the gain a cap, without which nothing bounds the robust term"
    if not np.isfinite(law.robust_slope):
        return "The robust term of this law is not covered by these certificates: simulate it"
    needed, slope, rate = verdict.numbers["spread"], verdict.numbers["slope"], verdict.numbers.get("rate")
    slower = "a bound on the joints' speeds" if rate is None else "slower joints"
    trials = {"as it is": law}
    if isinstance(law, TDE) and not law.synchronised:
        trials["synchronised"] = replace(law, synchronised=True, delay=None)
    lines = []
    for name, trial in trials.items():
        with suppress(TarcError):
            found = ball(trial, slope=slope, rate=rate, computation_delay=computation_delay).numbers
            scale = (found["low"] * found["high"]) ** 0.5
            scale /= (verdict.numbers["least ratio"] * verdict.numbers["greatest ratio"]) ** 0.5
            lines.append(f"{found['ratio']:.3g} ({name}, with {scale:.3g} of this M̂)")
    return (
        f"The robot's spread is {needed:.3g}; the widest ball of this loop holds {' or '.join(lines) or 'none'}. A "
        f"shorter window, a lower bandwidth, a smaller cap, more rotor inertia or {slower} narrow the gap; "
        "inconclusive does not mean unstable"
    )


def remedy(law: Law, witness: Witness, computation_delay: int = 0) -> str:
    """What `unstable_posture` found, and what to do about it, in a sentence each."""
    ratio, rate = witness["ratio"], witness["growth rate [1/s]"]
    posture = ", ".join(f"{one:.3g}" for one in witness["posture"])
    text = (
        f"{type(law).__name__}: held at rest at q = ({posture}) the loop is unstable: an eigenvalue of M(q)⁻¹M̂ is "
        f"{ratio:.4g}, and a mode grows by e in {1 / rate:.2g} s"
    )
    ranges = stable_intervals(law, computation_delay=computation_delay)
    if not ranges:
        return f"{text}. No ratio is stable: lower the bandwidth, shorten the window, or take out computation delay"
    low, high = max(ranges, key=lambda ends: ends[1] / max(ends[0], 1e-300))
    text += f"; the loop is stable from {low:.4g} to {high:.4g}. "
    if ratio < low:
        return text + "Use a larger inertia or a lower bandwidth"
    literal = isinstance(law, TDE) and not law.synchronised
    return text + f"Use a smaller inertia, a shorter window or {'synchronised=True' if literal else 'less bandwidth'}"


JUDGES["robot"] = judge
