"""Keys of a scenario that a study draws: where they are, and how their values are put there."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter, ScenarioError
from tarc.plants.base import Plant
from tarc.plants.load import load_robot
from tarc.scenario.model import Scenario
from tarc.scenario.schema import Component, check_component, parameters

PARTS = ("robot", "gearbox", "drive", "sensor", "reference", "torque_limits", "estimator")
"""Sections with one component each."""

NUMBERS = ("initial_position", "initial_velocity", "initial_torque", "computation_delay", "jitter")
"""Keys of the scenario itself that a study may draw."""

SHARED_ESTIMATOR = "estimator"
"""Path of the estimator that laws without one of their own share."""

KIND = "kind"
"""Last step to the class of a section; its names are drawn as texts."""

REFUSED = {
    "duration": "all runs of a study last as long",
    "period": "all runs of a study have one control period; make a study for each",
    "seed": "each run has a seed of its own already",
    "name": "it is no number",
    "metrics_start": "the measures of all runs begin at one time",
    "divergence_threshold": "all runs end by one rule",
    "substeps": "all runs have one integration method",
    "native": "the engine of a study decides it",
    "acceleration_limits": "they check the reference and change no run",
}
"""Keys of a scenario that a study does not draw, with the reason."""


@dataclass(frozen=True)
class DrawnKey:
    """Place of a drawn number or text in a scenario.

    Attributes
    ----------
    name
        As in the study, such as ``disturbance.0.mass``.
    section
        First word.
    item
        Number of the disturbance or the law; None for another section, and for all laws that have the key.
    path
        Steps inside the section: names and whole numbers.
    """

    name: str
    section: str
    item: int | None
    path: tuple[str | int, ...]

    @property
    def is_of_law(self) -> bool:
        """Whether it changes laws, and not what is simulated."""
        return self.section in ("law", "estimator")

    @property
    def is_of_estimator(self) -> bool:
        """Whether it changes an estimator of laws."""
        return self.section == "estimator" or (self.section == "law" and self.path[0] == "estimator")

    def overlaps(self, other: "DrawnKey") -> bool:
        """Return whether both are places of one number."""
        if self.section != other.section or (
            self.item is not None and other.item is not None and self.item != other.item
        ):
            return False
        shorter = min(len(self.path), len(other.path))
        return self.path[:shorter] == other.path[:shorter]


def find_key(scenario: Scenario, name: str) -> DrawnKey:
    """Return the place of a key in a scenario.

    Parameters
    ----------
    scenario
        With the laws of the study.
    name
        Words with dots between, such as ``robot.viscous.0``.

    Raises
    ------
    InvalidParameter
        For a key that the scenario does not have or that is not drawn, with the nearest one.
    """
    words = str(name).split(".")
    section = words[0]
    place = f"draws.{name}"
    if section in REFUSED:
        raise InvalidParameter(f"{place}: {section} cannot be drawn: {REFUSED[section]}", place)
    if section in NUMBERS:
        return DrawnKey(name, section, None, tuple(map(_step, words[1:])))
    if section not in (*PARTS, "disturbance", "law") or len(words) == 1:
        raise _unknown(scenario, name)
    steps = tuple(map(_step, words[1:]))
    item: int | None = None
    if section in ("disturbance", "law") and isinstance(steps[0], int):
        item, steps = steps[0], steps[1:]
    key = DrawnKey(name, section, item, steps)
    if not steps or not components_of(scenario, key):
        raise _unknown(scenario, name)
    return key


def components_of(scenario: Scenario, key: DrawnKey) -> dict[str, Component]:
    """Return the components that have a key: of laws by the law's name, else one by the section's name.

    A key ``law.estimator.…`` is of the estimators that laws have for themselves.
    """
    sections = scenario.sections
    if key.section == "law":
        laws = list(sections.laws.items())
        chosen = laws if key.item is None else laws[key.item : key.item + 1]
        if key.path[0] == "estimator":
            return {
                name: estimator
                for name, (_, estimator) in chosen
                if estimator.path != SHARED_ESTIMATOR and _has(estimator, key.path[1:])
            }
        return {name: law for name, (law, _) in chosen if _has(law, key.path)}
    if key.section == "estimator":
        return {
            name: estimator
            for name, (_, estimator) in sections.laws.items()
            if estimator.path == SHARED_ESTIMATOR and _has(estimator, key.path)
        }
    if key.section == "disturbance":
        events = sections.disturbances
        if key.item is None or key.item >= len(events) or not _has(events[key.item], key.path):
            return {}
        return {key.section: events[key.item]}
    component: Component | None = getattr(sections, key.section)
    return {key.section: component} if component is not None and _has(component, key.path) else {}


def _has(component: Component, path: Sequence[str | int]) -> bool:
    """Return whether a component has a parameter of this name, with the keys inside it that the path names."""
    if path == (KIND,):
        return component.kind is not load_robot
    if not path or path[0] not in parameters(component.kind):
        return False
    current: object = component.options.get(str(path[0]))
    for step in path[1:]:
        if isinstance(step, str) and not (isinstance(current, Mapping) and step in current):
            return False
        current = current.get(step) if isinstance(current, Mapping) else None
    return True


def _step(word: str) -> str | int:
    """Return a step of a path: a whole number for an index."""
    return int(word) if word.isdigit() else word


def _unknown(scenario: Scenario, name: str) -> InvalidParameter:
    """Return the error of a key that a scenario does not have."""
    known = known_keys(scenario)
    section = name.split(".")[0]
    alike = [key for key in known if key.split(".")[0] == section] or known
    plain = re.sub(r"\.\d+$", "", name)
    optional = {"gearbox": "stiffness: 1000", "drive": "time_constant: 0.002", "torque_limits": "magnitude: 100"}
    text = f"draws.{name}: the scenario has no such key"
    if section in optional and not getattr(scenario, section):
        text += f", since it has no {section}; add one, such as {section}: {{{optional[section]}}}"
    else:
        text += f"; known are {', '.join(alike)}.{check.did_you_mean(plain, known)}"
    return InvalidParameter(text, f"draws.{name}")


def known_keys(scenario: Scenario) -> list[str]:
    """Return the keys of a scenario that a study may draw, without indices of joints."""
    sections = scenario.sections
    keys: list[str] = []
    for section in PARTS:
        if section == "estimator":
            kinds = [estimator for _, estimator in sections.laws.values() if estimator.path == SHARED_ESTIMATOR][:1]
        else:
            component = getattr(sections, section)
            kinds = [] if component is None else [component]
        keys += [f"{section}.{name}" for component in kinds for name in _drawable(component)]
    for number, component in enumerate(sections.disturbances):
        keys += [f"disturbance.{number}.{name}" for name in _drawable(component)]
    for law, _ in sections.laws.values():
        keys += [f"law.{name}" for name in _drawable(law)]
    return [*dict.fromkeys(keys), *NUMBERS]


def _drawable(component: Component) -> list[str]:
    """Return the names of a component's parameters that may be numbers or texts."""
    words = ("number", "rows", "anything", "a text")
    allowed = {name: parameter.words for name, parameter in parameters(component.kind).items()}
    names = [name for name, text in allowed.items() if any(word in text for word in words)]
    return [*names, KIND] if _has(component, (KIND,)) else names


