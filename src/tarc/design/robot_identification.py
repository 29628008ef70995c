"""The inertia M̂ of a simulated robot, from its encoders and torques alone."""

import warnings
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import DesignWarning, InvalidParameter, NotIdentifiable
from tarc.core.types import Array
from tarc.core.validation import Numbers
from tarc.design.excitation import excitation_reference
from tarc.design.identification import IdentifiedInertia, inertia_from_data
from tarc.estimators.algebraic import Algebraic
from tarc.laws.tdc import TDC
from tarc.plants.base import Plant
from tarc.signals.references import Reference
from tarc.signals.sensors import Encoder
from tarc.simulation.run import Run
from tarc.simulation.simulator import simulate

MAX_RUNS = 12
"""Largest number of runs with a growing M̂."""
GROWTH = 4.0
"""Factor on the M̂ of a joint that does not follow."""
MAX_FOLLOWING_ERROR = 0.5
"""RMS error over the standard deviation of the motion from which a joint does not follow."""
INERTIA_RATIO = 0.5
"""Inertia ratio of the last run, well within the stable range of its law, 0.013 to 2.97 at 1 ms."""


def identify(
    plant: Plant,
    *,
    period: float = 1e-3,
    sensor: Encoder | None = None,
    reference: Reference | None = None,
    duration: float | None = None,
    torque: Numbers | Literal["rest"] = "rest",
    guess: float = 1e-3,
    diagonal: bool = True,
    seed: int = 0,
) -> IdentifiedInertia:
    """Identify M̂ of a simulated robot from its encoders and torques alone, as with a real one.

    The motion needs a law, and the law needs an M̂. Synchronised time-delay control with a low natural frequency
    drifts off slowly where M̂ is too small, and the run is stopped. So all joints start with a small M̂, and those
    that do not follow get four times theirs, until the record shows M. A last run with half of that inertia follows
    the reference, and its estimate is returned.

    Parameters
    ----------
    plant
        The robot; its model is not used.
    period
        T [s].
    sensor
        Its encoders; None for perfect ones.
    reference
        The motion; None for `excitation_reference` about home, within the position limits of the robot.
    duration
        [s]; None for 20 s, or 2.5 s per joint where that is more.
    torque
        Applied before the start [N m or N], as in `tarc.simulate`: ``"rest"`` for that of brakes, 0 for an arm that is
        released.
    guess
        M̂ to start from [kg m² or kg]; should be too small.
    diagonal
        Keep the diagonal only.
    seed
        Seed of the encoders' noise.

    Raises
    ------
    NotIdentifiable
        When no M̂ makes the robot follow, and when it follows but the record does not show M.
    InvalidParameter
        For a reference that leaves a joint at rest.
    """
    if not isinstance(plant, Plant):
        raise InvalidParameter(f"plant: got {plant!r}; needs one of tarc.plants")
    check.number("period", period, 0, strict=True)
    duration = max(20.0, 2.5 * plant.n_joints) if duration is None else duration
    if reference is None:
        low, high = plant.position_limits.T
        reference = excitation_reference(plant.home, duration=duration, low=low, high=high)
    experiment = _Experiment(plant, reference, duration, period, sensor, torque, seed)
    identified = experiment.first_estimate(check.number("guess", guess, 0, strict=True))
    run = experiment.run(INERTIA_RATIO * identified.inertia)
    if run.status.completed:
        with suppress(NotIdentifiable):
            identified = experiment.estimate(run)
    return identified.diagonal() if diagonal else identified


@dataclass(frozen=True)
class _Experiment:
    """Runs of a robot along a reference with different M̂."""

    plant: Plant
    reference: Reference
    duration: float
    period: float
    sensor: Encoder | None
    torque: Numbers | Literal["rest"]
    seed: int

    def first_estimate(self, guess: float) -> IdentifiedInertia:
        """Return the inertia from the first run that shows it; M̂ grows from a guess."""
        size = self._motion_size()
        inertia = np.full(self.plant.n_joints, guess)
        for _ in range(MAX_RUNS):
            run = self.run(inertia)
            error = np.abs(run.data["measured_position"].values - run.data["reference"].values)
            is_behind = np.sqrt(np.nanmean(error**2, axis=0)) > MAX_FOLLOWING_ERROR * size
            has_moved = np.nanstd(run.data["measured_position"].values, axis=0) > MAX_FOLLOWING_ERROR * size
            if run.status.completed and has_moved.all():
                try:
                    return self.estimate(run)
                except NotIdentifiable:
                    if not is_behind.any():
                        raise
            elif not run.status.completed:
                is_behind[np.argmax(np.nanmax(error, axis=0))] = True
            inertia = np.where(is_behind, GROWTH * inertia, inertia)
        raise NotIdentifiable(
            f"identify: with an M̂ from {guess:g} up to {inertia.max() / GROWTH:g} the robot does not follow the "
            "motion; start from another guess, give a slower reference, or a larger one where friction locks the joint"
        )

    def run(self, inertia: Array) -> Run:
        """Simulate the motion with an M̂; a run that leaves the range of the motion is stopped."""
        law = TDC(
            inertia=inertia,
            natural_frequency=5.0,
            period=self.period,
            estimator=Algebraic(window=10 * self.period),
            synchronised=True,
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DesignWarning)
            return simulate(
                self.plant,
                law,
                self.reference,
                self.duration,
                sensor=self.sensor,
                initial_torque=self.torque,
                divergence_threshold=float(np.max(np.ptp(self._path(), axis=1))),
                seed=self.seed,
            )

    def estimate(self, run: Run) -> IdentifiedInertia:
        """Return the inertia that a run shows."""
        q, tau = run.data["measured_position"].values, run.data["torque"].values
        return inertia_from_data(q, tau, self.period, diagonal=False)

    def _path(self) -> Array:
        return self.reference.sample(np.arange(0, self.duration, self.period))[0]

    def _motion_size(self) -> Array:
        """Return the standard deviation of each joint's reference, shape (n,)."""
        size = np.std(self._path(), axis=1)
        if not np.all(size > 0):
            raise InvalidParameter(
                "reference: it leaves a joint at rest; give all of them a motion, as excitation_reference(…) does"
            )
        return size
