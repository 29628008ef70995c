"""The tracking error that the linear loop predicts along a reference."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tarc.analysis.linearise import Channel, decoupled_channels
from tarc.core import validation as check
from tarc.core.types import Array
from tarc.design.noise import measurement_deviation
from tarc.laws.base import ControlInput
from tarc.laws.nominal_inertia import ModelTerms, NominalInertia
from tarc.laws.pole_placement import PolePlacement
from tarc.laws.tarc import TARC
from tarc.laws.tde import TDE
from tarc.numerics.norms import h2_norm
from tarc.plants.base import Plant
from tarc.plants.symbolic import SymbolicPlant
from tarc.signals.references import Reference
from tarc.signals.sensors import Encoder

SMALL_ERROR = 1e-9
"""Error [rad or m] at which the slope of a robust term is taken."""

SETTLING_TIMES = 10.0
"""Time at rest before the reference starts, in 1/ωn of the slowest joint."""
MAX_SETTLING = 5000
"""Largest number of periods at rest before the reference starts."""


class PredictedError(NamedTuple):
    """Error that the linear loop predicts.

    Attributes
    ----------
    error
        q − qᵈ without noise at each period, shape (n, k) [rad or m].
    noise
        RMS error that the noise of the encoders causes, shape (n,) [rad or m].
    period
        T [s].
    """

    error: Array
    noise: Array
    period: float

    def rms(self, start_time: float = 0.0) -> Array:
        """Return the RMS error of each joint after a start time [s], with noise, shape (n,) [rad or m]."""
        first = int(np.ceil(start_time / self.period - 1e-9))
        return np.sqrt(np.mean(self.error[:, first:] ** 2, axis=1) + self.noise**2)


def predict_error(
    law: PolePlacement,
    plants: Sequence[Plant],
    reference: Reference,
    duration: float,
    *,
    sensor: Encoder | None = None,
    computation_delay: int = 0,
    mean_ratio: float = 1.0,
) -> PredictedError:
    """Predict the tracking error by the law's linear loop along a reference, with the model of the robot there.

    The robot's equation on the reference, with M and N in the middle of each period, closes the linearised loop:

        q̈ = M(qᵈ)⁻¹M̂ v − M(qᵈ)⁻¹N(qᵈ, q̇ᵈ),     y⁺ = A y + B q̈ + W w,     v = C y + V w,
        w = q̈ᵈ + K1 qᵈ + K2 q̇ᵈ

    in the terms of `tarc.analysis.linearise.Channel`, opened at its ratio. TARC's robust term counts at its largest
    gain in the boundary layer, so that K1 is K1 + α ĉ P2/ε. The error of noise is that of white noise at one ratio.

    With M̂(q) of a model, M̂ is that at qᵈ, and ĥ(qᵈ, q̇ᵈ) is taken from N. Feed-forward adds M(qᵈ)⁻¹f to the
    acceleration, and with its own window w has the estimates of q̈ᵈ and q̇ᵈ.

    Parameters
    ----------
    law
        A law with an inertia M̂ or M̂(q), in units of torque.
    plants
        The robot from the start on; with several the duration is shared equally, in their order.
    reference
        The motion.
    duration
        Of the motion [s].
    sensor
        The encoders, for their noise; None for none.
    computation_delay
        Periods between a measurement and its torque.
    mean_ratio
        Inertia ratio ρ at which the noise is computed.

    Raises
    ------
    NotLinearisable, UnsupportedLaw
        As `tarc.analysis.linearise.decoupled_channels`.
    """
    gain = law.max_gain if isinstance(law, TARC) and law.max_gain is not None else 0.0
    channels = decoupled_channels(law, computation_delay, gain)
    n_periods = max(int(np.ceil(check.number("duration", duration, 0, strict=True) / law.period - 1e-9)), 1)
    times = law.period * np.arange(n_periods)
    ratios, load = _equation_along(law, plants, reference, times + law.period / 2)
    q, v, a = reference.sample(times)
    v, a = _fed_back(law, reference, times, v, a)
    command = a + (law.K1 + _robust_stiffness(law, gain)) @ q + law.K2 @ v
    at_rest = (law.K1 + _robust_stiffness(law, gain)) @ q[:, 0]
    zero = np.zeros((law.n_joints, 1))
    held = plants[0].gravity_torque(q[:, 0]) - _known_torque(law, q[:, :1], zero, zero)[1][0]
    rest_load = -np.linalg.solve(plants[0].inertia(q[:, 0]), held)
    loops = [_OpenLoop(channel) for channel in channels]
    slowest = float(np.sqrt(np.min(np.linalg.eigvals(law.K1).real)))
    n_settling = min(int(np.ceil(SETTLING_TIMES / (slowest * law.period))), MAX_SETTLING)
    error = np.empty((law.n_joints, n_periods))
    for _ in range(n_settling):
        _step(loops, ratios[0], rest_load, at_rest)
    for k in range(n_periods):
        for loop in loops:
            error[loop.joints, k] = loop.position - q[loop.joints, k]
        _step(loops, ratios[k], load[k], command[:, k])
    noise = np.zeros(law.n_joints)
    if sensor is not None:
        sigma = measurement_deviation(sensor, law.n_joints)
        for channel in channels:
            noise[list(channel.joints)] = _noise_gain(channel, mean_ratio) * sigma[list(channel.joints)]
    return PredictedError(error, noise, law.period)


def _robust_stiffness(law: PolePlacement, gain: float) -> Array:
    """Return what the robust term adds to K1 near zero error, shape (n, n): α ĉ P2/ε for TARC."""
    if isinstance(law, TDE) and not isinstance(law, TARC) and law.robust_slope_bound > 0:
        return _robust_slope(law)
    if not isinstance(law, TARC):
        return np.zeros((law.n_joints, law.n_joints))
    return law.gain_factor * gain / law.boundary_layer * law.P2


def _robust_slope(law: TDE) -> Array:
    """Return −∂Δu/∂e1 at rest by a small difference, shape (n, n)."""
    zero = np.zeros(law.n_joints)
    _, estimate = law.estimator.step(law.estimator.init(zero), zero)
    columns = []
    for error in SMALL_ERROR * np.eye(law.n_joints):
        tracking = ControlInput(estimate, error, zero, zero, zero, np.zeros(()), zero, zero, np.ones(()))
        columns.append(-law.robust(law.robust_init(), tracking)[1] / SMALL_ERROR)
    return np.column_stack(columns)


class _OpenLoop:
    """The loop of some joints, opened at its inertia ratio, and its state."""

    def __init__(self, channel: Channel):
        self.joints = list(channel.joints)
        self.A, self.B, self.C, self.W, self.V = channel.closed_loop(0.0)
        self.n_coupled = channel.n_coupled
        self.state = np.zeros((len(self.A), len(self.joints) // channel.n_coupled))

    @property
    def position(self) -> Array:
        """Return the positions of its joints."""
        return self.state[: self.n_coupled].ravel()

    def auxiliary_input(self, command: Array) -> Array:
        """Return v of its joints."""
        return (self.C @ self.state + self.V @ self._columns(command)).ravel()

    def step(self, acceleration: Array, command: Array) -> None:
        """Hold an acceleration for a period."""
        self.state = self.A @ self.state + self.B @ self._columns(acceleration) + self.W @ self._columns(command)

    def _columns(self, of_joints: Array) -> Array:
        return of_joints[self.joints].reshape(self.n_coupled, -1)


def _step(loops: Sequence[_OpenLoop], ratio: Array, load: Array, command: Array) -> None:
    """Run one period of all loops, which the matrix M⁻¹M̂ couples."""
    v = np.empty(len(load))
    for loop in loops:
        v[loop.joints] = loop.auxiliary_input(command)
    acceleration = ratio @ v + load
    for loop in loops:
        loop.step(acceleration, command)


def _equation_along(
    law: PolePlacement, plants: Sequence[Plant], reference: Reference, times: Array
) -> tuple[Array, Array]:
    """Return M⁻¹M̂ (k, n, n) and −M⁻¹N (k, n) on the reference, with dry friction where the plant states it."""
    n = law.n_joints
    ratios, loads = np.empty((len(times), n, n)), np.empty((len(times), n))
    for plant, part in zip(plants, np.array_split(np.arange(len(times)), len(plants)), strict=True):
        q, v, _ = reference.sample(times[part])
        if isinstance(plant, SymbolicPlant):
            M = plant.inertia_matrices(q)
            N = plant.evaluate("bias", q, v).reshape(n, -1).T
        else:
            M = np.array([plant.inertia(posture) for posture in q.T])
            N = np.array([plant.bias(*motion) for motion in zip(q.T, v.T, strict=True)])
            N += np.sign(v.T) * plant.parameters.get("coulomb", 0.0)
        nominal, known = _known_torque(law, *reference.sample(times[part] - law.period / 2))  # held over the period
        N = N - known
        ratios[part] = np.linalg.solve(M, np.broadcast_to(nominal, M.shape))
        loads[part] = -np.linalg.solve(M, N[:, :, None])[:, :, 0]
    return ratios, loads


def _known_torque(law: PolePlacement, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
    """Return M̂ on the reference, (n, n) or (k, n, n), and the torque ĥ + f of the law's models (k, n)."""
    inertia, forward, total = law.inertia, law.feedforward if isinstance(law, TDE) else None, np.zeros(q.T.shape)
    nominal = law.M if not isinstance(inertia, NominalInertia) else inertia.fraction * inertia.robot.inertia_matrices(q)
    if isinstance(inertia, NominalInertia):
        total = total + _forces_along(inertia, q, v)
    if forward is not None:
        total = total + _forces_along(forward, q, v)
        if forward.inertia:
            rest = forward.robot.inertia_matrices(q) - (0 if forward.same_window else nominal)
            total = total + (rest @ a.T[:, :, None])[:, :, 0]
    return nominal, total


