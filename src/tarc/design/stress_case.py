"""A design with one quantity changed: its certificate and its simulation."""

import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tarc.analysis.workspace import Workspace
from tarc.certificates.affine import AffineProof
from tarc.certificates.base import Certificate
from tarc.certificates.known_inertia import certify_known_inertia
from tarc.certificates.robot import certify_robot, strengthen_robot
from tarc.core.errors import DesignWarning
from tarc.design.affine_assessment import ORDERS
from tarc.design.known_model import uncertain_robots
from tarc.design.prediction import predict_error
from tarc.design.result import Design
from tarc.design.trial_motion import slow_sines
from tarc.estimators.algebraic import Algebraic
from tarc.laws.tarc import TARC
from tarc.laws.tdc import TDC
from tarc.signals.disturbances import Payload
from tarc.signals.references import Reference, Sinusoid
from tarc.signals.sensors import Encoder
from tarc.simulation.simulator import simulate

MAX_ERROR_RATIO = 10.0
"""RMS error over that of the design from which a run counts as unstable: nonlinear loops oscillate, not diverge."""
SMOOTHING_PERIODS = 51
"""Periods of torque that a parabola is fitted to; the remainder counts as noise."""


@dataclass(frozen=True, eq=False)
class StressRun:
    """Result of the simulation with one value changed.

    The torque limits are lifted, as the certificate assumes. With them an unstable loop may oscillate and not diverge.

    Attributes
    ----------
    value
        The changed value, in the question's unit.
    stable
        Whether the run completed, with an RMS error of at most ten times the design's. For a higher speed the error
        does not count.
    status
        In words.
    rms_error
        Over all joints [rad or m], without the first quarter of the run or its first second. The larger of the two
        where revolute and prismatic joints mix; NaN where the run did not complete.
    torque_noise
        RMS of the torque without its slow part, a parabola over 51 periods, shape (n,) [N m or N]; NaN as above.
    saturation_share
        Share of the samples, over all joints, in which the torque was beyond its limit.
    torque_variation
        Σ|Δτ| over all joints per time [N m/s]; NaN as above.
    torque_rate
        Largest change of the torque in a period, over the period, shape (n,) [N m/s]; NaN as above.
    """

    value: float
    stable: bool
    status: str
    rms_error: float
    torque_noise: np.ndarray
    saturation_share: float
    torque_rate: np.ndarray
    torque_variation: float = np.nan

    def __str__(self) -> str:
        if np.isnan(self.rms_error):
            return self.status
        oscillates = "" if self.stable else f" but at over {MAX_ERROR_RATIO:g} times the error of the design itself"
        beyond = f", {self.saturation_share:.2%} of torques beyond their limit" if self.saturation_share else ""
        noise = f"noise up to {self.torque_noise.max():.3g}"
        return f"{self.status}{oscillates}, RMS error {self.rms_error:.3g}, {noise}{beyond}"


