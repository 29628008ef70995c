"""Gains without a model of the robot, from a measured inertia and a bound on its spread."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tarc.certificates.base import Certificate
from tarc.certificates.varying_ratio import certify_varying_ratio
from tarc.core import validation as check
from tarc.core.errors import InfeasibleDesign, Relaxation
from tarc.core.validation import Matrix
from tarc.design.adaptation import choose_adaptation
from tarc.design.assessment import assess_candidates
from tarc.design.candidates import Candidate, enumerate_candidates, pareto_front
from tarc.design.infeasible import infeasible_design
from tarc.design.noise import measurement_deviation, torque_noise
from tarc.design.requirements import SLOPE_RATIO, default_encoder
from tarc.design.robustness import RobustnessSpec
from tarc.laws.tarc import TARC
from tarc.laws.tdc import TDC
from tarc.signals.sensors import Encoder


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelFreeDesign:
    """A law for a robot without a model, and the spread that it tolerates.

    Attributes
    ----------
    law
        The law.
    certificate
        Stability for every M(q) within the assumed spread, at any rate of change. Whether the robot's spread is within
        it, and whether gravity's stiffness is small beside K1, is not checked.
    spread
        The spread assumed.
    candidate
        The loop, with its predicted noise and error.
    torque_noise
        Predicted RMS of the torque that measurement noise makes, shape (n,) [N m].
    """

    law: TDC | TARC
    certificate: Certificate
    spread: float
    candidate: Candidate
    torque_noise: np.ndarray


def design_without_model(
    inertia: Matrix,
    spread: float,
    natural_frequency: float,
    *,
    period: float = 1e-3,
    sensor: Encoder | None = None,
    damping_ratio: float = 1.0,
    expected_step: float | None = None,
    computation_delay: int = 0,
    min_margin: float = 0.1,
) -> ModelFreeDesign:
    """Choose window, synchronisation, scale of M̂ and adaptation for a measured inertia, and certify the loop.

    The eigenvalues of M(q)⁻¹M, with M the inertia measured, are taken to lie between 1/√spread and √spread. Of the
    loops that tolerate it, the one with the least torque noise is chosen.

    Parameters
    ----------
    inertia
        M [kg m² or kg], as `inertia_from_data` finds it, or the mean over several postures.
    spread
        Largest over smallest eigenvalue of M(q)⁻¹M: about 10 for an arm of six joints with rotor inertia, and twice
        that with a payload. In doubt, take the square of the spread of several measurements.
    natural_frequency, damping_ratio
        ωn [rad/s] and ζ.
    period
        Control period [s].
    sensor
        The encoder; None for 17 bits.
    expected_step
        Expected step of acceleration [rad/s²], of payload or friction, which sets the adaptation of TARC; None for
        TDC.
    computation_delay
        Periods between a measurement and its torque.
    min_margin
        Least margin of the tolerated spread over the assumed one.

    Raises
    ------
    InfeasibleDesign
        When no loop of this natural frequency tolerates the spread; the relaxation is the largest tolerated one.
    """
    n_joints = max((1, *np.shape(check.float_array("inertia", inertia))))
    M = check.positive_definite("inertia", inertia, n_joints)
    check.number("natural_frequency", natural_frequency, 0, strict=True)
    sensor = default_encoder() if sensor is None else sensor
    trials = enumerate_candidates(
        period,
        natural_frequencies=[natural_frequency],
        windows=range(2, 31),
        damping_ratio=damping_ratio,
        computation_delay=check.integer("computation_delay", computation_delay),
    )
    slope_ratio = SLOPE_RATIO["TDC" if expected_step is None else "TARC"]
    spec = RobustnessSpec.from_spread(spread)
    assessed = assess_candidates(trials, spec, slope_ratio=slope_ratio, min_margin=min_margin)
    front = pareto_front(assessed)
    if not front:
        raise _no_feasible_loop(assessed, spread, min_margin)
    best, shape = front[0], M * spread**0.5
    law = _build_law(best, shape, sensor, expected_step)
    certificate = certify_varying_ratio(
        law,
        ratio_range=(best.inertia_scale, best.inertia_scale * spread),
        slope=law.robust_slope_bound,
        computation_delay=computation_delay,
    )
    if not certificate.certified:
        raise InfeasibleDesign(
            f"spread: the chosen loop is {certificate.verdict}, margin {certificate.margin:.3g}; raise min_margin"
        )
    noise = torque_noise(best.noise, shape, sensor)
    return ModelFreeDesign(law=law, certificate=certificate, spread=spread, candidate=best, torque_noise=noise)


def _no_feasible_loop(assessed: Sequence[Candidate], spread: float, min_margin: float) -> InfeasibleDesign:
    first = assessed[0]
    tolerated = max(loop.max_spread for loop in assessed) / (1 + min_margin)
    return infeasible_design(
        f"spread: required {spread:g}; with the margin the loops of {first.natural_frequency:g} rad/s at "
        f"{1 / first.period:g} Hz tolerate at most {tolerated:.3g}. Lower it, or raise the control rate",
        [Relaxation("spread", tolerated, f"a spread of at most {tolerated:.3g}")],
    )


def _build_law(best: Candidate, shape: np.ndarray, sensor: Encoder, expected_step: float | None) -> TDC | TARC:
    """Return the law of a loop: TARC where a step of acceleration is expected [rad/s²]."""
    options = {**best.law_options(), "inertia": best.inertia_scale * shape, "estimator": best.estimator}
    if expected_step is None:
        return TDC(**options)
    noise = float(np.linalg.norm(measurement_deviation(sensor, len(shape))))
    return TARC(**{**options, **choose_adaptation(best, expected_step, noise=noise).law_options()})
