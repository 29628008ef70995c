"""Theorem 2 repaired, for the nominal loop: input-to-state stability with a delay and a derivative window.

Theorem 2 of the paper has no solution (see `tarc.paper.check_theorem2`). The loop that it is about, with the delay h,
the window ς and the kernel Ω_1,

    ë1 = −K1 e1(t−h) − K2 ∫_{−ς}^0 Ω_1(ψ) e1(t−h+ψ) dψ + σ′,

has a condition that does. By parts ∫Ω_1 e1 = ∫w e2 with e2 = ė1, w(ψ) = −∫_{−ς}^ψ Ω_1 and ∫w = 1. So with
z1 = ∫_{−h}^0 e2(t+θ)dθ, z2 = ∫_{−h−ς}^0 g(θ) ė2(t+θ)dθ and g(θ) = ∫_{−ς}^{min(0, θ+h)} w,

    ė2 = −K1 e1 − K2 e2 + K1 z1 + K2 z2 + σ′.

With G = ∫|g| = h + ς G0, G0 a constant of the degree, and the functional

    V = eᵀPe + ∫_{−h}^0∫_{t+θ}^t e^{2a(s−t)} e2ᵀR1e2 ds dθ + ∫_{−h−ς}^0|g(θ)|∫_{t+θ}^t e^{2a(s−t)} ė2ᵀR2ė2 ds dθ

Jensen's inequality, which with |g| as the weight needs no sign of w, gives V̇ + 2aV ≤ F(e, z1, z2, σ′) + γ²‖σ′‖²,

    F = 2eᵀPė + 2a eᵀPe + h e2ᵀR1e2 + G ė2ᵀR2ė2 − e^{−2ah}/h z1ᵀR1z1 − e^{−2a(h+ς)}/G z2ᵀR2z2 − γ²‖σ′‖².

F grows with G, so that any upper bound of G will do, and its sign at one window is its sign at all shorter ones.
"""

from typing import Any

import numpy as np

from tarc.certificates.base import FORMS, JUDGES, Certificate, dict_certificate
from tarc.core import validation as check
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.numerics.ball_arithmetic import BALLS, FLOATS, Arithmetic, positive, prove
from tarc.numerics.sdp import furthest, least, longest, solve, symmetric
from tarc.paper.kernel import lag_area
from tarc.paper.law_parts import delay_of, delayed, gains, gather, rate, store, stretch, windowed

NAMES = ("K1", "K2", "P", "R1", "R2")
SHAPES = {"K1": (1, 1), "K2": (1, 1), "P": (2, 2), "R1": (1, 1), "R2": (1, 1)}


