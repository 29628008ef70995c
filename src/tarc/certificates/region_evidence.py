"""Evidence for a region of attraction: a Lyapunov function that falls in a tube about a reference."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from tarc.certificates.affine_form import LyapunovMatrices, RatioSet
from tarc.certificates.base import Evidence, Judgement, Verdict
from tarc.certificates.region_form import InputBounds, RegionWeights, TrackingLoop, region_decrease, signal_bounds
from tarc.certificates.region_tube import TubeSize
from tarc.core.types import Array
from tarc.numerics.ball_arithmetic import BALLS, decide, is_positive_definite
from tarc.numerics.matrix_polynomial import definite_pieces, is_definite_on

SLACK = 1 + 2.0**-27
"""Factor by which stored sizes may miss those computed again."""
SIZE_ROOM = 1e-5
"""Share by which sizes are stored smaller or larger than computed, beyond rounding."""
BISECTIONS = 50
"""Number of steps in which the largest level within the tube is found."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RegionProof:
    """A Lyapunov function for all errors in a tube about a reference, and the levels between which it falls.

    Lengths are in coordinates M̂^½ q.

    Attributes
    ----------
    tube
        Largest ‖M̂^½ e‖ and ‖M̂^½ ė‖ of the tube.
    loop
        The loop of one joint, in the states of the Lyapunov function.
    ratios
        What the robot is in the tube, with `MARGIN`.
    bounds
        What acts on the loop, with `MARGIN`.
    matrices, weights
        Of the Lyapunov function, and of what the signals satisfy.
    decay
        ϱ: V⁺ ≤ ϱ V + g.
    level
        V0: a level of V in the tube, also between samples.
    rest_stiffness
        Largest ‖M̂^−½ (∂N/∂q) M̂^−½‖ at rest in the tube [1/s²], with `MARGIN`.
    start_torque, start_velocity
        ‖M̂^−½ (N(qᵈ, 0) − τ*)‖ and ‖M̂^½ q̇ᵈ‖ at the start.
    """

    tube: TubeSize
    loop: TrackingLoop
    ratios: RatioSet
    bounds: InputBounds
    matrices: LyapunovMatrices
    weights: RegionWeights
    decay: float
    level: float
    rest_stiffness: float
    start_torque: float
    start_velocity: float

    @property
    def supply(self) -> float:
        """g, by which V may grow in a period."""
        force_squares, squares = signal_bounds(self.ratios, self.bounds)
        return float(self.weights.forces @ force_squares + np.array(self.weights[3:]) @ squares)

    @property
    def final_level(self) -> float:
        """g/(1 − ϱ), which V approaches."""
        return self.supply / (1 - self.decay)

    def with_largest_level(self) -> "RegionProof":
        """Return the same with the largest level of V that lies in the tube; the program makes it at most 1."""
        low, high = 0.0, 1.0
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            low, high = (middle, high) if self.is_in_tube(middle) else (low, middle)
        return replace(self, level=low * (1 - SIZE_ROOM))

    def is_in_tube(self, level: float) -> bool:
        """Return whether a level of V that is not left lies in the tube, also between samples."""
        error, rate = self._largest(level)
        return error <= SLACK * self.tube.error and rate <= SLACK * self.tube.error_rate

    @property
    def start_error(self) -> float:
        """R0: largest ‖M̂^½ e‖ at the start; the robot is at rest, and so held, and its window is full of q."""
        error, rate, window, torque = self.loop.starts.T
        taken = self._norm(torque) * self.start_torque + self._norm(rate) * self.start_velocity * self.ratios.period
        taken += self._norm(window) * self.bounds.noise
        needed = self._norm(error + window) + self.rest_stiffness * self._norm(torque)
        return max((self.level**0.5 - taken) / needed, 0.0)

    @property
    def final_error(self) -> float:
        """R∞: ‖M̂^½ e‖ in the end, between samples too; from the start it decays to it as √ϱ per period."""
        return self._largest(self.final_level)[0]

    @property
    def decay_rate(self) -> float:
        """Rate α [1/s] at which what exceeds the final level decays."""
        return float(-np.log(self.decay) / 2 / self.ratios.period)

    def margin(self) -> float:
        """Return 1 less the level that V approaches over that of the tube; −1 for numbers out of range."""
        if not self._is_consistent() or not self.is_in_tube(self.level):
            return -1.0
        return 1 - self.final_level / self.level

    def is_proven(self) -> bool:
        """Return whether ball arithmetic proves that V is positive and falls in the tube, at all ratios."""
        arguments = self.loop, self.ratios, self.matrices, self.weights, self.decay
        low, high = self.ratios.min_ratio, self.ratios.max_ratio
        ends = definite_pieces(region_decrease(*arguments), low, high)
        if ends is None:
            return False

        def is_positive() -> bool:
            P0, P1, Q1, S, R, S0 = (BALLS.matrix(part) for part in self.matrices)
            forms = [P0 * BALLS.number(ratio) + P1 + Q1 for ratio in (low, high)]
            forms += [S0 + P0, S0 - P0] if self.ratios.nominal_rate > 0 else []
            return all(is_positive_definite(form) for form in [*forms, S + P1, S - P1, R + Q1, R - Q1])

        return decide(is_positive) and decide(lambda: is_definite_on(region_decrease(*arguments, BALLS), ends))

    def _is_consistent(self) -> bool:
        """Return whether all numbers are finite and in range."""
        ratios, weights = self.ratios, [*self.weights.forces, *self.weights[1:]]
        numbers = [
            ratios.rate,
            ratios.relative_rate,
            ratios.nominal_rate,
            self.bounds.noise,
            self.bounds.residual,
            self.bounds.drift,
            self.rest_stiffness,
        ]
        numbers += [
            self.loop.half_slope,
            self.start_torque,
            self.start_velocity,
            *ratios.stiffness,
            *ratios.lead_times,
            *weights,
        ]
        return (
            0 < ratios.min_ratio <= ratios.max_ratio < np.inf
            and 0 < self.decay < 1
            and 0 < self.level < np.inf
            and bool(np.all(np.isfinite(numbers)) and np.all(np.array(numbers) >= 0))
            and bool(np.all(ratios.powers == 1) and np.isfinite(ratios.condition) and ratios.intersample)
            and bool(np.all(np.isfinite(ratios.force_bounds())))
        )

    def _ends(self) -> list[Array]:
        """Return P(λ) at the ends of the range; norms are largest there, since P is affine in 1/λ."""
        P0, P1, Q1 = self.matrices[:3]
        return [P0 + (P1 + Q1) / ratio for ratio in (self.ratios.min_ratio, self.ratios.max_ratio)]

    def _norm(self, state: Array) -> float:
        """Return the largest √(yᵀ P(λ) y)."""
        values = [float(state @ P @ state) for P in self._ends()]
        return _root(min(values), max(values))

    def _gain(self, row: Array) -> float:
        """Return the largest value of a row of the state over √V."""
        values = [float(row @ np.linalg.solve(P, row)) for P in self._ends()]
        return _root(min(values), max(values))

    def _largest(self, level: float) -> tuple[float, float]:
        """Return the largest ‖M̂^½ e‖ and ‖M̂^½ ė‖ of a level of V that is not left, between samples too.

        Between samples e differs from its chord by at most T²/8 of the largest acceleration. For ė it is at most T/2 of
        what the acceleration differs from its mean. M̂ is that of the start of the period, at its end too.
        """
        T, (position, velocity), root = self.ratios.period, self.loop.outputs, level**0.5
        end = root * (1 + self.ratios.max_nominal_change) ** 0.5
        bounds = self.bounds
        v = root * self._gain(self.loop.C[0]) + abs(self.loop.noise_gain.item()) * bounds.noise
        robust = self.loop.half_slope * (self.tube.error + bounds.noise)
        v += abs(self.loop.residual_gain.item()) * (bounds.residual + robust)
        force = bounds.held + bounds.torque
        if len(self.ratios.stiffness):
            reach = np.hypot(self.tube.error, self.ratios.lead_times * self.tube.error_rate)
            force += float((self.ratios.stiffness * reach).min())
        largest = self.ratios.max_ratio * (v + force)
        uneven = self.ratios.max_ratio * (self.ratios.swing * v + 2 * force)
        error = end * self._gain(position) + largest * T**2 / 8
        return float(error), float(end * self._gain(velocity) / T + uneven * T / 2)


