"""Robots of a session, each with its motion: shipped scenarios, the file given to the command, and uploads."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from tarc.core import validation as check
from tarc.studio.design_state import CONTROLS, LAWS, TORQUE_LIMIT, DesignState

SHIPPED = {"two_link_payload": "Two-link arm", "ur5e": "UR5e", "panda_multisine": "Panda"}
"""Shipped scenarios whose robots the page offers, with what it calls them."""
BEYOND_THE_LOOP = ("gearbox", "torque_limits", "drive", "jitter")
"""Keys of a scenario that runs have, and that neither the map nor a certificate knows."""


class Robots:
    """Content of a scenario by the name of its robot.

    Attributes
    ----------
    labels
        What the page calls each of them.
    """

    def __init__(self) -> None:
        self.labels = dict(SHIPPED)
        self._contents: dict[str, dict[str, Any]] = {}

    def copy(self) -> "Robots":
        """Return the same robots for a session, which adds its own."""
        robots = Robots()
        robots.labels = dict(self.labels)
        robots._contents = dict(self._contents)
        return robots

    def content(self, name: str) -> dict[str, Any]:
        """Return robot, reference and duration as the content of a scenario.

        Raises
        ------
        InvalidParameter
            For an unknown name.
        """
        check.one_of("robot", name, list(self.labels))
        return self._contents[name] if name in self._contents else _shipped_content(name)

    def add(self, name: str, label: str, content: dict[str, Any]) -> None:
        """Offer a robot with its motion."""
        self.labels[name] = label
        self._contents[name] = content

    def add_scenario(self, path: str | Path) -> tuple[DesignState, list[str]]:
        """Offer the robot of a scenario; return its design, and a line for all that the page leaves out.

        Raises
        ------
        ScenarioError, InvalidParameter
            For a file that is not there or is no scenario.
        """
        from tarc.scenario.model import Scenario

        content = load_content(path)
        Scenario.parse(content, str(path))
        name = str(content["name"])
        self.add(name, self.labels.get(name, name), content)
        return state_of(content)


def load_content(path: str | Path) -> dict[str, Any]:
    """Return the content of a scenario file, or of a shipped scenario by name."""
    from tarc.scenario.loader import find_scenario, read_scenario, resolve_files

    file = find_scenario(path)
    content = read_scenario(file)
    resolve_files(content, file.parent)
    return content


@cache
def _shipped_content(name: str) -> dict[str, Any]:
    return load_content(name)


def state_of(content: dict[str, Any]) -> tuple[DesignState, list[str]]:
    """Return the design of a scenario's first law, and a line for all that the page cannot express."""
    notes = [f"{key}: in the runs; map and certificates do not know it" for key in BEYOND_THE_LOOP if key in content]
    laws = content["law"] if isinstance(content["law"], list) else [content["law"]]
    law = dict(laws[0])
    rate = round(1 / float(content.get("period", 1e-3)))
    changes: dict[str, Any] = {"robot": str(content["name"]), "control_rate": rate, "payload": 0.0}
    kind = str(law.pop("kind"))
    law.pop("label", None)
    if kind in LAWS:
        changes["law"] = kind
    else:
        notes.append(f"law {kind}: shown as TDC, since the page shapes {' and '.join(LAWS)}")
        changes["law"] = "TDC"
    rivals = [str(part.get("kind")) for part in laws[1:]]
    if rivals and rivals[0] in LAWS:
        changes["rival"] = rivals[0]
    estimator = dict(law.pop("estimator", content["estimator"]))
    notes += _take_inertia(law.pop("inertia", 1.0), changes)
    notes += _take_estimator(estimator, rate, changes)
    if law.get("delay") is not None:
        law["delay"] = round(float(law["delay"]) * rate)
    scalars = {control.name for control in CONTROLS} | {"synchronised"}
    for key, value in law.items():
        if key == TORQUE_LIMIT:
            continue  # `DesignState.to_content` keeps it
        if key in scalars and isinstance(value, int | float):
            changes[key] = value
        else:
            notes.append(f"law.{key}: left out")
    changes["encoder_bits"] = content.get("sensor", {}).get("bits", 24)
    if "bits" not in content.get("sensor", {}):
        notes.append("sensor: shown as 24 bits")
    loads = [part for part in content.get("disturbance", []) if part.get("kind") == "Payload"]
    if loads:
        changes["payload"] = loads[0]["mass"]
    notes += ["disturbance: further payloads left out"] if len(loads) > 1 else []
    state = DesignState().with_changes(**changes)
    for control in CONTROLS:
        if control.name in changes and not np.isclose(getattr(state, control.name), float(changes[control.name])):
            notes.append(f"{control.name}: {changes[control.name]:g} is outside the range of its slider")
    return state, notes


def _take_inertia(inertia: object, changes: dict[str, Any]) -> list[str]:
    """Put the inertia share into the changes; return what it leaves out."""
    if isinstance(inertia, dict) and "fraction" in inertia:
        changes["inertia_share"] = float(inertia["fraction"])
        changes["model_known"] = bool(inertia.get("model"))
        others = [key for key in inertia if key not in ("fraction", "model")]
        if isinstance(inertia.get("model"), dict):
            others.append("model.*")
        return [f"law.inertia.{key}: left out" for key in others]
    return ["law.inertia: shown as a share of 0.08 of the mean inertia"]


def _take_estimator(estimator: dict[str, Any], rate: int, changes: dict[str, Any]) -> list[str]:
    """Put window and degree into the changes; return what they leave out."""
    if estimator.get("kind") != "Algebraic":
        return [f"estimator {estimator.get('kind')}: shown as Algebraic"]
    changes["window"] = round(float(estimator["window"]) * rate)
    changes["degree"] = int(estimator.get("degree", 2))
    return []
