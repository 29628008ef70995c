"""The decrease of a Lyapunov function that is affine in the inertia, as a cubic matrix polynomial in the ratio λ.

For V = Σ xᵀ (P0⊗I + P1⊗J) x, J = E⁻¹, everything decouples into the eigenvalues λ of E. With P(λ) = P0 + P1/λ, times
λ, one eigenvalue contributes −F(λ) to the change of V, and F must be positive definite:

    F(λ) = λ xᵀP(λ)x − e^{2αT} λ x⁺ᵀ(P(λ) + s S + r R/λ)x⁺ − λ (multipliers times what the uncertain signals satisfy)

A change of J adds P1⊗ΔJ to V. With P1 in two parts, S ± P1' ⪰ 0 and R ± P1'' ⪰ 0, that is at most S⊗s I + R⊗r J.

For M̂(q), V = Σ xᵀ (P0⊗M̂ + P1⊗M) x. In coordinates M̂^½ q that is the same, and a change of M̂ adds at most S0⊗s0 I,
S0 ± P0 ⪰ 0.
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from tarc.certificates.force_form import ForceForm
from tarc.certificates.reduced_loop import ReducedLoop, product
from tarc.core.types import Array
from tarc.numerics.ball_arithmetic import FLOATS, Arithmetic

MEAN_SQUARES = (
    np.array([[1, 1 / 2, 1 / 6], [1 / 2, 1 / 3, 1 / 8], [1 / 6, 1 / 8, 1 / 20]]),
    np.array([[0, 0, 0], [0, 1, 1 / 2], [0, 1 / 2, 1 / 3]]),
)
"""Mean squares of q and of q̇ T over a period, as forms of q, q̇ T and q̈ T² at its start."""
ROUNDING_ROOM = 1 + 1e-9
"""Factor on bounds that are computed in floating point."""
MOTION_SHARE = 1 / 64
"""Share of position and velocity that is left to their change within a period, for a form of the forces."""
TORQUE_SHARE = 1 / 32
"""Share of the torque that is left to the change of E within a period, for a form of the forces."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RatioSet:
    """Mismatches E(t) = M̂^½ M⁻¹ M̂^½, stiffnesses and dampings that a certificate covers.

    Attributes
    ----------
    min_ratio, max_ratio
        Smallest and largest eigenvalue of E.
    rate
        Largest ‖dE⁻¹/dt‖ [1/s].
    relative_rate
        Largest ‖E^½ (dE⁻¹/dt) E^½‖ = ‖M^−½ (dM/dt) M^−½‖ [1/s]; at most the rate times λmax.
    period
        T [s].
    intersample
        Whether E changes within a period as well.
    powers, lead_times, stiffness
        p_i of 0, ½ or 1, θ_i [s], and for each the largest κ = ‖E^−p [H, C/θ]‖ [1/s²], shape (k,).
    shares
        β_i, by which each of these bounds is split between the position and the acceleration, shape (k,).
    nominal_rate
        Largest ‖M̂^−½ (dM̂/dt) M̂^−½‖ [1/s] of an M̂ that follows the posture; zero for a constant one.
    lag_weights
        φ_i, shape (k,), for a law with a stiffness K of its own, which acts at the position of the torque's sample.
        Then κ = ‖E^−p [H, C/θ, K/φ]‖, and K multiplies q(t) less that position. Empty without such a law.
    form
        A form that stiffness and damping satisfy, in place of bounds on their norms; None without one.
    """

    min_ratio: float
    max_ratio: float
    rate: float
    relative_rate: float
    period: float
    intersample: bool
    powers: Array
    lead_times: Array
    stiffness: Array
    shares: Array
    nominal_rate: float = 0.0
    lag_weights: Array = field(default_factory=lambda: np.zeros(0))
    form: ForceForm | None = None

    def without_norms(self) -> "RatioSet":
        """Return these without bounds on the norms of stiffness and damping."""
        none = np.zeros(0)
        return replace(self, powers=none, lead_times=none, stiffness=none, shares=none)

    @property
    def has_forces(self) -> bool:
        """Whether there is stiffness or damping."""
        return bool(len(self.stiffness)) or self.form is not None

    @property
    def condition(self) -> float:
        """‖E(t) Ē⁻¹‖ for the mean Ē over a period: (1 + μ)/(1 − μ), μ = η/(1 − η), η = rate T λmax/2."""
        if not self.intersample:
            return 1.0
        swing = self.rate * self.period * self.max_ratio / 2
        if not swing < 1 / 3:
            return np.inf
        mu = swing / (1 - swing)
        return (1 + mu) / (1 - mu) * ROUNDING_ROOM

    @property
    def swing(self) -> float:
        """ε: ±(E(t) − Ē) ⪯ ε Ē within a period, by e^{−rτ} E(t) ⪯ E(t + τ) ⪯ e^{rτ} E(t) for the relative rate r."""
        change = self.relative_rate * self.period
        if not self.intersample or change <= 0:
            return 0.0
        return float(-change / np.expm1(-change) - 1) * ROUNDING_ROOM + 1e-15

    @property
    def max_change(self) -> float:
        """s: largest ‖ΔĒ⁻¹‖ from one period to the next."""
        return self.rate * self.period * self.condition**2 * ROUNDING_ROOM

    @property
    def max_relative_change(self) -> float:
        """r: ±ΔĒ⁻¹ ⪯ r Ē⁻¹ from one period to the next."""
        return float(np.expm1(self.relative_rate * self.period)) * ROUNDING_ROOM

    @property
    def max_nominal_change(self) -> float:
        """s0: ±ΔM̂ ⪯ s0 M̂ from one period to the next."""
        return float(np.expm1(self.nominal_rate * self.period)) * ROUNDING_ROOM

    def period_form(self, form: ForceForm) -> "PeriodForm":
        """Return what a form says of a period, see `PeriodForm`.

        With f = E(t) k and k' = Ē⁻¹ f, ‖Ē⁻¹ − E(t)⁻¹‖ ≤ d, η = `MOTION_SHARE`, ς = `TORQUE_SHARE`, and ã the
        acceleration less its mean, ms(ã) ≤ 2 |E k'|² + 2 ε² λmax |Ē^½ v|²,

            |k|² ≥ (1 − ς) |k'|² − (1/ς − 1) d² |f|²,     kᵀE(t)k ≥ e^{−rT} |Ē^½ k'|²,
            2 ẋᵀk ≥ 2 ẋᵀk' − d (s |ẋ|² + |f|²/s),     ms(ẋ) ≤ (1 + η) ms(ẋ of the mean) + (1 + 1/η) (T/π)² ms(ã),

        s the split, and the same for x with 2T/π more. ms(ẋᵀk') is known but for what E(t) − Ē adds to ẋ, at most
        (T/π) ε |Ē^½ v| |Ē^½ k'|.
        """
        T, swing = self.period, self.swing
        change = self.condition * self.rate * T / 2 * ROUNDING_ROOM
        velocity = form.velocity + form.power * change * form.split
        within = (T / np.pi) ** 2 * (velocity + form.position * (2 * T / np.pi) ** 2)
        within *= 2 * (1 + 1 / MOTION_SHARE) * ROUNDING_ROOM
        uneven = form.power * swing * T / np.pi * ROUNDING_ROOM
        taken = form.torque * (1 / TORQUE_SHARE - 1) * change**2 + form.power * change / form.split
        return PeriodForm(
            position=(1 + MOTION_SHARE) * form.position,
            velocity=(1 + MOTION_SHARE) * velocity * ROUNDING_ROOM,
            power=form.power,
            torque=(1 - TORQUE_SHARE) * form.torque,
            energy=form.energy * float(np.exp(-self.relative_rate * T)) / ROUNDING_ROOM - uneven,
            acceleration=taken * ROUNDING_ROOM + within,
            change=within * swing**2 * self.max_ratio * ROUNDING_ROOM + uneven,
        )

    def lags(self) -> Array:
        """Return φ_i, zero for a law without a stiffness of its own, shape (k,)."""
        return self.lag_weights if len(self.lag_weights) else np.zeros(len(self.stiffness))

    def force_bounds(self) -> list[tuple[float, float, float, float]]:
        """Return a, (θ/T)², b and φ² of each bound on k, where E k is the acceleration by stiffness and damping.

            ‖Ē^{1−p} k‖² ≤ a ms (q, θ q̇, φ l) + b |Ē^½ v|²,    ms over the period at the mean acceleration

        Here l is q less the position of the torque's sample. The acceleration differs from its mean by ã, and moves q̇
        by at most T/π rms ã, and q and l by 2T/π of that. So with g = (T/π) √((1 + φ²)(2T/π)² + θ²), the root mean
        square of (q, θ q̇, φ l) is at most

            (that at the mean acceleration + g ε λmax^½ |Ē^½ v|) / (1 − κ g λmax^p).

        The coefficients are infinite where the denominator is not above zero.
        """
        bounds, lags = [], self.lags()
        for i, stiffness in enumerate(self.stiffness):
            lead_time, share, power = self.lead_times[i], self.shares[i], self.powers[i]
            lag = float(lags[i]) ** 2
            gain = self.period / np.pi * np.hypot(2 * self.period / np.pi * (1 + lag) ** 0.5, lead_time) * ROUNDING_ROOM
            rest = 1 - stiffness * gain * self.max_ratio**power
            if not rest > 0 or not share > 0:
                return [(np.inf, np.inf, np.inf, np.inf)]
            distortion = {0.0: 1.0, 0.5: (1 + self.swing) ** 0.5}.get(float(power), self.condition)
            size = (distortion * stiffness / rest) ** 2 * ROUNDING_ROOM
            within = (gain * self.swing) ** 2 * self.max_ratio
            bounds.append(
                (
                    size * (1 + share),
                    (lead_time / self.period) ** 2 * ROUNDING_ROOM,
                    size * (1 + 1 / share) * within * ROUNDING_ROOM,
                    lag * ROUNDING_ROOM,
                )
            )
        return bounds


