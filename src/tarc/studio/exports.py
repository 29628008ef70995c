"""Files of a design: figures, the run, the scenario, and the law in C or as an FMU, by the package's own writers."""

import io
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tarc.export import export_c, export_fmu
from tarc.scenario.deployment import law_of
from tarc.scenario.model import Scenario
from tarc.studio.design_state import DesignState
from tarc.studio.jobs import Sender
from tarc.studio.robots import Robots
from tarc.studio.runs import RunPair, run_pair

DPI = 200


def figure_file(pair: RunPair, suffix: str) -> bytes:
    """Return the figure of both runs as PNG or PDF."""
    figure = pair.design.plot(others={pair.curves.rival.name: pair.rival})
    stream = io.BytesIO()
    figure.savefig(stream, format=suffix, dpi=DPI)
    return stream.getvalue()


def run_file(pair: RunPair) -> bytes:
    """Return the run of the design as netCDF."""
    with tempfile.TemporaryDirectory() as folder:
        return pair.design.save(Path(folder) / "run.nc").read_bytes()


def scenario_file(state: DesignState, robots: Robots) -> bytes:
    """Return the design with its rival as a scenario in YAML, with the whole duration of the robot's motion."""
    base = _portable(state.robot, robots)
    content = state.to_content(base)
    return Scenario.parse(content | {"law": [content["law"], state.rival_content(base)["law"]]}).to_yaml().encode()


def _portable(name: str, robots: Robots) -> dict[str, Any]:
    """Return the content of a robot; the file of an upload has the path that it has there, not that on the server."""
    content = robots.content(name)
    parts = Path(content["robot"].get("file", "")).parts
    if name not in parts[:-1]:
        return content
    inside = Path(*parts[parts.index(name) + 1 :])
    return content | {"robot": {**content["robot"], "file": inside.as_posix()}}


def law_files(state: DesignState, robots: Robots) -> bytes:
    """Return the law as a C99 project in a ZIP archive."""
    law, options = _law_to_export(state, robots)
    with tempfile.TemporaryDirectory() as place:
        written = export_c(law, Path(place) / "law", name="law", **options)
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
            for file in sorted(written.folder.rglob("*")):
                archive.write(file, file.relative_to(place))
        return stream.getvalue()


def fmu_file(state: DesignState, robots: Robots) -> bytes:
    """Return the law as an FMU.

    Raises
    ------
    MissingTool
        Without a compiler or the headers of FMI, which come with the extra ``ship``.
    """
    law, options = _law_to_export(state, robots)
    with tempfile.TemporaryDirectory() as place:
        return export_fmu(law, Path(place) / "law.fmu", name="law", **options).file.read_bytes()


def _law_to_export(state: DesignState, robots: Robots) -> tuple[Any, dict[str, Any]]:
    """Return the law with the robot's torque limits, and the options of its export."""
    scenario = Scenario.parse(state.to_content(robots.content(state.robot)))
    name, law, limits, joints = law_of(scenario)
    portable = Scenario.parse(state.to_content(_portable(state.robot, robots)))
    content = portable.model_dump(mode="json", exclude_defaults=True)
    options = {
        "torque_limits": limits,
        "joint_names": joints,
        "scenario": {"law": name, "content": content},
        "commands": scenario.build_plant().torque_units,
    }
    return law, options


def send_file(send: Sender, name: str, state: DesignState, robots: Robots) -> None:
    """Send a file of a design by its name, for a `Job`; its runs are simulated again.

    Raises
    ------
    InvalidParameter, ScenarioError, RobotFileError, UnsupportedLaw, MissingTool
        For a design that cannot be built, and for tools that are not there.
    """
    makers: dict[str, Callable[[], bytes]] = {
        "design.yaml": lambda: scenario_file(state, robots),
        "law.zip": lambda: law_files(state, robots),
        "law.fmu": lambda: fmu_file(state, robots),
        "run.nc": lambda: run_file(run_pair(state, robots)),
        "runs.png": lambda: figure_file(run_pair(state, robots), "png"),
        "runs.pdf": lambda: figure_file(run_pair(state, robots), "pdf"),
    }
    send(makers[name]())
