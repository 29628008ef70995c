"""A study of the design and its rival on drawn robots, in chunks as they finish."""

from typing import Any

import numpy as np

from tarc.core.units import unit_for_joints
from tarc.plants.base import Plant
from tarc.simulation.quantities import MEASURES, measure_unit
from tarc.studio.design_state import DesignState
from tarc.studio.jobs import Sender
from tarc.studio.results import CurvePair, StudyChunk, StudyStart
from tarc.studio.robots import Robots
from tarc.studio.runs import METRICS_START, curves_of, short_base
from tarc.study.cases import Cases
from tarc.study.draws import run_seeds
from tarc.study.engines import Simulator
from tarc.study.execution import build_engine, choose_study_integration
from tarc.study.specification import Study

CHUNK = 40
"""Runs that are shown at once."""
FRICTION = (0.5, 2.0)
"""Drawn friction over that of the robot."""
NOISE = (1e-6, 1e-4)
"""Drawn noise of the encoders [rad or m]."""


def study_content(state: DesignState, robots: Robots, runs: int) -> dict[str, Any]:
    """Return the study of a design: payload, viscous friction and noise of the encoders are drawn."""
    base = short_base(robots.content(state.robot))
    scenario = state.to_content(base)
    draws: dict[str, Any] = {"sensor.noise": {"log_uniform": list(NOISE)}}
    for number, part in enumerate(scenario["disturbance"]):
        if part["kind"] == "Payload" and part["mass"]:
            draws[f"disturbance.{number}.mass"] = {"uniform": [0.0, 2 * float(part["mass"])]}
    viscous = scenario["robot"].get("viscous")
    named = {"robot.viscous": viscous} if isinstance(viscous, int | float) else {}
    if isinstance(viscous, list):
        named = {f"robot.viscous.{joint}": value for joint, value in enumerate(viscous)}
    for key, value in named.items():
        if value:
            draws[key] = {"uniform": [factor * float(value) for factor in FRICTION]}
    design, rival = scenario["law"], state.rival_content(base)["law"]
    laws = [{**design, "label": "design"}, {**rival, "label": "rival"}]
    return {"scenario": scenario, "laws": laws, "runs": runs, "sampling": "sobol", "draws": draws}


def study_start(content: dict[str, Any], plant: Plant) -> StudyStart:
    """Return the content of a study with what the page says of its drawn values and measures."""
    labels = {}
    for key in content["draws"]:
        if key.startswith("robot.viscous"):
            joint = key.removeprefix("robot.viscous").removeprefix(".")
            of_joint = f" of {plant.joint_names[int(joint)]}" if joint else ""
            unit = unit_for_joints("N m s/rad", [plant.units[int(joint)]] if joint else plant.units)
            labels[key] = f"viscous friction{of_joint} [{unit}]"
        elif key == "sensor.noise":
            labels[key] = f"noise of the encoders [{unit_for_joints('rad', plant.units)}]"
        else:
            labels[key] = "payload [kg]"
    commands = {unit for unit in plant.torque_units if not unit.startswith("N")}
    command = commands.pop() if len(commands) == 1 else ""
    units = {name: measure_unit(name, plant.units, command) for name in MEASURES}
    return StudyStart(content, labels, units, {name: measure.scale for name, measure in MEASURES.items()})


def send_study(send: Sender, state: DesignState, robots: Robots, runs: int) -> None:
    """Send the `StudyStart` of a design, then run the study and send each `StudyChunk`, for a `Job`."""
    content = study_content(state, robots, runs)
    study = Study.parse(content)
    cases = Cases(study)
    send(study_start(content, cases.nominal.simulated))
    draws = study.draw()
    integration = choose_study_integration(cases, draws)
    engine = build_engine(study, integration, "auto")
    for start in range(0, study.runs, CHUNK):
        chunk = np.arange(start, min(start + CHUNK, study.runs))
        result = engine.run(chunk, draws.values[chunk], draws.seeds[chunk])
        send(StudyChunk(chunk, draws.values[chunk], result.measures, result.completed))


def send_replay(send: Sender, content: dict[str, Any], run: int) -> None:
    """Simulate one run of a study again, with its trajectories, and send its curves, for a `Job`."""
    study = Study.parse(content)
    draws = study.draw()
    cases = Cases(study)
    simulator = Simulator(cases, choose_study_integration(cases, draws))
    seed = int(run_seeds(draws.seed, np.array([run]))[0])
    design, rival = (
        curves_of(simulator.trace(draws.values[run], seed, law), f"{law}, run {run}", METRICS_START)
        for law in study.law_names
    )
    send(CurvePair(design, rival))
