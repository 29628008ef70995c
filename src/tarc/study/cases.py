"""Cases of a study: the parts of a loop with the drawn values of one run."""

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from itertools import islice, product
from typing import TYPE_CHECKING, Any

import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.laws.nominal_inertia import NominalInertia
from tarc.plants.base import Plant
from tarc.plants.gearbox import PREFIX
from tarc.plants.symbolic import SymbolicPlant
from tarc.scenario.cartesian import CartesianWaypoints
from tarc.scenario.model import Scenario
from tarc.scenario.parts import POSTURES_OF_MEAN_INERTIA, Sections, Setup
from tarc.scenario.schema import Component
from tarc.signals.disturbances import ParameterSchedule
from tarc.simulation.varying import DRAWN_BEFORE
from tarc.study.distributions import Choice, Distribution
from tarc.study.drawn_keys import KIND, NUMBERS, DrawnKey, components_of, find_key, replaced, value_at, with_value

if TYPE_CHECKING:
    from tarc.study.specification import Study

READ_BACK_TOLERANCE = 1e-9
"""Relative difference between a drawn value and the one that was read back that counts as rounding."""

MAX_CHOSEN = 256
"""Largest number of choices of law keys whose laws are kept."""

IN_LOOP = ("law", "estimator", "sensor", "torque_limits", "drive", "computation_delay")
"""Sections whose numbers are part of a traced loop, beside those of the robot."""

EXAMPLES = 4
"""Cases from which is seen what varies from run to run."""

