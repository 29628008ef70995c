"""All certificates of a law on a robot at once."""

import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from tarc.analysis.linearise import Channel, decoupled_channels, joints_share_loop
from tarc.analysis.rest_stability import describe_instability
from tarc.analysis.stability import disturbance_to_error, noise_to_torque, stable_intervals
from tarc.analysis.workspace import Workspace
from tarc.certificates.base import Certificate, Evidence, certificate_from_plain
from tarc.certificates.constant_ratio import ConstantRatioEvidence, certify_constant_ratio
from tarc.certificates.robot import RobotEvidence, certify_robot
from tarc.certificates.sector import SectorEvidence, certify_sector
from tarc.certificates.varying_ratio import VaryingRatioEvidence, certify_varying_ratio
from tarc.core.errors import TarcError
from tarc.core.types import Array
from tarc.estimators.algebraic import Algebraic
from tarc.laws.base import Law
from tarc.laws.pole_placement import PolePlacement
from tarc.laws.tarc import TARC
from tarc.laws.tde import TDE
from tarc.numerics.norms import max_singular_values
from tarc.paper.lemma1 import ConditionC2Evidence, Lemma1Evidence, check_condition_c2, check_lemma1
from tarc.paper.nominal_loop import NominalEvidence, check_nominal_loop
from tarc.paper.theorem1 import Theorem1Evidence, check_theorem1
from tarc.paper.theorem2 import Theorem2Evidence, check_theorem2
from tarc.plants.base import Plant


def certify_law(
    law: Law,
    plant: Plant | Sequence[Plant],
    workspace: Workspace,
    *,
    computation_delay: int = 0,
    samples: int = 2000,
    seed: int = 0,
    robot_certificate: Certificate[RobotEvidence] | None = None,
    on_certificate: Callable[[str], object] = lambda kind: None,
) -> "LawCertification":
    """Return all certificates that apply to a law on a robot, the verdict for the robot first.

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
        Of the workspace.
    known
        What `robot` gave for all this, where it was asked before.
    done
        Called with the kind of each certificate once it is made, to show progress.

    Returns
    -------
    LawCertification
        Its certificates by kind: ``robot``; ``loop`` for every constant ratio that occurs; ``slope``, for TARC, at the
        occurring ratio of the smallest limit; ``ball``, the widest; then the conditions of the paper, ``lemma1``,
        ``c2``, ``theorem1``, ``theorem2``, and ``nominal``, its second theorem repaired. Those that do not apply are
        left out.

    Raises
    ------
    TarcError
        For a law without an inertia, and as `robot` does.
    """
    if not isinstance(law, PolePlacement):
        raise TarcError(
            f"law: got {type(law).__name__}; certificates need a law with an inertia M̂, such as TDC or TARC"
        )
    found: dict[str, Certificate] = {}

    def add(certificate: Certificate[Any]) -> None:
        found[certificate.kind] = certificate
        on_certificate(certificate.kind)

    options = {"computation_delay": computation_delay, "samples": samples, "seed": seed}
    verdict = robot_certificate or certify_robot(law, plant, workspace, **options)
    add(verdict)
    low, high = verdict.evidence.min_ratio, verdict.evidence.max_ratio
    if all(channel.n_coupled == 1 for channel in decoupled_channels(law, computation_delay)):
        add(certify_constant_ratio(law, (low, high), computation_delay=computation_delay))
    if isinstance(law, TARC):
        ratios = low, (low * high) ** 0.5, high
        occurring = [certify_sector(law, ratio, computation_delay=computation_delay) for ratio in ratios]
        add(min(occurring, key=lambda one: one.evidence.circle_limit))
    if joints_share_loop(law):
        with suppress(TarcError):  # stable for no ratio, which the verdict for the robot has shown already
            add(certify_varying_ratio(law, computation_delay=computation_delay))
    add(check_lemma1(law, plant, workspace, samples=samples, seed=seed))
    if isinstance(law, TARC):
        add(check_condition_c2(law))
    if isinstance(law, TDE):
        add(check_theorem1(law))
        if isinstance(law.estimator, Algebraic):
            add(check_theorem2(law))
            add(check_nominal_loop(law))
    return LawCertification(law=law, certificates=found, computation_delay=computation_delay)


