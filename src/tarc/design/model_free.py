"""Gains without a model of the robot, from a measured inertia and a bound on its spread."""

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
from tarc.design.noise import measurement_deviation, torque_noise
from tarc.design.requirements import default_encoder
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
    joints = max((1, *np.shape(check.float_array("inertia", inertia))))
    M = check.positive_definite("inertia", inertia, joints)
    demand = RobustnessSpec.from_spread(spread)
    sensor = default_encoder() if sensor is None else sensor
    natural_frequency = check.number("natural_frequency", natural_frequency, 0, strict=True)
    check.number("damping_ratio", damping_ratio, 0, strict=True)
    trials = enumerate_candidates(
        period,
        natural_frequencies=[natural_frequency],
        windows=range(2, 31),
        damping_ratio=damping_ratio,
        computation_delay=check.integer("computation_delay", computation_delay),
    )
    looked = assess_candidates(trials, demand, slope_ratio=0.0 if expected_step is None else 1.0, min_margin=min_margin)
    able = pareto_front(looked)
    if not able:
        reach = max((one.max_spread for one in looked), default=1.0)
        available = reach / (1 + min_margin)
        text = f"a spread of at most {available:.3g}"
        raise InfeasibleDesign(
            f"spread: needed {spread:g}, available {available:.3g} of all loops of {natural_frequency:g} rad/s at "
            f"{1 / period:g} Hz. Lower the natural frequency, or raise the control rate",
            [Relaxation("spread", available, text)],
        )
    best, shape = able[0], M * spread**0.5
    sigma = np.broadcast_to(measurement_deviation(sensor), (joints,))
    common = {**best.law_options(), "inertia": best.inertia_scale * shape, "estimator": best.estimator}
    if expected_step is None:
        law: TDC | TARC = TDC(**common)
    else:
        law = TARC(
            **{**common, **choose_adaptation(best, expected_step, noise=float(np.linalg.norm(sigma))).law_options()}
        )
    ends = best.inertia_scale, best.inertia_scale * spread
    certificate = certify_varying_ratio(
        law, ratio_range=ends, slope=law.robust_slope_bound, computation_delay=computation_delay
    )
    if not certificate.certified:
        raise InfeasibleDesign(
            f"spread: the loop chosen is {certificate.verdict}, margin {certificate.margin:.3g}; raise min_margin"
        )
    noise = torque_noise(best.noise, shape, sensor)
    return ModelFreeDesign(law=law, certificate=certificate, spread=spread, candidate=best, torque_noise=noise)
