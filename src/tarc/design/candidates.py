"""Loops that a design chooses from: their parameters, and the noise and error of each."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from tarc.analysis.linearise import Channel, decoupled_channels
from tarc.analysis.stability import disturbance_to_error, noise_to_torque
from tarc.core import validation as check
from tarc.estimators.algebraic import Algebraic
from tarc.laws.tdc import TDC
from tarc.numerics.norms import h2_norm, output_covariance

WINDOWS = (3, 4, 5, 6, 8, 10, 12, 15, 20, 25, 30)
"""Windows that are tried [periods]."""
NATURAL_FREQUENCIES = (2.0, 3.0, 4.0, 5.0, 7.0, 10.0, 14.0, 20.0, 28.0, 40.0, 60.0, 90.0, 130.0)
"""Natural frequencies that are tried at a period of 1 ms [rad/s]; they are proportional to the control rate."""


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A loop: the parameters of its law, and its noise and error where they are assessed.

    X is the shape of M̂, scaled so that the eigenvalues of M(q)⁻¹X lie between 1 and the spread. M̂ = inertia_scale X.

    Attributes
    ----------
    window, delay
        [periods].
    degree, synchronised, natural_frequency, damping_ratio
        As in the laws; natural frequency in [rad/s].
    period
        [s].
    computation_delay
        Number of periods between a measurement and its torque, which the law takes into account.
    robust_slope
        Largest slope of a robust term that the loop tolerates together with the spread [1/s²].
    required_spread
        Largest over smallest eigenvalue of M(q)⁻¹X for which the loop was assessed.
    max_spread
        The largest spread that the loop tolerates.
    inertia_scale
        Scale of the shape, in the middle of those that tolerate the spread; zero where none does.
    spread_margin
        The spread that the loop tolerates at this scale, over the required one, less 1.
    is_affine
        Whether a Lyapunov function affine in the inertia shows that the loop tolerates the robot, instead of a ball.
    noise
        RMS torque over X for white measurement noise [1/s²]: torque noise = noise · ‖X_i‖ · σ.
    change
        RMS change of the torque per period over X for that noise [1/s²]. Torque variation by noise is √(2/π)/T of it.
    error
        Root of the integral of the squared error after a step of torque, over X⁻¹ [s^2.5]; the largest over the
        spread. It is the RMS error [rad] for one step of 1 N m per second, for an X of 1 kg m².
    """

    window: int
    degree: int
    delay: int
    synchronised: bool
    natural_frequency: float
    damping_ratio: float
    period: float
    computation_delay: int = 0
    robust_slope: float = 0.0
    required_spread: float = 1.0
    max_spread: float = 0.0
    inertia_scale: float = 0.0
    spread_margin: float = 0.0
    is_affine: bool = False
    noise: float = np.inf
    change: float = np.inf
    error: float = np.inf

    @property
    def feasible(self) -> bool:
        """Whether the loop tolerates the spread."""
        return self.inertia_scale > 0

    @property
    def estimator(self) -> Algebraic:
        """The estimator."""
        return Algebraic(window=self.window * self.period, degree=self.degree)

    def law_options(self) -> dict[str, Any]:
        """Return the parameters of a law with time-delay estimation, without inertia and estimator."""
        delay = None if self.delay == 1 else self.delay * self.period
        return {
            "natural_frequency": self.natural_frequency,
            "damping_ratio": self.damping_ratio,
            "period": self.period,
            "synchronised": self.synchronised,
            "delay": delay,
            "actuation_delay": self.computation_delay,
        }

    def channel(self) -> Channel:
        """Return the loop of one joint of unit inertia."""
        return _channel(replace(self, is_affine=False, **UNASSESSED))


RESULTS = (
    "robust_slope",
    "required_spread",
    "max_spread",
    "inertia_scale",
    "spread_margin",
    "noise",
    "change",
    "error",
)
"""What an assessment adds to a loop; the linearised loop does not depend on it."""
UNASSESSED = dict.fromkeys(RESULTS, 0.0)
"""Values of a loop that is not assessed."""