TYPICAL = 0.4
"""Probability of the quantiles of a typical row."""


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
        self._targets = {key: set(components_of(self.scenario, key)) for key in self.keys if key.section not in NUMBERS}
        self._known = set(study.known)
        self.distributions = list(study.distributions.values())
        self.nominal = self.scenario.build()
        self.law_names = list(self.nominal.laws)
        self.plant_parameters = self._drawn_parameters()
        self.plant_is_rebuilt = self.plant_parameters is None
        self._mean_inertia: Array | None = None
        self._robots: dict[tuple[str, ...], tuple[Plant, Plant]] = {}
        self._chosen_laws: dict[tuple[float, ...], dict[str, Law]] = {}
        self._choices = [column for column in range(len(self.keys)) if self._is_structural(column)]
        self.typical_row = np.array([d.quantile(np.array([TYPICAL]))[0] for d in self.distributions])
        self._refuse_hidden()
        if any(key.section in ("robot", "gearbox") for key in self.keys) and not self.plant_is_rebuilt:
            self.plant_is_rebuilt = not self._shares_equations()

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
        parts = self._sections(values)
        plant, simulated = self._plants(values, parts)
        reference = self.nominal.reference
        if self._is_drawn("reference"):
            reference = self._reference(parts.reference, self.nominal.plant)
        setup = replace(
            self.nominal,
            plant=plant,
            simulated=simulated,
            reference=reference,
            sensor=parts.sensor.build() if self._is_drawn("sensor") else self.nominal.sensor,
            torque_limits=self._optional("torque_limits", parts),
            drive=self._optional("drive", parts),
            events=self._events(parts),
            laws=self._laws(values, parts, row),
        )
        numbers = {name: self._number(name, values) for name in NUMBERS}
        case = Case(setup, **numbers, applied={}, choices=tuple(map(float, row[self._choices])))
        known = self._known_values(values)
        for (key, value), number in zip(values.items(), row, strict=True):
            if isinstance(value, str):
                robot = plant if self.plant_is_rebuilt else self._robot(values)[0]
                case.applied[key.name] = self._read_text(key, value, float(number), case, robot)
            else:
                case.applied[key.name] = self._read_back(key, float(value), case, known)
        return case

    def _plain(self, row: Array) -> dict[DrawnKey, Any]:
        """Return drawn values by key, as a scenario has them."""
        pairs = zip(self.keys, self.distributions, np.asarray(row, dtype=float), strict=True)
        return {key: distribution.plain(value) for key, distribution, value in pairs}

    def _is_drawn(self, section: str) -> bool:
        return any(key.section == section for key in self.keys)

    def _sections(self, values: Mapping[DrawnKey, Any]) -> Sections:
        """Return the sections of the scenario with drawn values."""
        sections = self.scenario.sections
        for key, value in sorted(values.items(), key=lambda item: item[0].path[-1:] != (KIND,)):
            if key.section not in NUMBERS:
                sections = self._with_value(sections, key, value)
        return sections

    def _with_value(self, sections: Sections, key: DrawnKey, value: object) -> Sections:
        """Return sections with the value of one key."""
        targets = self._targets[key]
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
            if name in targets and (key.section == "estimator" or key.path[0] == "estimator"):
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
        plant = self.nominal.plant
        present = _default(component, str(path[0]))
        if present is None and component.path == "robot":
            present = plant.parameters.get(str(path[0]))
        return with_value(component, path, value, present, plant.n_joints)

    def _number(self, name: str, values: Mapping[DrawnKey, Any]) -> Any:
        """Return a key of the scenario itself, with its drawn values."""
        current: Any = getattr(self.scenario, name)
        for key, value in values.items():
            if key.section == name:
                if current is None:
                    current = self.nominal.reference.sample(np.zeros(1))[0][:, 0].tolist()
                current = replaced(current, key.path, value, self.nominal.plant.n_joints, name)
        return current

    def _optional(self, section: str, parts: Sections) -> Any:
        """Return torque limits or drive: those of the scenario where they are not drawn."""
        if not self._is_drawn(section):
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

    def _plants(self, values: Mapping[DrawnKey, Any], parts: Sections) -> tuple[Plant, Plant]:
        """Return the robot, and the one behind its gearbox."""
        if not self._is_drawn("robot") and not self._is_drawn("gearbox"):
            return self.nominal.plant, self.nominal.simulated
        if self.plant_is_rebuilt:
            return self._built_plants(parts)
        plant, simulated = self._robot(values)
        numbers = {key: value for key, value in values.items() if not isinstance(value, str)}
        own = {key: value for key, value in numbers.items() if key.section == "robot"}
        geared = {key: value for key, value in numbers.items() if key.section == "gearbox"}
        changed = _parameter_values(simulated, own, "") | _parameter_values(simulated, geared, PREFIX)
        if own:
            plant = _with_values(plant, _parameter_values(plant, own, ""), "robot")
        if parts.gearbox is None:
            return plant, plant
        return plant, _with_values(simulated, changed, "robot" if own else "gearbox") if changed else simulated

    def _robot(self, values: Mapping[DrawnKey, Any]) -> tuple[Plant, Plant]:
        """Return robot, and robot behind its gearbox, with the drawn texts alone; each is built once."""
        texts = {key: text for key, text in _texts(values).items() if key.section in ("robot", "gearbox")}
        if not texts:
            return self.nominal.plant, self.nominal.simulated
        names = tuple(texts.values())
        if names not in self._robots:
            built = self._built_plants(self._sections(texts))
            if isinstance(built[1], SymbolicPlant) != isinstance(self.nominal.simulated, SymbolicPlant):
                keys = ", ".join(f"draws.{key.name}" for key in texts)
                raise InvalidParameter(
                    f"{keys}: with {', '.join(names)} the robot is simulated by another engine than in the scenario as "
                    "written; draw robots that are all simulated in symbols, or all in MuJoCo"
                )
            self._robots[names] = built
        return self._robots[names]

    def _built_plants(self, parts: Sections) -> tuple[Plant, Plant]:
        """Construct robot and gearbox from their sections."""
        plant = parts.robot.build() if self._is_drawn("robot") else self.nominal.plant
        return plant, plant if parts.gearbox is None else parts.gearbox.build(plant=plant)

    def _drawn_parameters(self) -> tuple[str, ...] | None:
        """Return the drawn parameters of the simulated plant; None where a key is no parameter."""
        names = []
        available = self.nominal.simulated.parameters
        for key, distribution in zip(self.keys, self.distributions, strict=True):
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

    def _shares_equations(self) -> bool:
        """Return whether the robot with typical drawn parameters is the one that its section builds."""
        values = self._plain(self.typical_row)
        parts = self._sections(values)
        _, shared = self._plants(values, parts)
        _, built = self._built_plants(parts)
        own, theirs = shared.parameters, built.parameters
        if any(not np.allclose(own[name], theirs[name], rtol=1e-12, atol=0) for name in theirs):
            return False
        if not isinstance(shared, SymbolicPlant) or not isinstance(built, SymbolicPlant):
            return True
        q = built.coordinates(built.home)
        inputs = np.ones(np.shape(built.joint_input(np.ones(built.n_joints), np.ones(built.n_joints))))
        expected = built.evaluate("acceleration", q, 0.1 + 0 * q, inputs)
        _, symbolic = self._robot(values)
        assert isinstance(symbolic, SymbolicPlant)
        traced = symbolic.evaluate("acceleration", q, 0.1 + 0 * q, inputs, parameters=own)
        return bool(np.allclose(traced, expected, rtol=1e-9, atol=0))

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
        affected = set(parts.laws) if known else {name for key in own for name in self._targets[key]}
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
        plant, reference = self.nominal.plant, self.nominal.reference
        robot = {key: value for key, value in known.items() if key.section == "robot"}
        parts = self._sections(known)
        if robot and self.plant_is_rebuilt:
            plant = parts.robot.build()
        elif robot:
            plant, _ = self._robot(robot)
            numbers = {key: value for key, value in robot.items() if not isinstance(value, str)}
            plant = _with_values(plant, _parameter_values(plant, numbers, ""), "robot") if numbers else plant
        if any(key.section == "reference" for key in known):
            reference = self._reference(parts.reference, plant)
        return plant, reference

    def _read_back(self, key: DrawnKey, drawn: float, case: Case, known: Mapping[DrawnKey, Any]) -> float | Array:
        """Return the value of a key as the parts have it, or refuse one that differs from the draw."""
        if not key.is_of_law:
            applied = _part_value(key, case)
            _require_equal(key, drawn, applied)
            return applied
        row = np.full(len(self.law_names), np.nan)
        for place, name in enumerate(self.law_names):
            if name in self._targets[key]:
                row[place] = self._law_value(key, case.setup.laws[name], known)
                _require_equal(key, drawn, row[place], f" of {name}")
        return row

    def _read_text(self, key: DrawnKey, drawn: str, number: float, case: Case, robot: Plant) -> float | Array:
        """Return the number of a drawn text where the parts have the text, or refuse another one."""
        if not key.is_of_law:
            _require_text(key, drawn, _part_text(key, case, robot))
            return number
        row = np.full(len(self.law_names), np.nan)
        for place, name in enumerate(self.law_names):
            if name in self._targets[key]:
                law = case.setup.laws[name]
                is_estimator = key.section == "estimator" or key.path[0] == "estimator"
                _require_text(key, drawn, _text_at(law.estimator if is_estimator else law, str(key.path[-1])))
                row[place] = number
        return row

    def _law_value(self, key: DrawnKey, law: Law, known: Mapping[DrawnKey, Any]) -> float:
        """Return the value of a key as a law has it."""
        path = ("estimator", *key.path) if key.section == "estimator" else key.path
        name, steps = str(path[0]), path[1:]
        value = getattr(law, name, None)
        if name != "inertia" or isinstance(value, NominalInertia):
            return value_at(value, steps)
        matrix = np.asarray(value, dtype=float)
        diagonal = np.diag(matrix) if matrix.ndim == 2 else matrix
        if steps == ("fraction",):
            return float(np.sum(diagonal) / np.trace(self._mean_inertia_for(known)))
        return value_at(diagonal if len(steps) < 2 else matrix, steps)

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


def _with_values(plant: Plant, values: dict[str, Array], section: str) -> Plant:
    """Return a plant with other parameters; a refused one gets its section in the scenario."""
    try:
        return plant.with_parameters(values)
    except InvalidParameter as error:
        raise InvalidParameter(f"{section}.{error}", f"{section}.{error.path}".rstrip(".")) from None


def _default(component: Component, name: str) -> Any:
    """Return the default of a component's parameter; None where it has none."""
    if is_dataclass(component.kind):
        for field in fields(component.kind):
            if field.name == name and field.default is not MISSING:
                return field.default
    return None


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


def _require_text(key: DrawnKey, drawn: str, applied: object) -> None:
    """Refuse a text that is not the drawn one."""
    if drawn.rpartition(":")[2] != str(applied).rpartition(":")[2]:
        raise InvalidParameter(
            f"draws.{key.name}: {drawn!r} was drawn, and the part has {applied!r}: the draw does not reach what is "
            "simulated. Draw another key",
            f"draws.{key.name}",
        )


def _texts(values: Mapping[DrawnKey, Any]) -> dict[DrawnKey, str]:
    """Return those of the values that are texts."""
    return {key: value for key, value in values.items() if isinstance(value, str)}


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