def with_value(
    component: Component, path: Sequence[str | int], value: object, present: object, n_joints: int
) -> Component:
    """Return a component with another value at a path.

    Parameters
    ----------
    component
        Section of the scenario.
    path
        Name of a parameter, and steps inside its value.
    value
        The new value.
    present
        Present value of the parameter, for one that the scenario leaves at its default.
    n_joints
        Number of joints, where one number stands for all of them and a joint is named.

    Raises
    ------
    InvalidParameter
        For a step that leads nowhere, and a kind or text that the section cannot have.
    """
    name = str(path[0])
    place = ".".join([component.path, *map(str, path)])
    if tuple(path) == (KIND,) or isinstance(value, str):
        return _with_text(component, path, value, place)
    if name not in parameters(component.kind):
        raise InvalidParameter(f"draws.{place}: {component.kind.__name__} has no {name}", f"draws.{place}")
    current = component.options.get(name, present)
    changed = replaced(current, path[1:], value, n_joints, place)
    return Component(component.path, component.kind, {**component.options, name: changed})


def _with_text(component: Component, path: Sequence[str | int], value: object, place: str) -> Component:
    """Return a component of another kind, or with another text; its keys and their types are checked."""
    is_file = component.kind is load_robot
    options = {"file" if is_file and name == "path" else name: given for name, given in component.options.items()}
    kind = {} if is_file else {KIND: component.kind.__name__}
    if len(path) > 1 or not isinstance(value, str):
        raise InvalidParameter(f"draws.{place}: got {value!r}; needs a choice of texts", f"draws.{place}")
    section = "estimator" if component.path.endswith("estimator") else component.path.split(".")[0]
    try:
        return check_component(section, {**kind, **options, str(path[0]): value}, component.path)
    except (InvalidParameter, ScenarioError) as error:
        raise InvalidParameter(f"draws.{place}: with {value!r}, {error}", f"draws.{place}") from None


