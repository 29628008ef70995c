"""The switching gain's parameters, from the slope that is certified and the step to be expected."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from tarc import check
from tarc.certificates.workspace import Workspace
from tarc.design.front import Candidate, peak
from tarc.plants.base import Plant

QUANTA = 5.0
"""The boundary layer is never thinner than so many standard deviations of the measurement noise."""


@dataclass(frozen=True, kw_only=True)
class Adaptation:
    """What `tarc.laws.TARC` takes for its switching gain: units as there, for the default weight, where s = e1.

    Attributes
    ----------
    rise, fall, floor, boundary, cap, margin
        c̄, c̲, γ, ε, the greatest gain and α.
    """

    rise: float
    fall: float
    floor: float
    boundary: float
    cap: float
    margin: float = 1.0

    def options(self) -> dict[str, float]:
        """As keyword arguments of the law, rounded to four digits, the cap so that its slope does not grow."""
        rounded = {name: float(f"{value:.4g}") for name, value in asdict(self).items()}
        slope = self.margin * self.cap / self.boundary
        rounded["cap"] = float(f"{0.9999 * slope * rounded['boundary'] / rounded['margin']:.5g}")
        return rounded


def adaptation(candidate: Candidate, expected: float, *, noise: float = 0.0) -> Adaptation:
    """Rise, fall, floor, boundary and cap of TARC's gain, for a loop whose ball bears a slope.

        ε = greatest error after the expected step,    cap = slope ε / α,    c̄ = c̲ = slope ωn,    γ = cap/100

    The slope α ĉ/ε is what the certificate bears, so that the cap follows from the layer ε and not the reverse. The
    layer is as wide as the error that the step to be expected leaves in the loop without the switching term: within it
    the term is linear and chatters nowhere, and beyond it the gain is at its cap. An error of ε takes the gain from
    nothing to its cap within 1/ωn. Rise and fall are the same, so that an error that comes and goes, and noise, which
    makes ‖s‖ rise and fall as often, leave the gain where it was: a faster rise lets noise drive the gain to its cap,
    where it chatters; a faster fall keeps it on its floor, where it does nothing.

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
    Paper, Section III-B, on what is too high and too low; theory of the slope: `tarc.certificates.slope`.
    """
    check.number("expected", expected, 0, strict=True)
    slope = check.number("slope", candidate.slope, 0, strict=True)
    channel = candidate.channel()
    response = max(peak(channel, float(ratio)) for ratio in (candidate.scale, 4 * candidate.scale))
    boundary = max(expected * response, QUANTA * noise)
    cap = slope * boundary
    rate = slope * candidate.bandwidth
    return Adaptation(rise=rate, fall=rate, floor=cap / 100, boundary=boundary, cap=cap)


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
    dry = 2 * np.abs(np.broadcast_to(first.parameters.get("coulomb", 0.0), (first.joints,)))
    for posture in workspace.sample(samples, seed):
        M, held = first.inertia(posture), np.asarray(first.gravity_torque(posture), dtype=float)
        fallback = max(fallback, 0.1 * float(np.linalg.norm(np.linalg.solve(M, held))))
        for other in plants[1:]:
            change = np.asarray(other.gravity_torque(posture), dtype=float) - held
            greatest = max(greatest, float(np.linalg.norm(np.linalg.solve(other.inertia(posture), change))))
        for torque in np.diag(dry):
            greatest = max(greatest, float(np.linalg.norm(np.linalg.solve(M, torque))))
    return greatest or fallback or 1.0
