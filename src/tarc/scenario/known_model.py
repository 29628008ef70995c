"""Models of the robot in a scenario's laws: ``inertia: {model: true}`` and ``feedforward: {model: true}``."""

from dataclasses import fields
from typing import Any, TypeVar

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.laws.nominal_inertia import ModelTerms
from tarc.plants.base import Plant
from tarc.scenario.schema import check_component

T = TypeVar("T", bound=ModelTerms)
"""NominalInertia or Feedforward."""


def model_terms(kind: type[T], given: dict[str, Any], path: str, plant: Plant) -> T:
    """Return the M̂(q) or the feed-forward that a law's section describes.

    Parameters
    ----------
    kind
        `NominalInertia` or `Feedforward`.
    given
        ``model`` and the parameters of the kind. The model is ``true`` for the scenario's robot, other values of its
        parameters by name, or a robot of its own with ``file`` or ``kind``.
    path
        Place of the section in the scenario, for the messages.
    plant
        The scenario's robot.

    Raises
    ------
    InvalidParameter
        For unknown and missing keys, a model of other joints, and what the kind refuses.
    """
    if not isinstance(given, dict):
        raise InvalidParameter(f"{path}: got {given!r}; needs keys and values, such as model: true", path)
    keys = [field.name for field in fields(kind)]
    for key in given:
        if key not in keys:
            raise InvalidParameter(
                f"{path}.{key}: unknown key; it has {', '.join(keys)}.{check.did_you_mean(str(key), keys)}",
                f"{path}.{key}",
            )
    for key in ("model", "fraction"):
        if key in keys and key not in given:
            example = "true" if key == "model" else "0.05"
            raise InvalidParameter(f"{path}.{key}: missing; give it, such as {key}: {example}", f"{path}.{key}")
    model = _model(given["model"], f"{path}.model", plant)
    try:
        return kind(**{**given, "model": model})
    except InvalidParameter as error:
        raise InvalidParameter(f"{path}.{error}", f"{path}.{error.path}".rstrip(".")) from None


def _model(given: object, path: str, plant: Plant) -> Plant:
    """Return the robot that ``true``, a mapping of parameters or a robot of its own describes."""
    if given is True:
        return plant
    if not isinstance(given, dict) or not given:
        raise InvalidParameter(
            f"{path}: got {given!r}; needs true for the robot itself, values of its parameters such as {{payload: 0}}, "
            "or a robot with file or kind",
            path,
        )
    if "file" not in given and "kind" not in given:
        for name in given:
            check.one_of(path, str(name), plant.parameters)
        try:
            return plant.with_parameters(given)
        except InvalidParameter as error:
            raise InvalidParameter(f"{path}.{error}", f"{path}.{error.path}".rstrip(".")) from None
    model = check_component("robot", given, path).build()
    if model.n_joints != plant.n_joints or model.units != plant.units:
        joints = (f"{', '.join(robot.joint_names)} [{', '.join(robot.units)}]" for robot in (model, plant))
        raise InvalidParameter("{}: its joints are {}, those of the robot {}".format(path, *joints), path)
    if model.joint_names != plant.joint_names and set(model.joint_names) == set(plant.joint_names):
        raise InvalidParameter(
            f"{path}: its joints are in the order {', '.join(model.joint_names)}, those of the robot in the order "
            f"{', '.join(plant.joint_names)}; list the joints in the same order",
            path,
        )
    return model
