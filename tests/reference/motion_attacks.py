"""Motions that try to make a loop grow: an oracle for certificates that speak of a robot however it moves.

Each attack is a periodic motion inside a workspace, within its speeds and accelerations, with one robot of several. The
robot is linearised about it once per period and the loop, joint by joint, is stepped through several turns of the
motion. An evolution breeds the motions whose loops grow fastest.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from tarc.analysis.linearise import Channel
from tarc.analysis.workspace import Workspace
from tarc.core.types import Array
from tarc.plants.base import Plant

BATCH = 32
"""Attacks that are simulated together."""
MIN_PERIODS = 2500
"""Shortest simulation [control periods]; the growth is that of its second half."""
MAX_LINEARISED = 400
"""Largest number of linearised robots per turn in a search; what grows there is tried again with one each period."""
PERIODS = (40, 2000)
"""Shortest and longest turn [control periods]."""
HARMONICS = 4
"""Largest number of oscillations of a joint per turn."""
FRESH_SHARE = 0.25
"""Share of each generation that is drawn anew."""
ELITE = 12
"""Motions that are bred from."""
TOLERANCE = 1e-3
"""Growth [1/s] that rounding and the end of a transient may show."""


class Motion(NamedTuple):
    """A periodic motion q_i(t) = centre_i + share_i · largest amplitude · sin(2π h_i t/turn + phase_i) of one robot."""

    plant: int
    turn: int
    centre: Array
    share: Array
    harmonics: Array
    phase: Array


@dataclass
class Attacks:
    """What attacks on a loop found.

    Attributes
    ----------
    count
        Attacks that were made.
    growth
        Fastest growth of an error [1/s]; negative for a loop that always decays.
    worst
        The motion of it.
    broken
        Number of attacks under which the error grew.
    """

    count: int = 0
    growth: float = -np.inf
    worst: Motion | None = None
    broken: int = 0
    elite: list[tuple[float, Motion]] = field(default_factory=list)


@dataclass(frozen=True)
class MotionAttacker:
    """Attacks on the loop of each joint, v_i from q_i in coordinates with τ = M̂ v, about motions of a robot.

    Parameters
    ----------
    channel
        The loop of one joint, which all joints have.
    nominal
        M̂, shape (n, n).
    plants
        The robots, of which one is held during an attack.
    workspace
        Postures, speeds and accelerations.
    starts
        Postures to try first.
    """

    channel: Channel
    nominal: Array
    plants: Sequence[Plant]
    workspace: Workspace
    starts: Sequence[Array] = ()

    def attack(
        self, count: int, seed: int = 0, *, until_broken: bool = False, done: Callable[[int], object] = lambda n: None
    ) -> Attacks:
        """Return the result of at least that many attacks."""
        rng, found = np.random.default_rng(seed), Attacks()
        first = [self._resting(posture, k) for posture in self.starts for k in range(len(self.plants))]
        while found.count < count:
            motions = first[:BATCH] if first else self._generation(found, rng)
            del first[:BATCH]
            growth = self.growth(motions, rng)
            for i in np.argsort(-growth):
                if growth[i] <= TOLERANCE:
                    break
                growth[i] = self.confirmed_growth(motions[i], rng)
                if until_broken and growth[i] > TOLERANCE:
                    break
            found.count += len(motions)
            found.broken += int(np.sum(growth > TOLERANCE))
            found.elite = sorted([*found.elite, *zip(growth.tolist(), motions, strict=True)], key=lambda one: -one[0])
            del found.elite[ELITE:]
            found.growth, found.worst = found.elite[0]
            done(len(motions))
            if until_broken and found.broken:
                break
        return found

    def growth(self, motions: Sequence[Motion], rng: np.random.Generator) -> Array:
        """Return the growth of a random error in each motion [1/s]."""
        growth = np.empty(len(motions))
        groups: dict[tuple[int, int], list[int]] = {}
        for i, motion in enumerate(motions):
            groups.setdefault((motion.plant, motion.turn), []).append(i)
        for (plant, turn), places in groups.items():
            stride = -(-turn // MAX_LINEARISED)
            maps = self._maps(self.plants[plant], [motions[i] for i in places], stride)
            growth[places] = self._grow(maps, turn, rng, MIN_PERIODS)
        return growth

    def confirmed_growth(self, motion: Motion, rng: np.random.Generator) -> float:
        """Return the growth with the robot linearised in each control period, over a time four times as long."""
        maps = self._maps(self.plants[motion.plant], [motion], 1)
        return float(self._grow(maps, motion.turn, rng, 4 * MIN_PERIODS)[0])

    def _resting(self, posture: Array, plant: int) -> Motion:
        n = len(self.nominal)
        return Motion(plant, PERIODS[0], np.asarray(posture, dtype=float), np.zeros(n), np.ones(n), np.zeros(n))

    def _generation(self, found: Attacks, rng: np.random.Generator) -> list[Motion]:
        """Return new motions: drawn, and bred from the best; all of a batch take one of four turns, to be fast."""
        turns = np.exp(rng.uniform(*np.log(PERIODS), size=2)).astype(int).tolist()
        turns += [motion.turn for _, motion in found.elite[:2]]
        motions = []
        for _ in range(BATCH):
            turn = int(rng.choice(turns))
            if not found.elite or rng.random() < FRESH_SHARE:
                motions.append(self._drawn(turn, rng))
            else:
                motions.append(self._bred(found.elite[rng.integers(len(found.elite))][1], turn, rng))
        return motions

    def _drawn(self, turn: int, rng: np.random.Generator) -> Motion:
        n = len(self.nominal)
        low, high = self._box()
        share = rng.random(n) ** 0.5 * (rng.random(n) < 0.8)
        return Motion(
            int(rng.integers(len(self.plants))),
            turn,
            rng.uniform(low, high),
            share,
            rng.integers(1, HARMONICS + 1, n).astype(float),
            rng.uniform(0, 2 * np.pi, n),
        )

    def _bred(self, parent: Motion, turn: int, rng: np.random.Generator) -> Motion:
        n, width = len(self.nominal), float(np.exp(rng.uniform(np.log(0.01), np.log(0.5))))
        low, high = self._box()
        mask = rng.random(n) < 0.6
        harmonics = np.where(rng.random(n) < 0.1, rng.integers(1, HARMONICS + 1, n), parent.harmonics)
        return Motion(
            parent.plant if rng.random() < 0.9 else int(rng.integers(len(self.plants))),
            turn,
            np.clip(parent.centre + mask * width * (high - low) * rng.standard_normal(n) / 3, low, high),
            np.clip(parent.share + mask * width * rng.standard_normal(n), 0.0, 1.0),
            harmonics.astype(float),
            parent.phase + mask * width * 2 * np.pi * rng.standard_normal(n),
        )

    def _box(self) -> tuple[Array, Array]:
        return self.workspace.low, self.workspace.high

    def states(self, motion: Motion) -> tuple[Array, Array, Array]:
        """Return positions, velocities and accelerations at the middle of each control period of a turn, (n, turn)."""
        T, (low, high) = self.channel.period, self._box()
        rate = 2 * np.pi * motion.harmonics / (motion.turn * T)
        amplitude = np.zeros(len(rate))
        if self.workspace.speed is not None and self.workspace.acceleration is not None:
            amplitude = np.minimum(self.workspace.speed / rate, self.workspace.acceleration / rate**2)
        amplitude = motion.share * np.minimum(amplitude, (high - low) / 2)
        centre = np.clip(motion.centre, low + amplitude, high - amplitude)
        angle = rate[:, None] * T * (np.arange(motion.turn) + 0.5) + motion.phase[:, None]
        sine, cosine = np.sin(angle), np.cos(angle)
        rate, amplitude = rate[:, None], amplitude[:, None]
        return centre[:, None] + amplitude * sine, amplitude * rate * cosine, -amplitude * rate**2 * sine

    def _maps(self, plant: Plant, motions: Sequence[Motion], stride: int) -> Array:
        """Return M⁻¹[M̂, −G, −D] for every few periods of each motion, shape (periods, k, n, 3n)."""
        states = [[part[:, stride // 2 :: stride] for part in self.states(motion)] for motion in motions]
        q, v, a = (np.concatenate(parts, axis=1) for parts in zip(*states, strict=True))
        M, D, G = plant.linearised_at(q, v, a)
        maps = np.linalg.solve(M, np.concatenate([np.broadcast_to(self.nominal, M.shape), -G, -D], axis=2))
        return np.ascontiguousarray(maps.reshape(len(motions), -1, *maps.shape[1:]).swapaxes(0, 1))

    def _grow(self, maps: Array, turn: int, rng: np.random.Generator, least: int) -> Array:
        """Return the growth [1/s] over the later half of whole turns."""
        loop, T = self.channel, self.channel.period
        count, k, n, _ = maps.shape
        turns = max(2, 2 * -(-least // (2 * turn)))
        C, D, F, G = loop.C[0], loop.D.item(), loop.F, loop.G[:, 0]
        places = np.minimum(np.arange(turn) * count // turn, count - 1)
        y, dy = rng.standard_normal((2, k, n))
        dy *= 1e-2 / T
        x, log = np.zeros((len(F), k * n)), np.zeros(k)
        for i in range(turns):
            for place in places:
                step = maps[place]
                v = (C @ x).reshape(k, n) + D * y
                x = F @ x + G[:, None] * y.reshape(-1)
                a = (step @ np.concatenate([v, y, dy], axis=1)[:, :, None])[:, :, 0]
                jerk = (step[:, :, n:] @ np.concatenate([dy, a], axis=1)[:, :, None])[:, :, 0]
                y = y + T * dy + T**2 / 2 * a + T**3 / 6 * jerk
                dy = dy + T * a + T**2 / 2 * jerk
            # what is in the memory of the law counts as far as it shows in the position
            size = np.sqrt(np.sum(y**2 + (10 * T * dy) ** 2, axis=1)) + 1e-300
            log += np.log(size) if i >= turns // 2 else 0.0
            y, dy = y / size[:, None], dy / size[:, None]
            x = (x.reshape(len(F), k, n) / size[:, None]).reshape(len(F), k * n)
        return log / (turns // 2 * turn * T)
