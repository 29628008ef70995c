"""Parameters of TARC's switching gain, from the certified slope and the expected step of acceleration."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from tarc.analysis.workspace import Workspace
from tarc.core import validation as check
from tarc.design.candidates import Candidate, peak_error
from tarc.plants.base import Plant

RISE_TO_FALL = 3.0
"""Rise rate over fall rate."""
MIN_LAYER_TO_NOISE = 5.0
"""Least boundary layer over the standard deviation of the measurement noise."""


@dataclass(frozen=True, kw_only=True)
class Adaptation:
    """Parameters of the switching gain of `tarc.laws.TARC`, for the default weight, with which s = e1.

    Attributes
    ----------
    rise_rate, fall_rate
        c̄ and c̲ [1/s³].
    min_gain, max_gain
        γ and the largest gain [rad/s²].
    boundary_layer
        ε [rad].
    gain_factor
        α.
    """

    rise_rate: float
    fall_rate: float
    min_gain: float
    boundary_layer: float
    max_gain: float
    gain_factor: float = 1.0

    def law_options(self) -> dict[str, float]:
        """Return the parameters of the law, rounded to four digits.

        The largest gain is rounded so that the slope does not grow.
        """
        rounded = {name: float(f"{value:.4g}") for name, value in asdict(self).items()}
        slope = self.gain_factor * self.max_gain / self.boundary_layer
        rounded["max_gain"] = float(f"{0.9999 * slope * rounded['boundary_layer'] / rounded['gain_factor']:.5g}")
        return rounded


def choose_adaptation(candidate: Candidate, expected: float, *, noise: float = 0.0) -> Adaptation:
    """Choose TARC's switching gain for a loop that tolerates a slope.

        ε = largest error after the expected step,    max_gain = slope ε / α,
        c̲ = slope ωn,    c̄ = 3 c̲,    γ = max_gain/100

    The certificate limits the slope α ĉ/ε. So the largest gain follows from the layer ε. The layer is as wide as the
    error after the expected step without the switching term; within the layer that term is linear. An error of ε
    moves the gain over its range within 1/ωn.

    ‖s‖ rises and falls about equally often, so the ratio of rise to fall rate decides where the gain stays. With equal
    rates it stays low and has little effect. With a far larger rise rate it stays at its largest value, which is
    certified; without that limit it chatters. A ratio of three avoids both.

    Parameters
    ----------
    candidate
        The loop, with its slope.
    expected
        Expected step of acceleration [rad/s²], as `expected_step` finds it.
    noise
        Standard deviation of the measured position over all joints [rad].

    Raises
    ------
    InvalidParameter
        For an expected step or a slope that is not above zero.

    References
    ----------
    Paper, Section III-B, on gains that are too high and too low; the slope: `tarc.certificates.certify_sector`.
    """
    check.number("expected", expected, 0, strict=True)
    slope = check.number("robust_slope", candidate.robust_slope, 0, strict=True)
    channel = candidate.channel()
    response = max(peak_error(channel, candidate.inertia_scale * ratio) for ratio in (1.0, candidate.required_spread))
    boundary_layer = max(expected * response, MIN_LAYER_TO_NOISE * noise)
    max_gain = slope * boundary_layer
    rate = slope * candidate.natural_frequency
    return Adaptation(
        rise_rate=RISE_TO_FALL * rate,
        fall_rate=rate,
        min_gain=max_gain / 100,
        boundary_layer=boundary_layer,
        max_gain=max_gain,
    )


def expected_step(plants: Sequence[Plant], workspace: Workspace, *, samples: int = 200, seed: int = 0) -> float:
    """Return the largest step of acceleration ‖M⁻¹ Δτ‖ [rad/s²] over sampled postures.

    Δτ is the change of the gravity torque when the payload is picked up, or a reversal of Coulomb friction. Without
    either, it is a tenth of the gravity torque.

    Parameters
    ----------
    plants
        The robot with its smallest and its largest payload.
    workspace
        The postures.
    samples
        Number of sampled postures.
    seed
        Seed of the sampled postures.
    """
    first = plants[0]
    friction_reversal = np.diag(2 * np.abs(np.broadcast_to(first.parameters.get("coulomb", 0.0), (first.n_joints,))))
    largest = fallback = 0.0
    for posture in workspace.sample(samples, seed):
        M, gravity = first.inertia(posture), _gravity_torque(first, posture)
        fallback = max(fallback, 0.1 * _acceleration(M, gravity))
        for loaded in plants[1:]:
            change = _gravity_torque(loaded, posture) - gravity
            largest = max(largest, _acceleration(loaded.inertia(posture), change))
        largest = max(largest, *(_acceleration(M, torque) for torque in friction_reversal))
    return largest or fallback or 1.0


def _gravity_torque(plant: Plant, posture: np.ndarray) -> np.ndarray:
    return np.asarray(plant.gravity_torque(posture), dtype=float)


def _acceleration(M: np.ndarray, torque: np.ndarray) -> float:
    return float(np.linalg.norm(np.linalg.solve(M, torque)))
