"""Evidence of the certificate of M̂(q): worst points of the robot, the ball or Lyapunov function that covers them."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from tarc.analysis.inertia_rate import inertia_rates
from tarc.analysis.known_inertia import lagged_force_norms, to_posture_coordinates
from tarc.analysis.operating_points import NEGLIGIBLE_STIFFNESS, SEARCH_MARGIN, UncertaintySamples
from tarc.analysis.rest_stability import rest_state_matrix
from tarc.analysis.stability import UnstableMode, Witness, unstable_mode
from tarc.analysis.uncertain_loop import System, UncertainLoop, scaled_system
from tarc.certificates.affine import AffineProof
from tarc.certificates.base import Evidence, Judgement, LoopMatrices, Verdict, fastest_decay, require_held_torque
from tarc.certificates.robot_evidence import LinearisedPoint, MaxRatePoint
from tarc.core.types import Array
from tarc.numerics.matrix_tests import schur_stability
from tarc.numerics.norms import hinf_norm

KNOWN_PARTS = "nominal", "model_stiffness"
"""Matrices of the law at a point."""


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownPoint:
    """A robot linearised in a posture, with the law's M̂(q) there.

    Attributes
    ----------
    nominal
        M̂(q), shape (n, n).
    robot
        M, D and G of the robot; G less the stiffness of the law's model, D without viscous friction.
    model_stiffness
        ∂(M̂ a + ĥ)/∂q, the stiffness of the law's model [N m/rad or N/m], shape (n, n).
    """

    nominal: Array
    robot: LinearisedPoint
    model_stiffness: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownRatePoint:
    """The posture in which M̂(q) changes fastest.

    Attributes
    ----------
    nominal, inertia_slopes
        M̂ (n, n) and ∂M̂/∂q_i (n, n, n), the joint i first.
    velocity_limits
        Largest speed of each joint [rad/s or m/s], shape (n,).
    """

    nominal: Array
    inertia_slopes: Array
    velocity_limits: Array

    def rate(self) -> float:
        """Return the largest ‖M̂^−½ (dM̂/dt) M̂^−½‖ [1/s] there."""
        return float(inertia_rates(self.nominal, self.inertia_slopes[None], self.velocity_limits)[0])


@dataclass(frozen=True, kw_only=True, eq=False)
class RestLoop:
    """The loop of all joints about a robot at rest, opened at its inertia ratio, and the robot.

    Attributes
    ----------
    loop
        The loop, with the stiffness of the law's model.
    nominal
        M̂(q), shape (n, n).
    robot
        M, D and G with viscous friction.
    """

    loop: LoopMatrices
    nominal: Array
    robot: LinearisedPoint

    def state_matrix(self, period: float) -> Array:
        """Return the state matrix of the closed loop."""
        loop = self.loop.A, self.loop.B, self.loop.C
        matrices = self.robot.inertia, self.robot.damping, self.robot.stiffness
        return rest_state_matrix(loop, self.nominal, matrices, period)


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownInertiaEvidence(Evidence):
    """Worst points of a robot under a law with M̂(q), and the ball that must contain them.

    Attributes
    ----------
    period
        T [s].
    computation_delay
        Periods between a measurement and its torque.
    loop
        The loop of one joint, opened at its inertia ratio.
    centre, radius, position_weight
        ρ0, δ and η [1/s²] of the ball.
    scale
        Scale of the robust term's block; None without one.
    points
        The robot linearised at its worst points, those of the extreme ratios first.
    rate_point
        Where M̂(q) changes fastest.
    rest_loop
        The loop at rest in a posture where it is unstable; None for none.
    affine
        A Lyapunov function affine in M̂ and M that covers the points; None where it was not needed or not found.
    relative_rate_point
        Where the robot's M changes fastest relative to itself.
    robust_term_is_bounded
        Whether the slope of the robust term has a bound.
    min_ratio, max_ratio
        Smallest and largest eigenvalue of M(q)⁻¹M̂(q) at the points. `judge` does not use them.
    samples
        Number of sampled postures.
    decay_growth, decay_radius
        e^{αT} and the radius up to which errors decay as e^{−αt} by the ball; 1 and 0 where no rate α is proven.
    """

    kind: ClassVar[str] = "known_inertia"
    witness_type: ClassVar[type[Witness] | None] = UnstableMode

    period: float
    computation_delay: int
    loop: UncertainLoop
    centre: float
    radius: float
    position_weight: float
    scale: float | None
    points: tuple[KnownPoint, ...]
    rate_point: KnownRatePoint
    rest_loop: RestLoop | None
    affine: AffineProof | None
    relative_rate_point: MaxRatePoint
    robust_term_is_bounded: bool
    min_ratio: float
    max_ratio: float
    samples: int
    decay_growth: float = 1.0
    decay_radius: float = 0.0

    @property
    def ratio_spread(self) -> float:
        """Largest by smallest inertia ratio."""
        return self.max_ratio / self.min_ratio

    @property
    def rate(self) -> float:
        """Largest ‖M̂^−½ (dM̂/dt) M̂^−½‖ [1/s]."""
        return self.rate_point.rate()

    @property
    def decay_rate(self) -> float:
        """α [1/s]: errors decay as e^{−αt}; zero where no rate is proven."""
        if self.affine is not None:
            return self.affine.decay_rate
        return float(np.log(self.decay_growth) / self.period)

    def with_decay(self) -> "KnownInertiaEvidence":
        """Return the evidence with the fastest decay that the ball proves for all points."""
        system = decayed_system(self.loop, self.centre, self.position_weight, self.growth)
        spectral_radius, needed = float(np.abs(np.linalg.eigvals(system[0])).max()), self.needed_radius()
        growth = fastest_decay(lambda growth: self.is_proven(needed, growth), spectral_radius)
        return replace(self, decay_growth=growth, decay_radius=needed) if growth > 1 else self

    @property
    def growth(self) -> float:
        """Change of M̂ in a period, relative to itself, with the margin for points that were missed."""
        return (1 + SEARCH_MARGIN) * self.rate * self.period

    def uncertainty(self) -> UncertaintySamples:
        """Return E, H, C and the law's own part of H of the points in coordinates M̂(q)^½ q."""
        robots = [point.robot for point in self.points]
        M, D, G = (np.array([getattr(robot, name) for robot in robots]) for name in ("inertia", "damping", "stiffness"))
        nominal, own = (np.array([getattr(point, name) for point in self.points]) for name in KNOWN_PARTS)
        return to_posture_coordinates(nominal, M, D, G, own)

    def lagged_force_norms(self, lead_time: float, power: float, lag_weight: float) -> Array:
        """Return ‖E^−p [H, C/θ, K/φ]‖ of the points [1/s²], shape (k,)."""
        robots = [point.robot for point in self.points]
        M, D, G = (np.array([getattr(robot, name) for robot in robots]) for name in ("inertia", "damping", "stiffness"))
        nominal, own = (np.array([getattr(point, name) for point in self.points]) for name in KNOWN_PARTS)
        return lagged_force_norms((nominal, M, D, G, own), lead_time, power, lag_weight)

    def needed_radius(self) -> float:
        """Return the radius of the points and of worse ones, with what M̂(q) changes until the torque has acted."""
        return widened_radius(
            self.uncertainty(),
            (self.centre, self.position_weight, self.loop.lead_periods.item() * self.period),
            self.growth,
            self.computation_delay,
            self.period,
        )

    def judge(self) -> Judgement:
        """Test the loop at rest for a mode that grows, then the Lyapunov function or the ball."""
        require_held_torque(self.loop.A, self.loop.B, self.period, self.loop.B_mismatch)
        if self.rest_loop is not None:
            verdict, radius, mode = schur_stability(self.rest_loop.state_matrix(self.period))
            if verdict == "refuted":
                witness = unstable_mode(radius, mode, self.period)
                return Judgement(
                    Verdict.REFUTED, float(1 - radius), replace(witness, posture=self.rest_loop.robot.position)
                )
        if self.affine is not None:
            margin = self.affine_margin(self.affine)
            proven = margin >= SEARCH_MARGIN and self.robust_term_is_bounded and self.affine.is_proven()
            return Judgement(Verdict.CERTIFIED if proven else Verdict.INCONCLUSIVE, margin)
        return self._judge_ball()

    def affine_margin(self, proof: AffineProof) -> float:
        """Return by what share ratios, rates and forces may grow until a Lyapunov function does not cover them.

        It is −1 for the Lyapunov function of another loop. The changes of M̂(q) within a period count.
        """
        ratios, full = proof.ratios, proof.loop.full.loop
        lag_periods = self.computation_delay if len(ratios.lag_weights) else 0
        own = self.loop.with_past_position(lag_periods)
        is_same = ratios.period == self.period
        is_same &= np.array_equal(full.A, own.A) and np.array_equal(full.C, own.C)
        is_same &= not lag_periods or len(proof.loop.full.scales) == 4
        is_same &= full.half_slope.item() >= self.loop.half_slope.item()
        uncertainty = self.uncertainty()
        values = np.linalg.eigvalsh(uncertainty.inertia)
        swing = float(np.exp(self.rate * self.period * (1 + self.computation_delay)))
        relative_rate = self.relative_rate_point.relative_rate()
        lowest, highest = float(values.min()) / swing, float(values.max()) * swing
        covered = [lowest / ratios.min_ratio, ratios.max_ratio / highest]
        needed = [(relative_rate, ratios.relative_rate), (relative_rate / lowest, ratios.rate)]
        needed.append((self.rate, ratios.nominal_rate))
        bounds = ratios.powers.tolist(), ratios.lead_times.tolist(), ratios.lags().tolist(), ratios.stiffness.tolist()
        for power, lead_time, lag, stiffness in zip(*bounds, strict=True):
            needed.append((swing * float(self.lagged_force_norms(lead_time, power, lag).max()), stiffness))
        if not len(ratios.stiffness):
            needed.append((float(uncertainty.force_norms(0.0).max()), NEGLIGIBLE_STIFFNESS))
        if not np.all(ratios.lags() > 0) or not len(ratios.stiffness):  # without a weight the lag is left out
            own_stiffness = np.array([point.model_stiffness for point in self.points])
            needed.append((float(np.abs(own_stiffness).max()), NEGLIGIBLE_STIFFNESS))
        if 0.0 in ratios.lead_times or not len(ratios.stiffness):  # a bound without a lead time leaves the damping out
            needed.append((float(np.abs(uncertainty.damping).max()), NEGLIGIBLE_STIFFNESS))
        if not is_same or any(value > limit for value, limit in needed):
            return -1.0
        covered += [limit / value for value, limit in needed if value > NEGLIGIBLE_STIFFNESS]
        return float(min(covered) - 1)

    def _judge_ball(self) -> Judgement:
        """Test the radius and the decayed norm of the loop."""
        uncertainty = self.uncertainty()
        lead_time = self.loop.lead_periods.item() * self.period
        has_stiffness = float(uncertainty.stiffness_norms(lead_time).max()) > NEGLIGIBLE_STIFFNESS
        has_damping = float(np.abs(uncertainty.damping).max()) > NEGLIGIBLE_STIFFNESS
        numbers = self.centre, self.radius, self.position_weight, lead_time, self.rate, self.decay_growth
        is_complete = np.all(np.isfinite(numbers)) and self.radius > 0 and self.centre > 0
        is_complete &= not has_stiffness or self.position_weight > 0
        is_complete &= not (has_damping or has_stiffness) or lead_time > 0
        is_complete &= self.loop.B_mismatch.shape[1] == 2  # the posture changes within a period
        if not is_complete:
            return Judgement(Verdict.INCONCLUSIVE, -1.0)
        margin = self.radius / max(self.needed_radius(), self.centre / 1e3) - 1
        certified = margin >= 0 and self.robust_term_is_bounded and self.is_proven(self.radius)
        if certified and self.decay_growth != 1:
            in_range = self.decay_growth > 1 and self.needed_radius() <= self.decay_radius <= self.radius
            certified = in_range and self.is_proven(self.decay_radius, self.decay_growth)
        return Judgement(Verdict.CERTIFIED if certified else Verdict.INCONCLUSIVE, float(margin))

    def is_proven(self, radius: float, growth: float = 1.0) -> bool:
        """Return whether the decayed loop is stable, and its norm shows a radius; with a growth g also a decay g^−k."""
        total = self.growth + 2 * float(np.log(growth))
        system = decayed_system(self.loop, self.centre, self.position_weight, total)
        if schur_stability(system[0])[0] != "certified":
            return False
        return hinf_norm(*scaled_system(system, radius, self.scale)) < 1