def check_nominal_loop(
    law: Law, *, window: float | None = None, delay: float | None = None, decay: float = 0.0
) -> Certificate:
    """Input-to-state stability of the nominal loop with its delay and its derivative window.

    A semidefinite program finds P, R1, R2 and the least γ², whose inequality is then proven in ball arithmetic. Joints
    that the gains do not couple cost what their different gains cost.

    Parameters
    ----------
    law
        A law on time-delay estimation with the estimator `tarc.estimators.Algebraic`, for K1, K2, h, ς and Λ.
    window, delay
        ς and h [s]; None for the law's own.
    decay
        a [1/s]. At zero γ is a gain in mean square; above, e decays as e^{−at} where σ′ is zero.

    Returns
    -------
    Certificate
        Certified or inconclusive: the condition is sufficient only. Its numbers: ``gamma``, and what it means for e1:
        without decay ``mean square gain`` [s²], ∫‖e1‖² ≤ γ²∫‖σ′‖² from rest; with decay, where P ≥ CᵀC with
        C = [I 0], ``peak gain`` [s²], limsup ‖e1‖ ≤ γ/√(2a) sup ‖σ′‖. Its margin is the least eigenvalue of the
        negated form once its diagonal is scaled to one.

    Raises
    ------
    TarcError
        For another estimator, and a window, delay or decay out of range.
    """
    law = delayed(law)
    estimator = windowed(law)
    numbers = {
        "delay": delay_of(law, delay),
        "window": estimator.window if window is None else check.number("window", window, 0, strict=True),
        "degree": float(estimator.degree),
        "decay": check.number("decay", decay, 0),
    }
    points = [_Program(K1, K2, numbers).least_gain(numbers) for K1, K2 in gains(law)]
    if all(point is not None for point in points):
        parts = [point[0] for point in points if point is not None]
        numbers["gamma"] = max(point[1] for point in points if point is not None)
    else:
        parts = gains(law)
    matrices = store(parts, NAMES)
    verdict, margin, _ = judge(matrices, numbers)
    a = numbers["decay"]
    if verdict == "certified":
        meaning = "peak gain" if a else "mean square gain"
        numbers[meaning] = numbers["gamma"] / (float(np.sqrt(2 * a)) if a else 1.0)
    return dict_certificate(
        kind="nominal",
        claim=f"The nominal loop with h = {numbers['delay']:g} s, ς = {numbers['window']:g} s and Λ = "
        f"{estimator.degree} is input-to-state stable from σ′ to the error"
        + (f", with decay rate {a:g} 1/s" if a else "")
        + "; this is not stability of the loop that runs.",
        verdict=verdict,
        margin=margin,
        margin_meaning="least eigenvalue of the negated form, its diagonal scaled to one",
        assumptions=(
            "σ′ is an input of its own: what is left out is that it holds the TDE error with M⁻¹M̂(q̈_h − q̈̂_h), which "
            "depends on the loop's own state and is of its own order; for the loop that runs use "
            "tarc.certificates.certify_constant_ratio",
            "continuous time and the kernel Ω_1 with its sign corrected; no sampling",
            "the switching term, the adaptation and torque limits are left out or count as σ′",
            "sufficient only: where it is inconclusive, the nominal loop may still be stable",
        ),
        matrices=matrices,
        numbers=numbers,
        problem="2eᵀPė + 2a eᵀPe + h e2ᵀR1e2 + G ė2ᵀR2ė2 − e^{−2ah}/h z1ᵀR1z1 − e^{−2a(h+ς)}/G z2ᵀR2z2 "
        + ("− γ²‖σ′‖² < 0, P > CᵀC" if a else "+ ‖e1‖² − γ²‖σ′‖² < 0"),
        proof_grade=verdict != "inconclusive",
    )


def nominal_max_window(law: Law, *, delay: float | None = None, decay: float = 0.0) -> float:
    """The largest window ς [s] that `nominal` certifies for the gains, delay and degree of a law; 0.0 for none.

    At damping 1 and a delay of 0.01 over the natural frequency: 0.980, 1.240 and 1.263 over the natural frequency
    for Λ = 1, 2, 3.
    """
    law = delayed(law)
    return _longest(law, "window", {"delay": delay_of(law, delay)}, decay)


def nominal_max_delay(law: Law, *, window: float | None = None, decay: float = 0.0) -> float:
    """The largest delay h [s] that `nominal` certifies for the gains, window and degree of a law; 0.0 for none."""
    law = delayed(law)
    window = windowed(law).window if window is None else check.number("window", window, 0, strict=True)
    return _longest(law, "delay", {"window": window}, decay)


def _longest(law: Any, name: str, fixed: dict[str, float], decay: float) -> float:
    numbers = {**fixed, "degree": float(windowed(law).degree), "decay": check.number("decay", decay, 0)}
    end = min(_Program(K1, K2, numbers).longest(name, numbers) for K1, K2 in gains(law))
    for room in (1e-7, 1e-6, 1e-5, 1e-4, 1e-3):
        value = end * (1 - room)
        if value > 0 and check_nominal_loop(law, **{**fixed, name: value}, decay=decay).certified:
            return value
    return 0.0


def form(part: tuple[Array, ...], numbers: dict[str, Any], kit: Arithmetic) -> Array:
    """−F, shape (5n, 5n), in (e1, e2, z1, z2, σ′), at K1, K2, P, R1, R2."""
    K1, K2, P, R1, R2 = (kit.matrix(one) for one in part)
    h, window, a, gamma = (kit.number(numbers[name]) for name in ("delay", "window", "decay", "gamma"))
    G = h + window * kit.number(lag_area(int(numbers["degree"])))
    e1, e2, z1, z2, disturbance = kit.matrix(np.eye(5 * len(K1))).reshape(5, len(K1), -1)
    e2_rate = -K1 @ e1 - K2 @ e2 + K1 @ z1 + K2 @ z2 + disturbance
    e, e_rate = np.concatenate([e1, e2]), np.concatenate([e2, e2_rate])
    power = e.T @ P @ e_rate
    F = (
        power
        + power.T
        + 2 * a * (e.T @ P @ e)
        + h * (e2.T @ R1 @ e2)
        + G * (e2_rate.T @ R2 @ e2_rate)
        - kit.exp(-2 * a * h) / h * (z1.T @ R1 @ z1)
        - kit.exp(-2 * a * (h + window)) / G * (z2.T @ R2 @ z2)
        - gamma * gamma * (disturbance.T @ disturbance)
    )
    return -F