class PeriodForm(NamedTuple):
    """What a form of the forces says of mean and moment of k' over a period, in terms of its start.

        (a0 + a1 λ − a2 λ²) |(mean, moment) of k'|² + 2 α2 ms(ẋᵀk') ≤ b ms(x) + c ms(ẋ) + e λ |v|²

    The means of x and ẋ are those at the mean acceleration. The left factor must be positive on the whole range.

    Attributes
    ----------
    position, velocity, power
        b, c and α2.
    torque, energy, acceleration
        a0, a1 and a2.
    change
        e.
    """

    position: float
    velocity: float
    power: float
    torque: float
    energy: float
    acceleration: float
    change: float

    def factor(self, ratio: float) -> float:
        """Return a0 + a1 λ − a2 λ², which is least at one end of a range."""
        return self.torque + self.energy * ratio - self.acceleration * ratio**2


class Multipliers(NamedTuple):
    """Weights of what the uncertain signals satisfy, all above zero.

    Attributes
    ----------
    error
        Of the error of the reduced loop.
    forces
        Of each bound on stiffness and damping, shape (k,).
    change
        Of the change of E within a period.
    slope
        Of the slope of the robust term.
    """

    error: float
    forces: Array
    change: float
    slope: float


class Rows(NamedTuple):
    """Signals as rows over ξ = (z, e, k, w_c, w), each a pair of matrices: constant part and factor of λ.

    Attributes
    ----------
    state, next_state
        z and z⁺.
    inputs, errors
        u and e.
    v, position, velocity, lag
        v, q, q̇ T, and q less the position of the torque's sample, all at the start of the period.
    forces
        k, with E k the acceleration by stiffness and damping: mean and first moment; no rows without them.
    change
        w_c, the first moment of the acceleration by which E changes within a period; no row if it does not.
    acceleration
        λ (v + k), the mean over the period: the factor of λ.
    robust
        w, what the robust term adds; no row without it.
    """

    state: Array
    next_state: tuple[Array, Array]
    inputs: tuple[Array, Array]
    errors: Array
    v: Array
    position: Array
    velocity: Array
    forces: Array
    change: Array
    robust: Array
    acceleration: Array
    lag: Array


