"""Gains without a model of the robot: from an inertia that was measured and a guess of how much it varies."""

from dataclasses import dataclass

import numpy as np

from tarc.certificates.base import Certificate
from tarc.certificates.varying_ratio import certify_varying_ratio
from tarc.core import validation as check
from tarc.core.errors import TarcError
from tarc.core.validation import Matrix
from tarc.design.adaptation import choose_adaptation
from tarc.design.candidates import Candidate, assess_candidates, enumerate_candidates, pareto_front
from tarc.design.robustness import RobustnessSpec
from tarc.laws.tarc import TARC
from tarc.laws.tdc import TDC
from tarc.signals.sensors import Encoder


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelFreeDesign:
    """A law for a robot without a model, and what it bears.

    Attributes
    ----------
    law
        The law.
    certificate
        The robust ball: for every M(q), however it varies, within the spread that was assumed. That the robot's is
        within it, and that gravity's stiffness is small beside K1, is for the user to know.
    spread
        The spread assumed.
    chosen
        The loop.
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
    loops that bear this, the one with the least torque noise is chosen.

    Parameters
    ----------
    inertia
        M [kg m² or kg], as `inertia_from_data` finds it, or the mean over several postures.
    spread
        Greatest over least eigenvalue of M(q)⁻¹M to be borne: about 10 for an arm of six joints with rotor inertia,
        twice that with a payload; what several measurements show, squared, if in doubt.
    natural_frequency, damping_ratio
        ωn [rad/s] and ζ.
    period
        Control period [s].
    sensor
        The encoder; None for 17 bits.
    expected
        Step of acceleration to be expected [rad/s²], of payload or friction, by which the adaptation of TARC is
        chosen; None for TDC.
    computation_delay
        Periods between a measurement and its torque.
    room
        By which share the spread that the loop bears must exceed the one assumed.

    Raises
    ------
    TarcError
        When no loop of this natural frequency bears the spread: says which spread one does.
    """
    joints = max((1, *np.shape(check.float_array("inertia", inertia))))
    M = check.positive_definite("inertia", inertia, joints)
    demand = RobustnessSpec.from_spread(spread)
    sensor = Encoder(bits=17) if sensor is None else sensor
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
        raise TarcError(
            f"spread: no loop of {natural_frequency:g} rad/s at {1 / period:g} Hz bears a spread of {spread:g}; one of "
            f"{reach / (1 + min_margin):.3g} is borne. Lower the natural frequency, or raise the rate"
        )
    best, shape = able[0], M * spread**0.5
    sigma = np.broadcast_to(np.sqrt(sensor.noise**2 + sensor.step_size**2 / 12), (joints,))
    common = {**best.law_options(), "inertia": best.inertia_scale * shape, "estimator": best.estimator}
    if expected_step is None:
        law: TDC | TARC = TDC(**common)
    else:
        law = TARC(
            **{**common, **choose_adaptation(best, expected_step, noise=float(np.linalg.norm(sigma))).law_options()}
        )
    ends = best.inertia_scale, best.inertia_scale * spread
    certificate = certify_varying_ratio(
        law, contains=ends, slope=law.robust_slope_bound, computation_delay=computation_delay
    )
    if not certificate.certified:
        raise TarcError(
            f"spread: the loop chosen is {certificate.verdict}, margin {certificate.margin:.3g}; raise room"
        )
    noise = best.noise * np.linalg.norm(shape * sigma, axis=1)
    return ModelFreeDesign(law=law, certificate=certificate, spread=spread, candidate=best, torque_noise=noise)
