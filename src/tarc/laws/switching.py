"""Base of the laws with a switching term along a sliding surface."""

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.types import Vector
from tarc.laws.base import ControlInput
from tarc.laws.tde import TDE


class SwitchingState(NamedTuple):
    """The switching gain ϱ."""

    gain: Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class Switching(TDE):
    """Pole placement and a switching term along a sliding surface, on time-delay estimation or without it.

        Δu = −ϱ s / max(‖s‖, ε),     s = (v̂ − q̇ᵈ) + λ e1
        τ = M̂ (q̈ᵈ − K2 (v̂ − q̇ᵈ) − K1 e1 + Δu − â_h) + τ_h,     without the last two if time_delay=False

    A law adds its initial gain, `start_gain`, and its adaptation, `adapt`. The gain is a state even where it is
    constant, so that a linearisation can hold it at any value. Takes the parameters of `TDE`, `PolePlacement` and
    `Law`, and those below.

    Parameters
    ----------
    boundary_layer
        ε [rad/s or m/s], the layer in which the switching term is linear. There the loop is that of `TDC` with ϱ/ε
        added to K2 and λ ϱ/ε to K1; `tarc.certificates.certify_constant_ratio` certifies it. It must exceed the noise
        of v̂, else the torque chatters.
    surface_slope
        λ [1/s], decay rate of the error on the surface; None for ½ K2. With damping 1 that is the double pole, and pole
        placement alone gives ṡ = −λ s.
    time_delay
        Whether N̂ is estimated. Without it the switching term compensates gravity and all other forces. Then ϱ must be
        a bound on M̂⁻¹N, M̂ should be near the inertia, and the estimator needs no acceleration.
    """

    boundary_layer: float = 0.2
    surface_slope: float | None = None
    time_delay: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        check.number("boundary_layer", self.boundary_layer, 0, strict=True)
        if self.surface_slope is not None:
            check.number("surface_slope", self.surface_slope, 0, strict=True)
        _ = self.start_gain

    def linearisation_constants(self, gain: float) -> dict[str, float | None]:
        """Return the constants of every law, and the states that adapt."""
        return {**super().linearisation_constants(gain), "gain": gain}

    @property
    def uses_tde(self) -> bool:
        """Return `time_delay`."""
        return self.time_delay

    @property
    @abstractmethod
    def start_gain(self) -> float:
        """Return the gain before the first step [rad/s²]."""

    @abstractmethod
    def adapt(self, gain: Vector, size: Vector) -> Vector:
        """Return the gain of the next period, from the present one and ‖s‖."""

    @cached_property
    def Lambda(self) -> np.ndarray:
        """Return λ I, or ½ K2, shape (n, n)."""
        return self.K2 / 2 if self.surface_slope is None else self.surface_slope * np.eye(self.n_joints)

    def sliding(self, error: Vector, error_rate: Vector) -> Vector:
        """Return the sliding variable s [rad/s or m/s], shape (n,)."""
        return error_rate + self.Lambda @ error

    def robust_init(self) -> SwitchingState:
        """Return the initial gain."""
        return SwitchingState(np.array(float(self.start_gain)))

    def robust(self, state: SwitchingState, tracking: ControlInput) -> tuple[SwitchingState, Vector, dict[str, Vector]]:
        """Return the next gain and Δu = −ϱ s / max(‖s‖, ε)."""
        s = self.sliding(tracking.error, tracking.error_rate)
        correction = -state.gain * s / ops.norm(s, self.boundary_layer)
        gain = ops.where(tracking.fault, state.gain, self.adapt(state.gain, ops.norm(s)))
        return SwitchingState(gain), correction, {"gain": state.gain}