def signal_rows(loop: ReducedLoop, ratios: RatioSet, arithmetic: Arithmetic = FLOATS) -> Rows:
    """Return the signals of a loop, in floats or balls."""
    full, matrix, number = loop.full, arithmetic.matrix, arithmetic.number
    n_outputs, n_states = loop.C.shape
    n_forces = 2 if ratios.has_forces else 0
    n_change, n_robust = int(ratios.intersample), int(full.has_slope)
    sizes = [n_states, n_outputs, n_forces, n_change, n_robust]
    ends = np.cumsum(sizes)
    unit = matrix(np.eye(int(ends[-1])))
    z, e, k, c, w = (unit[end - size : end] for end, size in zip(ends, sizes, strict=True))
    D = full.matrices(arithmetic)[3]
    outputs = product(matrix(loop.C), z) + number(loop.error_gain) * e
    if n_robust:
        outputs = outputs + D[:, -1:] * (w * number(full.centre))
    outputs = outputs / matrix(full.scales[:, None])
    v, position, velocity, lag = (outputs[i : i + 1] for i in range(4))
    lag = lag if len(lag) else 0 * v
    moved = v + k[:1] if n_forces else v
    constant, factor = [-number(full.centre) * v], [moved]
    if full.loop.B_mismatch.shape[1] == 2:
        zero = 0 * v
        constant.append(c if n_change else zero)
        factor.append(k[1:] if n_forces else zero)
    if n_robust:
        constant.append(w * number(full.centre))
        factor.append(0 * w)
    u = np.concatenate(constant), np.concatenate(factor)
    A, B = matrix(loop.A), matrix(loop.B)
    next_state = product(A, z) + product(B, u[0]), product(B, u[1])
    return Rows(z, next_state, u, e, v, position, velocity, k, c, w, moved, lag)


