"""A ball of inertia mismatches that a loop tolerates, with what proves it."""

from dataclasses import dataclass, replace

import numpy as np

from tarc.analysis.uncertain_loop import UncertainLoop, scaled_system
from tarc.certificates.base import Judgement, Verdict, fastest_decay
from tarc.certificates.iqc import Multiplier, iqc_matrices, satisfies_iqc
from tarc.core.types import Array
from tarc.numerics.matrix_tests import schur_stability
from tarc.numerics.norms import fdi_max_eigenvalue, hinf_norm, max_singular_values

RadiusProof = Multiplier | float | None
"""What proves a radius: a multiplier, the scale of the slope's block, or nothing where there is no slope."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Ball:
    """Symmetric mismatches E with ‖E − ρ0 I‖ ≤ δ that a loop tolerates, and the proof.

    Attributes
    ----------
    loop
        The loop, opened at its inertia ratio.
    centre, radius
        ρ0 and δ.
    position_weight
        η, which multiplies the position beside v [1/s²]; zero without stiffness.
    stiffness
        Largest ‖[H, C/θ]‖ of the robot [1/s²].
    scale
        Scale of the slope's block; None without a slope, and with a multiplier.
    max_change
        Largest change of E⁻¹ in one period; None for any.
    multiplier
        Proof of the radius where the change is bounded.
    growth, decay_radius
        e^{αT} and the radius up to which errors decay as e^{−αt}; 1 and 0 where no decay rate α is proven.
    """

    loop: UncertainLoop
    centre: float
    radius: float
    position_weight: float = 0.0
    stiffness: float = 0.0
    scale: float | None = None
    max_change: float | None = None
    multiplier: Multiplier | None = None
    growth: float = 1.0
    decay_radius: float = 0.0

    @property
    def min_ratio(self) -> float:
        """Smallest inertia ratio in the ball."""
        return self.centre - self.radius

    @property
    def max_ratio(self) -> float:
        """Largest inertia ratio in the ball."""
        return self.centre + self.radius

    @property
    def ratio_spread(self) -> float:
        """Largest over smallest inertia ratio in the ball; infinite where the smallest is not above zero."""
        return self.max_ratio / self.min_ratio if self.min_ratio > 0 else np.inf

    def judge(self, needed_radius: float) -> Judgement:
        """Test the radius against the needed one, the loop at the centre, and the norm or the form of the ball."""
        multiplier = self.multiplier
        numbers = [self.centre, self.radius, needed_radius, self.position_weight, self.stiffness]
        numbers += [self.growth, self.decay_radius]
        numbers += [value for value in (self.scale, self.max_change) if value is not None]
        numbers += [] if multiplier is None else [multiplier.slope, multiplier.stiffness]
        if not np.all(np.isfinite(numbers)) or not self.centre > 0 or self.scale == 0:
            return Judgement(Verdict.INCONCLUSIVE, 0.0)
        margin = self.radius / self.centre
        if needed_radius:
            margin = self.radius / max(needed_radius, self.centre / 1e3) - 1
        proven = self.radius > 0 and self.radius >= needed_radius and self.is_proven(self.radius)
        if proven and self.growth != 1:
            decays = self.growth > 1 and 0 < self.decay_radius <= self.radius and needed_radius <= self.decay_radius
            proven = decays and self.is_proven(self.decay_radius, self.growth)
        return Judgement(Verdict.CERTIFIED if proven else Verdict.INCONCLUSIVE, float(margin))

    def with_decay(self, radius: float) -> "Ball":
        """Return the ball with the fastest decay that its proof shows up to a radius."""
        system = self.loop.closed_loop(self.centre, self.position_weight)
        spectral_radius = float(np.abs(np.linalg.eigvals(system[0])).max())
        if not 0 < radius <= self.radius:
            return self
        growth = fastest_decay(lambda growth: self.is_proven(radius, growth), spectral_radius)
        return replace(self, growth=growth, decay_radius=radius) if growth > 1 else self

    def is_proven(self, radius: float, growth: float = 1.0) -> bool:
        """Return whether the loop at the centre is stable, and the norm or the form shows a radius.

        With a growth g they show that errors decay as g^−k.
        """
        system = self.loop.closed_loop(self.centre, self.position_weight, growth)
        if schur_stability(system[0])[0] != "certified":
            return False
        if self.max_change is None:
            return hinf_norm(*scaled_system(system, radius, self.scale)) < 1
        if self.multiplier is None:
            return False
        return satisfies_iqc(
            self.loop,
            self.centre,
            radius,
            self.max_change,
            self.multiplier,
            self.position_weight,
            self.stiffness,
            growth,
        )

    def gains(self, angles: Array) -> Array:
        """Return what must stay below one at each angle ω [rad]: the weighted gain, or with a multiplier its form."""
        if self.max_change is not None and self.multiplier is not None:
            A, B, Q, S, R = iqc_matrices(
                self.loop,
                self.centre,
                self.radius,
                self.max_change,
                self.multiplier,
                self.position_weight,
                self.stiffness,
            )
            return 1 + fdi_max_eigenvalue(A, B, Q, S, R, angles)
        system = self.loop.closed_loop(self.centre, self.position_weight)
        return max_singular_values(*scaled_system(system, self.radius, self.scale), angles)


def make_ball(
    loop: UncertainLoop,
    centre: float,
    radius: float,
    proof: RadiusProof,
    *,
    position_weight: float = 0.0,
    stiffness: float = 0.0,
    max_change: float | None = None,
) -> Ball:
    """Return a ball with the proof that `max_radius` gave."""
    return Ball(
        loop=loop,
        centre=centre,
        radius=radius,
        position_weight=position_weight,
        stiffness=stiffness,
        scale=proof if isinstance(proof, float) else None,
        max_change=max_change,
        multiplier=proof if isinstance(proof, Multiplier) else None,
    )