@dataclass(frozen=True, kw_only=True, eq=False)
class RegionEvidence(Evidence):
    """Errors from which a law recovers along a reference.

    Attributes
    ----------
    proof
        The Lyapunov function; None where none was found.
    nominal_inertia
        M̂ [kg m² or kg], shape (n, n); for M̂(q) a matrix at least as large as it at the start.
    error_units
        √(M̂⁻¹)_ii, shape (n,); for M̂(q) the largest in the tube.
    max_error
        R, largest error of each joint that is allowed [rad or m], shape (n,).
    start_error, final_error
        R0 and R∞: largest ‖M̂^½ e‖ at the start and in the end; zero and infinite without a proof.
    """

    kind: ClassVar[str] = "region"

    proof: RegionProof | None
    nominal_inertia: Array
    error_units: Array
    max_error: Array
    start_error: float
    final_error: float

    def judge(self) -> Judgement:
        """Prove that V is positive and falls in the tube, and compare its levels."""
        proof = self.proof
        if proof is None:
            return Judgement(Verdict.INCONCLUSIVE, -1.0)
        margin = proof.margin()
        holds = margin > 0 and 0 < self.start_error <= SLACK * proof.start_error
        holds = holds and SLACK * self.final_error >= proof.final_error
        least = np.sqrt(np.diag(np.linalg.inv(self.nominal_inertia)))
        holds = holds and bool(np.all(SLACK * self.error_units >= least))
        holds = (
            holds and bool(np.all(self.joint_errors(proof.tube.error) <= SLACK * self.max_error)) and proof.is_proven()
        )
        return Judgement(Verdict.CERTIFIED if holds else Verdict.INCONCLUSIVE, margin)

    def joint_errors(self, size: float) -> Array:
        """Return the largest |e_i| of ‖M̂^½ e‖ ≤ size [rad or m], shape (n,)."""
        return size * self.error_units

    @property
    def tube_errors(self) -> Array:
        """Largest error of each joint that ever occurs [rad or m], shape (n,)."""
        return self.joint_errors(self.proof.tube.error) if self.proof else 0 * self.max_error

    @property
    def start_errors(self) -> Array:
        """R0: largest initial error of each joint if the others have none [rad or m], shape (n,)."""
        return self.start_error / np.sqrt(np.diag(self.nominal_inertia))

    @property
    def final_errors(self) -> Array:
        """R∞: bound on the error of each joint in the end [rad or m], shape (n,)."""
        return self.joint_errors(self.final_error)

    def start_contains(self, error: Array) -> bool:
        """Return whether an initial error of all joints (n,) is covered."""
        return float(error @ self.nominal_inertia @ error) <= self.start_error**2


def _root(least: float, largest: float) -> float:
    """Return the root of the larger of two squares; infinite where one is negative, of a form that is not positive."""
    return float(largest) ** 0.5 if least >= 0 else float("inf")
