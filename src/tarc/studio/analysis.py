"""The loop of a design and its stability map, fast enough to follow a slider; pure functions of the design.

The open loop is G = G0 + K1 G1 + K2 G2 in the gains, since both enter the auxiliary input alone. So three frequency
responses hold the map of every natural frequency and damping ratio, and they change with the estimator alone.
"""

import json
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from tarc.analysis.inertia_ratio import inertia_spread
from tarc.analysis.linearise import Channel, decoupled_channels
from tarc.analysis.optimum import distance_from_optimum
from tarc.analysis.stability import CIRCLE_TOLERANCE, noise_to_torque, stable_intervals, widest_interval
from tarc.core.types import Array
from tarc.design.noise import torque_noise
from tarc.estimators.algebraic import Algebraic
from tarc.laws.tdc import TDC
from tarc.numerics.norms import h2_norm
from tarc.scenario.model import Scenario, Setup
from tarc.signals.sensors import Encoder
from tarc.studio.design_state import DesignState
from tarc.studio.results import LoopAnalysis, RobotFacts, StabilityMap
from tarc.studio.robots import Robots

MAP_FREQUENCIES = np.geomspace(2.0, 100.0, 28)
"""Natural frequencies of the map [rad/s]."""
ANGLES = np.geomspace(1e-4, np.pi, 240)
"""Angles ω T at which the loop is evaluated [rad]."""
BASE_GAINS = np.array([[1.0, 1.0], [2.0, 1.0], [1.0, 2.0]])
"""Gains over 400/s² and 40/s at which the loop is linearised."""
GAIN_UNITS = np.array([400.0, 40.0])
MAX_ROBOTS = 4
"""Robots whose parts are kept, for all sessions."""
SPREAD_SAMPLES = 300
"""Sampled postures of the robot's inertia ratios; the certificates take more."""


@dataclass(frozen=True)
class _LoopKey:
    """What the loop depends on besides the gains."""

    window: int
    degree: int
    delay: int
    synchronised: bool
    control_rate: int
    computation_delay: int

    @classmethod
    def of(cls, state: DesignState, computation_delay: int = 0) -> "_LoopKey":
        return cls(state.window, state.degree, state.delay, state.synchronised, state.control_rate, computation_delay)

    def law(self, position_gain: float, velocity_gain: float) -> TDC:
        """Return the law of one joint."""
        period = 1 / self.control_rate
        return TDC(
            inertia=1.0,
            position_gain=position_gain,
            velocity_gain=velocity_gain,
            delay=None if self.synchronised or self.delay == 1 else self.delay * period,
            synchronised=self.synchronised,
            period=period,
            estimator=Algebraic(window=self.window * period, degree=self.degree, period=period),
        )

    def channel(self, position_gain: float, velocity_gain: float) -> Channel:
        """Return the loop of one joint."""
        return decoupled_channels(self.law(position_gain, velocity_gain), self.computation_delay)[0]


@dataclass(frozen=True, eq=False)
class _AffineLoop:
    """The open loop of one joint as an affine function of K1 and K2."""

    A: Array
    B: Array
    C: Array
    response: Array

    def combine(self, parts: Array, weights: Array) -> Array:
        """Return the sum of three parts, weighted for each of k pairs of gains."""
        return np.tensordot(weights, parts, axes=1)


@lru_cache(maxsize=64)
def _affine_loop(key: _LoopKey) -> _AffineLoop:
    """Return the loop at three pairs of gains, from which those at all others follow."""
    A, B, C, responses = [], np.zeros(0), [], []
    for gains in BASE_GAINS * GAIN_UNITS:
        A_open, B, C_open = key.channel(*gains).closed_loop(0.0)[:3]
        A.append(A_open)
        C.append(C_open)
        responses.append(_response(A_open, B, C_open, ANGLES))
    return _AffineLoop(np.array(A), B, np.array(C), np.array(responses))


def _response(A: Array, B: Array, C: Array, angles: Array) -> Array:
    """Return C (zI − A)⁻¹ B on the unit circle, shape (m,)."""
    z = np.exp(1j * angles)[:, None, None]
    return (C @ np.linalg.solve(z * np.eye(len(A)) - A, B + 0j * z))[:, 0, 0]


def _weights(natural_frequencies: Array, damping_ratio: float) -> Array:
    """Return the weights of the three base loops for K1 = ωn², K2 = 2 ζ ωn, shape (k, 3); each row has the sum one."""
    gains = np.stack([natural_frequencies**2, 2 * damping_ratio * natural_frequencies], axis=1) / GAIN_UNITS
    rows = np.concatenate([BASE_GAINS.T, np.ones((1, 3))])
    return np.linalg.solve(rows, np.concatenate([gains.T, np.ones((1, len(gains)))])).T


