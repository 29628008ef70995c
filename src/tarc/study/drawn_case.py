"""The parts of a loop with the drawn values of one run, and those values as the parts have them."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.laws.nominal_inertia import NominalInertia
from tarc.plants.base import Plant
from tarc.plants.gearbox import PREFIX
from tarc.scenario.parts import Setup
from tarc.study.drawn_keys import KIND, NUMBERS, DrawnKey, value_at

READ_BACK_TOLERANCE = 1e-9
"""Relative difference between a drawn value and the one that was read back that counts as rounding."""


@dataclass(frozen=True, eq=False)
class Case:
    """Constructed parts of one run, with its drawn values in them.

    Attributes
    ----------
    setup
        Plants, reference, sensor and so on; parts without drawn keys are the same objects in all cases.
    initial_position, initial_velocity, initial_torque, computation_delay, jitter
        As in `tarc.simulate`.
    applied
        Values that were read back from the parts, by key: a number, or (laws,) for keys of laws, NaN for a law without
        the key. Of a text it is its number among those of the choice.
    choices
        Numbers of the drawn texts, and drawn choices of law, sensor, drive and the like. Cases with the same ones have
        loops of one structure.
    """

    setup: Setup
    initial_position: Any
    initial_velocity: Any
    initial_torque: Any
    computation_delay: int
    jitter: float
    applied: dict[str, float | Array]
    choices: tuple[float, ...] = ()


def applied_number(
    key: DrawnKey, drawn: float, case: Case, laws: Collection[str], mean_inertia: Callable[[], Array]
) -> float | Array:
    """Return the value of a key as the parts of a case have it: a number, or one per law, NaN without the key.

    Parameters
    ----------
    key, drawn
        Place of a number in the scenario, and its drawn value.
    case
        The case.
    laws
        Names of the laws that have the key.
    mean_inertia
        Gives the matrix [kg m² or kg] of which an inertia may be a fraction.

    Raises
    ------
    InvalidParameter
        For a value that differs from the drawn one.
    """
    if not key.is_of_law:
        applied = _part_value(key, case)
        _require_equal(key, drawn, applied)
        return applied
    values = np.full(len(case.setup.laws), np.nan)
    for place, (name, law) in enumerate(case.setup.laws.items()):
        if name in laws:
            values[place] = _law_value(key, law, mean_inertia)
            _require_equal(key, drawn, values[place], f" of {name}")
    return values


def applied_text(
    key: DrawnKey, drawn: str, number: float, case: Case, laws: Collection[str], robot: Plant
) -> float | Array:
    """Return the number of a drawn text where the parts of a case have the text; one per law, NaN without the key.

    Parameters
    ----------
    key, drawn, number
        Place of a text in the scenario, the drawn text, and its number among those of the choice.
    case, laws
        As for `applied_number`.
    robot
        The robot with the texts of the case.

    Raises
    ------
    InvalidParameter
        For another text than the drawn one.
    """
    if not key.is_of_law:
        _require_text(key, drawn, _part_text(key, case, robot))
        return number
    values = np.full(len(case.setup.laws), np.nan)
    for place, (name, law) in enumerate(case.setup.laws.items()):
        if name in laws:
            _require_text(key, drawn, _text_at(law.estimator if key.is_of_estimator else law, str(key.path[-1])))
            values[place] = number
    return values


def _law_value(key: DrawnKey, law: Law, mean_inertia: Callable[[], Array]) -> float:
    """Return the value of a key as a law has it."""
    path = ("estimator", *key.path) if key.section == "estimator" else key.path
    name, steps = str(path[0]), path[1:]
    value = getattr(law, name, None)
    if name != "inertia" or isinstance(value, NominalInertia):
        return value_at(value, steps)
    matrix = np.asarray(value, dtype=float)
    diagonal = np.diag(matrix) if matrix.ndim == 2 else matrix
    if steps == ("fraction",):
        return float(np.sum(diagonal) / np.trace(mean_inertia()))
    return value_at(diagonal if len(steps) < 2 else matrix, steps)


def _part_value(key: DrawnKey, case: Case) -> float:
    """Return the value of a key as plant, sensor, drive, reference, disturbance or start have it."""
    if key.section in NUMBERS:
        return value_at(getattr(case, key.section), key.path)
    name, steps = str(key.path[0]), key.path[1:]
    if key.section in ("robot", "gearbox"):
        return _plant_value(case.setup.simulated, name, steps, PREFIX if key.section == "gearbox" else "")
    if key.section == "disturbance":
        assert key.item is not None
        part = case.setup.events[key.item]
    else:
        part = getattr(case.setup, key.section)
    return value_at(getattr(part, name, None), steps)


def _plant_value(plant: Plant, name: str, steps: tuple[str | int, ...], prefix: str) -> float:
    """Return a value of a plant: a parameter, a gain of its loops, or its home posture."""
    parameters = plant.parameters
    if f"{prefix}{name}" in parameters:
        return value_at(parameters[f"{prefix}{name}"], steps)
    servo = getattr(plant, "servo", None)
    loop_gains = {"kp": "stiffness", "kd": "damping"}
    if not prefix and servo is not None and name in loop_gains:
        return value_at(getattr(servo, loop_gains[name]), steps)
    return value_at(getattr(plant, name, None), steps)


def _part_text(key: DrawnKey, case: Case, robot: Plant) -> object:
    """Return the text of a key as robot, gearbox, sensor, drive, reference or disturbance has it."""
    name = str(key.path[-1])
    if key.section == "robot":
        return robot.file_options.get(name) if name == "file" else _text_at(robot, name)
    if key.section == "disturbance":
        assert key.item is not None
        return _text_at(case.setup.events[key.item], name)
    part = case.setup.simulated if key.section == "gearbox" else getattr(case.setup, key.section)
    return _text_at(part, name)


def _text_at(part: object, name: str) -> object:
    return type(part).__name__ if name == KIND else getattr(part, name, None)


def _require_equal(key: DrawnKey, drawn: float, applied: float, owner: str = "") -> None:
    """Refuse a value that is not the drawn one."""
    if abs(applied - drawn) <= READ_BACK_TOLERANCE * abs(drawn):
        return
    what = "cannot be read back" if np.isnan(applied) else f"is {applied:.9g}"
    raise InvalidParameter(
        f"draws.{key.name}: {drawn:.9g} was drawn, and the applied value{owner} {what}: the draw does not reach "
        "what is simulated. Draw another key, or write the part of the scenario so that this key is the number itself",
        f"draws.{key.name}",
    )


def _require_text(key: DrawnKey, drawn: str, applied: object) -> None:
    """Refuse a text that is not the drawn one."""
    if drawn.rpartition(":")[2] != str(applied).rpartition(":")[2]:
        raise InvalidParameter(
            f"draws.{key.name}: {drawn!r} was drawn, and the part has {applied!r}: the draw does not reach what is "
            "simulated. Draw another key",
            f"draws.{key.name}",
        )
