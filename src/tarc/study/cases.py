"""Cases of a study: the parts of a loop with the drawn values of one run."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import islice, product
from typing import TYPE_CHECKING, Any

import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.plants.base import Plant
from tarc.plants.gearbox import PREFIX
from tarc.scenario.cartesian import CartesianWaypoints
from tarc.scenario.model import Scenario
from tarc.scenario.parts import POSTURES_OF_MEAN_INERTIA, Sections
from tarc.scenario.schema import Component
from tarc.signals.disturbances import ParameterSchedule
from tarc.simulation.varying import DRAWN_BEFORE
from tarc.study.distributions import Choice, Distribution
from tarc.study.drawn_case import Case, applied_number, applied_text
from tarc.study.drawn_keys import NUMBERS, DrawnKey, find_key
from tarc.study.drawn_robot import DrawnRobot
from tarc.study.drawn_sections import DrawnSections

if TYPE_CHECKING:
    from tarc.study.specification import Study

MAX_CHOSEN = 256
"""Largest number of choices of law keys whose laws are kept."""

IN_LOOP = ("law", "estimator", "sensor", "torque_limits", "drive", "computation_delay")
"""Sections whose numbers are part of a traced loop, beside those of the robot."""

EXAMPLES = 4
"""Cases from which is seen what varies from run to run."""

TYPICAL = 0.4
"""Probability of the quantiles of a typical row."""


class Cases:
    """Builds the cases of a study: only what has drawn keys is built anew.

    Laws are built from the scenario as written, but for their own keys and those that the study says they know.

    Parameters
    ----------
    study
        The study.

    Attributes
    ----------
    scenario
        The scenario without draws.
    nominal
        Its constructed parts.
    keys, distributions
        Places of the drawn keys and their distributions, in the order of the columns.
    plant_parameters
        Names of the parameters of the simulated plant that are drawn; its equations stay the same then.
    typical_row
        A row of values near the medians.
    plant_is_rebuilt
        Whether draws change the plant beyond its parameters, so that its equations are derived for each case.

    Raises
    ------
    InvalidParameter
        For a key that cannot be read back, and a schedule that hides a drawn parameter.
    """

    def __init__(self, study: "Study"):
        self.scenario: Scenario = study.undrawn_scenario
        self.keys = [find_key(self.scenario, name) for name in study.draws]
        self._known = set(study.known)
        self.distributions = list(study.distributions.values())
        self.nominal = self.scenario.build()
        self.law_names = list(self.nominal.laws)
        self._mean_inertia: Array | None = None
        self._chosen_laws: dict[tuple[float, ...], dict[str, Law]] = {}
        self._choices = [column for column in range(len(self.keys)) if self._is_structural(column)]
        self.typical_row = np.array([d.quantile(np.array([TYPICAL]))[0] for d in self.distributions])
        self._refuse_hidden()
        self._sections = DrawnSections(self.scenario, self.nominal, self.keys)
        typical = self._plain(self.typical_row)
        self._robot = DrawnRobot(self._sections, self.nominal, self.keys, self.distributions, typical)
        self.plant_parameters, self.plant_is_rebuilt = self._robot.parameters, self._robot.is_rebuilt

    @property
    def typical_rows(self) -> list[Array]:
        """Return a typical row for each combination of texts, of many the first `MAX_CHOSEN`."""
        columns = [column for column, one in enumerate(self.distributions) if one.texts]
        choices = [range(len(self.distributions[column].texts)) for column in columns]
        rows = []
        for numbers in islice(product(*choices), MAX_CHOSEN):
            row = self.typical_row.copy()
            row[columns] = numbers
            rows.append(row)
        return rows

    @property
    def has_known(self) -> bool:
        """Return whether the laws are built with some of the drawn values."""
        return bool(self._known)

    def _is_structural(self, column: int) -> bool:
        """Return whether a column is a choice between loops, and not of numbers of the robot or inputs."""
        one, key = self.distributions[column], self.keys[column]
        return isinstance(one, Choice) and bool(one.texts or key.section in IN_LOOP)

    def examples(self, choices: Sequence[float]) -> list[Case]:
        """Return the cases of `example_rows`, with these choices."""
        rows = self.example_rows()
        rows[:, self._choices] = choices
        return [self.build(row) for row in rows]

    def example_rows(self) -> Array:
        """Return rows that show what varies from run to run; they depend on the study alone."""
        probabilities = np.random.default_rng(0).uniform(0.05, 0.95, (EXAMPLES, len(self.keys)))
        return np.array([d.quantile(column) for d, column in zip(self.distributions, probabilities.T, strict=True)]).T

    @property
    def has_loop_keys(self) -> bool:
        """Return whether numbers of the traced loop are drawn beside the robot's, or laws know some of those."""
        columns = [column for column in range(len(self.keys)) if column not in self._choices]
        return self.has_known or any(
            self.keys[column].section in IN_LOOP and self.keys[column].path[0] not in DRAWN_BEFORE for column in columns
        )

    def build(self, row: Array) -> Case:
        """Return the case of a row of drawn values, (keys,).

        Raises
        ------
        InvalidParameter
            For a value that a part refuses, and for a part with another value than the drawn one. The message has key,
            drawn and applied value.
        """
        values = self._plain(row)
        parts = self._sections.with_values(values)
        plant, simulated = self._robot.with_values(values, parts)
        reference = self.nominal.reference
        if self._sections.is_drawn("reference"):
            reference = self._reference(parts.reference, self.nominal.plant)
        setup = replace(
            self.nominal,
            plant=plant,
            simulated=simulated,
            reference=reference,
            sensor=parts.sensor.build() if self._sections.is_drawn("sensor") else self.nominal.sensor,
            torque_limits=self._optional("torque_limits", parts),
            drive=self._optional("drive", parts),
            events=self._events(parts),
            laws=self._laws(values, parts, row),
        )
        numbers = {name: self._sections.number(name, values) for name in NUMBERS}
        case = Case(setup, **numbers, applied={}, choices=tuple(map(float, row[self._choices])))
        for (key, value), number in zip(values.items(), row, strict=True):
            laws = self._sections.laws_with(key) if key.is_of_law else ()
            if isinstance(value, str):
                robot = plant if self._robot.is_rebuilt else self._robot.with_texts(values)[0]
                case.applied[key.name] = applied_text(key, value, float(number), case, laws, robot)
            else:
                known = self._known_values(values)
                case.applied[key.name] = applied_number(
                    key, float(value), case, laws, lambda known=known: self._mean_inertia_for(known)
                )
        return case

    def _plain(self, row: Array) -> dict[DrawnKey, Any]:
        """Return drawn values by key, as a scenario has them."""
        pairs = zip(self.keys, self.distributions, np.asarray(row, dtype=float), strict=True)
        return {key: distribution.plain(value) for key, distribution, value in pairs}

    def _optional(self, section: str, parts: Sections) -> Any:
        """Return torque limits or drive: those of the scenario where they are not drawn."""
        if not self._sections.is_drawn(section):
            return getattr(self.nominal, section)
        component: Component = getattr(parts, section)
        return component.build()

    def _events(self, parts: Sections) -> list[Any]:
        """Return the disturbances, those with drawn keys anew."""
        drawn = {key.item for key in self.keys if key.section == "disturbance"}
        return [
            parts.disturbances[number].build() if number in drawn else event
            for number, event in enumerate(self.nominal.events)
        ]

    def _reference(self, component: Component, plant: Plant) -> Any:
        """Construct a reference."""
        more = {"robot": plant} if component.kind is CartesianWaypoints else {}
        return component.build(**more).for_run(plant.joint_names, self.scenario.duration)

    def _laws(self, values: Mapping[DrawnKey, Any], parts: Sections, row: Array) -> dict[str, Law]:
        """Return the laws, those with drawn or known keys anew; the same choice has the same objects."""
        known = self._known_values(values)
        own = [key for key in self.keys if key.is_of_law]
        if not known and not own:
            return self.nominal.laws
        is_chosen = not known and all(isinstance(self._distribution(key), Choice) for key in own)
        place = tuple(float(row[self.keys.index(key)]) for key in own)
        if is_chosen and place in self._chosen_laws:
            return self._chosen_laws[place]
        plant, reference = self._known_robot(known)
        affected = set(parts.laws) if known else {name for key in own for name in self._sections.laws_with(key)}
        chosen = {name: part for name, part in parts.laws.items() if name in affected}
        built = self.scenario.with_sections(replace(parts, laws=chosen)).build_laws(plant, reference)
        laws = {name: built.get(name, law) for name, law in self.nominal.laws.items()}
        if is_chosen and len(self._chosen_laws) < MAX_CHOSEN:
            self._chosen_laws[place] = laws
        return laws

    def _distribution(self, key: DrawnKey) -> Distribution:
        return self.distributions[self.keys.index(key)]

    def _known_values(self, values: Mapping[DrawnKey, Any]) -> dict[DrawnKey, Any]:
        """Return those of the values that the laws are built with."""
        return {key: value for key, value in values.items() if key.name in self._known}

    def _known_robot(self, known: Mapping[DrawnKey, Any]) -> tuple[Plant, Any]:
        """Return the robot and the reference that the laws are built for."""
        reference, parts = self.nominal.reference, self._sections.with_values(known)
        plant = self._robot.known_by_laws(known, parts)
        if any(key.section == "reference" for key in known):
            reference = self._reference(parts.reference, plant)
        return plant, reference

    def _mean_inertia_for(self, known: Mapping[DrawnKey, Any]) -> Array:
        """Return the mean inertia along the reference of the robot that the laws are built for."""
        if known or self._mean_inertia is None:
            plant, reference = self._known_robot(known)
            postures = reference.sample(np.linspace(0, self.scenario.duration, POSTURES_OF_MEAN_INERTIA))[0]
            self._mean_inertia = plant.mean_inertia(postures)
        return self._mean_inertia

    def _refuse_hidden(self) -> None:
        """Refuse a drawn parameter that a schedule replaces from the start."""
        for number, event in enumerate(self.nominal.events):
            if not isinstance(event, ParameterSchedule) or not float(np.ravel(event.times)[0]) <= 0:
                continue
            for key in self.keys:
                name = f"{PREFIX if key.section == 'gearbox' else ''}{key.path[0] if key.path else ''}"
                if key.section in ("robot", "gearbox") and name == event.parameter:
                    raise InvalidParameter(
                        f"draws.{key.name}: disturbance.{number} sets {name} from the start, so that the draw has no "
                        f"effect; draw disturbance.{number}.values.0 instead, or let the schedule begin later",
                        f"draws.{key.name}",
                    )
