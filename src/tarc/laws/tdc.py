"""Time-delayed control."""

from dataclasses import dataclass

from tarc.core.types import Vector
from tarc.laws.base import ControlInput
from tarc.laws.tde import TDE


@dataclass(frozen=True, kw_only=True, eq=False)
class TDC(TDE):
    """Time-delayed control: time-delay estimation and pole placement, no robust term.

        τ = M̂ (q̈ᵈ − K2 (v̂ − q̇ᵈ) − K1 e1 − â_h) + τ_h

    Takes the parameters of `TDE`, `PolePlacement` and `Law`. Velocity and acceleration come from an estimator, as
    everywhere in this package, instead of a measurement.

    References
    ----------
    Paper, Section II-A, equations (2), (3), (5); K. Youcef-Toumi and O. Ito, ASME J. Dyn. Syst. Meas. Control
    112(1), 1990; T. Hsia and L. Gao, IEEE ICRA, 1990.

    Examples
    --------
    >>> import tarc
    >>> law = tarc.laws.TDC(inertia=[0.1, 0.05], natural_frequency=20.0, period=1e-3,
    ...                     estimator=tarc.estimators.Algebraic(window=0.010, degree=2))
    >>> law.K1.diagonal()
    array([400., 400.])
    """

    @property
    def robust_slope_bound(self) -> float:
        """Return zero: the law is linear."""
        return 0.0

    def robust_init(self) -> tuple[()]:
        """Return no state."""
        return ()

    def robust(self, state: tuple[()], tracking: ControlInput) -> tuple[tuple[()], Vector, dict[str, Vector]]:
        """Evaluate Δu = 0."""
        return state, 0 * tracking.error, {}
