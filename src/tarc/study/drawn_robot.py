"""The robot of a study's runs: with drawn parameters in its equations, or built anew."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.plants.base import Plant
from tarc.plants.gearbox import PREFIX
from tarc.plants.symbolic import SymbolicPlant
from tarc.scenario.parts import Sections, Setup
from tarc.study.distributions import Distribution
from tarc.study.drawn_keys import DrawnKey
from tarc.study.drawn_sections import DrawnSections


class DrawnRobot:
    """Builds the robot of a run, and the one behind its gearbox.

    Parameters
    ----------
    sections, nominal
        The sections of the scenario, and its constructed parts.
    keys, distributions
        Places of the drawn values, and their distributions.
    typical
        Values near the medians, by key.

    Attributes
    ----------
    parameters
        Names of the drawn parameters of the simulated robot; None where a key is no parameter.
    is_rebuilt
        Whether draws change the robot beyond its parameters, so that its equations are derived for each case.
    """

    def __init__(
        self,
        sections: DrawnSections,
        nominal: Setup,
        keys: Sequence[DrawnKey],
        distributions: Sequence[Distribution],
        typical: Mapping[DrawnKey, Any],
    ):
        self._sections, self._nominal = sections, nominal
        self._built: dict[tuple[str, ...], tuple[Plant, Plant]] = {}
        self.parameters = self._drawn_parameters(keys, distributions)
        self.is_rebuilt = self.parameters is None
        if self.is_drawn and not self.is_rebuilt:
            self.is_rebuilt = not self._shares_equations(typical)

    @property
    def is_drawn(self) -> bool:
        """Return whether robot or gearbox have drawn keys."""
        return self._sections.is_drawn("robot") or self._sections.is_drawn("gearbox")

    def with_values(self, values: Mapping[DrawnKey, Any], parts: Sections) -> tuple[Plant, Plant]:
        """Return the robot with drawn values, and the one behind its gearbox."""
        if not self.is_drawn:
            return self._nominal.plant, self._nominal.simulated
        if self.is_rebuilt:
            return self.build(parts)
        plant, simulated = self.with_texts(values)
        own, geared = _numbers(values, "robot"), _numbers(values, "gearbox")
        changed = _parameter_values(simulated, own, "") | _parameter_values(simulated, geared, PREFIX)
        if own:
            plant = _with_parameters(plant, _parameter_values(plant, own, ""), "robot")
        if parts.gearbox is None:
            return plant, plant
        return plant, _with_parameters(simulated, changed, "robot" if own else "gearbox") if changed else simulated

    def known_by_laws(self, values: Mapping[DrawnKey, Any], parts: Sections) -> Plant:
        """Return the robot, without gearbox, with those drawn values alone that laws know."""
        own = {key: value for key, value in values.items() if key.section == "robot"}
        if not own:
            return self._nominal.plant
        if self.is_rebuilt:
            return parts.robot.build()
        (plant, _), numbers = self.with_texts(own), _numbers(own, "robot")
        return _with_parameters(plant, _parameter_values(plant, numbers, ""), "robot") if numbers else plant

    def with_texts(self, values: Mapping[DrawnKey, Any]) -> tuple[Plant, Plant]:
        """Return robot, and robot behind its gearbox, with the drawn texts alone; each is built once."""
        texts = {
            key: value
            for key, value in values.items()
            if isinstance(value, str) and key.section in ("robot", "gearbox")
        }
        if not texts:
            return self._nominal.plant, self._nominal.simulated
        names = tuple(texts.values())
        if names not in self._built:
            built = self.build(self._sections.with_values(texts))
            if isinstance(built[1], SymbolicPlant) != isinstance(self._nominal.simulated, SymbolicPlant):
                keys = ", ".join(f"draws.{key.name}" for key in texts)
                raise InvalidParameter(
                    f"{keys}: with {', '.join(names)} the robot is simulated by another engine than in the scenario as "
                    "written; draw robots that are all simulated in symbols, or all in MuJoCo"
                )
            self._built[names] = built
        return self._built[names]

    def build(self, parts: Sections) -> tuple[Plant, Plant]:
        """Construct robot and gearbox from their sections."""
        plant = parts.robot.build() if self._sections.is_drawn("robot") else self._nominal.plant
        return plant, plant if parts.gearbox is None else parts.gearbox.build(plant=plant)

    def _drawn_parameters(
        self, keys: Sequence[DrawnKey], distributions: Sequence[Distribution]
    ) -> tuple[str, ...] | None:
        """Return the drawn parameters of the simulated plant; None where a key is no parameter."""
        names = []
        available = self._nominal.simulated.parameters
        for key, distribution in zip(keys, distributions, strict=True):
            if key.section not in ("robot", "gearbox") or distribution.texts:
                continue
            name = f"{PREFIX if key.section == 'gearbox' else ''}{key.path[0]}"
            is_entry = len(key.path) == 1 or (
                len(key.path) == 2 and isinstance(key.path[1], int) and np.ndim(available.get(name, 0.0)) == 1
            )
            if name not in available or not is_entry:
                return None
            names.append(name)
        return tuple(dict.fromkeys(names))

    def _shares_equations(self, values: Mapping[DrawnKey, Any]) -> bool:
        """Return whether the robot with typical drawn parameters is the one that its section builds."""
        parts = self._sections.with_values(values)
        _, shared = self.with_values(values, parts)
        _, built = self.build(parts)
        own, theirs = shared.parameters, built.parameters
        if any(not np.allclose(own[name], theirs[name], rtol=1e-12, atol=0) for name in theirs):
            return False
        if not isinstance(shared, SymbolicPlant) or not isinstance(built, SymbolicPlant):
            return True
        q = built.coordinates(built.home)
        inputs = np.ones(np.shape(built.joint_input(np.ones(built.n_joints), np.ones(built.n_joints))))
        expected = built.evaluate("acceleration", q, 0.1 + 0 * q, inputs)
        _, symbolic = self.with_texts(values)
        assert isinstance(symbolic, SymbolicPlant)
        traced = symbolic.evaluate("acceleration", q, 0.1 + 0 * q, inputs, parameters=own)
        return bool(np.allclose(traced, expected, rtol=1e-9, atol=0))


def _numbers(values: Mapping[DrawnKey, Any], section: str) -> dict[DrawnKey, float]:
    """Return those of the values that are numbers of a section."""
    return {key: value for key, value in values.items() if key.section == section and not isinstance(value, str)}


def _parameter_values(plant: Plant, values: Mapping[DrawnKey, Any], prefix: str) -> dict[str, Array]:
    """Return the parameters of a plant with drawn values, by name."""
    changed: dict[str, Array] = {}
    for key, value in values.items():
        name = f"{prefix}{key.path[0]}"
        if name not in plant.parameters:
            raise InvalidParameter(f"draws.{key.name}: {plant.label} has no such parameter", f"draws.{key.name}")
        array = changed.setdefault(name, np.array(plant.parameters[name], dtype=float))
        place = tuple(int(step) for step in key.path[1:])
        array[place if place else ...] = value
    return changed


def _with_parameters(plant: Plant, values: dict[str, Array], section: str) -> Plant:
    """Return a plant with other parameters; a refused one gets its section in the scenario."""
    try:
        return plant.with_parameters(values)
    except InvalidParameter as error:
        raise InvalidParameter(f"{section}.{error}", f"{section}.{error.path}".rstrip(".")) from None
