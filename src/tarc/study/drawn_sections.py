"""Sections of a scenario with drawn values in them."""

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass, replace
from typing import Any

import numpy as np

from tarc.scenario.model import Scenario
from tarc.scenario.parts import Sections, Setup
from tarc.scenario.schema import Component
from tarc.study.drawn_keys import KIND, NUMBERS, DrawnKey, components_of, replaced, with_value


class DrawnSections:
    """Puts drawn values into the sections of a scenario.

    Parameters
    ----------
    scenario, nominal
        The scenario without draws, and its constructed parts.
    keys
        Places of the drawn values.
    """

    def __init__(self, scenario: Scenario, nominal: Setup, keys: Sequence[DrawnKey]):
        self._scenario, self._nominal, self._keys = scenario, nominal, keys
        self._laws = {key: set(components_of(scenario, key)) for key in keys if key.section not in NUMBERS}

    def is_drawn(self, section: str) -> bool:
        """Return whether a section has drawn keys."""
        return any(key.section == section for key in self._keys)

    def laws_with(self, key: DrawnKey) -> set[str]:
        """Return the names of the laws that have a key; of a key that is not of laws, those of its section."""
        return self._laws[key]

    def with_values(self, values: Mapping[DrawnKey, Any]) -> Sections:
        """Return the sections with values at some keys; kinds go first, since they decide which keys there are."""
        sections = self._scenario.sections
        for key, value in sorted(values.items(), key=lambda item: item[0].path[-1:] != (KIND,)):
            if key.section not in NUMBERS:
                sections = self._with_value(sections, key, value)
        return sections

    def number(self, name: str, values: Mapping[DrawnKey, Any]) -> Any:
        """Return a key of the scenario itself, with its drawn values."""
        current: Any = getattr(self._scenario, name)
        for key, value in values.items():
            if key.section == name:
                if current is None:
                    current = self._nominal.reference.sample(np.zeros(1))[0][:, 0].tolist()
                current = replaced(current, key.path, value, self._nominal.plant.n_joints, name)
        return current

    def _with_value(self, sections: Sections, key: DrawnKey, value: object) -> Sections:
        """Return sections with the value of one key."""
        targets = self.laws_with(key)
        if key.section == "disturbance":
            assert key.item is not None
            events = list(sections.disturbances)
            events[key.item] = self._changed(events[key.item], key.path, value)
            return replace(sections, disturbances=events)
        if not key.is_of_law:
            component = self._changed(getattr(sections, key.section), key.path, value)
            return replace(sections, **{key.section: component})
        laws = {}
        changed: dict[int, Component] = {}  # laws with the same estimator keep sharing it
        for name, (law, estimator) in sections.laws.items():
            if name in targets and key.is_of_estimator:
                path = key.path if key.section == "estimator" else key.path[1:]
                if id(estimator) not in changed:
                    changed[id(estimator)] = self._changed(estimator, path, value)
                estimator = changed[id(estimator)]
            elif name in targets:
                law = self._changed(law, key.path, value)
            laws[name] = law, estimator
        return replace(sections, laws=laws)

    def _changed(self, component: Component, path: tuple[str | int, ...], value: object) -> Component:
        """Return a component with another value at a path."""
        plant = self._nominal.plant
        present = _default(component, str(path[0]))
        if present is None and component.path == "robot":
            present = plant.parameters.get(str(path[0]))
        return with_value(component, path, value, present, plant.n_joints)


def _default(component: Component, name: str) -> Any:
    """Return the default of a component's parameter; None where it has none."""
    if is_dataclass(component.kind):
        for field in fields(component.kind):
            if field.name == name and field.default is not MISSING:
                return field.default
    return None
