"""A design as a scenario, ready to run."""

from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np

from tarc.errors import TarcError
from tarc.plants.base import Plant
from tarc.plants.mujoco import MujocoPlant
from tarc.scenario import Scenario

if TYPE_CHECKING:
    from tarc.design.choose import Design

AMPLITUDE = 0.4
"""Greatest amplitude of the sines [rad or m]."""
SLOW = 1.5
"""Frequency of the first joint's sine [rad/s]; the others are a fifth apart."""


def scenario_of(design: "Design", duration: float) -> Scenario:
    """See `Design.scenario`."""
    low, high = design.payload
    content: dict[str, Any] = {
        "name": f"{getattr(design.plants[0], 'label', type(design.plants[0]).__name__)} designed",
        "robot": robot_section(design.plants[0]),
        "law": law_section(design.law),
        "estimator": {
            "kind": "Algebraic",
            "window": round(design.chosen.window * design.law.period, 9),
            "degree": design.chosen.degree,
        },
        "reference": reference_section(design),
        "sensor": {key: value for key, value in _given(design.sensor).items() if value is not None},
        "start": {"torque": "rest"},
        "period": design.law.period,
        "computation_delay": design.chosen.computation_delay,
        "duration": duration,
        "measure_from": min(1.0, duration / 4),
    }
    if high > low:
        content["disturbance"] = [{"kind": "Payload", "mass": high, "at": duration / 2}]
    return Scenario.parse(content)


def robot_section(plant: Plant) -> dict[str, Any]:
    """A robot as a scenario writes it."""
    if isinstance(plant, MujocoPlant):
        return _plain(plant.options)
    if type(plant).__module__.startswith("tarc.plants"):
        return {"kind": type(plant).__name__, **_plain(_given(plant))}
    raise TarcError(
        f"scenario: {type(plant).__name__} is neither from a file nor one of tarc.plants; run it with tarc.simulate"
    )


def law_section(law: Any) -> dict[str, Any]:
    """A law as a scenario writes it, without its estimator and period."""
    options = {name: value for name, value in _given(law).items() if name not in ("period", "estimator")}
    limit = options.get("torque_limit")
    if limit is not None and not np.all(np.isfinite(limit)):
        options.pop("torque_limit")
    return {"kind": type(law).__name__, **_plain(options)}


def reference_section(design: "Design") -> dict[str, Any]:
    """Sines about the middle of the workspace, at most a quarter of its width, that begin at rest."""
    n = design.law.joints
    if design.workspace.reference is not None:
        raise TarcError("scenario: the workspace is a tube about a reference; put that reference into the scenario")
    low, high = design.workspace.low, design.workspace.high
    middle = np.clip(design.plants[0].home, low, high)
    amplitude = np.minimum(AMPLITUDE, (high - low) / 4)
    middle = np.clip(middle, low + amplitude, high - amplitude)
    return {
        "kind": "Sinusoid",
        "amplitude": amplitude.round(4).tolist(),
        "frequency": [round(SLOW * (1 + 0.2 * i), 3) for i in range(n)],
        "phase": float(np.pi / 2),
        "offset": middle.round(4).tolist(),
    }


def _given(part: Any) -> dict[str, Any]:
    """Parameters of a component that are not at their default."""
    return {one.name: value for one in fields(part) if not _same(value := getattr(part, one.name), one.default)}


def _same(one: Any, other: Any) -> bool:
    return np.shape(one) == np.shape(other) and bool(np.all(one == other))


def _plain(content: Any) -> Any:
    """Lists and numbers instead of arrays, to eight digits."""
    if isinstance(content, dict):
        return {key: _plain(value) for key, value in content.items()}
    if isinstance(content, np.ndarray | np.generic):
        return _plain(content.tolist())
    if isinstance(content, list | tuple):
        return [_plain(one) for one in content]
    return float(f"{content:.8g}") if isinstance(content, float) else content