@dataclass(frozen=True)
class StressCase:
    """A design with one quantity changed.

    Attributes
    ----------
    design
        The design.
    law, sensor
        The changed law and encoder.
    delay
        Computation delay of the loop [periods].
    payload
        Largest payload [kg]; None for a robot without one.
    workspace
        Postures and speeds.
    is_faster
        Whether the motion uses the speeds of the workspace.
    """

    design: Design
    law: TDC | TARC
    sensor: Encoder
    delay: int
    payload: float | None
    workspace: Workspace
    is_faster: bool = False

    @classmethod
    def from_design(cls, design: Design) -> "StressCase":
        """Return the case without a change."""
        payload = float(np.squeeze(design.plants[-1].parameters["payload"])) if len(design.plants) > 1 else None
        return cls(design, design.law, design.sensor, design.law.actuation_delay, payload, design.workspace)

    def change(self, name: str, value: float) -> "StressCase":
        """Return the case with another value of a quantity, in its unit."""
        if name == "payload":
            return replace(self, payload=value)
        if name == "bits":
            return replace(self, sensor=replace(self.sensor, bits=int(value), resolution=None))
        if name == "speed" and self.workspace.speed is not None:
            workspace = self.workspace.scale_speed(value / self.workspace.speed.max())
            return replace(self, workspace=workspace, is_faster=True)
        if name == "computation_delay":
            return replace(self, delay=self.delay + int(value))
        return self._change_rate(value)

    def _change_rate(self, rate: float) -> "StressCase":
        law, estimator, period = self.design.law, self.design.estimator, 1 / rate
        ratio = law.period / period
        computation_delay = int(np.ceil(law.actuation_delay * ratio - 1e-9))
        window = max(estimator.degree, round(estimator.window / law.period * ratio))
        # a delay of one period would leave an alternating torque undamped where the computation delay is odd
        delay = None if law.delay_periods == 1 else (1 + computation_delay % 2) * period
        slower = replace(
            self.law,
            period=period,
            estimator=Algebraic(window=window * period, degree=estimator.degree),
            delay=delay,
            actuation_delay=computation_delay,
        )
        return replace(self, law=slower, delay=computation_delay)

    def certificate(self) -> Certificate:
        """Certify the case on the robot: by balls, else by a Lyapunov function of the order that designs are tried at.

        `tarc certify` tries the same, and a higher order then.
        """
        plants = [self.design.plants[0]]
        if self.payload is not None:
            plants.append(plants[0].with_parameters({"payload": self.payload}))
        samples = self.design.certificates["robot"].evidence.samples
        if self.law.has_model:
            robots = uncertain_robots(plants, self.design.requirements, self.workspace)
            return certify_known_inertia(
                self.law, robots, self.workspace, computation_delay=self.delay, samples=samples
            )
        given: dict[str, Any] = {"computation_delay": self.delay, "samples": samples}
        certificate = certify_robot(self.law, plants, self.workspace, **given)
        options: dict[str, Any] = {**given, "start": self._start(), "orders": ORDERS}
        return strengthen_robot(certificate, self.law, plants, self.workspace, **options)

    def _start(self) -> AffineProof | None:
        """Return the design's own Lyapunov function with a form, where the case leaves the loop as it is."""
        cover = self.design.certificates["robot"].evidence.affine
        is_same_loop = self.law is self.design.law and self.delay == self.law.actuation_delay
        return cover.proof if is_same_loop and cover is not None and cover.proof.ratios.form is not None else None

    def simulate(self, value: float, duration: float, max_error: float = np.inf) -> StressRun:
        """Simulate the motion of `Design.scenario`, or the workspace's reference; the payload comes at half-time."""
        reference = self._reference()
        if self.design.workspace.reference is not None:
            duration = min(duration, float(self.design.workspace.high[0]))
        periods = int(np.ceil(self.law.period / self.design.law.period - 1e-9))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DesignWarning)  # expected beyond the limit
            run = simulate(
                self.design.plants[0],
                replace(self.law, torque_limit=np.inf),
                reference,
                duration,
                sensor=self.sensor,
                initial_torque="rest",
                disturbance=() if self.payload is None else Payload(mass=self.payload, start_time=duration / 2),
                computation_delay=self.delay,
                substeps=None if periods == 1 else 2 * periods,
                progress=False,
            )
        torque = run.data["torque"].values
        error = variation = np.nan
        noise = rate = np.full(torque.shape[1], np.nan)
        if run.status.completed:
            measures = run.metrics(min(1.0, duration / 4))
            error = max(value for name, value in measures.items() if name.startswith("rms_error"))
            variation = measures["torque_variation"]
            noise = _fast_part(torque)
            rate = np.max(np.abs(np.diff(torque, axis=0)), axis=0) / self.law.period
        saturation = float(np.mean(np.abs(torque) > self.law.torque_limits))
        return StressRun(value, bool(error <= max_error), str(run.status), error, noise, saturation, rate, variation)

    def predict(self, duration: float) -> float:
        """Return the RMS error that the linear loop predicts for `simulate`, as `StressRun.rms_error` counts."""
        robot = self.design.certificates["robot"].evidence
        if self.design.workspace.reference is not None:
            duration = min(duration, float(self.design.workspace.high[0]))
        plants = [self.design.plants[0]]
        if self.payload is not None:
            plants.append(plants[0].with_parameters({"payload": self.payload}))
        predicted = predict_error(
            self.law,
            plants,
            self._reference(),
            duration,
            sensor=self.sensor,
            computation_delay=self.delay,
            mean_ratio=(robot.min_ratio * robot.max_ratio) ** 0.5,
        )
        of_joints, units = predicted.rms(min(1.0, duration / 4)), np.array(self.design.plants[0].units)
        return max(float(np.sqrt(np.mean(of_joints[units == unit] ** 2))) for unit in set(units.tolist()))

    def _reference(self) -> Reference:
        workspace = self.design.workspace
        if workspace.reference is not None:
            return workspace.reference
        sines = slow_sines(self.design.law, self.design.plants, workspace, self.design.torque_noise)
        if not self.is_faster:
            return sines
        return replace(sines, frequency=speed_factor(sines, self.workspace) * np.asarray(sines.frequency))


def speed_factor(sines: Sinusoid, workspace: Workspace) -> float:
    """Return the factor on the frequencies at which a joint reaches its largest speed or acceleration."""
    if workspace.speed is None or workspace.acceleration is None:
        return 1.0
    speed = np.abs(np.asarray(sines.amplitude) * np.asarray(sines.frequency))
    acceleration = speed * np.asarray(sines.frequency)
    moves = speed > 0
    if not moves.any():
        return 1.0
    by_acceleration = np.sqrt(workspace.acceleration[moves] / acceleration[moves])
    return float(min(np.min(workspace.speed[moves] / speed[moves]), np.min(by_acceleration)))


def _fast_part(torque: np.ndarray) -> np.ndarray:
    """Return the RMS of torques (k, n) without a moving parabola, shape (n,)."""
    from scipy.signal import savgol_filter

    window = min(SMOOTHING_PERIODS, len(torque) - 1 + len(torque) % 2)
    return np.sqrt(np.mean((torque - savgol_filter(torque, window, 2, axis=0)) ** 2, axis=0))
