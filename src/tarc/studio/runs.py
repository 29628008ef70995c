"""Short runs of a design and of its rival, for the page."""

from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

import numpy as np

from tarc.plants.shapes import RobotGeometry
from tarc.scenario.model import Scenario, Setup
from tarc.simulation.quantities import MEASURES, measure_unit
from tarc.simulation.run import Run
from tarc.studio.design_state import DesignState
from tarc.studio.results import CurvePair, Curves
from tarc.studio.robots import Robots
from tarc.studio.scene import robot_message, run_geometry, run_message

DURATION = 3.0
"""Longest run of the page [s]; the payload is picked up at half of it."""
METRICS_START = 0.5
"""Start of the measures [s]."""
MAX_POINTS = 600
"""Points of a curve."""
MAX_SESSIONS = 32
"""Sessions whose newest runs are kept."""


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

    def simulate(self, content: dict[str, Any]) -> tuple[Run, Curves]:
        """Simulate the law of a scenario that shares these parts."""
        law = self.scenario.build_law({**content["law"], "estimator": content["estimator"]}, self.setup)
        run = self.scenario.run_law(law, self.setup, progress=False)
        return run, curves_of(run, content["law"]["kind"], self.scenario.metrics_start)


@dataclass(frozen=True, eq=False)
class RunPair:
    """The runs of a design and of its rival.

    Attributes
    ----------
    design, rival
        The runs.
    curves
        What the page draws of them.
    parts, rival_content
        What they share, and the scenario of the rival.
    """

    design: Run
    rival: Run
    curves: CurvePair
    parts: RunParts
    rival_content: dict[str, Any]


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
    design, design_curves = parts.simulate(content)
    if previous is not None and previous.rival_content == rival_content:
        curves = CurvePair(design_curves, previous.curves.rival)
        return RunPair(design, previous.rival, curves, parts, rival_content)
    rival, rival_curves = parts.simulate(rival_content)
    return RunPair(design, rival, CurvePair.named(design_curves, rival_curves), parts, rival_content)


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
        units={name: measure_unit(name, run.joint_units, run.command_unit) for name in MEASURES},
        scales={name: measure.scale for name, measure in MEASURES.items()},
        status=str(run.status),
        has_completed=run.status.completed,
    )


@dataclass
class _SessionRuns:
    """The newest runs of a session, and the robot of which its scene is."""

    pair: RunPair
    robot: str
    geometry: RobotGeometry | None = None


_SESSIONS: OrderedDict[str, _SessionRuns] = OrderedDict()
"""Of the process that computes runs, by the name of the session."""


def newest_runs(session: str, state: DesignState, robots: Robots) -> CurvePair:
    """Simulate the design of a session and its rival, and keep the runs for the next call.

    Raises
    ------
    InvalidParameter, ScenarioError, RobotFileError, UnsupportedLaw
        For a design that cannot be built.
    """
    kept = _SESSIONS.pop(session, None)
    pair = run_pair(state, robots, None if kept is None else kept.pair)
    geometry = kept.geometry if kept is not None and kept.robot == state.robot else None
    _SESSIONS[session] = _SessionRuns(pair, state.robot, geometry)
    if len(_SESSIONS) > MAX_SESSIONS:
        _SESSIONS.popitem(last=False)
    return pair.curves


def forget_runs(session: str) -> None:
    """Drop the runs of a session that is closed."""
    _SESSIONS.pop(session, None)


def newest_scene(session: str, shown_robot: str) -> tuple[str, dict[str, Any] | None, dict[str, Any]] | None:
    """Return what the browser needs to play the newest run of a session; None for a session without runs.

    Parameters
    ----------
    session
        Name of the session.
    shown_robot
        The robot that its scene shows already; empty for none.

    Returns
    -------
    tuple
        Name of the robot, its message as of `tarc.studio.scene.robot_message` or None where it is shown already, and
        that of the run.

    Raises
    ------
    InvalidParameter
        For a robot without bodies in space.
    """
    kept = _SESSIONS.get(session)
    if kept is None:
        return None
    if kept.geometry is None:
        kept.geometry = run_geometry(kept.pair.design)
    robot = robot_message(kept.geometry, kept.pair.design) if kept.robot != shown_robot else None
    return kept.robot, robot, run_message(kept.geometry, kept.pair.design)
