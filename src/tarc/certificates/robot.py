"""The verdict for a robot: the spread of its inertia over a workspace against what the loop bears."""

from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from tarc.certificates.ball import Evidence, ball, best_centre, recorded, widest
from tarc.certificates.ball import judge as judge_ball
from tarc.certificates.base import JUDGES, Certificate, Witness, schur
from tarc.certificates.linear import alike, decouple, whole
from tarc.certificates.loop import stable_intervals
from tarc.certificates.mismatch import PARTS, Responses, parts_of
from tarc.certificates.postures import (
    Posture,
    fastest,
    in_nominal,
    inertia_slopes,
    joint_norms,
    mismatches,
    rates,
    sampled,
    searched,
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

    A small error obeys, in coordinates x = M̂^½ q, ẍ = E(q) v − H(q) x with E = M̂^½ M⁻¹ M̂^½ and
    H = M̂^½ M⁻¹ (∂g/∂q) M̂^−½ the stiffness of gravity and springs; so at rest, and about a motion but for the stiffness
    ∂(M q̈ + C q̇)/∂q and the damping that its own forces make, which are left out. They grow with the square of the
    speed, and can undo what is certified where M̂ or the bandwidth is low. Certified if the robust ball, of pairs
    ‖[E − ρ0 I, H/η]‖ ≤ δ with the weight η that leaves it the most room, holds those of all postures of the workspace,
    together with every slope of the robust term up to that at its cap. Where the workspace has a speed, the ball is
    that for ‖dE⁻¹/dt‖ up to the greatest at this speed, which holds far more. Refuted if in one of the worst postures
    the robot held at rest, linearised with its inertia, gravity and viscous friction, is unstable.
    Inconclusive between the two, and for gains that differ between the joints, which the ball does not cover.

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
        ratio and the greatest stiffness were found, with the robot linearised there; its numbers the ratios
        (``least ratio``, ``greatest ratio``), their ``spread``, the ``stiffness`` [1/s²], how many ``samples`` were
        taken, the ball's centre and radius, and with a speed the ``rate`` ‖dE⁻¹/dt‖ [1/s] that it may reach, in
        ``posture_fast``. The margin is the ball's radius over the one that is needed, less 1;
        where refuted, 1 less the spectral radius.

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
    postures = [*ends, *sampled(plants, workspace, min(samples, STIFF_SAMPLES), seed)]
    bounded = bool(np.isfinite(law.robust_slope))
    slope = law.robust_slope if bounded else 0.0
    matrices = {"nominal": law.M}
    numbers = {"period": law.period, "alike": float(alike(law)), "bounded": float(bounded)}
    if numbers["alike"]:
        parts = parts_of(decouple(law, computation_delay)[0], slope, intersample=True)
        moving, step = {}, None
        if workspace.speed is not None:
            fast = fastest(plants, law.M, workspace, min(samples, STIFF_SAMPLES), seed)
            moving = {"posture_fast": fast[1], "slopes_fast": inertia_slopes(*fast), "speed": workspace.speed}
            step = law.period * float(rates(law.M, moving["slopes_fast"][None], workspace.speed)[0])
        tries = {best_centre(parts, (found.low, found.high), step), (found.low + found.high) / 2}
        postures, E, H = hardest(parts, tries, postures, law.M, workspace, units)
        best, evidence, radius = best_ball(parts, tries, E, H, step)
        joint, step = best.joint, best.step
        evidence_matrices, evidence_numbers = recorded(evidence)
        matrices |= dict(zip(PARTS, parts, strict=True)) | evidence_matrices | ({} if step is None else moving)
        numbers |= {"centre": best.centre, "radius": radius, "weight": best.weight} | evidence_numbers
        numbers |= {} if step is None else {"step": step, "rate": step / law.period}
    else:
        (E, H), joint, step = mismatches(law.M, postures), 0, None
        channel = whole(law, computation_delay)
        matrices |= dict(zip(PARTS[:3], channel.around(0.0)[:3], strict=True))
    sizes = np.linalg.norm(H, 2, axis=(1, 2))
    stiff = int(np.argmax(sizes))
    numbers["stiffness"] = float(sizes[stiff])
    joint = joint if numbers["alike"] else stiff
    worst = {"low": postures[0], "high": postures[1], "stiff": postures[stiff], "joint": postures[joint]}
    for name, (one, posture) in worst.items():
        M, damping, gravity = one.at_rest(posture)
        matrices |= {f"posture_{name}": posture, f"inertia_{name}": M}
        matrices |= {f"damping_{name}": damping, f"stiffness_{name}": gravity}
    verdict, margin, witness = judge(matrices, numbers)
    numbers |= {"least ratio": found.low, "greatest ratio": found.high, "spread": found.ratio, "slope": slope}
    numbers["samples"] = float(found.samples)
    return Certificate(
        kind="robot",
        claim=f"{type(law).__name__} keeps the robot stable however it moves in the workspace"
        + ("." if step is None else ", at the joints' speeds given or less."),
        problem=(
            "‖[E(q) − ρ0 I, H(q)/η]‖ ≤ δ for all q of the workspace, ‖dE⁻¹/dt‖ within a rate, and a ball of radius δ "
            "that the loop bears at this rate"
            if step is not None
            else "‖[E(q) − ρ0 I, H(q)/η]‖ ≤ δ < 1/‖[T_v; η T_q]‖∞ for all q of the workspace"
        )
        + (f", with every slope of the robust term up to {slope:.4g} 1/s²" if slope else ""),
        verdict=verdict,
        margin=margin,
        margin_meaning="1 less the spectral radius in that posture"
        if verdict == "refuted"
        else "radius of the ball over the one needed, less 1",
        assumptions=_assumptions(law, found, numbers, workspace.speed if step is not None else None, computation_delay),
        matrices=matrices,
        numbers=numbers,
        witness=witness,
    )


def _assumptions(
    law: PolePlacement, found: Spread, numbers: dict[str, float], speed: Array | None, computation_delay: int
) -> tuple[str, ...]:
    def posture(q: Array) -> str:
        return "(" + ", ".join(f"{one:.3g}" for one in q) + ")"

    lines = [
        f"the eigenvalues of M(q)⁻¹M̂ lie between {found.low:.4g}, found at q = {posture(found.where_low)}, and "
        f"{found.high:.4g}, at {posture(found.where_high)}; {found.samples} samples and local search found no others",
        f"gravity and springs have a stiffness, in these coordinates, of at most {numbers['stiffness']:.3g} 1/s², "
        f"which with its posture's inertia is taken from {min(found.samples, STIFF_SAMPLES)} samples, the two postures "
        "above and local search",
        "the robot stays in the workspace; Coriolis forces and friction disturb only, viscous friction apart where the "
        "robot is at rest: what stiffness and damping fast motion makes is left out; dry friction may hold back what "
        "is refuted",
        "no torque limit is reached and no sample is lost",
        f"the torque reaches the joints {computation_delay} periods late and is held for a period",
    ]
    if speed is not None:
        lines.append(
            f"no joint is faster than {posture(speed)} rad/s or m/s, so that M̂^−½ M M̂^−½ changes by at most "
            f"{numbers['rate']:.3g} 1/s, the greatest that samples and local search found; the payload stays the same, "
            "or changes so seldom that the loop has settled in between"
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
    loop = tuple(matrices[name] for name in PARTS[:3])
    least, greatest = np.inf, 0.0
    worst, witness = 1.0, None
    names = ("low", "high", "stiff", "joint")
    for name in names:
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
    centre, weight = numbers["centre"], numbers["weight"]
    needed = max(greatest - centre, centre - least)
    M, G = (np.array([matrices[f"{part}_{name}"] for name in names]) for part in ("inertia", "stiffness"))
    E, H = in_nominal(matrices["nominal"], M, G)
    stiffest = float(np.linalg.norm(H, 2, axis=(1, 2)).max())
    if weight > 0:
        needed = max(needed, float(joint_norms(E, H, centre, weight).max()))
    elif not stiffest <= NO_STIFFNESS:  # which the loop without its weight leaves out
        return "inconclusive", 0.0, None
    if "step" in numbers:
        rate = float(rates(matrices["nominal"], matrices["slopes_fast"][None], matrices["speed"])[0])
        more = rate * numbers["period"] / (1 + 1e-9) > numbers["step"]
        if more or not stiffest <= (1 + 1e-9) * numbers["stiffness"]:
            return "inconclusive", 0.0, None
    verdict, margin, _ = judge_ball(matrices, {**numbers, "needed": needed})
    return (verdict if numbers["bounded"] else "inconclusive"), margin, None


NO_STIFFNESS = 1e-9
"""Stiffness [1/s²] of a robot below which it counts as none."""
TRIALS = 4
"""Most balls that are tried on all frequencies."""
STIFF_SAMPLES = 500
"""Postures whose stiffness is computed; it changes little beside the inertia's eigenvalues."""


class Trial(NamedTuple):
    """A ball: its room, radius over the one needed, as a grid of frequencies has it; and what makes it."""

    room: float
    needed: float
    weight: float
    joint: int
    centre: float
    step: float | None


def hardest(
    parts: tuple[Array, ...], tries: Collection[float], postures: list[Posture], nominal: Array, workspace: Workspace,
    units: Array,
) -> tuple[list[Posture], Array, Array]:  # fmt: skip
    """Postures with their `mismatches`, and those that a local search adds; the worst one moves with the weight."""
    E, H = mismatches(nominal, postures)
    for _ in range(2):
        one = max((best_weights(parts, centre, E, H)[0] for centre in tries), key=lambda one: one.room)
        if not one.weight:
            break
        postures, E, H = searched(postures, E, H, workspace, units, nominal, one.centre, one.weight)
    return postures, E, H


def best_ball(
    parts: tuple[Array, ...], tries: Collection[float], E: Array, H: Array, step: float | None
) -> tuple[Trial, Evidence, float]:
    """The ball with the most room, what shows it, and its radius.

    Several are looked at: what holds on a grid of frequencies need not hold on all, and a ball for any speed may do
    better than one for a bounded speed.
    """
    stiffness = float(np.linalg.norm(H, 2, axis=(1, 2)).max())
    trials = [one for kind in {step, None} for centre in tries for one in best_weights(parts, centre, E, H, kind)]
    trials.sort(reverse=True, key=lambda one: one.room)
    best, evidence, radius = trials[0], None, -1.0
    for one in trials[:TRIALS]:
        if one.room > radius / best.needed:
            shown, reach = widest(parts, one.centre, one.weight, step=one.step, stiffness=stiffness)
            if reach / one.needed > radius / best.needed:
                best, evidence, radius = one, shown, reach
    return best, evidence, radius


def best_weights(parts: tuple[Array, ...], centre: float, E: Array, H: Array, step: float | None = None) -> list[Trial]:
    """The weights η of the position beside v with the most room, the best first, and the pair that needs it.

    A large η makes little of the stiffness in what the ball must hold and much of it in what the loop bears. Zero where
    there is no stiffness. With a step E⁻¹ changes by no more than that in a period.
    """
    sizes = np.linalg.norm(H, 2, axis=(1, 2))
    apart = np.linalg.norm(E - centre * np.eye(E.shape[1]), 2, axis=(1, 2))
    responses, found = Responses(parts), []
    extent, stiffness = max(float(apart.max()), 0.1 * centre), float(sizes.max())

    def radius(weight: float) -> float:
        if step is None:
            return responses.best(centre, weight)[1]
        return best_multiplier(parts, centre, step, weight=weight, stiffness=stiffness, responses=responses)[1]

    if stiffness <= NO_STIFFNESS:
        return [Trial(radius(0.0) / extent, extent, 0.0, int(np.argmax(apart)), centre, step)]
    for weight in stiffness / extent * np.geomspace(0.1, 100.0, 31 if step is None else 7):
        norms = joint_norms(E, H, centre, weight)
        needed = float(norms.max())
        found.append(Trial(radius(float(weight)) / needed, needed, float(weight), int(np.argmax(norms)), centre, step))
    return sorted(found, reverse=True, key=lambda one: one.room)[:2]


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
        answer, radius, mode = schur(_at_rest((free, into, out), law.M, plant.at_rest(posture), law.period))
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
