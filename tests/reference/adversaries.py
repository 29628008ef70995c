"""Many uncertain loops at once, whose mismatch and slope adversaries choose at any speed."""

import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from reference.constant_loop import loop_polynomials, most_negative_real_part, peak_gain_of_pair
from reference.law_parameters import PERIOD
from reference.uncertain_case import UncertainCase, state_matrices, worst_pair_direction

Array = np.ndarray

SUBSTEPS = 4
"""Stretches of a period over which a mismatch that may change within it is constant."""
RESCALE_INTERVAL = 50
"""Steps between two measurements of the size of the states."""


class Adversary(NamedTuple):
    """How the mismatch and the slope are chosen, by the names in `Fleet.run`."""

    mismatch: str = "none"
    slope: str = "none"


MISMATCHES = ("rotate at the peak", "rotate at half", "rotate", "switch", "bang", "greedy", "greedy output", "random")
SLOPES = ("pulse at the peak", "pulse", "greedy", "greedy output", "returning", "phase")


class AdversarialLoops:
    """Many loops at once, each in two dimensions as complex numbers, under many adversaries each.

    A symmetric mismatch Δ with eigenvalues l and m, turned by θ, takes v to (l+m)/2 v + (l−m)/2 e^{2iθ} v̄. A stiffness
    beside it that turns q and scales it, in shares of cos and sin, leaves the pair of them the norm of the radius.
    """

    def __init__(self, cases: Sequence[UncertainCase], adversaries: Sequence[Adversary], seed: int = 0):
        self.cases, self.adversaries = cases, adversaries
        self.rng = np.random.default_rng(seed)
        count = len(cases)
        self.length = max(max(len(case.law.q), len(case.law.v) + 1, case.law.delay + 1) for case in cases)
        self.q, self.v = np.zeros((self.length, count)), np.zeros((self.length, count))
        for i, case in enumerate(cases):
            self.q[: len(case.law.q), i] = case.law.q
            self.v[1 : len(case.law.v) + 1, i] = case.law.v
        self.e, self.centre, self.radius, self.slope, self.weight = (
            np.array(one)
            for one in zip(
                *((c.law.e, c.centre, c.radius, c.max_slope, c.stiffness_weight) for c in cases), strict=True
            )
        )
        self.delay = np.array([case.law.delay for case in cases])
        self.peak, self.turn = np.zeros(count), np.zeros(count)
        for i, case in enumerate(cases):
            known = loop_polynomials(case.law, case.centre, case.max_slope / 2)
            self.peak[i] = peak_gain_of_pair(known, case.stiffness_weight)[1]
            self.turn[i] = most_negative_real_part(known.w_to_q, known.closed)[1] if case.max_slope else self.peak[i]
        self.functionals = {
            kind: self._lyapunov_functional(kind)
            for kind in ("greedy", "greedy output")
            if self._needs_functional(kind)
        }

    def _needs_functional(self, kind: str) -> bool:
        names = {name for adversary in self.adversaries for name in adversary}
        return kind in names or (kind == "greedy" and "bang" in names)

    def _lyapunov_functional(self, kind: str) -> dict[str, Array]:
        """Weights of the histories in BᵀPAx for the two rows that an acceleration enters, and in WᵀPAx.

        P is a Lyapunov matrix of the loop at the centre: of the state, or of v alone.
        """
        from scipy.linalg import solve_discrete_lyapunov

        count = len(self.cases)
        rows = {"q": np.zeros((3, self.length, count)), "v": np.zeros((3, self.length, count))}
        rows |= {"rate": np.zeros((3, count)), "w": np.zeros((3, count))}
        for i, case in enumerate(self.cases):
            A, _, W, C = state_matrices(case)
            scale = np.ones(len(A))
            scale[2 + len(case.law.q) - 1 :] = PERIOD**2  # so that v counts as q does
            row = C * PERIOD**2 / scale
            weight = np.eye(len(A)) if kind == "greedy" else np.outer(row, row)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # whatever P is, the adversary is allowed; it only guesses worse
                P = solve_discrete_lyapunov(A.T * np.outer(1 / scale, scale), weight, method="bilinear")
            P = (P + P.T) / 2 * np.outer(scale, scale)
            m = len(case.law.q) - 1
            picked = np.stack([P[0] @ A, P[1] @ A, W @ P @ A])
            rows["q"][:, 0, i], rows["rate"][:, i] = picked[:, 0], picked[:, 1]
            rows["q"][:, 1 : m + 1, i] = picked[:, 2 : 2 + m]
            width = min(picked.shape[1] - 3 - m, self.length - 1)
            rows["v"][:, 1 : width + 1, i] = picked[:, 2 + m : 2 + m + width]
            rows["w"][:, i] = picked[:, -1]
        return rows

    def run(self, steps: int, *, intersample: bool = False) -> Array:
        """Logarithm of the growth over the second half of the steps, (adversaries, cases).

        With ``within`` the mismatch may change inside a period.
        """
        kinds, count, L = len(self.adversaries), len(self.cases), self.length
        shape = (kinds, count)
        rng, T2 = self.rng, PERIOD**2
        q = rng.normal(size=shape) + 1j * rng.normal(size=shape)
        rate = np.zeros(shape, dtype=complex)
        room = 8 * L
        Q, V = np.zeros((room, *shape), dtype=complex), np.zeros((room, *shape), dtype=complex)
        last_w = np.zeros(shape, dtype=complex)
        at, log, half = L - 1, np.zeros(shape), np.zeros(shape)
        rates = {"rotate": rng.uniform(0, 2, count) * self.peak, "pulse": rng.uniform(0, 3, count) * self.turn}
        rates |= {"rotate at half": self.peak / 2, "rotate at the peak": self.peak}
        leans = {kind: self._pair_directions(rates[kind]) for kind in rates if kind.startswith("rotate")}
        aside = rng.uniform(0, 2 * np.pi, count)
        columns, held = np.arange(count), 1 if not intersample else SUBSTEPS
        for k in range(steps):
            if at == room - 1:
                Q[: L - 1], V[: L - 1] = Q[-(L - 1) :], V[-(L - 1) :]
                at = L - 2
            at += 1
            Q[at] = q
            past_q, past_v = Q[at : at - L if at >= L else None : -1], V[at : at - L if at >= L else None : -1]
            V[at] = 0
            v = np.einsum("lc,lkc->kc", self.q, past_q) + np.einsum("lc,lkc->kc", self.v, past_v) + self.e * last_w
            pulls = {
                kind: self._functional_values(rows, past_q, past_v, rate, last_w)
                for kind, rows in self.functionals.items()
            }
            kappa = np.zeros(shape)
            for i, adversary in enumerate(self.adversaries):
                if adversary.slope != "none":
                    on = self._slope_is_on(adversary.slope, i, k, q, rate, pulls, rates, aside)
                    kappa[i] = np.where(on, self.slope, 0.0)
            w = -kappa * q
            v += w
            V[at] = v
            acting = V[at - self.delay, :, columns].T
            last_w = w
            for j in range(held):
                reach = (held - j - 0.5) / held
                moment = k + (j + 0.5) / held
                push = self.centre * acting
                for i, adversary in enumerate(self.adversaries):
                    if adversary.mismatch != "none":
                        outputs = acting[i], self.weight * q[i]
                        push[i] += self._acceleration(
                            adversary.mismatch, i, moment, reach, outputs, pulls, rates, leans
                        )
                q = q + rate / held + push * T2 / (2 * held**2)
                rate = rate + push * T2 / held
            if k % RESCALE_INTERVAL == RESCALE_INTERVAL - 1:
                size = np.maximum(np.max(np.abs(Q[at - L + 1 : at + 1]), axis=0), np.abs(q)) + 1e-290
                size = np.maximum(size, np.max(np.abs(V[at - L + 1 : at + 1]), axis=0) * T2)
                q, rate, last_w = q / size, rate / size, last_w / size
                Q[at - L + 1 : at + 1] /= size
                V[at - L + 1 : at + 1] /= size
                log += np.log(size)
                if k < steps // 2:
                    half = log.copy()
        return log - half

    def _functional_values(self, rows: dict[str, Array], Q: Array, V: Array, rate: Array, w: Array) -> Array:
        """Return the three functionals of the state, (3, adversaries, cases)."""
        sums = np.einsum("rlc,lkc->rkc", rows["q"], Q) + np.einsum("rlc,lkc->rkc", rows["v"], V)
        return sums + rows["rate"][:, None] * rate + rows["w"][:, None] * w

    def _pair_directions(self, rates: Array) -> tuple[Array, Array]:
        """`lean` of each case at its own rate."""
        found = [
            worst_pair_direction(case, rate, case.max_slope / 2) for case, rate in zip(self.cases, rates, strict=True)
        ]
        return np.array([share for share, _ in found]), np.array([phase for _, phase in found])

    def _acceleration(
        self,
        kind: str,
        i: int,
        moment: float,
        reach: float,
        outputs: tuple[Array, Array],
        pulls: dict[str, Array],
        rates: dict[str, Array],
        leans: dict[str, tuple[Array, Array]],
    ) -> Array:
        """Return the acceleration that one adversary makes of (v, η q): at most the radius times the norm of both."""
        v, q = outputs
        if kind.startswith("rotate"):
            share, phase = leans[kind]
            mismatch = np.cos(share) * np.exp(2j * rates[kind] * moment) * v.conj()
            return self.radius * (mismatch + np.sin(share) * np.exp(1j * phase) * q)
        if kind == "switch":
            share, sign = leans["rotate"][0], np.sign(np.sin(rates["rotate"] * moment + 0.1))
            return self.radius * sign * (np.cos(share) * v + np.sin(share) * q)
        if kind == "random":
            one, turn = self.rng.uniform(-1, 1, len(v)), np.exp(2j * self.rng.uniform(0, np.pi, len(v)))
            mismatch = (1 + one) / 2 * v + (1 - one) / 2 * turn * v.conj()
            share = np.where(self.weight > 0, self.rng.uniform(0, np.pi / 2, len(v)), 0.0)
            spring = np.exp(1j * self.rng.uniform(0, 2 * np.pi, len(v))) * q
            return self.radius * (np.cos(share) * mismatch + np.sin(share) * spring)
        pull = pulls["greedy output" if kind == "greedy output" else "greedy"][:, i]
        goal, size = reach * pull[0] + pull[1], np.hypot(np.abs(v), np.abs(q))
        if kind == "bang":
            along = (np.where((goal.conj() * one).real >= 0, 1.0, -1.0) * np.abs(one) * one for one in (v, q))
            return self.radius * sum(along) / np.maximum(size, 1e-300)
        # a reflection takes v to any direction, and a rotation q
        return self.radius * size * goal / np.maximum(np.abs(goal), 1e-300)

    def _slope_is_on(
        self,
        kind: str,
        i: int,
        k: int,
        q: Array,
        rate: Array,
        pulls: dict[str, Array],
        rates: dict[str, Array],
        aside: Array,
    ) -> Array:
        """Whether the slope is at its largest, else it is zero."""
        if kind == "pulse at the peak":
            return np.sin(2 * self.turn * k + aside) > 0
        if kind == "pulse":
            return np.sin(rates["pulse"] * k + aside) > 0
        if kind == "returning":
            return (q[i].conj() * rate[i]).real < 0
        if kind == "phase":
            beside = np.cos(aside) * q[i] + np.sin(aside) * rate[i] / np.maximum(self.turn, 1e-6)
            return (q[i].conj() * beside).real > 0
        # in the loop with half the slope, more of it adds −k/2 q along W and less of it k/2 q
        return (pulls[kind][2, i].conj() * q[i]).real < 0