def square(row: Array) -> Array:
    """Return the form of the sum of squares of some rows."""
    return product(row.T, row)


def constraint_forms(
    rows: Rows, loop: ReducedLoop, ratios: RatioSet, arithmetic: Arithmetic = FLOATS
) -> tuple[list[Array], list[list[Array]], list[Array], list[Array]]:
    """Return the forms that are at least zero, as polynomials in λ: of error, forces, change and slope.

    Each is a list of coefficients; empty where the signal does not exist.
    """
    number = arithmetic.number
    constant, factor = rows.inputs
    mixed = product(constant.T, factor)
    error = [square(constant) - square(rows.errors), mixed + mixed.T, square(factor)]
    forces = []
    squared_period = number(ratios.period) ** 2
    for power, (size, lead, within, lag) in zip(ratios.powers.tolist(), ratios.force_bounds(), strict=True):
        weights = np.kron([[1, 0], [0, 0]], MEAN_SQUARES[0] + lead * MEAN_SQUARES[1])
        weights = weights + np.kron([[0, 0], [0, lag]], MEAN_SQUARES[0])
        zero = 0 * rows.position
        known = np.concatenate([rows.position, rows.velocity, zero, rows.lag, rows.velocity, zero])
        added = np.concatenate([zero, zero, rows.acceleration * squared_period] * 2)
        weighted = arithmetic.matrix(weights * size)
        mixed = product(known.T, product(weighted, added))
        coefficients = [product(known.T, product(weighted, known)), mixed + mixed.T]
        coefficients.append(product(added.T, product(weighted, added)))
        coefficients[1] = coefficients[1] + number(within) * square(rows.v)
        degree = round(2 - 2 * power)
        coefficients[degree] = coefficients[degree] - square(rows.forces)
        forces.append(coefficients)
    change, slope = [], []
    if ratios.intersample:
        # Ē^−½ of the moment is at most ε Ē^½ v; times λ
        form = -square(rows.change)
        change = [form, 0 * form, number(ratios.swing) ** 2 * square(rows.v)]
    if loop.full.has_slope:
        half = number(loop.full.loop.half_slope.item())
        slope = [half**2 * square(rows.position) - square(rows.robust)]
    return error, forces, change, slope