def _forces_along(terms: ModelTerms, q: Array, v: Array) -> Array:
    """Return the torque of a model's terms at k columns, shape (k, n)."""
    if q.shape[1] == 1:
        return np.asarray(terms.forces(q[:, 0], v[:, 0]))[None]
    return np.asarray(terms.forces(q, v)).T


def _fed_back(law: PolePlacement, reference: Reference, times: Array, v: Array, a: Array) -> tuple[Array, Array]:
    """Return q̇ᵈ and q̈ᵈ of the feedback: those of the law's estimator where the law takes them."""
    if not isinstance(law, TDE) or law.feedforward is None or not law.feedforward.same_window:
        return v, a
    past = reference.sample(np.array([times[0]]))[0][:, 0]
    state, estimates = law.estimator.init(past), []
    for q in reference.sample(times)[0].T:
        state, estimate = law.estimator.step(state, q)
        estimates.append((estimate.velocity, estimate.acceleration))
    velocity, acceleration = np.array(estimates, dtype=float).transpose(1, 2, 0)
    return velocity, acceleration


def _noise_gain(channel: Channel, ratio: float) -> float:
    """Return the RMS position error over that of white measurement noise; infinite for an unstable loop."""
    A, B, *_ = channel.closed_loop(ratio)
    n = channel.n_coupled
    noise_input = ratio * B @ channel.D
    noise_input[2 * n :] += channel.G
    return h2_norm(A, noise_input, np.eye(1, len(A)), np.zeros((1, n)))
