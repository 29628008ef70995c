"""The reasons for the gains of a design, in words."""

import numpy as np

from tarc.analysis.inertia_ratio import InertiaSpread
from tarc.certificates.base import Certificate
from tarc.certificates.robot_evidence import RobotEvidence
from tarc.design.adaptation import Adaptation
from tarc.design.candidates import Candidate
from tarc.design.choice import DesignChoice
from tarc.design.noise import torque_noise
from tarc.design.selection import MAX_BUDGET_FACTOR, LoopSelection


def explain_loop(selection: LoopSelection, best: Candidate) -> list[DesignChoice]:
    """Return the choices of window, natural frequency, synchronisation and delay, and the torque noise."""
    return [
        _window(selection, best),
        _natural_frequency(selection, best),
        DesignChoice(
            ("law", "synchronised"),
            "synchronised",
            "yes" if best.synchronised else "no",
            "past torques are averaged like the acceleration, so that a far larger M̂ is stable"
            if best.synchronised
            else "at this window the literal law tolerates the spread and has less torque noise",
        ),
        _delay(best),
        _torque_noise(selection, best),
    ]


def explain_adaptation(best: Candidate, adaptation: Adaptation, step: float) -> list[DesignChoice]:
    """Return the choices of TARC's switching gain.

    Parameters
    ----------
    best
        The loop.
    adaptation
        The parameters of the switching gain.
    step
        Expected step of acceleration [rad/s²].
    """
    return [
        DesignChoice(
            ("law", "boundary_layer"),
            "boundary layer, largest gain",
            f"{adaptation.boundary_layer:.3g} rad, {adaptation.max_gain:.3g} rad/s²",
            f"a step of {step:.3g} rad/s², the largest of payload or friction, leaves this error without the "
            f"switching term; the largest gain limits the slope to {best.robust_slope:.4g} 1/s², which is certified",
        ),
        DesignChoice(
            ("law", "rise_rate"),
            "rise and fall rates",
            f"{adaptation.rise_rate:.3g}, {adaptation.fall_rate:.3g} 1/s³",
            "an error as wide as the layer moves the gain over its range within 1/ωn; with equal rates the gain "
            "stays low, and with a far larger rise rate it stays at its largest value",
        ),
        DesignChoice(
            ("law", "min_gain"),
            "smallest gain",
            f"{adaptation.min_gain:.3g} rad/s²",
            "a hundredth of the largest; it must be above zero",
        ),
    ]


def explain_certificate(certificate: Certificate[RobotEvidence]) -> DesignChoice:
    """Return which certificate covers the robot."""
    evidence = certificate.evidence
    if evidence.affine is not None:
        kind, reason = "affine", "a Lyapunov function affine in the inertia, which uses that it changes slowly"
    elif evidence.rate is not None:
        kind, reason = "iqc", "a ball of inertia mismatches that change slowly, by integral quadratic constraints"
    else:
        kind, reason = "ball", "a ball of inertia mismatches that change at any rate, by the small-gain theorem"
    return DesignChoice((), "certificate", kind, f"{reason}; the cheapest of ball, iqc and affine that covers it")


def explain_inertia(selection: LoopSelection, best: Candidate, spread: InertiaSpread) -> DesignChoice:
    """Return the choice of a constant M̂."""
    shape = selection.shape
    is_diagonal = np.count_nonzero(shape - np.diag(np.diag(shape))) == 0
    over = "payloads and workspace" if len(selection.problem.plants) > 1 else "the workspace"
    return DesignChoice(
        ("law", "inertia"),
        "inertia",
        f"{best.inertia_scale:.4g} times the shape, a {'diagonal' if is_diagonal else 'full'} matrix",
        f"of all {'diagonal ' if is_diagonal else ''}M̂ this shape has the least spread of the eigenvalues of "
        f"M(q)⁻¹M̂: {spread.ratio:.3g} over {over} ({spread.samples} samples and local search); scaled they lie "
        f"between {best.inertia_scale:.3g} and {best.inertia_scale * spread.ratio:.3g}, and the loop tolerates at "
        f"least {100 * best.spread_margin:.0f} % more",
    )


def _window(selection: LoopSelection, best: Candidate) -> DesignChoice:
    target = selection.problem.requirements.noise_target
    is_free = selection.problem.requirements.natural_frequency is None
    if not is_free:
        criterion = "the least noise of them"
    elif selection.noise_ratio(best) > target:
        reference = "the least noise" if selection.free_noise_ratio > target else "the budget"
        criterion = f"the least noise² × error within {MAX_BUDGET_FACTOR:g} times {reference}"
    else:
        criterion = "the least error within the budget"
    count, feasible = len(selection.candidates), sum(candidate.feasible for candidate in selection.candidates)
    return DesignChoice(
        ("estimator", "window"),
        "window",
        f"{1e3 * best.window * best.period:g} ms, {best.window} periods, degree {best.degree}",
        f"a shorter one tolerates more spread and has more noise; of {count} loops {feasible} tolerate it, "
        f"and this one has {criterion}",
    )


def _natural_frequency(selection: LoopSelection, best: Candidate) -> DesignChoice:
    target = selection.problem.requirements.noise_target
    if selection.problem.requirements.natural_frequency is not None:
        reason = "as given"
    elif selection.free_noise_ratio > target:
        reason = (
            f"no loop that was found to tolerate the spread, gravity and motion changes the torque by noise within "
            f"{100 * target:.3g} % of the limit"
        )
    elif selection.noise_ratio(best) > target:
        reason = (
            f"noise changes the torque by more than {100 * target:.3g} % of the limit per period, since the error "
            "falls faster than the square of that"
        )
    else:
        reason = f"the least error at which noise changes the torque by {100 * target:.3g} % of the limit per period"
    return DesignChoice(
        ("law", "natural_frequency"),
        "natural frequency",
        f"{best.natural_frequency:.4g} rad/s, damping ratio {best.damping_ratio:g}",
        reason,
    )


def _delay(best: Candidate) -> DesignChoice:
    if best.synchronised:
        value, reason = "that of the window", "the torque is averaged over the window"
    elif best.delay == 1:
        value, reason = f"{1e3 * best.period:g} ms", "the shortest that the control rate allows"
    else:
        value = f"{1e3 * best.delay * best.period:g} ms"
        reason = "with the delay of the actuation, one period leaves an alternating torque undamped"
    return DesignChoice(("law", "delay"), "delay", value, reason)


def _torque_noise(selection: LoopSelection, best: Candidate) -> DesignChoice:
    problem = selection.problem
    noise = torque_noise(best.noise, selection.shape, problem.requirements.sensor)
    limits, plant = problem.torque_limits, problem.plants[0]
    joint = int(np.argmax(noise / limits if np.isfinite(limits).all() else noise))
    share = "no limit is known"
    if np.isfinite(limits).any():
        change = f"{100 * selection.noise_ratio(best):.2g} % of the limit"
        share = f"{100 * float(np.max(noise / limits)):.2g} % of its limit; its change per period is {change}"
    return DesignChoice(
        ("sensor",),
        "torque noise",
        f"{noise[joint]:.3g} {plant.torque_units[joint]} RMS at {plant.joint_names[joint]}, {share}",
        "white noise of the encoder's resolution in the closed loop; the largest over the spread",
    )
