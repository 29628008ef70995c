"""Sliding mode with a boundary layer, on time-delay estimation or without it."""

from dataclasses import dataclass

from tarc.core import validation as check
from tarc.core.types import Vector
from tarc.laws.switching import Switching


@dataclass(frozen=True, kw_only=True, eq=False)
class SlidingMode(Switching):
    """Sliding mode with a fixed gain towards a surface on which the error decays.

        Δu = −ϱ s / max(‖s‖, ε),     s = (v̂ − q̇ᵈ) + λ e1

    With ``time_delay=True`` time-delay estimation compensates slow disturbances, and the switching term only its error.
    With False it is classical sliding mode control. Takes the parameters of `Switching`, `TDE`, `PolePlacement` and
    `Law`, and:

    Parameters
    ----------
    gain
        ϱ [rad/s²], a bound on the disturbing acceleration: on the error of time-delay estimation or, without it, on all
        that M̂ u does not explain, gravity included. The signal ``tde_error`` of a run of `TDC` shows the former.

    Raises
    ------
    InvalidParameter
        For a gain below zero, and a boundary layer or surface slope that is not above zero.

    Notes
    -----
    Use it where a bound is known: then nothing needs to adapt. A smaller gain does not keep s = 0, and a larger one
    shakes the robot. One number serves every motion and load.

    On an ideal double integrator with damping 1, ṡ = −λ s − ϱ s/‖s‖, so that the layer is reached within
    ‖s(0)‖/ϱ, at t = ln((λ‖s(0)‖ + ϱ)/(λε + ϱ))/λ.

    The surface s = ė + λe is the classical one. The sources differ in it, and in the feedback beside the switching
    term, which here is always pole placement. The boundary layer is that of the unit vector, for all joints together.

    References
    ----------
    On time-delay estimation after S. Roy, S. Nandy, R. Ray and S. N. Shome, IEEE ICRA, 2014, and J. Kim, H. Joe,
    S.-C. Yu, J. S. Lee and M. Kim, IEEE Trans. Ind. Electron. 63(2), 2016. The unit vector with a layer: M. Corless
    and G. Leitmann, IEEE Trans. Autom. Control 26(5), 1981.
    """

    gain: float

    @property
    def start_gain(self) -> float:
        """Return the gain ϱ [rad/s²]."""
        return check.number("gain", self.gain, 0)

    def adapt(self, gain: Vector, size: Vector) -> Vector:
        """Return the gain unchanged."""
        return gain
