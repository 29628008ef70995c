"""A control loop as an environment of Gymnasium: an agent's torque on top of a law's, or alone."""

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from tarc.core.optional import require

require("gym", "tarc.runtime.LawEnvironment")

import gymnasium
from gymnasium.spaces import Box

from tarc.control.controller import Controller
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.core.validation import Numbers
from tarc.laws.base import Law
from tarc.plants.base import Plant
from tarc.runtime.sampled_plant import Motion, SampledPlant
from tarc.scenario.model import Scenario
from tarc.signals.references import Reference
from tarc.signals.sensors import Encoder, EncoderInput
from tarc.simulation.sampled_inputs import check_compatible

ACTIONS = ("residual", "torque")
RESIDUAL_SHARE = 0.2
"""Largest residual torque by default, over the limit of the torque."""
LARGEST = 1e3
"""Bound of observed rates and references, beyond which they are cut."""


class _Instant(NamedTuple):
    """What an instant adds to the episode: measured position, law's torque and velocity estimate, each (n,)."""

    measured: Array
    torque: Array
    velocity: Array


class LawEnvironment(gymnasium.Env[Array, Array]):
    """A law that tracks a reference on a robot, with an agent that adds a torque or gives it alone.

    In each period the robot is measured and the law computes its torque τ_law. The agent sees both, and its action a in
    [−1, 1] per joint is scaled by the largest torque. Robot, limits and law then get

        τ = clip(τ_law + a τ_max, −τ_limit, τ_limit)      or, for ``action="torque"``,      τ = a τ_max

    The law knows the torque that was applied, as on a robot that reports it. An agent that does nothing leaves a loop
    with the numbers of `tarc.simulate`.

    The observation has, joint by joint, the measured error over the error scale and the estimated error rate. Then
    come the reference, its velocity and acceleration, and τ_law over its limit. The reward is

        −mean(e²)/scale² − weight · mean(a²)

    An episode is terminated where an error exceeds the divergence threshold, and truncated after the duration.

    Parameters
    ----------
    plant
        A robot in symbols.
    law, reference
        As in `tarc.simulate`. The law needs a torque limit, or the robot has one.
    duration
        Of an episode [s].
    action
        ``"residual"`` for a torque on top of the law's, ``"torque"`` for the torque itself.
    max_torque
        τ_max [N m or N], one number or one per joint; None for a fifth of the limit, or all of it for ``"torque"``.
    sensor
        Encoder between robot and law; None for the true position.
    initial_error
        Largest initial error, drawn evenly for each joint [rad or m].
    error_scale
        Error that counts as one [rad or m].
    effort_weight
        Weight of the action in the reward.
    divergence_threshold
        Error that ends an episode [rad or m].
    substeps
        Runge–Kutta steps per period.

    Raises
    ------
    InvalidParameter
        For parts that do not fit together, and a robot and a law without torque limits.
    MissingTool
        Without the extra ``gym``.

    Examples
    --------
    >>> import tarc
    >>> environment = tarc.runtime.LawEnvironment.from_scenario(
    ...     "two_link_payload", torque_limit=[150.0, 60.0], initial_error=0.01)
    >>> observation, _ = environment.reset(seed=1)
    >>> observation, reward, terminated, truncated, info = environment.step([0.0, 0.0])
    >>> observation.shape, terminated, truncated
    ((12,), False, False)
    """

    def __init__(
        self,
        plant: Plant,
        law: Law,
        reference: Reference,
        duration: float,
        *,
        action: str = "residual",
        max_torque: Numbers | None = None,
        sensor: Encoder | None = None,
        initial_error: float = 0.0,
        error_scale: float = 0.01,
        effort_weight: float = 0.01,
        divergence_threshold: float = 1.0,
        substeps: int = 2,
    ):
        self.metadata = {"render_modes": []}
        self.sensor = Encoder() if sensor is None else sensor
        check_compatible(plant, law, reference, self.sensor)
        check.one_of("action", action, ACTIONS)
        self.plant, self.law, self.kind = plant, law, action
        self.limits = np.minimum(law.torque_limits, plant.torque_limits)
        if not np.all(self.limits < np.inf) or np.any(self.limits > 1e20):
            raise InvalidParameter(
                "law: neither the law nor the robot has a torque limit; give torque_limit [N m or N] to the law, which "
                "scales the action"
            )
        share = 1.0 if action == "torque" else RESIDUAL_SHARE
        given = share * self.limits if max_torque is None else max_torque
        self.max_torque = check.vector("max_torque", given, law.n_joints, 0, strict=True)
        self.initial_error = check.number("initial_error", initial_error, 0)
        self.error_scale = check.number("error_scale", error_scale, 0, strict=True)
        self.effort_weight = check.number("effort_weight", effort_weight, 0)
        self.divergence_threshold = check.number("divergence_threshold", divergence_threshold, 0, strict=True)
        count = round(check.number("duration", duration, law.period) / law.period)
        times = law.period * np.arange(count + 1)
        fitted = reference.for_run(plant.joint_names, duration)
        self._reference = tuple(np.ascontiguousarray(part.T) for part in fitted.sample(times))
        self._advance = SampledPlant.from_robot(plant, law.period, substeps).function()
        self._controller = Controller(law)
        n = law.n_joints
        self.action_space = Box(-1.0, 1.0, (n,), np.float32)
        widest = self.divergence_threshold / self.error_scale
        high = np.repeat([widest, LARGEST, LARGEST, LARGEST, LARGEST, 1.0], n).astype(np.float32)
        self.observation_space = Box(-high, high, dtype=np.float32)
        self._count, self._k = count, 0
        self._motion = Motion(np.zeros(n), np.zeros(n))
        self._instant = _Instant(np.zeros(n), np.zeros(n), np.zeros(n))

    @classmethod
    def from_scenario(
        cls, scenario: Scenario | str | Path, law: str = "", torque_limit: Numbers | None = None, **options: Any
    ) -> Self:
        """Build an environment from a scenario's robot, law, reference, encoder and duration.

        Parameters
        ----------
        scenario
            The scenario, its file, or the name of a shipped one. Its disturbances are left out.
        law
            Name of one of its laws; empty for the first.
        torque_limit
            Limit of the law [N m or N] in place of its own.
        options
            Other parameters of `LawEnvironment`.

        Raises
        ------
        InvalidParameter
            For a name that the scenario does not have.
        """
        loaded = scenario if isinstance(scenario, Scenario) else Scenario.load(scenario)
        setup = loaded.build()
        if law and law not in setup.laws:
            raise InvalidParameter(f"law: got {law!r}; the scenario has {', '.join(setup.laws)}", "law")
        chosen = setup.laws[law or next(iter(setup.laws))]
        if torque_limit is not None:
            chosen = replace(chosen, torque_limit=torque_limit)
        options = {"sensor": setup.sensor, **options}
        return cls(setup.plant, chosen, setup.reference, loaded.duration, **options)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start an episode at rest, held by the torque that balances gravity; return observation and info.

        Parameters
        ----------
        seed
            Of the noise and the initial error; None goes on with the generator.
        options
            ``initial_position`` [rad or m], shape (n,), in place of the drawn one.
        """
        super().reset(seed=seed)
        n = self.law.n_joints
        drawn = self._reference[0][0] + self.initial_error * self.np_random.uniform(-1, 1, n)
        position = check.vector("initial_position", (options or {}).get("initial_position", drawn), n)
        self._noise = self.sensor.sample_noise(n, self._count + 1, self.np_random)
        self._k, self._motion = 0, Motion(position, np.zeros(n))
        self._encoder = self.sensor.init(position, self._noise[:, 0])
        first = self._encoder.delay_line[:, 0]
        self._applied = np.clip(self.plant.holding_torque(position), -self.limits, self.limits)
        self._controller.reset(first, self._applied)
        self._instant = self._measure(None)
        return self._observation(), self._info()

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Apply the agent's torque for a period; return observation, reward, terminated, truncated and info.

        Raises
        ------
        InvalidParameter
            For an action of another shape, and one that is not finite.
        """
        given = np.clip(check.vector("action", action, self.law.n_joints), -1, 1)
        added = self.max_torque * given
        torque = added if self.kind == "torque" else self._instant.torque + added
        self._applied = np.clip(torque, -self.limits, self.limits)
        following = np.asarray(self._advance(np.concatenate(self._motion), self._applied)[0]).ravel()
        n = self.law.n_joints
        self._motion = Motion(following[:n], following[n:])
        self._k += 1
        self._instant = self._measure(self._applied)
        error = self._motion.position - self._reference[0][self._k]
        reward = -float(np.mean(error**2)) / self.error_scale**2 - self.effort_weight * float(np.mean(given**2))
        diverged = not bool(np.all(np.abs(error) <= self.divergence_threshold))
        return self._observation(), reward, diverged, self._k >= self._count, self._info()

    def _measure(self, applied: Array | None) -> _Instant:
        """Read the encoders and step the law."""
        travel = self.law.period * self._motion.velocity
        value = EncoderInput(self._motion.position, travel, self._noise[:, self._k])
        self._encoder, measured = self.sensor.step(self._encoder, value)
        goal = (part[self._k] for part in self._reference)
        torque = self._controller.step(measured, *goal, applied_torque=applied).copy()
        return _Instant(measured, torque, self._controller.signals["velocity_estimate"].copy())

    def _observation(self) -> Array:
        """Return what the agent sees, cut to the bounds of the space; a missing sample is seen as no error."""
        reference, velocity, acceleration = (part[self._k] for part in self._reference)
        error = np.nan_to_num(self._instant.measured - reference) / self.error_scale
        rate = self._instant.velocity - velocity
        parts = [error, rate, reference, velocity, acceleration, self._instant.torque / self.limits]
        space: Any = self.observation_space
        return np.clip(np.concatenate(parts).astype(np.float32), space.low, space.high)

    def _info(self) -> dict[str, Any]:
        """Return time [s], true error [rad or m], the law's torque and the one that was applied [N m or N]."""
        return {
            "time": self._k * self.law.period,
            "error": self._motion.position - self._reference[0][self._k],
            "law_torque": self._instant.torque,
            "applied_torque": self._applied,
        }
