"""The torque variation that laws may have in a scenario, whatever its own laws are."""

from dataclasses import dataclass

import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.core.units import unit_for_joints
from tarc.design.noise import measurement_deviation
from tarc.estimators.algebraic import Algebraic
from tarc.plants.base import Plant
from tarc.scenario.model import Scenario
from tarc.scenario.parts import POSTURES_OF_MEAN_INERTIA
from tarc.signals.sensors import Encoder
from tarc.simulation.sampled_inputs import SampledInputs, sample_inputs, scheduled_plants

REFERENCE_FREQUENCY = 0.03
"""Natural frequency of the reference loop, ωn T [rad per period]: 30 rad/s at 1 kHz."""

REFERENCE_WINDOW = 10
"""Window of the line whose slope is the velocity in the reference loop [periods]."""


@dataclass(frozen=True, kw_only=True)
class TorqueVariationBudget:
    """Torque variation Σ|Δτ|/T [N m/s or N/s] that each law may have: that of the task and that of the noise.

    Attributes
    ----------
    motion
        Variation of the torque that the reference, the payloads and the disturbances need.
    noise
        Variation that the encoders' noise causes in the reference loop.
    unit
        Their unit.
    """

    motion: float
    noise: float
    unit: str = "N m/s"

    @property
    def total(self) -> float:
        """Return the sum of both [N m/s or N/s]."""
        return self.motion + self.noise

    def __str__(self) -> str:
        return (
            f"{self.total:.4g} {self.unit}, of which the motion needs {self.motion:.4g} and the noise in a PD loop of "
            f"ωn T = {REFERENCE_FREQUENCY:g} makes {self.noise:.4g}"
        )


def torque_variation_budget(scenario: Scenario) -> TorqueVariationBudget:
    """Return the torque variation that every law may have in a scenario; no law of the scenario enters.

        V = Σ|Δτ|/T + Σ_i √(2/π) ‖Δw‖ σ_i/T,     τ = M(q) q̈ᵈ + N(q, q̇ᵈ) − d

    The first term is that of the inverse dynamics along the reference, with payloads and disturbances d, from
    ``metrics_start`` on. The second is the mean of |Δτ| for white noise in a PD loop:

        τ = −M̄ (K1 q̂ + K2 v̂),     K1 = ωn²,  K2 = 2 ωn,  ωn T = 0.03

    M̄ is the mean inertia along the reference. q̂ and v̂ are value and slope of a line through the last 10 periods. The
    weights of K1 q̂ + K2 v̂ are w. The deviation of M̄ times the measured position is σ.

    Raises
    ------
    InvalidParameter
        For a robot with passive joints or constraints, whose inverse dynamics no reference determines.
    """
    plant = scenario.build_plant()
    plant.require_fully_driven("the rule of the torque variation (unless --budget gives a number)")
    reference = scenario.build_reference(plant).for_run(plant.joint_names, scenario.duration)
    events = [part.build() for part in scenario.sections.disturbances]
    sensor: Encoder = scenario.sections.sensor.build()
    inputs = sample_inputs(plant, scenario.period, reference, scenario.duration, sensor, events, 1, scenario.seed)
    first = int(np.searchsorted(inputs.times, scenario.metrics_start - 1e-9))
    if len(inputs.times) - first < 2:
        raise InvalidParameter(
            f"metrics_start: got {scenario.metrics_start:g} s of {scenario.duration:g} s; needs two periods or more "
            "after it",
            "metrics_start",
        )
    torque = _inverse_dynamics(plant, inputs)[first:]
    motion = np.sum(np.abs(np.diff(torque, axis=0))) / (scenario.period * (len(torque) - 1))
    numbers = np.linspace(0, len(inputs.times) - 1, POSTURES_OF_MEAN_INERTIA).astype(int)
    inertia = plant.mean_inertia(inputs.reference[0][:, numbers])
    return TorqueVariationBudget(
        motion=float(motion),
        noise=_noise_variation(inertia, sensor, scenario.period),
        unit=unit_for_joints("N m/s", plant.units),
    )


def _inverse_dynamics(plant: Plant, inputs: SampledInputs) -> Array:
    """Return the torque [N m or N], or command, that the reference needs, shape (k, n)."""
    changes = scheduled_plants(plant, inputs.events)
    starts = np.array([start for start, _ in changes])
    torques = []
    for number, (time, q, velocity, acceleration) in enumerate(
        zip(inputs.times, *(values.T for values in inputs.reference), strict=True)
    ):
        robot = changes[int(np.searchsorted(starts, time + 1e-9, side="right")) - 1][1]
        disturbance = inputs.disturbance[:, number, 0] / plant.command_gain
        torques.append(robot.inertia(q) @ acceleration + robot.bias(q, velocity) - disturbance)
    return np.array(torques)


def _noise_variation(inertia: Array, sensor: Encoder, period: float) -> float:
    """Return the variation [N m/s or N/s] that measurement noise causes in the reference loop."""
    line = Algebraic(window=REFERENCE_WINDOW * period, degree=1).with_period(period)
    omega = REFERENCE_FREQUENCY / period
    weights = omega**2 * line.weights(0) + 2 * omega * line.weights(1)
    changes = np.diff(weights, prepend=0.0, append=0.0)
    deviation = np.linalg.norm(inertia * measurement_deviation(sensor, len(inertia)), axis=1)
    return float(np.sqrt(2 / np.pi) * np.linalg.norm(changes) * np.sum(deviation) / period)
