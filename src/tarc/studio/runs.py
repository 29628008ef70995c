"""Short runs of a design and of its rival, for the page."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tarc.core.types import Array
from tarc.scenario.model import Scenario, Setup
from tarc.simulation.quantities import measure_unit
from tarc.simulation.run import Run
from tarc.studio.design_state import DesignState
from tarc.studio.robots import Robots

DURATION = 3.0
"""Longest run of the page [s]; the payload is picked up at half of it."""
METRICS_START = 0.5
"""Start of the measures [s]."""
MAX_POINTS = 600
"""Points of a curve."""


@dataclass(frozen=True, eq=False)
class Curves:
    """What the page draws of a run.

    Attributes
    ----------
    name
        Name of the law.
    joints
        Names of the joints.
    times
        [s], shape (k,).
    errors, torques
        Of each joint [rad or m], [N m or N], shape (k, n).
    gain
        Switching gain ĉ [rad/s²], shape (k,); None for a law without.
    measures
        Of the run after `METRICS_START`, as `tarc.simulation.Run.metrics`; empty for one that diverged before.
    status, has_completed
        How the run ended, in words, and whether at its end.
    run
        The run itself.
    """

    name: str
    joints: tuple[str, ...]
    times: Array
    errors: Array
    torques: Array
    gain: Array | None
    measures: dict[str, float]
    status: str
    has_completed: bool
    run: Run

    def unit(self, measure: str) -> str:
        """Return the unit of a measure."""
        return measure_unit(measure, self.run.joint_units, self.run.command_unit)


@dataclass(frozen=True, eq=False)
class RunParts:
    """What the runs of designs share that differ in law and estimator alone: robot, motion, sensor, load.

    Attributes
    ----------
    content
        What is shared, as the content of a scenario.
    scenario, setup
        Its scenario, with any law, and its constructed parts.
    """

    content: dict[str, Any]
    scenario: Scenario
    setup: Setup

    def simulate(self, content: dict[str, Any]) -> "Curves":
        """Simulate the law of a scenario that shares these parts."""
        law = self.scenario.build_law({**content["law"], "estimator": content["estimator"]}, self.setup)
        run = self.scenario.run_law(law, self.setup, progress=False)
        return curves_of(run, content["law"]["kind"], self.scenario.metrics_start)


@dataclass(frozen=True, eq=False)
class RunPair:
    """The runs of a design and of its rival, with the parts that they share and the scenario of the rival."""

    design: Curves
    rival: Curves
    parts: RunParts | None = None
    rival_content: dict[str, Any] | None = None


def short_base(base: dict[str, Any]) -> dict[str, Any]:
    """Return a scenario's content with a duration for the page."""
    duration = min(float(base["duration"]), DURATION)
    return base | {"duration": duration, "metrics_start": min(METRICS_START, duration / 2)}


def run_pair(state: DesignState, robots: Robots, previous: RunPair | None = None) -> RunPair:
    """Simulate a design and its rival.

    Parameters
    ----------
    state
        The design.
    robots
        The robots of the session.
    previous
        The runs of an earlier design; what did not change since is neither built nor simulated again.

    Raises
    ------
    InvalidParameter, ScenarioError, RobotFileError, UnsupportedLaw
        For a design that cannot be built.
    """
    base = short_base(robots.content(state.robot)) | {"native": False}  # compiling takes longer than a run
    content, rival_content = state.to_content(base), state.rival_content(base)
    shared = {key: value for key, value in content.items() if key not in ("law", "estimator")}
    parts = None if previous is None else previous.parts
    if parts is None or parts.content != shared:
        scenario = Scenario.parse(content)
        parts = RunParts(shared, scenario, scenario.build())
    design = parts.simulate(content)
    if previous is not None and previous.rival_content == rival_content:
        return RunPair(design, previous.rival, parts, rival_content)
    rival = parts.simulate(rival_content)
    return RunPair(design, replace(rival, name=f"{rival.name} (rival)"), parts, rival_content)


def curves_of(run: Run, name: str, start_time: float) -> Curves:
    """Return what the page draws of a run, with its measures after a start time."""
    data = run.data
    step = max(1, -(-data.sizes["time"] // MAX_POINTS))
    return Curves(
        name=name,
        joints=tuple(str(joint) for joint in data["joint"].values),
        times=data["time"].values[::step],
        errors=(data["position"].values - data["reference"].values)[::step],
        torques=data["torque"].values[::step],
        gain=data["gain"].values[::step] if "gain" in data else None,
        measures={key: float(np.asarray(value)) for key, value in run.metrics_or_none(start_time).items()},
        status=str(run.status),
        has_completed=run.status.completed,
        run=run,
    )