def replaced(current: object, path: Sequence[str | int], value: object, n_joints: int, place: str) -> object:
    """Return a value with another one at a path inside it; the value itself stays as it is.

    Parameters
    ----------
    current
        A number, a list, or a mapping.
    path
        Steps: indices of lists, and keys of mappings; empty for the value itself.
    value
        What to put there.
    n_joints
        Length of the list for which one number stands.
    place
        Name of the value, for the messages.

    Raises
    ------
    InvalidParameter
        For a step that leads nowhere.
    """
    if not path:
        return value
    step = path[0]
    if isinstance(current, Mapping):
        if step not in current:
            names = list(map(str, current))
            raise InvalidParameter(
                f"draws.{place}: there is no {step!r}; known are {', '.join(names)}."
                f"{check.did_you_mean(str(step), names)}",
                f"draws.{place}",
            )
        return {**current, step: replaced(current[step], path[1:], value, n_joints, place)}
    if isinstance(current, int | float) and not isinstance(current, bool):
        current = [current] * n_joints
    if isinstance(current, np.ndarray):
        current = current.tolist()
    if not isinstance(current, Sequence) or isinstance(current, str):
        raise InvalidParameter(
            f"draws.{place}: the scenario has {current!r} there, which has no {step!r}; write the numbers in the "
            "scenario",
            f"draws.{place}",
        )
    if not isinstance(step, int) or step >= len(current):
        raise InvalidParameter(
            f"draws.{place}: got {step!r}, which is no index of {len(current)} numbers; use 0 to {len(current) - 1}",
            f"draws.{place}",
        )
    items: list[Any] = list(current)
    items[step] = replaced(items[step], path[1:], value, n_joints, place)
    return items


def value_at(current: object, path: Sequence[str | int]) -> float:
    """Return the number at a path inside a value; NaN where it is not there or the numbers at the place differ.

    Parameters
    ----------
    current
        A number, numbers in a list or array, a mapping, or an object with attributes. One number stands for all joints.
    path
        Steps: indices of lists, and keys of mappings.
    """
    for step in path:
        if isinstance(current, np.ndarray):
            current = current.tolist()
        if isinstance(current, Mapping):
            current = current.get(step)
        elif isinstance(step, str):
            known = current.parameters if isinstance(current, Plant) else {}
            current = known[step] if step in known else getattr(current, step, None)
        elif isinstance(current, Sequence) and not isinstance(current, str):
            current = current[step] if step < len(current) else None
    if current is None or isinstance(current, str | Mapping):
        return float("nan")
    try:
        numbers = np.unique(np.asarray(current, dtype=float))
    except (TypeError, ValueError):
        return float("nan")
    return float(numbers[0]) if len(numbers) == 1 else float("nan")