@dataclass(frozen=True, kw_only=True, eq=False)
class StabilityMap:
    """Stable inertia ratios over the window of the estimator.

    Attributes
    ----------
    windows
        Windows [periods], shape (k,); two places for an estimator without a window.
    window
        That of the law.
    stable
        Ends of the widest range in which every constant ratio is stable, shape (k, 2); nan for none.
    tolerated
        Ends of the ball of varying ratios, shape (k, 2); nan for none.
    required
        Smallest and largest inertia ratio of the robot.
    rate
        Largest rate of change for which the ball holds [1/s]; None for any.
    """

    windows: Array
    window: float
    stable: Array
    tolerated: Array
    required: tuple[float, float]
    rate: float | None


@dataclass(frozen=True, kw_only=True, eq=False)
class LawCertification:
    """All certificates of one law on one robot, and what follows from them; each computed once.

    Attributes
    ----------
    law
        The law.
    certificates
        By kind, the verdict for the robot first.
    computation_delay
        Periods between a measurement and its torque.
    """

    law: PolePlacement
    certificates: dict[str, Certificate]
    computation_delay: int = 0

    @property
    def verdict(self) -> Certificate[RobotEvidence]:
        """The certificate of the robot."""
        return self.certificates["robot"]

    @cached_property
    def channels(self) -> list[Channel]:
        """The linearised loops of the law."""
        return decoupled_channels(self.law, self.computation_delay)

    @cached_property
    def suggestion(self) -> str:
        """What to change in a law that was not certified; empty for one that was."""
        ball = self.certificates.get("varying_ratio")
        return suggest_changes(self.law, self.verdict, self.computation_delay, ball=ball)

    @property
    def ratios(self) -> dict[str, float]:
        """Smallest, mean and largest inertia ratio of the robot, by name."""
        low, high = self.verdict.evidence.min_ratio, self.verdict.evidence.max_ratio
        return {"least ratio": low, "mean": float(np.sqrt(low * high)), "greatest ratio": high}

    @cached_property
    def eigenvalues(self) -> dict[str, Array]:
        """Eigenvalues of the loop at each of the `ratios`, by name."""
        return {
            name: np.concatenate([np.linalg.eigvals(channel.state_matrix(ratio)) for channel in self.channels])
            for name, ratio in self.ratios.items()
        }

    def gains_over_frequency(self, angles: Array) -> tuple[dict[str, Array], dict[str, Array]]:
        """Return the gains from disturbance to error [s²] and from noise to M̂⁻¹τ [1/s²] at angles ω T [rad]."""

        def largest(system: Callable[[Channel, float], tuple[Array, Array, Array, Array]], ratio: float) -> Array:
            return np.max([max_singular_values(*system(channel, ratio), angles) for channel in self.channels], axis=0)

        disturbed = {name: largest(disturbance_to_error, ratio) for name, ratio in self.ratios.items()}
        noisy = {name: largest(noise_to_torque, ratio) for name, ratio in self.ratios.items()}
        return disturbed, noisy

    @cached_property
    def stability_map(self) -> StabilityMap | None:
        """Stable ratios over the window; None where the gains couple the joints."""
        if any(channel.n_coupled > 1 for channel in self.channels):
            return None
        estimator, period = self.law.estimator, self.law.period
        laws, window, windows = [self.law], 1, [0, 2]
        if isinstance(estimator, Algebraic):
            window = estimator.samples - 1
            longest = max(min(4 * window, 40), 30, 1.3 * window)  # the time grows with its cube
            windows = sorted({*np.geomspace(estimator.degree, longest, 14).astype(int).tolist(), window})
            laws = [
                self.law if count == window else replace(self.law, estimator=replace(estimator, window=count * period))
                for count in windows
            ]
        ends = np.array([(*self._stable(law), *self._tolerated(law)) for law in laws])
        ends = np.broadcast_to(ends, (len(windows), 4))
        evidence = self.verdict.evidence
        return StabilityMap(
            windows=np.array(windows, dtype=float),
            window=window,
            stable=ends[:, :2],
            tolerated=ends[:, 2:],
            required=(evidence.min_ratio, evidence.max_ratio),
            rate=evidence.rate,
        )

    def _stable(self, law: PolePlacement) -> tuple[float, float]:
        """Return the widest range of stable constant ratios; nan for none."""
        ranges = stable_intervals(law, computation_delay=self.computation_delay)
        return max(ranges, key=lambda ends: ends[1] / max(ends[0], 1e-300), default=(np.nan, np.nan))

    def _tolerated(self, law: PolePlacement) -> tuple[float, float]:
        """Return the ends of the ball of varying ratios; nan for none.

        With a rate it is the ball that suits the robot: the widest may be at another scale of M̂, and so another rate.
        """
        if not joints_share_loop(law):
            return np.nan, np.nan
        evidence = self.verdict.evidence
        contains = None if evidence.rate is None else (evidence.min_ratio, evidence.max_ratio)
        certificate = self.certificates.get("varying_ratio") if law is self.law and evidence.rate is None else None
        try:
            certificate = certificate or certify_varying_ratio(
                law, ratio_range=contains, rate=evidence.rate, computation_delay=self.computation_delay
            )
        except TarcError:  # stable for no ratio
            return np.nan, np.nan
        return certificate.evidence.min_ratio, certificate.evidence.max_ratio