def conditions(part: tuple[Array, ...], numbers: dict[str, Any], kit: Arithmetic) -> tuple[Array, Array]:
    """What must be positive definite: −F and P, less CᵀC with e1 = C e in the first, with decay in the second."""
    left, P = form(part, numbers, kit), kit.matrix(part[2])
    if numbers["decay"]:
        return left, P - _seen(part, P, kit)
    return left - _seen(part, left, kit), P


def _seen(part: tuple[Array, ...], like: Array, kit: Arithmetic) -> Array:
    """‖e1‖² as a form of the same size."""
    return kit.matrix(np.diag(np.arange(len(like)) < len(part[0])).astype(float))


def judge(matrices: dict[str, Array], numbers: dict[str, Any]) -> tuple[str, float, None]:
    """Verdict and margin from the stored matrices, by ball arithmetic alone."""
    parts = gather(matrices, SHAPES)
    positives = [numbers.get(name, 0.0) for name in ("delay", "window", "gamma")]
    legal = np.all(np.isfinite([*positives, numbers["decay"]])) and min(positives) > 0 and numbers["decay"] >= 0
    if not parts or not legal or numbers["degree"] not in range(1, 7):
        return "inconclusive", 0.0, None
    margin = min(least(conditions(part, numbers, FLOATS)[0])[0] for part in parts)

    def holds(part: tuple[Array, ...]) -> bool:
        weights = (BALLS.matrix(one) for one in part[2:])
        return all(positive(one) for one in (*weights, *conditions(part, numbers, BALLS)))

    proven = margin > 0 and all(prove(lambda part=part: holds(part)) for part in parts)
    return ("certified" if proven else "inconclusive"), margin, None


JUDGES["nominal"] = judge
FORMS["nominal"] = lambda matrices, numbers: {
    f"−F, part {i + 1}": conditions(part, numbers, FLOATS)[0] for i, part in enumerate(gather(matrices, SHAPES))
}


