"""A loop of few states in place of a long window's, and a proven bound on the difference of their outputs."""

from dataclasses import dataclass, replace

import numpy as np

from tarc.analysis.uncertain_loop import UncertainLoop
from tarc.core.types import Array
from tarc.numerics.ball_arithmetic import BALLS, FLOATS, Arithmetic, decide, is_positive_definite
from tarc.numerics.matrix_tests import schur_stability
from tarc.numerics.norms import hinf_norm

NEGLIGIBLE_SHARE = 1e-7
"""Share of the largest Hankel singular value below which states are left out in any case."""
ERROR_SLACK = 2.0
"""Factor on the gain of the error, so that its storage function is far from singular."""
MIN_ERROR_SHARE = 1e-6
"""Least bound on the error, as a share of the largest Hankel singular value."""
MIN_STATE_SHARE = 1e-9
"""Least size of a state of the error system, as a share of the largest."""
MIN_POWER = 1e-12
"""Largest entry of a power of A at which its series has converged."""
MAX_DOUBLINGS = 40
"""Largest number of steps in which a Riccati equation is solved."""
STRICTNESS = 0.3
"""Gain from the inputs to all states of the error system, weighted so that the dissipation is strict."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CentredLoop:
    """The loop of one joint closed at a centre ρ0, with its inputs and outputs scaled.

        x⁺ = A x + B u,     y = C x + D u

    The inputs u are the mean and the first moment of the acceleration over a period, less ρ0 v, and ρ0 w of the robust
    term. The outputs y are v, q, q̇ T and l, times `scales`, where l is q less the last state of the loop.

    Attributes
    ----------
    loop
        The loop, opened at its inertia ratio; its mismatched acceleration has one or two columns.
    centre
        ρ0.
    scales
        Factors on the outputs v, q, q̇ T and l, shape (o,); those after the last are left out. With l the last state of
        the loop is the position of the torque's sample.
    """

    loop: UncertainLoop
    centre: float
    scales: Array

    @property
    def has_slope(self) -> bool:
        """Whether there is a robust term."""
        return bool(self.loop.half_slope.item())

    @property
    def n_inputs(self) -> int:
        """Number of inputs u."""
        return self.loop.B_mismatch.shape[1] + self.has_slope

    def matrices(self, arithmetic: Arithmetic = FLOATS) -> tuple[Array, Array, Array, Array]:
        """Return A, B, C and D, in floats or balls."""
        matrix = arithmetic.matrix
        A, B, C, B_robust, D_robust = (matrix(part) for part in self.loop[:5])
        B_mismatch, centre, half = matrix(self.loop.B_mismatch), arithmetic.number(self.centre), self.loop.half_slope
        position = matrix(np.eye(1, len(self.loop.A)))
        v = C - arithmetic.number(half.item()) * (D_robust @ position)
        A = A + centre * (B @ v) - arithmetic.number(half.item()) * (B_robust @ position)
        unit = np.eye(len(self.loop.A))
        outputs = np.concatenate([v, matrix(unit[:2]), matrix(unit[:1] - unit[-1:])])[: len(self.scales)]
        outputs = outputs * matrix(self.scales[:, None])
        D = matrix(np.zeros((len(self.scales), self.n_inputs)))
        inputs = [B_mismatch]
        if self.has_slope:
            inputs.append(B_robust / centre + B @ D_robust)
            D[0, -1] = arithmetic.number(self.scales[0]) * D_robust.item() / centre
        return A, np.concatenate(inputs, axis=1), outputs, D


@dataclass(frozen=True, kw_only=True, eq=False)
class ReducedLoop:
    """A loop of fewer states, and a storage function that bounds the error of its outputs.

        z⁺ = A z + B u,     y = C z + D u + γ e,     Σ |e_k|² ≤ Σ |u_k|²

    Attributes
    ----------
    full
        The loop that it stands for, with the same inputs and outputs.
    A, B, C
        Its matrices; D is that of the full loop.
    projection
        L: z is nearly L x.
    error_gain
        γ.
    storage
        P_e: along any motion, ξᵀ P_e ξ grows in one period by less than |u|² − |e|², with ξ = [x; z − L x].
    """

    full: CentredLoop
    A: Array
    B: Array
    C: Array
    projection: Array
    error_gain: float
    storage: Array

    def transformed(self, T: Array, inverse: Array) -> "ReducedLoop":
        """Return the same loop in states T z, without a storage function."""
        return replace(
            self,
            A=T @ self.A @ inverse,
            B=T @ self.B,
            C=self.C @ inverse,
            projection=T @ self.projection,
            storage=np.zeros((0, 0)),
        )

    def error_system(self, arithmetic: Arithmetic = FLOATS) -> tuple[Array, Array, Array]:
        """Return A, B and C of the system from u to e, with states (x, z − L x)."""
        A, B, C, _ = self.full.matrices(arithmetic)
        A_r, B_r, C_r, L = (arithmetic.matrix(part) for part in (self.A, self.B, self.C, self.projection))
        top = np.concatenate([A, arithmetic.matrix(np.zeros((len(A), len(A_r))))], axis=1)
        bottom = np.concatenate([product(A_r, L) - product(L, A), A_r], axis=1)
        outputs = np.concatenate([C - product(C_r, L), -C_r], axis=1) / arithmetic.number(self.error_gain)
        return np.concatenate([top, bottom]), np.concatenate([B, B_r - product(L, B)]), outputs

    def with_storage(self, growth: float) -> "ReducedLoop | None":
        """Return the same loop with a storage function; None where there is none.

        Parameters
        ----------
        growth
            Factor e^{αT} on states and inputs, for a decay rate α.
        """
        A, B, C = self.error_system()
        A, B = growth * A, growth * B
        if schur_stability(A)[0] != "certified":
            return None
        size = np.sqrt(np.diag(gramian(A, B)))
        size = np.maximum(size, MIN_STATE_SHARE * size.max())
        A, B, C = A * size / size[:, None], B / size[:, None], C * size
        to_states = hinf_norm(A, B, np.eye(len(A)), np.zeros(B.shape), 1e-2)
        weight = C.T @ C + (STRICTNESS / to_states) ** 2 * np.eye(len(A))
        P = _storage_matrix(A, B, weight)
        return None if P is None else replace(self, storage=P / np.outer(size, size))

    def error_is_bounded(self, growth: float) -> bool:
        """Return whether balls prove that the storage function is one, for states that may grow by a factor."""

        def is_proven() -> bool:
            A, B, C = self.error_system(BALLS)
            P, factor = BALLS.matrix(self.storage), BALLS.number(growth) ** 2
            step = np.concatenate([A, B], axis=1)
            form = -factor * product(step.T, product(P, step))
            n = len(A)
            form[:n, :n] += P - C.T @ C
            form[n:, n:] += BALLS.matrix(np.eye(B.shape[1]))
            return is_positive_definite(P) and is_positive_definite(form)

        return self.storage.shape == (len(self.full.loop.A) + len(self.A),) * 2 and decide(is_proven)


def product(first: Array, second: Array) -> Array:
    """Return the product of two matrices of floats or balls; that of balls is ten times as fast as by ``@``."""
    if first.dtype != object:
        return first @ second
    import flint

    n_rows, n_inner, n_columns = len(first), len(second), second.shape[1]
    left = flint.arb_mat(n_rows, n_inner, list(first.ravel()))
    right = flint.arb_mat(n_inner, n_columns, list(second.ravel()))
    return np.array((left * right).entries(), dtype=object).reshape(n_rows, n_columns)


def reduce_loop(full: CentredLoop, max_states: int) -> ReducedLoop | None:
    """Return a loop of fewer states by balanced truncation; None where the loop at the centre is not stable.

    States that are not needed are always left out: a synchronised law remembers positions and torques, and only one
    combination of both counts.

    Parameters
    ----------
    full
        The loop.
    max_states
        Largest number of states.
    """
    from scipy.linalg import svd

    A, B, C, D = full.matrices()
    if schur_stability(A)[0] != "certified":
        return None
    reachable, observable = _root(gramian(A, B)), _root(gramian(A.T, C.T))
    left, hankel, right = svd(observable.T @ reachable)
    tails = 2 * np.array([hankel[i:].sum() for i in range(len(hankel) + 1)])
    count = min(int(np.argmax(tails < NEGLIGIBLE_SHARE * hankel[0])), max_states)
    to_reduced = (observable @ left[:, :count] / np.sqrt(hankel[:count])).T
    to_full = reachable @ right[:count].T / np.sqrt(hankel[:count])
    reduced = ReducedLoop(
        full=full,
        A=to_reduced @ A @ to_full,
        B=to_reduced @ B,
        C=C @ to_full,
        projection=to_reduced,
        error_gain=1.0,
        storage=np.zeros((0, 0)),
    )
    error = hinf_norm(*reduced.error_system(), 0 * D, 1e-2)
    gain = ERROR_SLACK * max(min(error, tails[count]), MIN_ERROR_SHARE * hankel[0])
    return replace(reduced, error_gain=gain)


def gramian(A: Array, B: Array) -> Array:
    """Return Σ_k A^k B Bᵀ (Aᵀ)^k of a stable A, doubling the number of summands in each step."""
    W, power = B @ B.T, A
    while np.abs(power).max() > MIN_POWER:
        W = W + power @ W @ power.T
        power = power @ power
    return (W + W.T) / 2


def _storage_matrix(A: Array, B: Array, weight: Array) -> Array | None:
    """Return P = AᵀPA + W + AᵀPB (I − BᵀPB)⁻¹ BᵀPA by doubling; None where there is no such P.

    References
    ----------
    E. K.-W. Chu, H.-Y. Fan, W.-W. Lin and C.-S. Wang, International Journal of Control 77(8), 2004.
    """
    power, G, P = A, -B @ B.T, weight
    for _ in range(MAX_DOUBLINGS):
        if not np.all(np.isfinite(P)):
            return None
        try:
            middle = np.linalg.inv(np.eye(len(A)) + G @ P)
        except np.linalg.LinAlgError:
            return None
        step = middle @ power
        power, G, P = power @ step, G + power @ middle @ G @ power.T, P + power.T @ P @ step
        if np.abs(power).max() < MIN_POWER:
            return (P + P.T) / 2
    return None


def _root(gramian: Array) -> Array:
    values, vectors = np.linalg.eigh((gramian + gramian.T) / 2)
    return vectors * np.sqrt(np.maximum(values, 0.0))