def _crossing_ratios(response: Array) -> Array:
    """Return the ratios ρ = 1/G at which G is real and positive between the angles; nan elsewhere, shape (k, m − 1)."""
    imag, real = np.imag(response), np.real(response)
    left, right = imag[:, :-1], imag[:, 1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        part = left / (left - right)
        value = real[:, :-1] + part * (real[:, 1:] - real[:, :-1])
        return np.where((left * right < 0) & (value > 0), 1 / value, np.nan)


def stability_map(state: DesignState, computation_delay: int = 0, frequencies: Array = MAP_FREQUENCIES) -> StabilityMap:
    """Return the widest stable range of the inertia ratio over the natural frequency.

    The ends are where G(e^{jθ}) = 1/ρ is real, interpolated between the angles. Between two ends the eigenvalues tell.

    Parameters
    ----------
    state
        The design.
    computation_delay
        Periods between a measurement and its torque.
    frequencies
        Natural frequencies [rad/s], shape (k,).
    """
    loop = _affine_loop(_LoopKey.of(state, computation_delay))
    weights = _weights(frequencies, state.damping_ratio)
    crossings = _crossing_ratios(loop.combine(loop.response, weights))
    bounds = []
    for row in crossings:
        ends = np.sort(row[np.isfinite(row)])
        ends = ends[(ends > 1e-6) & (ends < 1e4)]
        bounds.append(np.concatenate([[0.0], ends, [2 * ends[-1] + 1 if ends.size else 1.0]]))
    middles = [(ends[1:] + ends[:-1]) / 2 for ends in bounds]
    owner = np.repeat(np.arange(len(middles)), [len(row) for row in middles])
    ratio = np.concatenate(middles)[:, None, None]
    closed = loop.combine(loop.A, weights)[owner] + ratio * (loop.B @ loop.combine(loop.C, weights)[owner])
    is_stable = np.abs(np.linalg.eigvals(closed)).max(axis=1) < 1 - CIRCLE_TOLERANCE
    low, high = np.full(len(bounds), np.nan), np.full(len(bounds), np.nan)
    for index, ends in enumerate(bounds):
        merged = _merge(ends, is_stable[owner == index])
        widest = widest_interval(merged)
        if widest is not None:
            low[index], high[index] = widest
    return StabilityMap(frequencies, low, high)


def _merge(ends: Array, is_stable: Array) -> list[tuple[float, float]]:
    """Return the stable ranges between neighbouring ends, with those that touch joined."""
    ranges: list[tuple[float, float]] = []
    for low, high, stable in zip(ends[:-1], ends[1:], is_stable, strict=True):
        if stable and ranges and ranges[-1][1] == low:
            ranges[-1] = ranges[-1][0], float(high)
        elif stable:
            ranges.append((float(low), float(high)))
    return ranges


def robot_facts(state: DesignState, robots: Robots) -> RobotFacts:
    """Return the inertia ratios of the robot with and without its payload, at an inertia share of one.

    Raises
    ------
    InvalidParameter, RobotFileError, ScenarioError
        For a robot or a motion that cannot be built.
    """
    content = DesignState(robot=state.robot, payload=state.payload).to_content(robots.content(state.robot))
    scenario = Scenario.parse(content)
    setup = _unloaded(json.dumps(content | {"disturbance": []}))
    events = [part.build() for part in scenario.sections.disturbances]
    workspace, plants = scenario.certified_region(replace(setup, events=events))
    mean = setup.mean_inertia.matrix
    spread = inertia_spread(plants, mean, workspace, samples=SPREAD_SAMPLES, refine=1)
    return RobotFacts(spread.min_ratio, spread.max_ratio, mean, scenario.computation_delay)


@lru_cache(maxsize=MAX_ROBOTS)
def _unloaded(content: str) -> Setup:
    """Return the parts of a scenario in JSON, so that a move of the payload does not construct them again."""
    return Scenario.parse(json.loads(content)).build()


def analyse_loop(state: DesignState, facts: RobotFacts) -> LoopAnalysis:
    """Return map, stable range, noise, loop gain and distance from the optimum of a design.

    Parameters
    ----------
    state
        The design.
    facts
        Of its robot, see `robot_facts`.
    """
    key = _LoopKey.of(state, facts.computation_delay)
    loop = _affine_loop(key)
    position_gain, velocity_gain = state.natural_frequency**2, 2 * state.damping_ratio * state.natural_frequency
    channel = key.channel(position_gain, velocity_gain)
    low, high = state.inertia_share * facts.min_ratio, state.inertia_share * facts.max_ratio
    if state.model_known:
        low = high = state.inertia_share
    ratios = low, float(np.sqrt(low * high)), high
    radii = np.abs(np.linalg.eigvals(np.array([channel.state_matrix(ratio) for ratio in ratios]))).max(axis=1)
    is_stable = [bool(radius < 1 - CIRCLE_TOLERANCE) for radius in radii]
    weights = _weights(np.array([state.natural_frequency]), state.damping_ratio)
    response = loop.combine(loop.response, weights)[0]
    gains = np.abs(response) * np.array(ratios)[:, None]
    frequencies = ANGLES * state.control_rate
    above = np.flatnonzero(gains[1] >= 1)
    stable = widest_interval(stable_intervals(key.law(position_gain, velocity_gain), channels=[channel]))
    distance = distance_from_optimum(channel, ratios[1], delay=facts.computation_delay)
    return LoopAnalysis(
        map=stability_map(state, facts.computation_delay),
        stable=stable,
        ratios=ratios,
        is_stable=(is_stable[0], is_stable[1], is_stable[2]),
        torque_noise=_torque_noise(state, facts, channel, ratios[1]),
        frequencies=frequencies,
        loop_gains=gains,
        crossover=float(frequencies[above[-1]]) if above.size else float("nan"),
        error_over_optimum=distance.ratio,
        change_over_optimum=distance.change_ratio,
    )


def _torque_noise(state: DesignState, facts: RobotFacts, channel: Channel, ratio: float) -> float:
    """Return the largest RMS torque noise of a joint by the encoder [N m or N]; infinite for an unstable loop."""
    A, B, C, D = noise_to_torque(channel, ratio)
    if np.abs(np.linalg.eigvals(A)).max() >= 1 - CIRCLE_TOLERANCE:
        return float("inf")
    shape = state.inertia_share * facts.mean_inertia
    return float(torque_noise(h2_norm(A, B, C, D), shape, Encoder(bits=state.encoder_bits)).max())
