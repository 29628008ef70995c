"""Uncertain loops whose mismatch changes no faster than a rate."""

from collections.abc import Sequence

import numpy as np

from reference.adversaries import SUBSTEPS, AdversarialLoops, Adversary
from reference.law_parameters import PERIOD
from reference.uncertain_case import UncertainCase

Array = np.ndarray


SLOW_MISMATCHES = (
    "rotate at the peak",
    "rotate at half",
    "rotate",
    "switch",
    "pump",
    "bang",
    "greedy output",
    "random",
)


def invert_map(m: Array, c: Array) -> tuple[Array, Array]:
    """m and c of the inverse of v ↦ m v + c v̄."""
    size = m**2 - np.abs(c) ** 2
    return m / size, -c / size


class SlowAdversarialLoops(AdversarialLoops):
    """Loops whose mismatch heads for where an adversary wants it, at no more than the rate of its case.

    A symmetric matrix takes v to m v + c v̄, with m real; its norm is |m| + |c|. What is kept here is E⁻¹, for which the
    ball is convex too. The stiffness, which may change at once, takes what room the mismatch leaves it.
    """

    def __init__(self, cases: Sequence[UncertainCase], adversaries: Sequence[Adversary], seed: int = 0):
        super().__init__(cases, adversaries, seed)
        self.reach = np.array([case.max_rate * PERIOD / SUBSTEPS for case in cases])
        self.stiffest = np.array([case.max_stiffness if case.stiffness_weight else 0.0 for case in cases])
        shape = len(adversaries), len(cases)
        self.m, self.c = 1 / self.centre + np.zeros(shape), np.zeros(shape, dtype=complex)
        self.goal_m, self.goal_c = np.zeros(shape), np.zeros(shape, dtype=complex)
        share = self.rng.uniform(0, np.pi / 2, len(cases))
        self.extent = self.radius * np.where(self.stiffest > 0, np.cos(share), 1.0)
        self.share = self.reach / np.abs(invert_map(self.centre, self.extent)[1])

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
        v, q = outputs[0], outputs[1] / np.where(self.weight > 0, self.weight, 1.0)
        pull = pulls["greedy output"][:, i]
        goal = reach * pull[0] + pull[1]
        along = goal / np.maximum(np.abs(goal), 1e-300)
        m, c = self._mismatch_goal(kind, i, moment, v, along, rates)
        m, c = invert_map(self.centre + m, c)
        m, c = m - self.m[i], c - self.c[i]
        share = np.minimum(1.0, self.reach / np.maximum(np.abs(m) + np.abs(c), 1e-300))
        self.m[i] += share * m
        self.c[i] += share * c
        m, c = invert_map(self.m[i], self.c[i])
        m = m - self.centre
        room = np.maximum(self.radius**2 - (np.abs(m) + np.abs(c)) ** 2, 0.0)
        spring = np.minimum(self.stiffest, self.weight * np.sqrt(room))
        towards = np.exp(1j * leans[kind][1]) * q if kind.startswith("rotate") else np.abs(q) * along
        return m * v + c * v.conj() + spring * towards

    def _needs_functional(self, kind: str) -> bool:
        return kind == "greedy output" or super()._needs_functional(kind)

    def _mismatch_goal(
        self, kind: str, i: int, moment: float, v: Array, along: Array, rates: dict[str, Array]
    ) -> tuple[Array, Array]:
        """Where the mismatch heads: m and c of E − ρ0 I."""
        none, size = np.zeros(len(v)), self.extent
        if kind.startswith("rotate"):
            return none, size * np.exp(1j * np.minimum(2 * rates[kind], self.share * SUBSTEPS) * moment)
        if kind in ("switch", "pump"):
            turn = 2 * self.peak if kind == "pump" else rates["rotate"]
            return size * np.sign(np.sin(turn * moment + 0.1)), none + 0j
        if kind == "bang":
            return size * np.where(np.real(along.conj() * v) >= 0, 1.0, -1.0), none + 0j
        if kind == "random":
            arrived = self.rng.random(len(v)) < np.minimum(1.0, self.share)
            one, turn = self.rng.uniform(-1, 1, len(v)), np.exp(2j * self.rng.uniform(0, np.pi, len(v)))
            self.goal_m[i] = np.where(arrived, size * (1 + one) / 2, self.goal_m[i])
            self.goal_c[i] = np.where(arrived, size * (1 - one) / 2 * turn, self.goal_c[i])
            return self.goal_m[i], self.goal_c[i]
        return none, size * along * v / np.maximum(np.abs(v), 1e-300)