def suggest_changes(
    law: PolePlacement,
    verdict: Certificate[RobotEvidence],
    computation_delay: int = 0,
    *,
    ball: Certificate[VaryingRatioEvidence] | None = None,
) -> str:
    """Return what to change in a law that was not certified, with numbers; empty for one that was.

    Parameters
    ----------
    law
        The law.
    verdict
        Its certificate on the robot.
    computation_delay
        Periods between a measurement and its torque.
    ball
        The widest ball of the law without a slope and a rate, where it is at hand.
    """
    if verdict.witness:
        return describe_instability(law, verdict.witness, computation_delay)
    if verdict.certified:
        return ""
    if not joints_share_loop(law):
        return "Give all joints the same natural frequency and damping, which the ball needs"
    if isinstance(law, TARC) and law.max_gain is None:
        return "Give the gain a cap, without which nothing bounds the robust term"
    if not np.isfinite(law.robust_slope_bound):
        return "The robust term of this law is not covered by these certificates: simulate it"
    return _suggest_wider_ball(law, verdict.evidence, computation_delay, ball)


def _suggest_wider_ball(
    law: PolePlacement,
    evidence: RobotEvidence,
    computation_delay: int,
    ball: Certificate[VaryingRatioEvidence] | None,
) -> str:
    """Return the ratios that the robot has and that the law tolerates, as it is and synchronised."""
    slope, rate = evidence.slope, evidence.rate
    slower = "a bound on the joints' speeds" if rate is None else "slower joints"
    trials = {"as it is": law}
    if isinstance(law, TDE) and not law.synchronised:
        trials["synchronised"] = replace(law, synchronised=True, delay=None)
    ranges = []
    for name, trial in trials.items():
        widest = ball if trial is law and slope == 0 and rate is None else None
        with suppress(TarcError):  # stable for no ratio
            widest = widest or certify_varying_ratio(trial, slope=slope, rate=rate, computation_delay=computation_delay)
            scale = (widest.evidence.min_ratio * widest.evidence.max_ratio) ** 0.5
            scale /= (evidence.min_ratio * evidence.max_ratio) ** 0.5
            ranges.append(f"{widest.evidence.ratio_spread:.3g} ({name}, with {scale:.3g} of this M̂)")
    return (
        f"The robot's spread is {evidence.ratio_spread:.3g}; the widest ball of this loop holds "
        f"{' or '.join(ranges) or 'none'}. A shorter window, a lower natural frequency, a smaller cap, more rotor "
        f"inertia or {slower} narrow the gap; inconclusive does not mean unstable"
    )


def _evidence_types() -> dict[str, type[Evidence]]:
    """Return the class of evidence of each kind of certificate."""
    classes: tuple[type[Evidence], ...] = (
        RobotEvidence,
        ConstantRatioEvidence,
        SectorEvidence,
        VaryingRatioEvidence,
        Lemma1Evidence,
        ConditionC2Evidence,
        Theorem1Evidence,
        Theorem2Evidence,
        NominalEvidence,
    )
    return {evidence_type.kind: evidence_type for evidence_type in classes}


def certificate_from_dict(content: dict[str, Any]) -> Certificate:
    """Return the certificate that `Certificate.to_dict` wrote.

    Raises
    ------
    TarcError
        For content that is no certificate.
    """
    try:
        evidence_type = _evidence_types()[content["kind"]]
        return certificate_from_plain(evidence_type, content, content["evidence"])
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise TarcError(f"certificate: cannot read it ({error}); needs what Certificate.to_dict wrote") from None


def certificate_from_json(text: str) -> Certificate:
    """Return the certificate that `Certificate.to_json` wrote.

    Raises
    ------
    TarcError
        For text that is no certificate.
    """
    try:
        content = json.loads(text)
    except ValueError as error:
        raise TarcError(f"certificate: the text is no JSON ({error}); needs what Certificate.to_json wrote") from None
    return certificate_from_dict(content)
