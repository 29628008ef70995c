"""Constructs the laws of a scenario: each with its estimator, and with inertia, model and limits of the robot."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.estimators.base import Estimator
from tarc.laws.base import Law
from tarc.laws.nominal_inertia import Feedforward, NominalInertia
from tarc.plants.base import Plant
from tarc.scenario.known_model import model_terms
from tarc.scenario.parts import MeanInertia
from tarc.scenario.schema import Component
from tarc.scenario.user_law import check_user_law, is_from_file


def build_laws(
    parts: Mapping[str, tuple[Component, Component]], period: float, plant: Plant, mean_inertia: MeanInertia
) -> dict[str, Any]:
    """Construct laws by name from each one's component and its estimator's; laws with the same estimator share it."""
    estimators: dict[int, Estimator] = {}
    laws = {}
    for name, (part, estimator) in parts.items():
        if id(estimator) not in estimators:
            estimators[id(estimator)] = estimator.build(period=period)
        laws[name] = _build(part, estimators[id(estimator)], period, plant, mean_inertia)
    return laws


def build_law(part: Component, estimator: Component, period: float, plant: Plant, mean_inertia: MeanInertia) -> Law:
    """Construct one law with its estimator."""
    return _build(part, estimator.build(period=period), period, plant, mean_inertia)


def _build(part: Component, estimator: Estimator, period: float, plant: Plant, mean_inertia: MeanInertia) -> Law:
    """Construct a law with the robot's inertia or model and its torque limits."""
    more: dict[str, Any] = {"period": period, "estimator": estimator}
    inertia = part.options.get("inertia")
    if isinstance(inertia, dict) and "model" in inertia:
        more["inertia"] = model_terms(NominalInertia, inertia, f"{part.path}.inertia", plant)
    elif isinstance(inertia, dict):
        more["inertia"] = _fraction(inertia, part.path, mean_inertia)
    elif isinstance(inertia, int | float):
        more["inertia"] = np.full(plant.n_joints, inertia)
    if part.options.get("model") is not None:
        check.one_of(f"{part.path}.model", part.options["model"], ["robot"])
        more["model"] = plant
    if part.options.get("feedforward") is not None:
        more["feedforward"] = model_terms(Feedforward, part.options["feedforward"], f"{part.path}.feedforward", plant)
    limits = getattr(plant, "torque_limits", None)
    if part.options.get("torque_limit") is None and limits is not None and np.any(np.isfinite(limits)):
        more["torque_limit"] = limits
    law = part.build(**more)
    if is_from_file(law):
        check_user_law(law, part.path)
    return law


def _fraction(given: dict[str, Any], path: str, mean_inertia: MeanInertia) -> Array:
    """Return the fraction of the robot's mean inertia along the reference."""
    for key in given:
        if key not in ("fraction", "diagonal"):
            raise InvalidParameter(
                f"{path}.inertia.{key}: unknown key; it has fraction and diagonal, or model and fraction."
                f"{check.did_you_mean(str(key), ['fraction', 'diagonal', 'model'])}",
                f"{path}.inertia.{key}",
            )
    fraction = check.number(f"{path}.inertia.fraction", given.get("fraction"), 0, strict=True)
    mean = mean_inertia.matrix
    return fraction * (np.diag(np.diag(mean)) if given.get("diagonal") else mean)
