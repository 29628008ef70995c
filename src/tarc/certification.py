"""All certificates of a law on a robot at once."""

from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypedDict

import numpy as np

from tarc.analysis.command_units import in_torque_units
from tarc.analysis.inertia_ratio import as_plants
from tarc.analysis.linearise import (
    Channel,
    decoupled_channels,
    joints_share_loop,
    refuse_nominal_inertia,
    require_inertia,
)
from tarc.analysis.rest_stability import describe_instability
from tarc.analysis.stability import disturbance_to_error, noise_to_torque, stable_intervals, widest_interval
from tarc.analysis.workspace import Workspace
from tarc.certificates.ball import Ball
from tarc.certificates.base import Certificate
from tarc.certificates.constant_ratio import certify_constant_ratio
from tarc.certificates.robot import certify_robot, strengthen_robot
from tarc.certificates.robot_evidence import RobotEvidence
from tarc.certificates.robot_points import RobotPoints
from tarc.certificates.robot_proof import ProvenRobot, prove_robot
from tarc.certificates.sector import certify_sector
from tarc.certificates.varying_ratio import certify_varying_ratio, widest_ball
from tarc.core.errors import NoStableRatio
from tarc.core.types import Array
from tarc.estimators.algebraic import Algebraic
from tarc.laws.base import Law
from tarc.laws.pole_placement import PolePlacement
from tarc.laws.tarc import TARC
from tarc.laws.tde import TDE
from tarc.numerics.norms import max_singular_values
from tarc.paper.law_parts import delay_or_default
from tarc.paper.lemma1 import check_condition_c2, check_lemma1
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
    others: Collection["LawCertification"] = (),
    on_certificate: Callable[[str], object] = lambda kind: None,
    prove: bool = False,
    prove_time: float = 600.0,
) -> "LawCertification":
    """Return all certificates that apply to a law on a robot.

    Parameters
    ----------
    law
        A law with an inertia M̂.
    plant
        The robot, or several, such as one without and one with its payload.
    workspace
        The postures that it takes.
    computation_delay
        Periods between a measurement and its torque.
    samples, seed
        Number of sampled postures, and the seed.
    robot_certificate
        Result of `certify_robot` for the same arguments, where it exists already.
    others
        Certifications of other laws on the same robot and workspace, with the same samples and seed. What depends only
        on M̂ or on the linearised loop is taken from those that share it.
    on_certificate
        Called with the kind of each certificate once it is made, to show progress.
    prove
        Prove the robot's certificate for every posture by branch and bound, with `LawCertification.proven`. A law that
        is not certified is strengthened first.
    prove_time
        Time after which such a proof stops as it is [s].

    Returns
    -------
    LawCertification
        Its certificates by kind. First ``robot``; ``constant_ratio`` for every ratio that occurs; for TARC ``sector``,
        at the ratio of the smallest limit; ``varying_ratio``, in the widest range. Then the conditions of the paper,
        ``lemma1``, ``c2``, ``theorem1``, ``theorem2``, and ``nominal``. Those that do not apply are left out.

    Raises
    ------
    UnsupportedLaw
        For a law without an inertia, and for M̂(q) of a model.
    NotLinearisable
        For a law that has no linearisation at rest.
    InvalidParameter
        As in `certify_robot`.
    """
    law = require_inertia(law, "certify_law")
    refuse_nominal_inertia(law, "the certificate of a robot")
    channels = decoupled_channels(law, computation_delay)
    torque_law, plants = in_torque_units(law, as_plants(plant))
    certificates: dict[str, Certificate] = {}

    def add(certificate: Certificate[Any]) -> None:
        certificates[certificate.kind] = certificate
        on_certificate(certificate.kind)

    sampling: dict[str, int] = {"samples": samples, "seed": seed}
    loop: _LoopOptions = {"computation_delay": computation_delay, "channels": channels}
    same_inertia = next((other for other in others if np.array_equal(other.law.M, law.M)), None)
    points = next((other.points.for_inertia(torque_law.M) for other in others if other.points is not None), None)
    if points is None and robot_certificate is None:
        points = RobotPoints.from_robot(plants, torque_law.M, workspace, **sampling)
    robot = robot_certificate or certify_robot(torque_law, plants, workspace, **sampling, **loop, points=points)
    add(robot)
    low, high = robot.evidence.min_ratio, robot.evidence.max_ratio
    if all(channel.n_coupled == 1 for channel in channels):
        add(certify_constant_ratio(law, (low, high), **loop))
    if isinstance(law, TARC):
        sectors = [certify_sector(law, ratio, **loop) for ratio in (low, (low * high) ** 0.5, high)]
        add(min(sectors, key=lambda certificate: certificate.evidence.circle_limit))
    if joints_share_loop(law):
        with suppress(NoStableRatio):  # the certificate of the robot has refuted the law already
            add(certify_varying_ratio(law, **loop))
    if same_inertia is None:
        spread = None if points is None else points.spread
        add(check_lemma1(torque_law, plants, workspace, **sampling, spread=spread))
    else:
        add(same_inertia.certificates["lemma1"])
    if isinstance(law, TARC):
        add(check_condition_c2(law))
    if isinstance(law, TDE):
        for certificate in _time_delay_conditions(law, others):
            add(certificate)
    result = LawCertification(law=law, certificates=certificates, points=points, others=tuple(others), **loop)
    if prove:
        result = result.strengthened(plants, workspace, samples=samples, seed=seed)
        result = result.proven(plants, workspace, time_limit=prove_time)
    return result


