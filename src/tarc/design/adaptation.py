"""The switching gain's parameters, from the slope that is certified and the step to be expected."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from tarc.analysis.workspace import Workspace
from tarc.core import validation as check
from tarc.design.candidates import Candidate, peak_error
from tarc.plants.base import Plant

RISE_TO_FALL = 3.0
"""Rise over fall."""
MIN_LAYER_TO_NOISE = 5.0
"""The boundary layer is never thinner than so many standard deviations of the measurement noise."""


@dataclass(frozen=True, kw_only=True)
class Adaptation:
    """What `tarc.laws.TARC` takes for its switching gain: units as there, for the default weight, where s = e1.

    Attributes
    ----------
    rise_rate, fall_rate, min_gain, boundary_layer, max_gain, gain_factor
        c̄, c̲, γ, ε, the greatest gain and α.
    """

    rise_rate: float
    fall_rate: float
    min_gain: float
    boundary_layer: float
    max_gain: float
    gain_factor: float = 1.0

    def law_options(self) -> dict[str, float]:
        """As keyword arguments of the law, rounded to four digits, the cap so that its slope does not grow."""
        rounded = {name: float(f"{value:.4g}") for name, value in asdict(self).items()}
        slope = self.gain_factor * self.max_gain / self.boundary_layer
        rounded["max_gain"] = float(f"{0.9999 * slope * rounded['boundary_layer'] / rounded['gain_factor']:.5g}")
        return rounded


def choose_adaptation(candidate: Candidate, expected: float, *, noise: float = 0.0) -> Adaptation:
    """Rise, fall, floor, boundary and cap of TARC's gain, for a loop whose ball bears a slope.

        ε = greatest error after the expected step,    max_gain = slope ε / α,    c̲ = slope ωn,    c̄ = 3 c̲,    γ =
        cap/100

    The slope α ĉ/ε is what the certificate bears, so that the cap follows from the layer ε and not the reverse. The
    layer is as wide as the error that the step to be expected leaves in the loop without the switching term: within it
    the term is linear. An error of ε that shrinks takes the gain from its cap to nothing within 1/ωn. As ‖s‖ rises and
    falls about as often, by noise or by the motion, it is the ratio of rise to fall that settles where the gain stays:
    with the same for both it stays low and hardly acts, and with a rise far above the fall it stays at its cap. There
    it does no harm, for the cap is certified; without a cap it chatters. Three to one leaves it room both ways.

    Parameters
    ----------
    candidate
        The loop, with its slope.
    expected
        The step of acceleration to be expected [rad/s²], as `expected_step` finds it.
    noise
        Standard deviation of the measured position over all joints [rad].

    References
    ----------
    Paper, Section III-B, on what is too high and too low; theory of the slope: `tarc.certificates.certify_sector`.
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
    """The largest step of acceleration ‖M⁻¹ Δτ‖ [rad/s²] that picking up the payload, or Coulomb friction, makes.

    Over sampled postures, of the robots given, the lightest first: the difference of the torques that hold them, and a
    reversal of dry friction. Where there is neither, a tenth of the torque that holds the robot.

    Parameters
    ----------
    plants
        The robot with its least and its greatest payload.
    workspace, samples, seed
        Postures to look at.
    """
    greatest = fallback = 0.0
    first = plants[0]
    dry = 2 * np.abs(np.broadcast_to(first.parameters.get("coulomb", 0.0), (first.n_joints,)))
    for posture in workspace.sample(samples, seed):
        M, held = first.inertia(posture), np.asarray(first.gravity_torque(posture), dtype=float)
        fallback = max(fallback, 0.1 * float(np.linalg.norm(np.linalg.solve(M, held))))
        for other in plants[1:]:
            change = np.asarray(other.gravity_torque(posture), dtype=float) - held
            greatest = max(greatest, float(np.linalg.norm(np.linalg.solve(other.inertia(posture), change))))
        for torque in np.diag(dry):
            greatest = max(greatest, float(np.linalg.norm(np.linalg.solve(M, torque))))
    return greatest or fallback or 1.0
