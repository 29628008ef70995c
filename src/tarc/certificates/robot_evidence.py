"""Evidence of the robot certificate: worst points of the robot, the ball that must contain them, and its test."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from tarc.analysis.inertia_rate import inertia_rates
from tarc.analysis.operating_points import (
    NEGLIGIBLE_STIFFNESS,
    SEARCH_MARGIN,
    OperatingPoint,
    UncertaintySamples,
    linearise_point,
    to_nominal_coordinates,
)
from tarc.analysis.rest_stability import rest_state_matrix
from tarc.analysis.stability import UnstableMode, Witness, unstable_mode
from tarc.analysis.workspace import Workspace
from tarc.certificates.affine import AffineProof
from tarc.certificates.ball import Ball
from tarc.certificates.base import Evidence, Judgement, LoopMatrices, Verdict, require_held_torque
from tarc.core.types import Array
from tarc.numerics.matrix_tests import schur_stability


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearisedPoint:
    """A robot linearised in a posture: M δq̈ + D δq̇ + G δq = δτ.

    Attributes
    ----------
    position
        Posture [rad or m], shape (n,).
    inertia, damping, stiffness
        M, D and G, shape (n, n).
    velocity, acceleration
        Of the motion, shape (n,); None at rest.
    friction
        Viscous friction of a moving robot, which D leaves out, shape (n, n); None at rest, where it is D.
    """

    position: Array
    inertia: Array
    damping: Array
    stiffness: Array
    velocity: Array | None = None
    acceleration: Array | None = None
    friction: Array | None = None


def linearised_point(point: OperatingPoint) -> LinearisedPoint:
    """Return the robot linearised about a point; at rest with viscous friction, moving without."""
    M, D, G = linearise_point(point) if point.is_moving else point.plant.linearised(point.position)
    return LinearisedPoint(
        position=point.position,
        inertia=M,
        damping=D,
        stiffness=G,
        velocity=point.velocity if point.is_moving else None,
        acceleration=point.acceleration if point.is_moving else None,
        friction=point.plant.damping(point.position) if point.is_moving else None,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class WorstPoints:
    """The points of a workspace that limit the certificate.

    Attributes
    ----------
    min_ratio, max_ratio
        At rest, of the smallest and the largest inertia ratio.
    stiffest, largest_norm
        At rest, of the largest ‖[H, C/θ]‖ and ‖[E − ρ0 I, H/η, C/(η θ)]‖.
    stiffest_moving, largest_norm_moving
        The same in motion; None for a workspace without speeds.
    """

    min_ratio: LinearisedPoint
    max_ratio: LinearisedPoint
    stiffest: LinearisedPoint
    largest_norm: LinearisedPoint
    stiffest_moving: LinearisedPoint | None = None
    largest_norm_moving: LinearisedPoint | None = None

    def at_rest(self) -> tuple[LinearisedPoint, ...]:
        """Return the points at rest."""
        return self.min_ratio, self.max_ratio, self.stiffest, self.largest_norm

    def moving(self) -> tuple[LinearisedPoint, ...]:
        """Return the points in motion."""
        return tuple(point for point in (self.stiffest_moving, self.largest_norm_moving) if point is not None)


@dataclass(frozen=True, kw_only=True, eq=False)
class MaxRatePoint:
    """The posture in which the inertia changes fastest.

    Attributes
    ----------
    position
        Posture [rad or m], shape (n,).
    inertia
        M there, shape (n, n).
    inertia_slopes
        ∂M/∂q_i, shape (n, n, n), the joint i first.
    velocity_limits
        Largest speed of each joint [rad/s or m/s], shape (n,).
    """

    position: Array
    inertia: Array
    inertia_slopes: Array
    velocity_limits: Array

    @classmethod
    def from_point(cls, point: OperatingPoint, workspace: Workspace) -> "MaxRatePoint":
        """Return it for an operating point of a workspace with speeds."""
        return cls(
            position=point.position,
            inertia=point.plant.inertia(point.position),
            inertia_slopes=point.plant.inertia_slopes(point.position),
            velocity_limits=np.asarray(workspace.speed),
        )

    def rate(self, nominal: Array) -> float:
        """Return the largest ‖dE⁻¹/dt‖ [1/s] there, for M̂ (n, n)."""
        return float(inertia_rates(nominal, self.inertia_slopes[None], self.velocity_limits)[0])

    def relative_rate(self) -> float:
        """Return the largest ‖M^−½ (dM/dt) M^−½‖ [1/s] there."""
        return self.rate(self.inertia)


@dataclass(frozen=True, kw_only=True, eq=False)
class AffineCover:
    """A Lyapunov function affine in the inertia, and the points of the robot that limit it.

    Attributes
    ----------
    proof
        The Lyapunov function, with the ratios, the rate and the forces that it covers.
    force_points
        Where ‖E^−p [H, C/θ]‖ is largest, for each bound of the proof.
    rate_points
        Where the inertia changes fastest, in units of M̂ and relative to itself.
    """

    proof: AffineProof
    force_points: tuple[LinearisedPoint, ...]
    rate_points: tuple[MaxRatePoint, ...]

    def margin(self, nominal: Array, points: "UncertaintySamples") -> float:
        """Return by what share ratios, rate and forces may grow until the proof does not cover them.

        Parameters
        ----------
        nominal
            M̂ [kg m² or kg], shape (n, n).
        points
            Uncertainty at all points that must be covered.
        """
        ratios = self.proof.ratios
        values = np.linalg.eigvalsh(points.inertia)
        covered = [values.min() / ratios.min_ratio, ratios.max_ratio / values.max()]
        needed = [(point.rate(nominal), ratios.rate) for point in self.rate_points]
        needed += [(point.relative_rate(), ratios.relative_rate) for point in self.rate_points]
        if ratios.form is not None:
            covered.append(1 + ratios.form.margin(points))
        for power, lead_time, stiffness in zip(ratios.powers, ratios.lead_times, ratios.stiffness, strict=True):
            needed.append((float(points.force_norms(float(lead_time), float(power)).max()), float(stiffness)))
        if not ratios.has_forces:
            needed.append((float(points.force_norms(0.0).max()), NEGLIGIBLE_STIFFNESS))
        if 0.0 in ratios.lead_times or not ratios.has_forces:  # a bound without a lead time leaves the damping out
            needed.append((float(np.abs(points.damping).max()), NEGLIGIBLE_STIFFNESS))
        if any(value > limit for value, limit in needed):
            return -1.0
        covered += [limit / value for value, limit in needed if value > NEGLIGIBLE_STIFFNESS]
        return float(min(covered) - 1)


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotEvidence(Evidence):
    """The worst points of a robot in a workspace, and the ball that must contain them.

    Attributes
    ----------
    nominal_inertia
        M̂ [kg m² or kg], shape (n, n).
    period
        T [s].
    robust_term_is_bounded
        Whether the slope of the robust term has a bound.
    ball
        The ball that the loop tolerates; None for gains that differ between the joints.
    coupled_loop
        The loop of all joints where there is no ball.
    points
        The robot linearised at its worst points.
    max_rate_point
        Where the inertia changes fastest; None where the rate is not bounded.
    min_ratio, max_ratio
        Smallest and largest eigenvalue of M(q)⁻¹M̂ over the workspace. Like the rest, `judge` does not use them.
    stiffness
        Largest ‖[H, C/θ]‖ [1/s²].
    slope
        Largest slope of the robust term [1/s²].
    samples
        Number of sampled postures.
    affine
        The Lyapunov function affine in the inertia; None where the ball decides.
    """

    kind: ClassVar[str] = "robot"
    witness_type: ClassVar[type[Witness] | None] = UnstableMode

    nominal_inertia: Array
    period: float
    robust_term_is_bounded: bool
    ball: Ball | None
    coupled_loop: LoopMatrices | None
    points: WorstPoints
    max_rate_point: MaxRatePoint | None
    min_ratio: float
    max_ratio: float
    stiffness: float
    slope: float
    samples: int
    affine: AffineCover | None = None

    @property
    def method(self) -> str:
        """What decides the verdict: ``ball``, ``ball with a rate`` or ``affine Lyapunov function``."""
        if self.affine is not None:
            return "affine Lyapunov function"
        return "ball" if self.rate is None else "ball with a rate"

    @property
    def decay_rate(self) -> float | None:
        """Rate α [1/s] at which errors are proven to decay, e^{−αt}; None without a ball."""
        if self.affine is not None:
            return self.affine.proof.decay_rate
        return None if self.ball is None else float(np.log(self.ball.growth) / self.period)

    @property
    def ratio_spread(self) -> float:
        """Largest by smallest inertia ratio over the workspace."""
        return self.max_ratio / self.min_ratio

    @property
    def rate(self) -> float | None:
        """Largest ‖dE⁻¹/dt‖ [1/s] that the ball allows; None for any."""
        return None if self.ball is None or self.ball.max_change is None else self.ball.max_change / self.period

    def judge(self) -> Judgement:
        """Test the worst points at rest for a mode that grows, then whether what the loop tolerates contains all."""
        worst_radius, witness = 1.0, None
        loop = self._open_loop()
        require_held_torque(*loop[:2], self.period, None if self.ball is None else self.ball.loop.B_mismatch)
        for point in self.points.at_rest():
            ratios = np.linalg.eigvals(np.linalg.solve(point.inertia, self.nominal_inertia)).real
            matrices = point.inertia, point.damping, point.stiffness
            state_matrix = rest_state_matrix(loop, self.nominal_inertia, matrices, self.period)
            verdict, radius, mode = schur_stability(state_matrix)
            if verdict == "refuted" and radius > worst_radius:
                ratio = ratios.max() if point is self.points.max_ratio else ratios.min()
                worst_radius, witness = radius, unstable_mode(radius, mode, self.period)
                witness = replace(witness, ratio=float(ratio), posture=point.position)
        if witness:
            return Judgement(Verdict.REFUTED, float(1 - worst_radius), witness)
        if self.ball is None:
            return Judgement(Verdict.INCONCLUSIVE, 0.0)
        if self.affine is not None:
            return self._judge_affine(self.affine)
        return self._judge_ball(self.ball)

    def _open_loop(self) -> tuple[Array, Array, Array]:
        """Return A, B, C of the loop opened at its inertia ratio."""
        if self.ball is not None:
            return self.ball.loop.A, self.ball.loop.B, self.ball.loop.C
        if self.coupled_loop is None:
            raise ValueError("evidence: it has neither a ball nor a loop of all joints")
        return self.coupled_loop.A, self.coupled_loop.B, self.coupled_loop.C

    def with_decay(self) -> "RobotEvidence":
        """Return the evidence with the fastest decay that the ball proves for all points."""
        return self if self.ball is None else replace(self, ball=self.ball.with_decay(self.needed_radius(self.ball)))

    def _judge_ball(self, ball: Ball) -> Judgement:
        """Test whether the ball contains the ratios, the stiffness and the rate of all points."""
        judgement = ball.judge(self.needed_radius(ball))
        is_bounded = self.robust_term_is_bounded and self.slope <= 2 * ball.loop.half_slope.item()
        return judgement if is_bounded else judgement._replace(verdict=Verdict.INCONCLUSIVE)

    def needed_radius(self, ball: Ball) -> float:
        """Return the radius that contains all points and worse ones; infinite where the ball leaves something out."""
        lead_time = ball.loop.lead_periods.item() * self.period
        uncertainty = self.uncertainty().grown(SEARCH_MARGIN, self.period)
        stiffness, room = float(uncertainty.stiffness_norms(lead_time).max()), 1 + SEARCH_MARGIN
        damping = float(np.abs(uncertainty.damping).max())
        within = ball.loop.B_mismatch.shape[1] == 2  # the posture changes within a period
        has_either = max(damping, stiffness) > NEGLIGIBLE_STIFFNESS
        if not within or not np.isfinite(lead_time) or (lead_time <= 0 and has_either):
            return np.inf
        ratios = np.linalg.eigvalsh(self.uncertainty().inertia)
        needed_radius = float(max(room * ratios.max() - ball.centre, ball.centre - ratios.min() / room))
        if ball.position_weight > 0:
            joint_radius = uncertainty.needed_radius(ball.centre, ball.position_weight, lead_time, self.period)
            needed_radius = max(needed_radius, joint_radius)
        elif not stiffness <= NEGLIGIBLE_STIFFNESS:  # without a weight the ball leaves the stiffness out
            return np.inf
        if ball.max_change is not None:
            if self.max_rate_point is None or not stiffness <= (1 + 1e-9) * ball.stiffness:
                return np.inf
            rate = room * self.max_rate_point.rate(self.nominal_inertia)
            if rate * self.period / (1 + 1e-9) > ball.max_change:
                return np.inf
        return needed_radius

    def _judge_affine(self, cover: AffineCover) -> Judgement:
        """Test whether the Lyapunov function covers all points, and prove it."""
        uncertainty = self.uncertainty(cover.force_points).with_friction()
        margin = cover.margin(self.nominal_inertia, uncertainty)
        proof = cover.proof
        matches = proof.ratios.period == self.period and self.slope <= 2 * proof.loop.full.loop.half_slope.item()
        matches = matches and proof.ratios.intersample and self.robust_term_is_bounded
        if matches and margin >= SEARCH_MARGIN and proof.is_proven():
            return Judgement(Verdict.CERTIFIED, margin)
        return Judgement(Verdict.INCONCLUSIVE, margin)

    def uncertainty(self, added: tuple[LinearisedPoint, ...] = ()) -> UncertaintySamples:
        """Return the uncertainty at all points, with the viscous friction by itself."""
        points = [*self.points.at_rest(), *self.points.moving(), *added]
        M, D, G = (np.array([getattr(point, name) for point in points]) for name in ("inertia", "damping", "stiffness"))
        friction = np.array([point.damping if point.friction is None else point.friction for point in points])
        D[np.array([point.velocity is None for point in points])] = 0
        return to_nominal_coordinates(self.nominal_inertia, M, D, G, friction)
