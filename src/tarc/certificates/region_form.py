"""The decrease of a Lyapunov function along the nonlinear sampled loop, as a cubic matrix polynomial in the ratio λ.

With e = q − qᵈ and τ* the torque along the reference, the robot and a law without a model obey, exactly,

    M(q) ë = (τ − τ*) − G̃ e − D̃ ė,     G̃, D̃ = means of ∂(M q̈ᵈ + N)/∂q and ∂N/∂q̇ between (qᵈ, q̇ᵈ) and (q, q̇).

In coordinates M̂^½ e that is E (v − v* + k̃), where ‖k̃‖ ≤ κ ‖(e, θ ė)‖ as long as (e, ė) stays in the tube over which κ
is the largest torque-level norm. For V = Σ xᵀ (P0⊗I + (P1 + Q1)⊗Ē⁻¹) x everything decouples into the eigenvalues λ of
Ē. One of them contributes at least −F(λ)/λ to ϱ V − V⁺ + g, g the sum of the weights of what is bounded.

For M̂(q), v is the law's acceleration and v* the one along the reference, see `tarc.analysis.known_tube`. M̂ is that of
the measured position and constant in each period. From one to the next it adds at most s0 S0⊗I, S0 ± P0 ⪰ 0.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tarc.certificates.affine_form import MEAN_SQUARES, ROUNDING_ROOM, LyapunovMatrices, RatioSet, square
from tarc.certificates.reduced_loop import product
from tarc.core.types import Array
from tarc.numerics.ball_arithmetic import FLOATS, Arithmetic


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackingLoop:
    """The loop of one joint in errors from a reference, opened at its inertia ratio.

        y⁺ = A y + B (mean, moment) + N n + R r + X δ,     v = C y + d n + s r

    The state y is (e, ė T, x), with x the memory of the law less that along the reference. (mean, moment) are those of
    the acceleration over a period, the moment with T²/√12. The inputs n, r and δ are the error of measurement, what
    the law's derivatives of the reference lack, and the change of v* in a period, negative. Half of the largest slope
    of a robust term is in the loop; the rest w, ‖w‖ ≤ ‖e + n‖ k/2, enters as r does.

    Attributes
    ----------
    A, B, C
        Shapes (m, m), (m, 2) and (1, m).
    noise, residual, change
        N, R and X, each (m, 1).
    noise_gain, residual_gain
        d and s, each (1, 1).
    outputs
        Rows of e and ė T, (2, m).
    starts
        Columns y, (m, 4): an error of one, an ė T of one, a window full of an error of one, and v − v* of one.
    half_slope
        k/2 [1/s²]; zero without a robust term.
    period
        T [s].
    """

    A: Array
    B: Array
    C: Array
    noise: Array
    residual: Array
    change: Array
    noise_gain: Array
    residual_gain: Array
    outputs: Array
    starts: Array
    half_slope: float
    period: float

    def transformed(self, T: Array, inverse: Array) -> "TrackingLoop":
        """Return the loop in states T y."""
        return TrackingLoop(
            A=T @ self.A @ inverse,
            B=T @ self.B,
            C=self.C @ inverse,
            noise=T @ self.noise,
            residual=T @ self.residual,
            change=T @ self.change,
            noise_gain=self.noise_gain,
            residual_gain=self.residual_gain,
            outputs=self.outputs @ inverse,
            starts=T @ self.starts,
            half_slope=self.half_slope,
            period=self.period,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class InputBounds:
    """Largest norms of what acts on the loop, in coordinates M̂^½ q.

    Attributes
    ----------
    noise
        ‖n‖, error of measurement [rad kg^½ m].
    residual
        ‖r‖, what the law's derivatives of the reference lack [rad kg^½ m/s²].
    change
        Change of v* over a period [rad kg^½ m/s²], with v* the command along the reference: without feed-forward.
    held
        ‖M̂^−½ (τ*(t) − τ*(s))‖ over a period, s ≤ t [rad kg^½ m/s²], reached at a steady rate; feed-forward is held.
    torque
        Norm of any further torque M̂^−½ τ [rad kg^½ m/s²], such as dry friction, which may change at any time.
    """

    noise: float
    residual: float
    change: float
    held: float
    torque: float

    @property
    def drift(self) -> float:
        """Root mean square over a period of what differs from the τ* of its start."""
        return self.held / 3**0.5 + self.torque


class RegionWeights(NamedTuple):
    """Weights of what the signals satisfy, all at least zero.

    Attributes
    ----------
    forces
        Of each bound on k, shape (k,).
    swing
        Of the change of E within a period.
    slope
        Of the bound on w; zero without a robust term.
    drift, noise, residual, change
        Of the bounds on f (the change of v* within the period), n, r and δ.
    """

    forces: Array
    swing: float
    slope: float
    drift: float
    noise: float
    residual: float
    change: float


def signal_bounds(ratios: RatioSet, bounds: InputBounds) -> tuple[Array, Array]:
    """Return the squares that the weights multiply in g: of the forces (k,), and of drift, noise, residual and change.

    E f is the acceleration by what differs from the v* at the start of the period. Its root mean square adds λmax times
    the drift to that of the acceleration which differs from its mean.
    """
    drift = (ratios.condition * bounds.drift) ** 2
    constants = []
    for i, stiffness in enumerate(ratios.stiffness.tolist()):
        gain = ratios.period / np.pi * np.hypot(2 * ratios.period / np.pi, ratios.lead_times[i]) * ROUNDING_ROOM
        rest = 1 - stiffness * gain * ratios.max_ratio
        size = (ratios.condition * stiffness / rest) ** 2 * (1 + 1 / ratios.shares[i])
        constants.append(2 * size * (gain * ratios.max_ratio * bounds.drift) ** 2)
    others = [drift, bounds.noise**2, bounds.residual**2, bounds.change**2]
    return np.array(constants) * ROUNDING_ROOM, np.array(others) * ROUNDING_ROOM


def region_forms(loop: TrackingLoop, ratios: RatioSet, arithmetic: Arithmetic = FLOATS) -> "RegionForms":
    """Return the signals of the loop and the forms that are at least zero, less their constants."""
    matrix, number = arithmetic.matrix, arithmetic.number
    sizes = [len(loop.A), 2, 1, 2, 1, 1, 1, int(loop.half_slope > 0)]
    ends = np.cumsum(sizes)
    unit = matrix(np.eye(int(ends[-1])))
    z, k, c, f, n, r, d, w = (unit[end - size : end] for end, size in zip(ends, sizes, strict=True))
    B, auxiliary = matrix(loop.B), np.concatenate([r, w]).sum(axis=0, keepdims=True)
    v = product(matrix(loop.C), z) + product(matrix(loop.noise_gain), n)
    v = v + product(matrix(loop.residual_gain), auxiliary)
    mean, moment = v + k[:1] + f[:1], k[1:] + f[1:]
    constant = product(matrix(loop.A), z) + product(B[:, 1:], c) + product(matrix(loop.noise), n)
    constant = constant + product(matrix(loop.residual), auxiliary) + product(matrix(loop.change), d)
    factor = product(B[:, :1], mean) + product(B[:, 1:], moment)
    rows = product(matrix(loop.outputs), z)
    forces = []
    for size, lead, within, _ in ratios.force_bounds():
        weights = matrix((MEAN_SQUARES[0] + lead * MEAN_SQUARES[1]) * size)
        known = np.concatenate([rows, 0 * v])
        added = np.concatenate([0 * rows, mean * number(ratios.period) ** 2])
        mixed = product(known.T, product(weights, added))
        forces.append(
            [
                product(known.T, product(weights, known)) - square(k),
                mixed + mixed.T + number(2 * within) * square(v),
                product(added.T, product(weights, added)),
            ]
        )
    swing = [-square(c), 0 * square(c), number(ratios.swing) ** 2 * square(v)]
    slope = [number(loop.half_slope) ** 2 * square(rows[:1] + n) - square(w)] if len(w) else []
    return RegionForms(z, (constant, factor), forces, swing, slope, [square(part) for part in (f, n, r, d)])


class RegionForms(NamedTuple):
    """The state, the next state as a pair of constant part and factor of λ, and forms as polynomials in λ."""

    state: Array
    next_state: tuple[Array, Array]
    forces: list[list[Array]]
    swing: list[Array]
    slope: list[Array]
    inputs: list[Array]


def region_decrease(
    loop: TrackingLoop,
    ratios: RatioSet,
    matrices: LyapunovMatrices,
    weights: RegionWeights,
    decay: float,
    arithmetic: Arithmetic = FLOATS,
) -> list[Array]:
    """Return F_0 to F_3, in floats or balls.

    Parameters
    ----------
    loop, ratios
        The loop and what it must tolerate in the tube.
    matrices
        Of the Lyapunov function; S0 counts for an M̂ that follows the posture.
    weights
        Of the bounds on the signals.
    decay
        ϱ, the factor on V in a period.
    arithmetic
        Floats or balls.
    """
    number = arithmetic.number
    signals = region_forms(loop, ratios, arithmetic)
    P0, P1, Q1, S, R, S0 = (arithmetic.matrix(part) for part in matrices)
    changed = number(ratios.max_change) * S + number(ratios.max_nominal_change) * S0
    later = P0 + changed, P1 + Q1 + number(ratios.max_relative_change) * R
    constant, factor = signals.next_state
    forms = [number(decay) * product(signals.state.T, product(P, signals.state)) for P in (P1 + Q1, P0)]
    forms += [0 * forms[0], 0 * forms[0]]
    for degree, P in ((0, later[1]), (1, later[0])):
        mixed = product(constant.T, product(P, factor))
        parts = product(constant.T, product(P, constant)), mixed + mixed.T, product(factor.T, product(P, factor))
        for i, part in enumerate(parts):
            forms[degree + i] = forms[degree + i] - part
    pairs = [(1, weight, form) for weight, form in zip(weights.forces.tolist(), signals.forces, strict=True)]
    pairs += [(0, weights.swing, signals.swing), (1, weights.slope, signals.slope)]
    pairs += [(1, -weight, [form]) for weight, form in zip(weights[3:], signals.inputs, strict=True)]
    for degree, weight, coefficients in pairs:
        for i, form in enumerate(coefficients):
            forms[degree + i] = forms[degree + i] - number(weight) * form
    return forms