def _time_delay_conditions(law: TDE, others: Collection["LawCertification"]) -> list[Certificate]:
    """Return Theorems 1 and 2 and the nominal loop; those of another law where gains, delay and estimator are equal."""
    for other in others:
        if isinstance(other.law, TDE) and _has_same_estimation(law, other.law):
            kinds = Theorem1Evidence.kind, Theorem2Evidence.kind, NominalEvidence.kind
            return [other.certificates[kind] for kind in kinds if kind in other.certificates]
    conditions: list[Certificate] = [check_theorem1(law)]
    if isinstance(law.estimator, Algebraic):
        conditions += [check_theorem2(law), check_nominal_loop(law)]
    return conditions


def _has_same_estimation(law: TDE, other: TDE) -> bool:
    """Return whether two laws have the same gains, delay and estimator."""
    return (
        law.estimator is other.estimator
        and delay_or_default(law, None) == delay_or_default(other, None)
        and np.array_equal(law.K1, other.K1)
        and np.array_equal(law.K2, other.K2)
    )


class _LoopOptions(TypedDict):
    """Options that the certificates of the loop share."""

    computation_delay: int
    channels: Sequence[Channel]


@dataclass(frozen=True, kw_only=True, eq=False)
class StabilityMap:
    """Stable inertia ratios over the window of the estimator.

    Attributes
    ----------
    windows
        Windows [periods], shape (k,); two points for an estimator without a window.
    window
        Window of the law [periods].
    stable
        Ends of the widest range in which every constant ratio is stable, shape (k, 2); nan for none.
    tolerated
        Ends of the range of varying ratios that is certified, shape (k, 2); nan for none.
    required
        Smallest and largest inertia ratio of the robot.
    rate
        Largest rate of change for which the range of varying ratios is certified [1/s]; None for any.
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
    channels
        Its linearised loops.
    certificates
        By kind, that of the robot first.
    points
        What samples and searches have found of the robot; None where its certificate was given.
    computation_delay
        Periods between a measurement and its torque.
    others
        Certifications of other laws on the same robot, whose results this one may share.
    proof
        What of the robot's certificate is proven for every posture; None where that was not tried.
    """

    law: PolePlacement
    channels: Sequence[Channel]
    certificates: dict[str, Certificate]
    points: RobotPoints | None = None
    computation_delay: int = 0
    others: Collection["LawCertification"] = ()
    proof: ProvenRobot | None = None

    @property
    def verdict(self) -> Certificate[RobotEvidence]:
        """Return the certificate of the robot."""
        return self.certificates["robot"]

    def strengthened(
        self,
        plant: Plant | Sequence[Plant],
        workspace: Workspace,
        *,
        samples: int = 2000,
        seed: int = 0,
        on_program: Callable[[], object] = lambda: None,
    ) -> "LawCertification":
        """Return the same with the robot's certificate by `tarc.certificates.strengthen_robot`, where that is better.

        Parameters
        ----------
        plant, workspace, samples, seed
            As in `certify_law`.
        on_program
            Called after each semidefinite program, to show progress.
        """
        robot = strengthen_robot(
            self.verdict,
            self.law,
            plant,
            workspace,
            computation_delay=self.computation_delay,
            samples=samples,
            seed=seed,
            channels=self.channels,
            points=self.points,
            on_program=on_program,
        )
        return self if robot is self.verdict else replace(self, certificates=self.certificates | {"robot": robot})

    def proven(
        self,
        plant: Plant | Sequence[Plant],
        workspace: Workspace,
        *,
        time_limit: float = 600.0,
        progress: bool | None = None,
    ) -> "LawCertification":
        """Return the same with the robot's certificate proven for every posture, by `tarc.certificates.prove_robot`.

        The verdict then says for every posture; where a bound is not proven in the time, with which share it is.

        Parameters
        ----------
        plant, workspace
            As in `certify_law`.
        time_limit
            Time after which the proof stops as it is [s].
        progress
            Show progress bars when it takes more than two seconds; None for when standard error is a terminal.
        """
        proof = prove_robot(self.verdict, self.law, plant, workspace, time_limit=time_limit, progress=progress)
        return replace(self, certificates=self.certificates | {"robot": proof.certificate}, proof=proof)

    @cached_property
    def suggestion(self) -> str:
        """Return what to change in a law that was not certified; empty for one that was."""
        law, robot = self.law, self.verdict
        if robot.witness:
            return describe_instability(law, robot.witness, self.computation_delay, channels=self.channels)
        if robot.certified:
            return ""
        if not joints_share_loop(law):
            return (
                "Give all joints the same natural frequency and damping ratio, which the varying-ratio certificate "
                "needs"
            )
        if isinstance(law, TARC) and law.max_gain is None:
            return "Give the gain a maximum, max_gain, without which nothing bounds the robust term"
        if not np.isfinite(law.robust_slope_bound):
            return "The robust term of this law is not covered by these certificates: simulate it"
        return self._suggest_wider_range()

    @property
    def ratios(self) -> dict[str, float]:
        """Return the smallest, mean and largest inertia ratio of the robot, by name."""
        low, high = self.verdict.evidence.min_ratio, self.verdict.evidence.max_ratio
        return {"smallest ratio": low, "mean": float(np.sqrt(low * high)), "largest ratio": high}

    @cached_property
    def eigenvalues(self) -> dict[str, Array]:
        """Return the eigenvalues of the loop at each of the `ratios`, by name."""
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
        """Return the stable ratios over the window; None where the gains couple the joints."""
        if any(channel.n_coupled > 1 for channel in self.channels):
            return None
        same = next((other for other in self.others if self._has_same_map(other)), None)
        if same is not None:
            return same.stability_map
        estimator, period = self.law.estimator, self.law.period
        laws, window, windows = [self.law], 1, [0, 2]
        if isinstance(estimator, Algebraic):
            window = estimator.samples - 1
            longest = max(min(4 * window, 40), 30, 1.3 * window)  # the time grows with its cube
            windows = sorted({*np.geomspace(estimator.degree, longest, 11).astype(int).tolist(), window})
            laws = [
                self.law if count == window else replace(self.law, estimator=replace(estimator, window=count * period))
                for count in windows
            ]
        ends = np.broadcast_to(np.array([self._stable_ranges(law) for law in laws]), (len(windows), 4))
        evidence = self.verdict.evidence
        return StabilityMap(
            windows=np.array(windows, dtype=float),
            window=window,
            stable=ends[:, :2],
            tolerated=ends[:, 2:],
            required=(evidence.min_ratio, evidence.max_ratio),
            rate=evidence.rate,
        )

    def _has_same_map(self, other: "LawCertification") -> bool:
        """Return whether another law has the same loop, but for its robust term, on the same range of ratios."""
        evidence, others = self.verdict.evidence, other.verdict.evidence
        same_robot = (evidence.min_ratio, evidence.max_ratio, evidence.rate) == (
            others.min_ratio,
            others.max_ratio,
            others.rate,
        )
        return (
            same_robot
            and self.law.estimator is other.law.estimator
            and self.computation_delay == other.computation_delay
            and len(self.channels) == len(other.channels)
            and all(
                mine.joints == theirs.joints
                and all(np.array_equal(getattr(mine, name), getattr(theirs, name)) for name in "FGCD")
                for mine, theirs in zip(self.channels, other.channels, strict=True)
            )
        )

    def _stable_ranges(self, law: PolePlacement) -> tuple[float, float, float, float]:
        """Return the ends of the widest range of stable constant ratios, and of varying ones; nan for none."""
        channels = self.channels if law is self.law else decoupled_channels(law, self.computation_delay)
        constant = widest_interval(stable_intervals(law, channels=channels)) or (np.nan, np.nan)
        return *constant, *self._varying_range(law, channels)

    def _varying_range(self, law: PolePlacement, channels: Sequence[Channel]) -> tuple[float, float]:
        """Return the ends of the certified range of varying ratios; nan for none.

        With a rate it is the range that suits the robot. The widest may be at another scale of M̂, and so another rate.
        """
        if not joints_share_loop(law):
            return np.nan, np.nan
        robot = self.verdict.evidence
        ratio_range = None if robot.rate is None else (robot.min_ratio, robot.max_ratio)
        certificate = self.certificates.get("varying_ratio") if law is self.law and robot.rate is None else None
        try:
            certificate = certificate or certify_varying_ratio(
                law,
                ratio_range=ratio_range,
                rate=robot.rate,
                computation_delay=self.computation_delay,
                channels=channels,
                affine=False,
            )
        except NoStableRatio:
            return np.nan, np.nan
        return certificate.evidence.min_ratio, certificate.evidence.max_ratio

    @cached_property
    def tolerated(self) -> dict[bool, Ball]:
        """Return the widest balls at the robot's rate, of the law as it is and synchronised, by whether it is that.

        One that is stable for no ratio is left out.
        """
        law, robot = self.law, self.verdict.evidence
        is_synchronised = isinstance(law, TDE) and law.synchronised
        variants: dict[bool, tuple[PolePlacement, Sequence[Channel] | None]] = {is_synchronised: (law, self.channels)}
        if isinstance(law, TDE) and not law.synchronised:
            variants[True] = replace(law, synchronised=True, delay=None), None
        found = {}
        for synchronised, (variant, channels) in variants.items():
            is_computed = variant is law and robot.slope == 0 and robot.rate is None
            certificate = self.certificates.get("varying_ratio") if is_computed else None
            with suppress(NoStableRatio):
                found[synchronised] = (
                    certificate.evidence.ball
                    if certificate
                    else widest_ball(
                        variant,
                        slope=robot.slope,
                        rate=robot.rate,
                        computation_delay=self.computation_delay,
                        channels=channels,
                    )
                )
        return found

    def _suggest_wider_range(self) -> str:
        """Return the ratios of the robot and those that the law tolerates, as it is and synchronised."""
        law, robot = self.law, self.verdict.evidence
        slower = "a bound on the joints' speeds" if robot.rate is None else "slower joints"
        robot_centre = (robot.min_ratio * robot.max_ratio) ** 0.5
        ranges = []
        for is_synchronised, ball in self.tolerated.items():
            name = "synchronised" if is_synchronised and not getattr(law, "synchronised", True) else "as it is"
            scale = (ball.min_ratio * ball.max_ratio) ** 0.5 / robot_centre
            ranges.append(f"{ball.ratio_spread:.3g} ({name}, with {scale:.3g} of this M̂)")
        return (
            f"The robot's largest inertia ratio is {robot.ratio_spread:.3g} times its smallest; the varying-ratio "
            f"certificate of this loop allows {' or '.join(ranges) or 'none'}. A shorter window, a lower natural "
            f"frequency, a smaller max_gain, more rotor inertia or {slower} narrow the gap; inconclusive does not mean "
            "unstable"
        )