def decayed_system(loop: UncertainLoop, centre: float, position_weight: float, growth: float) -> System:
    """Return the loop with states that grow by e^{growth/2} in each period, as A, B, C, D.

    If its norm is below 1/δ, a P exists with e^{growth} V(x⁺) < V(x) for all mismatches up to δ, V = xᵀ (P ⊗ M̂) x. Then
    V decreases although M̂ grows by e^{growth} in a period.
    """
    return loop.closed_loop(centre, position_weight, float(np.exp(growth / 2)))


def widened_radius(
    uncertainty: UncertaintySamples,
    ball: tuple[float, float, float],
    growth: float,
    computation_delay: int,
    period: float,
) -> float:
    """Return the radius that contains points and worse ones, and what M̂(q) changes until the torque has acted.

    The worse ones are those of `UncertaintySamples.grown`, by the margin of a search.

    At the end of the period M̂ is e^{(1 + d) growth} times that of the torque at most, and the coordinates are those of
    its start.

    Parameters
    ----------
    uncertainty
        The points.
    ball
        Centre ρ0, weight η [1/s²], lead time θ [s].
    growth
        Relative change of M̂ in one period.
    computation_delay
        d, periods between a measurement and its torque.
    period
        T [s].
    """
    centre, weight, lead_time = ball
    uncertainty = uncertainty.grown(SEARCH_MARGIN, period)
    needed = uncertainty.needed_radius(centre, weight or np.inf, lead_time if weight else 0.0, period)
    largest_ratio = float(np.linalg.eigvalsh(uncertainty.inertia).max())
    return float(np.exp(growth) * (needed + largest_ratio * np.expm1((1 + computation_delay) * growth)))