class _Program:
    """The semidefinite programs of one part, in time scaled by ω, with R1/h and R2/G for unknowns.

    ``centre`` is as far inside F < 0 (without σ′) as tr P = 2n lets it be; ``gain`` has the least γ².
    """

    def __init__(self, K1: Array, K2: Array, numbers: dict[str, float]) -> None:
        import cvxpy as cp

        n = len(K1)
        self.gains, self.omega = (K1, K2), rate(K1)
        self.area = float(lag_area(int(numbers["degree"])))
        k1, k2 = K1 / self.omega**2, K2 / self.omega
        self.P, self.S1, self.S2 = (cp.Variable((size, size), symmetric=True) for size in (2 * n, n, n))
        self.h2, self.G2, self.w1, self.w2 = (cp.Parameter(nonneg=True) for _ in range(4))
        self.square, t = cp.Variable(nonneg=True), cp.Variable()
        a = numbers["decay"] / self.omega
        e1, e2, z1, z2, disturbance = np.eye(5 * n).reshape(5, n, 5 * n)
        e2_rate = -k1 @ e1 - k2 @ e2 + k1 @ z1 + k2 @ z2 + disturbance
        e, e_rate = np.concatenate([e1, e2]), np.concatenate([e2, e2_rate])
        power = e.T @ self.P @ e_rate
        F = (
            power
            + power.T
            + 2 * a * (e.T @ self.P @ e)
            + self.h2 * (e2.T @ self.S1 @ e2)
            + self.G2 * (e2_rate.T @ self.S2 @ e2_rate)
            - self.w1 * (z1.T @ self.S1 @ z1)
            - self.w2 * (z2.T @ self.S2 @ z2)
        )
        free, room = -F[: 4 * n, : 4 * n], t * np.eye(4 * n)
        limits = [cp.trace(self.P) == 2 * n, self.P >> room[: 2 * n, : 2 * n]]
        self.centre = cp.Problem(cp.Maximize(t), [(free + free.T) / 2 >> room, *limits])
        whole, seen = self.square * (disturbance.T @ disturbance) - F, e1.T @ e1
        left, right = (whole, self.P - seen[: 2 * n, : 2 * n]) if a else (whole - seen, self.P)
        self.gain = cp.Problem(cp.Minimize(self.square), [(left + left.T) / 2 >> 0, right >> 0])

    def _set(self, numbers: dict[str, float]) -> None:
        h, window, a = numbers["delay"], numbers["window"], numbers["decay"]
        self.h2.value = (self.omega * h) ** 2
        self.G2.value = (self.omega * (h + window * self.area)) ** 2
        self.w1.value, self.w2.value = np.exp(-2 * a * h), np.exp(-2 * a * (h + window))

    def _part(self, found: list[Array], numbers: dict[str, float], scale: float = 1.0) -> tuple[Array, ...]:
        """K1, K2, P, R1, R2 of what a program found, in seconds."""
        P, S1, S2 = found[:3]
        back = stretch(len(S1), 1 / self.omega)
        h, G = numbers["delay"], numbers["delay"] + numbers["window"] * self.area
        return (
            *self.gains,
            *(symmetric(scale * one) for one in (back @ P @ back, self.omega * h * S1, G / self.omega * S2)),
        )

    def middle(self, numbers: dict[str, float]) -> list[Array] | None:
        """P, R1/h, R2/G in scaled time, as far inside as can be."""
        self._set(numbers)
        return solve(self.centre, self.P, self.S1, self.S2)

    def least_gain(self, numbers: dict[str, float]) -> tuple[tuple[Array, ...], float] | None:
        """K1, K2, P, R1, R2 and γ, or None.

        The least γ² is on the edge of the feasible set; the point returned is the first strictly inside on the way
        from there to a point of the middle.
        """
        middle = self.middle(numbers)
        if middle is None:
            return None
        inner = self._within(self._part(middle, numbers), numbers)
        if inner is None:
            return None
        edge = solve(self.gain, self.P, self.S1, self.S2, self.square)
        scale = 1.0 if numbers["decay"] else 1 / self.omega
        if edge is None:
            return inner
        for share in (1e-4, 1e-3, 1e-2, 1e-1):
            weights = zip(self._part(edge, numbers, scale)[2:], inner[0][2:], strict=True)
            part = (*self.gains, *(symmetric((1 - share) * p + share * q) for p, q in weights))
            square = float(edge[3]) * scale / self.omega**3
            gamma = float(np.sqrt((1 - share) * square + share * inner[1] ** 2))
            if min(least(one)[0] for one in conditions(part, {**numbers, "gamma": gamma}, FLOATS)) > 1e-9:
                return part, gamma
        return inner

    def _within(self, part: tuple[Array, ...], numbers: dict[str, float]) -> tuple[tuple[Array, ...], float] | None:
        """The point times what makes ‖e1‖² take no more than half, and its γ by a Schur complement; None if F is not
        negative without σ′.
        """
        from scipy.linalg import LinAlgError, eigh

        n = len(part[0])
        left = form(part, {**numbers, "gamma": 0.0}, FLOATS)
        inside, cross, own = left[: 4 * n, : 4 * n], left[: 4 * n, 4 * n :], left[4 * n :, 4 * n :]
        try:
            taken = [eigh(_seen(part, one, FLOATS), one, eigvals_only=True)[-1] for one in (inside, part[2])]
        except LinAlgError:
            return None
        scale = 2 * max(taken)
        square = scale * np.linalg.eigvalsh(2 * cross.T @ np.linalg.solve(inside, cross) - own)[-1]
        return (*self.gains, *(scale * one for one in part[2:])), float(np.sqrt(1.01 * square))

    def longest(self, name: str, numbers: dict[str, float]) -> float:
        """The largest window or delay [s] for which a point is found."""
        inside = slice(4 * len(self.gains[0]))

        def reach(found: list[Array]) -> float:
            def holds(value: float) -> bool:
                at = {**numbers, name: value, "gamma": 0.0}
                return least(form(self._part(found, at), at, FLOATS)[inside, inside])[0] > 1e-9

            return furthest(holds, 1e-9 / self.omega, 100 / self.omega)

        return longest(lambda value: self.middle({**numbers, name: value}), reach, 1e-3 / self.omega)
