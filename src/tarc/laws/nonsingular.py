"""Continuous nonsingular terminal sliding mode on time-delay estimation."""

from dataclasses import dataclass

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.types import Vector
from tarc.laws.base import ControlInput
from tarc.laws.tde import TDE


@dataclass(frozen=True, kw_only=True, eq=False)
class NonsingularTerminal(TDE):
    """Nonsingular terminal sliding mode with a continuous reaching law: powers of the velocity, not of the error.

        u = q̈ᵈ − Λ ė/ψ'(ė) − K1 e1 − Λ ψ(ė) − k sig(s)^ρ,     ė = v̂ − q̇ᵈ
        s = Λ e1 + ψ(ė),     ψ(v) = v0 sig(v/v0)^a,     Λ = ½ K2

    With damping 1 (K1 = Λ²) and perfect time-delay estimation ṡ = −ψ'(ė) (Λ s + k sig(s)^ρ), and on s = 0 the error
    goes to zero in finite time. The power sig(x)^a = |x|^a sgn x of each joint is smoothed to x (x² + ε²)^((a−1)/2),
    so that nothing is singular at zero. Takes the parameters of `TDE`, `PolePlacement` and `Law`, and:

    Parameters
    ----------
    reaching_gain
        k [rad/s² where |s| is 1 rad/s], of the reaching law: an error of time-delay estimation of c leaves |s| at no
        more than (c/k)^(1/ρ), outside ε.
    exponent
        a, from 1 to below 2; at 1 the mode is linear, and with k = 0 the law is TDC.
    reaching_exponent
        ρ of the reaching law, above 0 and up to 1; towards 0 it becomes a switching term.
    velocity_scale
        v0 [rad/s or m/s]: the error's rate at which ψ(v) = v; below it the law brakes harder than TDC.
    boundary_layer
        ε [rad/s or m/s], below which all powers are linear. Above the noise of v̂, else the torque chatters: at zero
        the reaching law adds k ε^(ρ−1) (ε/v0)^(a−1) to K2 and k ε^(ρ−1) Λ to K1.

    Raises
    ------
    InvalidParameter
        For exponents out of their range, a scale or boundary that is not above zero, and a gain below zero.

    Notes
    -----
    Use it for a fast and smooth end of a motion. A power below 1 is stiffer for small errors, and amplifies noise more.
    The boundary layer sets the compromise. Inside it the law is linear, as the constant-ratio certificate assumes.

    For gains that couple the joints the equation of ṡ above does not hold.

    References
    ----------
    After M. Jin, J. Lee and K. K. Ahn, IEEE/ASME Trans. Mechatron. 20(2), 2015, as time-delay estimation with the
    continuous law of S. Yu, X. Yu, B. Shirinzadeh and Z. Man, Automatica 41(11), 2005, on the surface of Y. Feng, X. Yu
    and Z. Man, Automatica 38(12), 2002: a reading and not a transcription. The scaling by which a = 1 is TDC, and the
    smoothing, are additions.
    """

    reaching_gain: float
    exponent: float = 1.2
    reaching_exponent: float = 0.5
    velocity_scale: float = 1.0
    boundary_layer: float = 0.1

    def __post_init__(self) -> None:
        super().__post_init__()
        check.number("reaching_gain", self.reaching_gain, 0)
        check.number("exponent", self.exponent, 1.0, high=1.99)
        check.number("reaching_exponent", self.reaching_exponent, 0, strict=True, high=1.0)
        for name in ("velocity_scale", "boundary_layer"):
            check.number(name, getattr(self, name), 0, strict=True)

    def terminal_map(self, rate: Vector) -> Vector:
        """Return ψ(v) [rad/s or m/s], shape (n,)."""
        return self.velocity_scale * ops.power(
            rate / self.velocity_scale, self.exponent, self.boundary_layer / self.velocity_scale
        )

    def slope(self, rate: Vector) -> Vector:
        """Return ψ'(v), shape (n,), above zero."""
        return ops.power_slope(rate / self.velocity_scale, self.exponent, self.boundary_layer / self.velocity_scale)

    def sliding(self, error: Vector, error_rate: Vector) -> Vector:
        """Return the sliding variable s [rad/s or m/s], shape (n,)."""
        return self.K2 @ error / 2 + self.terminal_map(error_rate)

    def feedback(self, tracking: ControlInput) -> Vector:
        """Return q̈ᵈ − Λ ė/ψ'(ė) − K1 e1 − Λ ψ(ė) [rad/s² or m/s²], shape (n,)."""
        rate = tracking.error_rate
        damped = self.K2 @ (rate / self.slope(rate) + self.terminal_map(rate)) / 2
        return tracking.acceleration_reference - damped - self.K1 @ tracking.error

    def robust_init(self) -> tuple[()]:
        """Return no state."""
        return ()

    def robust(self, state: tuple[()], tracking: ControlInput) -> tuple[tuple[()], Vector, dict[str, Vector]]:
        """Evaluate Δu = −k sig(s)^ρ."""
        s = self.sliding(tracking.error, tracking.error_rate)
        return state, -self.reaching_gain * ops.power(s, self.reaching_exponent, self.boundary_layer), {}
