"""What a robot, a reference and a law with M̂(q) do in a tube of states about the reference.

Along the reference the law holds c* = M̂(qᵈ)⁻¹ (τ* − ĥ(qᵈ, q̇ᵈ) − f), with τ* = M(qᵈ) q̈ᵈ + N(qᵈ, q̇ᵈ). With c its command,
e = q − qᵈ, w = c − c* and q̂ the measured position, exactly

    M(q) ë = M̂(q̂) w + K̃ (e + n) − G̃ e − D̃ ė − (τ*(t) − τ*(t_k)),     K̃ = mean of ∂(M̂(p) c* + ĥ(p, q̇ᵈ))/∂p

between qᵈ and q̂ at the sample t_k. G̃ and D̃ are as for a constant M̂. They act at the same share s of the line from the
reference, so that the difference of K and G at one share counts. Norms are in coordinates M̂(q̂)^½ q.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import casadi as ca
import numpy as np

from tarc.analysis.tube import LEAD_FACTORS, STEPS_PER_PERIOD, TubeBounds, torques_along
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.laws.nominal_inertia import NominalInertia
from tarc.laws.tde import TDE
from tarc.numerics.local_search import local_maximum
from tarc.plants.base import Plant
from tarc.plants.symbolic import SymbolicPlant
from tarc.signals.references import Reference

LAG_SHARE = 0.5
"""Part of the lead time θ that what q changes since the sample counts as."""
N_STARTS = 3
"""Number of samples from which a local search starts."""
UNIT_STEP = 1e-5
"""Step of differences on the unit cube."""
MAX_JOINTS = 8
"""Largest number of joints, of which all combinations of signs are tried."""

Values = Callable[["TubeStates"], Array]
"""A function of k states of a tube to one number each, (k,)."""


@dataclass(frozen=True, eq=False)
class TubeStates:
    """States of a tube at k instants, each array (n, k) but the times and the shares (k,).

    Attributes
    ----------
    time, sample_time
        t, and the time of the sample before it [s].
    share
        s, place on the line from the reference to the robot.
    error, error_rate
        e and ė.
    shift, own_shift
        q̂ − q at the sample, and how far the place on the line at the sample may be from that at t.
    """

    time: Array
    sample_time: Array
    share: Array
    error: Array
    error_rate: Array
    shift: Array
    own_shift: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownTubeBounds:
    """Largest values that were found in a tube.

    Attributes
    ----------
    robot
        As for a constant M̂; the lead times include what q changes since the sample.
    nominal_rate
        Largest relative rate of M̂(q̂) [1/s], noise included.
    own_stiffness
        Largest ‖M̂^−½ K M̂^−½‖ of the law [1/s²].
    noise, residual, change, held, friction
        Norms of the error of measurement, of r, of the change of c* in a period, of that of τ*, and of friction.
    disturbance, disturbance_change
        Norms of the largest disturbing torque, and of its change in a period.
    start_torque
        ‖M̂^½ (c − c*)‖ of a robot that is held at the start of the reference, and what noise adds.
    start_velocity
        ‖M̂^½ q̇ᵈ‖ at the start.
    """

    robot: TubeBounds
    nominal_rate: float
    own_stiffness: float
    noise: float
    residual: float
    change: float
    held: float
    friction: float
    disturbance: float
    disturbance_change: float
    start_torque: float
    start_velocity: float


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownTube:
    """A box of errors about a reference, for a law with M̂(q) and the robots that it may drive.

    Parameters
    ----------
    law, plants, reference, duration
        The law, the robot or several, the motion and its duration [s].
    error, error_rate
        Largest |e_i| and |ė_i|, each (n,).
    noise
        Largest error of measurement of each joint, (n,).
    samples, seed
        Number of sampled states, and the seed.
    """

    law: TDE
    plants: Sequence[Plant]
    reference: Reference
    duration: float
    error: Array
    error_rate: Array
    noise: Array
    samples: int
    seed: int

    def __post_init__(self) -> None:
        if self.law.n_joints > MAX_JOINTS:
            raise InvalidParameter(
                f"law: it has M̂(q) and {self.law.n_joints} joints; the region of such a law needs at most {MAX_JOINTS}"
            )

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.law.n_joints

    @cached_property
    def corners(self) -> Array:
        """All combinations of signs, (2^n, n)."""
        return np.array(list(product((-1.0, 1.0), repeat=self.n)))

    @cached_property
    def _speed(self) -> Array:
        """Largest speed of each joint along the reference, (n,)."""
        return np.abs(self.reference.sample(self._steps(1))[1]).max(axis=1)

    def _steps(self, per_period: int) -> Array:
        step = self.law.period / per_period
        return np.arange(round(self.duration / step) + 1) * step

    def states(self, units: Array) -> TubeStates:
        """Return the states at points of the unit cube, (k, 4 n + 3)."""
        n, T = self.n, self.law.period
        time = units[:, 0] * self.duration
        signed = (2 * units[:, 3:] - 1).T
        moved = T * (self._speed + self.error_rate) + self.noise
        return TubeStates(
            time=time,
            sample_time=np.maximum(time - T * units[:, 1], 0.0),
            share=units[:, 2],
            error=self.error[:, None] * signed[:n],
            error_rate=self.error_rate[:, None] * signed[n : 2 * n],
            shift=moved[:, None] * signed[2 * n : 3 * n],
            own_shift=moved[:, None] * signed[3 * n :],
        )

    @cached_property
    def units(self) -> Array:
        """Points of the unit cube: half of them at corners in the errors, rates and shifts."""
        rng = np.random.default_rng(self.seed)
        units = rng.random((self.samples, 4 * self.n + 3))
        half = self.samples // 2
        units[:half, 3:] = np.round(units[:half, 3:])
        return units

    def largest(self, values: Values) -> float:
        """Return the largest value of samples and of local searches from the best."""
        sampled = values(self.states(self.units))
        best, scale = float(sampled.max()), max(float(np.abs(sampled).max()), 1e-12)
        size = self.units.shape[1]

        def value_and_gradient(point: Array) -> tuple[float, Array]:
            steps = UNIT_STEP * np.eye(size)
            found = values(self.states(np.clip([point, *(point + steps), *(point - steps)], 0, 1)))
            return float(found[0]), (found[1 : size + 1] - found[size + 1 :]) / (2 * UNIT_STEP)

        for start in self.units[np.argsort(sampled)[::-1][:N_STARTS]]:
            value, _ = local_maximum(value_and_gradient, start, scale=scale, tolerance=1e-6, max_iterations=40)
            best = max(best, value)
        return best

    def nominal(self, positions: Array) -> Array:
        """Return M̂ at k positions (n, k), shape (k, n, n)."""
        inertia = self.law.inertia
        assert isinstance(inertia, NominalInertia)
        return inertia.fraction * inertia.robot.inertia_matrices(positions)

    def positions(self, states: TubeStates) -> tuple[Array, Array]:
        """Return q and q̂ of states, each (n, k)."""
        position = self.reference.sample(states.time)[0] + states.error
        return position, position + states.shift

    def roots(self, states: TubeStates) -> tuple[Array, Array]:
        """Return M̂^½ and M̂^−½ at q̂, each (k, n, n)."""
        return roots(self.nominal(self.positions(states)[1]))

    def units_of_joints(self) -> Array:
        """Return the largest √(M̂⁻¹)_ii in the tube, shape (n,)."""
        found = [
            self.largest(lambda states, i=i: np.linalg.inv(self.nominal(self.positions(states)[1]))[:, i, i])
            for i in range(self.n)
        ]
        return np.sqrt(found)

    def bounds(self, torque_rate: Array, max_torque: Array, friction: Array, residuals: Array) -> KnownTubeBounds:
        """Return the largest values of the tube.

        Parameters
        ----------
        torque_rate, max_torque
            Largest rate of a disturbing torque, and its largest size, each (n,).
        friction
            Largest torque that may change at any time, (n,).
        residuals
            r at each period, (n, k).
        """
        T = self.law.period

        def scaled(limits: Array, place: int) -> Values:
            columns = (self.corners * limits).T
            return lambda states: np.linalg.norm(self.roots(states)[place] @ columns, axis=1).max(axis=1)

        def ratio(sign: int) -> float:
            return max(self.largest(lambda states, p=robot: self._ratios(p, states, sign)) for robot in self._robots)

        least, most = -ratio(-1), ratio(1)
        forces = [_Forces(self, plant) for plant in self.plants]
        stiffness, damping, own = (max(self.largest(part) for part in parts) for parts in zip(*forces, strict=True))
        theta = [factor * max(min(damping / max(stiffness, 1e-9), 1.0), 1e-3) for factor in LEAD_FACTORS]
        together = [
            max(self.largest(lambda states, f=f, t=t: f.norms(states, t, LAG_SHARE * t / T)) for f in forces)
            for t in theta
        ]
        slopes = zip(self._robots, self._robot_slopes, strict=True)
        relative = max(self.largest(lambda states, p=pair: self._rates(p, states)) for pair in slopes)
        start_torque, rest_stiffness, start_velocity = self._start()
        return KnownTubeBounds(
            robot=TubeBounds(
                min_ratio=least,
                max_ratio=most,
                rate=relative / least,
                relative_rate=relative,
                lead_times=np.hypot(1.0, LAG_SHARE) * np.array(theta),
                stiffness=np.array(together),
                rest_stiffness=rest_stiffness,
            ),
            nominal_rate=self.largest(lambda states: self._rates(None, states)),
            own_stiffness=own,
            noise=self.largest(scaled(self.noise, 0)),
            residual=self._along(residuals, 0),
            change=max(self._along(np.diff(self.command(plant, self._steps(1)), axis=1), 0) for plant in self.plants),
            held=max(self._held(plant) for plant in self.plants),
            friction=self.largest(scaled(friction, 1)) if np.any(friction) else 0.0,
            disturbance=self.largest(scaled(max_torque, 1)) if np.any(max_torque) else 0.0,
            disturbance_change=self.largest(scaled(T * torque_rate, 1)) if np.any(torque_rate) else 0.0,
            start_torque=start_torque,
            start_velocity=start_velocity,
        )

    def command(self, plant: Plant, times: Array) -> Array:
        """Return c* of a robot at k times, (n, k)."""
        q, v, a = self.reference.sample(times)
        M, known = self._along_reference(q, v, a)
        torque = torques_along(plant, q, v, a) - known
        return np.linalg.solve(M, torque.T[:, :, None])[:, :, 0].T

    def _along_reference(self, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
        """Return M̂ (k, n, n) and ĥ + f (n, k) on the reference."""
        return self.nominal(q), np.array(self._functions["known"](q, q, v, a))

    @cached_property
    def _functions(self) -> dict[str, ca.Function]:
        """Functions of the law: ĥ + f, its stiffness at a command, and the slopes of M̂."""
        p, r, v, a, c = (ca.SX.sym(name, self.n) for name in ("p", "r", "v", "a", "c"))
        inertia, known = self.law.model_terms(p, r, v, a)
        own = ca.jacobian(inertia @ c + known, p)
        return {
            "known": ca.Function("known", [p, r, v, a], [ca.densify(known)]),
            "own": ca.Function("own", [p, r, v, a, c], [ca.densify(own)]),
            "slopes": ca.Function("slopes", [p], [ca.densify(ca.jacobian(ca.vec(inertia), p))]),
        }

    @cached_property
    def _robots(self) -> list[SymbolicPlant]:
        """The robots, in symbols."""
        robots = [plant for plant in self.plants if isinstance(plant, SymbolicPlant)]
        for plant in self.plants:
            if plant not in robots:
                raise InvalidParameter(f"plant: got {plant.label}; the region of a law with M̂(q) needs it in symbols")
        return robots

    @cached_property
    def _robot_slopes(self) -> list[ca.Function]:
        """Functions of q for ∂M/∂q of the robots."""
        q = ca.SX.sym("q", self.n)
        slopes = [ca.jacobian(ca.vec(robot.evaluate("inertia", q)), q) for robot in self._robots]
        return [ca.Function("slopes", [q], [ca.densify(part)]) for part in slopes]

    def own_stiffness(self, plant: Plant, states: TubeStates) -> Array:
        """Return K of states, (k, n, n), at the share of the line and the command of the sample."""
        q, v, a = self.reference.sample(states.sample_time)
        moved = self.reference.sample(states.time)[0] + states.share * states.error + states.own_shift
        return _stacked(self._functions["own"](moved, q, v, a, self.command(plant, states.sample_time)), self.n)

    def _ratios(self, robot: SymbolicPlant, states: TubeStates, sign: int) -> Array:
        """Return the largest eigenvalue of M(q)⁻¹M̂(q̂) for the sign 1; for −1 the smallest, negative."""
        position, measured = self.positions(states)
        inverse = roots(robot.inertia_matrices(position))[1]
        values = np.linalg.eigvalsh(inverse @ self.nominal(measured) @ inverse)
        return values[:, -1] if sign > 0 else -values[:, 0]

    def _rates(self, robot: tuple[SymbolicPlant, ca.Function] | None, states: TubeStates) -> Array:
        """Return the largest relative rate of M(q) of a robot, by its ∂M/∂q, or of M̂(q̂) with noise, (k,)."""
        position, measured = self.positions(states)
        speed = np.abs(self.reference.sample(states.time)[1]) + self.error_rate[:, None]
        if robot is None:
            slopes, inverse = self._functions["slopes"](measured), roots(self.nominal(measured))[1]
            speed = speed + 2 * self.noise[:, None] / self.law.period
        else:
            slopes, inverse = robot[1](position), roots(robot[0].inertia_matrices(position))[1]
        n, k = self.n, len(states.time)
        by_joint = np.array(slopes).reshape(n, n, n, k, order="F").transpose(3, 2, 0, 1) * speed.T[:, :, None, None]
        rates = inverse[:, None] @ by_joint @ inverse[:, None]
        corners = self.corners[: len(self.corners) // 2]
        return np.abs(np.linalg.eigvalsh(np.einsum("sj,kjab->ksab", corners, rates))).max(axis=(1, 2))

    def _along(self, columns: Array, place: int) -> float:
        """Return the largest ‖M̂^½ x‖ or ‖M̂^−½ x‖ of columns at successive periods, at corners of the tube."""
        q = self.reference.sample(np.arange(columns.shape[1]) * self.law.period)[0]
        offsets = [np.zeros(self.n), *(self.corners * (self.error + self.noise))]
        parts = [roots(self.nominal(q + offset[:, None]))[place] @ columns.T[:, :, None] for offset in offsets]
        return max(float(np.linalg.norm(part, axis=1).max()) for part in parts)

    def _held(self, plant: Plant) -> float:
        """Return the largest ‖M̂^−½ Δτ*‖ over a period, from samples at quarters of it."""
        torque = torques_along(plant, *self.reference.sample(self._steps(STEPS_PER_PERIOD)))
        steps = STEPS_PER_PERIOD * np.diff(torque, axis=1)
        return max(self._along(steps[:, place::STEPS_PER_PERIOD], 1) for place in range(STEPS_PER_PERIOD))

    def _start(self) -> tuple[float, float, float]:
        """Return the largest ‖M̂^½ (c − c*)‖ of a robot held at qᵈ, its slope over e, and ‖M̂^½ q̇ᵈ‖, at the start."""
        n = self.n
        q, measured = ca.SX.sym("q", n), ca.SX.sym("measured", n)
        inertia, known = self.law.model_terms(measured, measured, 0 * q, 0 * q)
        first, velocity, _ = self.reference.sample([0.0])

        def places(states: TubeStates) -> tuple[Array, Array, Array, Array]:
            noise = np.sign(states.shift) * self.noise[:, None]
            line = first + states.share * states.error
            return line, line + noise, *roots(self.nominal(first + states.error + noise))

        def columns(some: Array) -> float:
            return self.largest(lambda states: np.linalg.norm(places(states)[2] @ some, axis=1).max(axis=1))

        def slope(expression: ca.SX) -> float:
            function = ca.Function("slope", [q, measured], [ca.densify(expression)])

            def norms(states: TubeStates) -> Array:
                line, moved, root, inverse_root = places(states)
                return _norm(root @ _stacked(function(line, moved), n) @ inverse_root)

            return self.largest(norms)

        noise, torques, slopes = columns((self.corners * self.noise).T), [], []
        for plant in self._robots:
            smooth = {name: 0 * np.asarray(plant.parameters[name], dtype=float) for name in plant.dry_friction}
            held = plant.evaluate("bias", q, 0 * q, parameters=smooth)
            command = ca.solve(ca.densify(inertia), ca.densify(held - known))
            by_noise = ca.jacobian(command, measured)
            at_first = np.array(ca.Function("command", [q, measured], [command])(first, first))
            torques.append(columns(at_first - self.command(plant, np.zeros(1))) + slope(by_noise) * noise)
            slopes.append(slope(ca.jacobian(command, q) + by_noise))
        return max(torques), max(slopes), columns(velocity)

    def start_inertia(self) -> Array:
        """Return a matrix that is at least M̂(q̂) wherever the robot may be at the start, (n, n)."""
        first = self.reference.sample([0.0])[0]
        middle = self.nominal(first)[0]
        inverse = roots(middle[None])[1][0]

        def ratios(states: TubeStates) -> Array:
            measured = first + states.error + np.sign(states.shift) * self.noise[:, None]
            return np.linalg.eigvalsh(inverse @ self.nominal(measured) @ inverse)[:, -1]

        return self.largest(ratios) * middle


class _Forces:
    """Norms of the stiffness, damping and the law's stiffness of one robot in a tube."""

    def __init__(self, tube: KnownTube, plant: Plant):
        self._tube, self._plant = tube, plant

    def __iter__(self):
        yield lambda states: _norm(self.parts(states)[0])
        yield lambda states: _norm(self.parts(states)[1])
        yield lambda states: _norm(self.parts(states)[2])

    def parts(self, states: TubeStates) -> tuple[Array, Array, Array]:
        """Return K − G, D and K in coordinates M̂^½ q, each (k, n, n)."""
        tube = self._tube
        q, v, a = tube.reference.sample(states.time)
        place = q + states.share * states.error, v + states.share * states.error_rate, a
        _, D, G = self._plant.linearised_at(*place)
        own = tube.own_stiffness(self._plant, states)
        inverse = tube.roots(states)[1]
        return inverse @ (own - G) @ inverse, inverse @ D @ inverse, inverse @ own @ inverse

    def norms(self, states: TubeStates, lead_time: float, lag_weight: float) -> Array:
        """Return ‖[K − G, D/θ, K/φ]‖ of states, (k,)."""
        stiffness, damping, own = self.parts(states)
        return _norm(np.concatenate([stiffness, damping / lead_time, own / lag_weight], axis=2))


def roots(matrices: Array) -> tuple[Array, Array]:
    """Return the roots and inverse roots of k positive definite matrices, each (k, n, n)."""
    values, vectors = np.linalg.eigh(matrices)
    transposed = vectors.transpose(0, 2, 1)
    return (vectors * values[:, None] ** 0.5) @ transposed, (vectors * values[:, None] ** -0.5) @ transposed


def _norm(matrices: Array) -> Array:
    return np.linalg.norm(matrices, 2, axis=(1, 2))


def _stacked(columns: object, n: int) -> Array:
    """Return matrices that stand beside each other (n, k n) as (k, n, n)."""
    found = np.array(columns)
    return found.reshape(n, found.shape[1] // n, n).transpose(1, 0, 2)