def period_form_polynomial(
    rows: Rows, ratios: RatioSet, form: ForceForm, arithmetic: Arithmetic = FLOATS
) -> list[Array]:
    """Return right less left side of a `PeriodForm`, times λ, as a polynomial in λ.

    With k0 and k1 mean and moment of k', c the moment of the acceleration by which E changes, and T' = T/√12,

        ms(ẋᵀk') = (ẋ + λ (v + k0) T/2) k0 − T' λ v k1 + T' c k0.
    """
    number, bounds, T = arithmetic.number, ratios.period_form(form), arithmetic.number(ratios.period)
    zero = 0 * rows.position
    known, added = (
        np.concatenate([rows.position, rows.velocity, zero]),
        np.concatenate([zero, zero, rows.acceleration * T**2]),
    )
    weights = arithmetic.matrix(MEAN_SQUARES[0]) * number(bounds.position)
    weights = weights + arithmetic.matrix(MEAN_SQUARES[1]) * (number(bounds.velocity) / T**2)
    mixed = product(known.T, product(weights, added))
    mean, moment = rows.forces[:1], rows.forces[1:]
    moment_time = T / number(12.0).sqrt() if arithmetic is not FLOATS else T / 12**0.5
    constant = product((rows.velocity / T).T, mean)
    if len(rows.change):
        constant = constant + moment_time * product(rows.change.T, mean)
    factor = product(rows.acceleration.T, mean) * (T / 2) - moment_time * product(rows.v.T, moment)
    squares, power = square(rows.forces), number(bounds.power)
    return [
        0 * squares,
        product(known.T, product(weights, known)) - power * (constant + constant.T) - number(bounds.torque) * squares,
        mixed
        + mixed.T
        - power * (factor + factor.T)
        - number(bounds.energy) * squares
        + number(bounds.change) * square(rows.v),
        product(added.T, product(weights, added)) + number(bounds.acceleration) * squares,
    ]


class LyapunovMatrices(NamedTuple):
    """Matrices of a Lyapunov function V = Σ xᵀ (P0⊗I + (P1 + Q1)⊗J) x.

    Attributes
    ----------
    P0, P1, Q1
        Symmetric matrices.
    S, R
        S ± P1 and R ± Q1 are positive definite.
    S0
        S0 ± P0 is positive definite; zero for a constant M̂.
    """

    P0: Array
    P1: Array
    Q1: Array
    S: Array
    R: Array
    S0: Array


def decrease(
    loop: ReducedLoop,
    ratios: RatioSet,
    matrices: LyapunovMatrices,
    multipliers: Multipliers,
    growth: float,
    arithmetic: Arithmetic = FLOATS,
) -> list[Array]:
    """Return F_0 to F_3, in floats or balls.

    Parameters
    ----------
    loop, ratios
        The loop and what it must tolerate.
    matrices
        Of the Lyapunov function.
    multipliers
        Weights of the constraints.
    growth
        e^{αT}.
    arithmetic
        Floats or balls.
    """
    number = arithmetic.number
    rows = signal_rows(loop, ratios, arithmetic)
    P0, P1, Q1, S, R, S0 = (arithmetic.matrix(part) for part in matrices)
    slopes = P1 + Q1
    changed = P0 + number(ratios.max_change) * S + number(ratios.max_nominal_change) * S0
    later = changed, slopes + number(ratios.max_relative_change) * R
    constant, factor = rows.next_state
    forms = [product(rows.state.T, product(P, rows.state)) for P in (slopes, P0)]
    forms += [0 * forms[0], 0 * forms[0]]
    squared = number(growth) ** 2
    for degree, P in ((0, later[1]), (1, later[0])):
        mixed = product(constant.T, product(P, factor))
        parts = product(constant.T, product(P, constant)), mixed + mixed.T, product(factor.T, product(P, factor))
        for i, part in enumerate(parts):
            forms[degree + i] = forms[degree + i] - squared * part
    error, forces, change, slope = constraint_forms(rows, loop, ratios, arithmetic)
    # that of the change within a period holds times λ already
    weighted = [(1, multipliers.error, error), (0, multipliers.change, change), (1, multipliers.slope, slope)]
    weighted += [(1, weight, form) for weight, form in zip(multipliers.forces.tolist(), forces, strict=True)]
    if ratios.form is not None:
        weighted.append((0, 1.0, period_form_polynomial(rows, ratios, ratios.form, arithmetic)))
    for degree, weight, coefficients in weighted:
        for i, form in enumerate(coefficients):
            forms[degree + i] = forms[degree + i] - number(weight) * form
    return forms
