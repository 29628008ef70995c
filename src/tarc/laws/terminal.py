"""Time-delayed control with nonlinear damping and a terminal sliding mode."""

from dataclasses import dataclass

from tarc.core import array_ops as ops
from tarc.core import validation as check
from tarc.core.types import Vector
from tarc.laws.base import ControlInput
from tarc.laws.tde import TDE


@dataclass(frozen=True, kw_only=True, eq=False)
class TerminalSliding(TDE):
    """TDC with a terminal sliding mode and a damping that grows with the distance from the surface.

        u = q̈ᵈ − Λ (1 + φ'(e1)) (v̂ − q̇ᵈ) − K1 φ(e1) − κ ‖s‖ s
        s = (v̂ − q̇ᵈ) + Λ φ(e1),     φ(e) = ℓ sig(e/ℓ)^p,     Λ = ½ K2

    With damping 1 (K1 = Λ²) and perfect time-delay estimation ṡ = −Λ s − κ ‖s‖ s, and on s = 0 the error goes to zero
    in finite time. sig(x)^p = |x|^p sgn x in each joint, smoothed to x (x² + ε²)^((p−1)/2). Takes the parameters of
    `TDE`, `PolePlacement` and `Law`, and:

    Parameters
    ----------
    nonlinear_damping
        κ [1/rad or 1/m]: an error of time-delay estimation of c [rad/s²] leaves ‖s‖ at no more than √(c/κ).
    exponent
        p, from ½ to 1; at 1 the mode is linear, and with κ = 0 the law is TDC.
    error_scale
        ℓ [rad or m]: the error at which φ(e) = e; below it the law is stiffer than TDC, above it softer.
    boundary_layer
        ε [rad or m], below which φ is linear with slope (ε/ℓ)^(p−1), by which K1 is multiplied there. Above the
        encoder's resolution, else the torque chatters.
    max_gain
        Largest κ ‖s‖ [1/s], which adds to K2 and must keep the loop stable; None for none.

    Raises
    ------
    InvalidParameter
        For an exponent outside ½ to 1, a scale, boundary layer or maximal gain that is not above zero, and κ below
        zero.

    Notes
    -----
    Use it for a smaller error near rest than that of a linear law of the same natural frequency. The finite time holds
    for the ideal equation. Inside ε the error decays as under a linear law; there the constant-ratio certificate, which
    linearises at zero error, decides stability. The varying-ratio certificate covers that slope alone, and not those
    between.

    For gains that couple the joints the equation of ṡ above does not hold.

    References
    ----------
    After Y. Jin, P. H. Chang, M. Jin and D. G. Gweon, IEEE Trans. Ind. Electron. 60(8), 2013: time-delay estimation,
    terminal sliding mode, nonlinear damping. A reading of that idea and not a transcription: the damping is ‖s‖ s, the
    terminal mode is scaled so that p = 1 is TDC, and the smoothing keeps φ' finite at e = 0.
    """

    nonlinear_damping: float
    exponent: float = 0.8
    error_scale: float = 0.1
    boundary_layer: float = 0.01
    max_gain: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check.number("nonlinear_damping", self.nonlinear_damping, 0)
        check.number("exponent", self.exponent, 0.5, high=1.0)
        for name in ("error_scale", "boundary_layer"):
            check.number(name, getattr(self, name), 0, strict=True)
        if self.max_gain is not None:
            check.number("max_gain", self.max_gain, 0, strict=True)

    def terminal_map(self, error: Vector) -> Vector:
        """Return φ(e) [rad or m], shape (n,)."""
        return self.error_scale * ops.power(
            error / self.error_scale, self.exponent, self.boundary_layer / self.error_scale
        )

    def slope(self, error: Vector) -> Vector:
        """Return φ'(e), shape (n,)."""
        return ops.power_slope(error / self.error_scale, self.exponent, self.boundary_layer / self.error_scale)

    def sliding(self, error: Vector, error_rate: Vector) -> Vector:
        """Return the sliding variable s [rad/s or m/s], shape (n,)."""
        return error_rate + self.K2 @ self.terminal_map(error) / 2

    def feedback(self, tracking: ControlInput) -> Vector:
        """Return q̈ᵈ − Λ (1 + φ') (v̂ − q̇ᵈ) − K1 φ [rad/s² or m/s²], shape (n,)."""
        error, rate = tracking.error, tracking.error_rate
        damped = self.K2 @ (rate + self.slope(error) * rate) / 2
        return tracking.acceleration_reference - damped - self.K1 @ self.terminal_map(error)

    def robust_init(self) -> tuple[()]:
        """Return no state."""
        return ()

    def robust(self, state: tuple[()], tracking: ControlInput) -> tuple[tuple[()], Vector, dict[str, Vector]]:
        """Evaluate Δu = −κ ‖s‖ s."""
        s = self.sliding(tracking.error, tracking.error_rate)
        highest = ops.HUGE if self.max_gain is None else self.max_gain
        return state, -ops.clip(self.nonlinear_damping * ops.norm(s), 0.0, highest) * s, {}
