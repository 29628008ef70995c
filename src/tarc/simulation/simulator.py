"""`simulate`: run a law on a robot along a reference."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from tarc.analysis.rest_stability import remedy, unstable_posture
from tarc.control.digital_controller import DigitalController
from tarc.core import validation as check
from tarc.core.errors import DesignWarning
from tarc.laws.base import Law
from tarc.plants.base import Plant
from tarc.plants.euler_lagrange import EulerLagrange
from tarc.signals.references import Reference
from tarc.signals.sensors import Encoder
from tarc.simulation.casadi_backend import run_fused
from tarc.simulation.closed_loop import ClosedLoop
from tarc.simulation.monitor import Watch
from tarc.simulation.mujoco_backend import run_stepping
from tarc.simulation.run import Run
from tarc.simulation.sampled_inputs import Plan, fit, start, variants
from tarc.simulation.sampled_inputs import plan as sample_plan


def warn_if_unstable(plant: Plant, law: Law, plan: Plan, computation_delay: int, postures: int = 60) -> None:
    """Warn of a design whose loop, at rest in a posture of the reference, is unstable, with the remedy."""
    moments = np.unique(np.linspace(0, len(plan.times) - 1, postures).astype(int))
    robots = variants(plant, plan.events)
    found = None
    for (begin, robot), (end, _) in pairwise([*robots, (np.inf, plant)]):
        during = moments[(plan.times[moments] >= begin) & (plan.times[moments] < end)]
        if during.size:
            witness = unstable_posture(law, robot, plan.reference[0][:, during], computation_delay)
            if witness and (found is None or witness["growth rate [1/s]"] > found["growth rate [1/s]"]):
                found = witness
    if found:
        warnings.warn(remedy(law, found, computation_delay), DesignWarning, stacklevel=3)


def simulate(
    plant: Plant,
    law: Law,
    reference: Reference,
    duration: float,
    *,
    sensor: Encoder | None = None,
    disturbance: Any = (),
    initial_position: Any = None,
    initial_velocity: Any = 0.0,
    initial_torque: Any = 0.0,
    computation_delay: int = 0,
    substeps: int | None = None,
    divergence_threshold: float = 5.0,
    seed: int = 0,
    native: bool = False,
    progress: bool | None = None,
) -> Run:
    """Run a law on a robot along a reference.

    The law is called once a period with the measured position and the reference; its torque is held until the next
    call while the plant is integrated in substeps. Plants from energies run fused with the law in CasADi's virtual
    machine, robots from files step by step in MuJoCo; the equations are the same.

    Parameters
    ----------
    plant, law, reference
        Of the same number of joints n. A law without a torque limit gets the robot's, if it has one.
    duration
        [s].
    sensor
        What the law sees; None for the true position.
    disturbance
        One or a list of `tarc.signals` disturbances, payloads and schedules.
    position, velocity
        Start of the robot, shape (n,); None for the reference's first position, at rest.
    torque
        Torque applied before the start, shape (n,), with which the law's memory is filled; ``"rest"`` for the one
        that holds the robot, as a real arm's brakes or servo would have.
    computation_delay
        Periods between a measurement and its torque on the joints. A law that knows of it, by ``actuation_delay``,
        pairs its estimates with the torques that acted; one that does not bears only a smaller inertia.
    substeps
        Plant steps a period; None for 2 with Runge–Kutta and 1 with MuJoCo.
    divergence_threshold
        Error [rad or m] beyond which the run ends as diverged.
    seed
        Of all noise.
    native
        Compile the traced functions to machine code, which takes a second or so the first time and is kept; needs a C
        compiler. The result is the same to rounding.
    progress
        Show a progress bar when it takes more than two seconds; None for when standard error is a terminal.

    Returns
    -------
    Run
        Labelled trajectories, metrics, status, figures. A run that diverges ends early and says so in its status.

    Raises
    ------
    TarcError
        When the parts do not fit together.

    Warns
    -----
    DesignWarning
        When held at rest somewhere along the reference the loop is unstable; the run goes on all the same.
    """
    sensor = Encoder() if sensor is None else sensor
    check.integer("seed", seed, 0, 2**63 - 1)
    events = list(disturbance) if isinstance(disturbance, Sequence) else [disturbance]
    fit(plant, law, reference, sensor)
    limit = getattr(plant, "torque_limits", None)
    if law.torque_limit is None and limit is not None and np.any(np.isfinite(limit)):
        law = replace(law, torque_limit=limit)
    drive = DigitalController(sensor, law, check.integer("computation_delay", computation_delay, 0))
    fused = isinstance(plant, EulerLagrange)
    steps = check.integer("substeps", (2 if fused else 1) if substeps is None else substeps, 1)
    plan = sample_plan(plant, law, reference, duration, sensor, events, steps, seed)
    begin = start(plant, plan, initial_position, initial_velocity, initial_torque)
    warn_if_unstable(plant, law, plan, computation_delay)
    watch = Watch(plan, divergence_threshold, progress)
    if isinstance(plant, EulerLagrange):
        record = run_fused(ClosedLoop(plant, drive, steps), begin, plan, watch, native)
    else:
        record = run_stepping(plant, drive, begin, plan, watch, native)
    return Run.from_record(plant, drive, reference, plan, record, watch, seed)