@lru_cache(maxsize=1000)
def _channel(loop: Candidate) -> Channel:
    law = TDC(inertia=1.0, estimator=loop.estimator, **loop.law_options())
    return decoupled_channels(law, loop.computation_delay)[0]


def enumerate_candidates(
    period: float,
    *,
    natural_frequencies: Iterable[float] | None = None,
    windows: Iterable[int] | None = None,
    degrees: Iterable[int] = (2, 3),
    delays: Iterable[int] | None = None,
    synchronised: Iterable[bool] = (False, True),
    damping_ratio: float = 1.0,
    computation_delay: int = 0,
) -> list[Candidate]:
    """Return all combinations of parameters that make a law, not yet assessed.

    By default a literal law has a delay of one period, and also of two where the computation delay is odd. There, one
    period leaves a torque undamped that alternates from period to period. A synchronised law has that of its window.

    Raises
    ------
    InvalidParameter
        For a period or damping ratio that is not above zero.
    """
    check.number("damping_ratio", damping_ratio, 0, strict=True)
    rate = 1e-3 / check.number("period", period, 0, strict=True)
    if delays is None:
        delays = (1, 2) if computation_delay % 2 else (1,)
    if natural_frequencies is None:
        natural_frequencies = [rate * frequency for frequency in NATURAL_FREQUENCIES]
    windows, frequencies = list(WINDOWS if windows is None else windows), list(natural_frequencies)
    return [
        Candidate(
            window=window,
            degree=degree,
            delay=delay,
            synchronised=is_synchronised,
            natural_frequency=float(frequency),
            damping_ratio=damping_ratio,
            period=period,
            computation_delay=computation_delay,
        )
        for is_synchronised in synchronised
        for delay in delays
        if delay == 1 or not is_synchronised
        for degree in degrees
        for window in windows
        if window >= degree
        for frequency in frequencies
    ]


def step_error(channel: Channel, ratio: float) -> float:
    """Return the root of the integral of the squared error after a step of 1 rad/s² [rad s^½]: (T Σ e_k²)^½.

    The response settles at x∞ = (I − A)⁻¹B without error, and e_k = −C Aᵏ x∞.
    """
    A, B, C, D = disturbance_to_error(channel, ratio)
    settled = np.linalg.solve(np.eye(len(A)) - A, B)
    return float(np.sqrt(channel.period) * h2_norm(A, settled, C, 0 * D))


def peak_error(channel: Channel, ratio: float, horizon: int = 4000) -> float:
    """Return the largest error after a step of 1 rad/s² [rad], within a horizon [periods]."""
    A, B, C, _ = disturbance_to_error(channel, ratio)
    state, peak = np.zeros((len(A), 1)), 0.0
    for _ in range(horizon):
        state = A @ state + B
        error = abs((C @ state).item())
        peak = max(peak, error)
        if error < 0.05 * peak:
            break
    return peak


def noise_and_change(channel: Channel, ratio: float) -> tuple[float, float]:
    """Return the RMS torque, and its RMS change per period, over M̂ for white measurement noise [1/s²].

    They are the H2 norms of the loop from noise to torque, and of (1 − z⁻¹) times it. With the last torque as a further
    state one Lyapunov equation has both. They are infinite for a loop that is not stable.
    """
    A, B, C, D = noise_to_torque(channel, ratio)
    past = np.zeros((len(A), 1))
    A = np.block([[A, past], [C, np.zeros((1, 1))]])
    outputs = np.block([[C, np.zeros((1, 1))], [C, -np.ones((1, 1))]])
    covariance = output_covariance(A, np.vstack([B, D]), outputs, np.vstack([D, D]))
    noise, change = np.sqrt(np.diag(covariance))
    return float(noise), float(change)


def pareto_front(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return the feasible loops that no other beats in both torque change and error, sorted by torque change."""
    feasible = sorted((loop for loop in candidates if loop.feasible), key=lambda loop: (loop.change, loop.error))
    least, front = np.inf, []
    for loop in feasible:
        if loop.error < least:
            least = loop.error
            front.append(loop)
    return front
