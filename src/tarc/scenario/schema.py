"""Kinds and parameters of each section of a scenario, from the classes themselves."""

import inspect
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any, Union

from pydantic import BaseModel, ConfigDict, ValidationError, create_model

import tarc.estimators
import tarc.laws
import tarc.plants
import tarc.signals
from tarc.core import validation as check
from tarc.core.errors import InvalidParameter, ScenarioError
from tarc.laws.nominal_inertia import ModelTerms
from tarc.plants.load import load_robot
from tarc.scenario.cartesian import CartesianWaypoints
from tarc.scenario.user_law import is_user_law, load_law

SECTIONS: dict[str, tuple[types.ModuleType, type]] = {
    "robot": (tarc.plants, tarc.plants.EulerLagrange),
    "law": (tarc.laws, tarc.laws.Law),
    "estimator": (tarc.estimators, tarc.estimators.Estimator),
    "reference": (tarc.signals, tarc.signals.Reference),
    "sensor": (tarc.signals, tarc.signals.Encoder),
    "torque_limits": (tarc.signals, tarc.signals.TorqueLimits),
    "gearbox": (tarc.plants, tarc.plants.Gearbox),
    "drive": (tarc.signals, tarc.signals.Drive),
    "disturbance": (tarc.signals, object),
}
EVENTS = (
    "BandLimitedNoise",
    "ImpulseDisturbance",
    "Payload",
    "ParameterSchedule",
    "SineDisturbance",
    "StepDisturbance",
)
SET_BY_SCENARIO = {"period", "estimator", "plant", "robot"}


def catalogue(section: str) -> dict[str, Any]:
    """Return the kinds that a section of a scenario may have, by name."""
    module, base = SECTIONS[section]
    members = {name: getattr(module, name) for name in module.__all__}
    if section == "disturbance":
        return {name: members[name] for name in EVENTS}
    if section == "reference":
        members["CartesianWaypoints"] = CartesianWaypoints
    return {
        name: kind
        for name, kind in members.items()
        if inspect.isclass(kind) and issubclass(kind, base) and not inspect.isabstract(kind)
    }


@dataclass(frozen=True)
class Parameter:
    """A parameter of a kind, as a user writes it."""

    name: str
    allowed: Any
    default: Any

    @property
    def needed(self) -> bool:
        """Whether it has no default."""
        return self.default is ...

    @property
    def words(self) -> str:
        """What is allowed, in words."""
        return _words(self.allowed)


@cache
def parameters(kind: Any) -> Mapping[str, Parameter]:
    """Return the parameters that a scenario may give to a kind: a class, or a function such as a robot from a file."""
    hints = typing.get_type_hints(kind)
    if not is_dataclass(kind):
        hints["file"] = hints.pop("path")  # a scenario says "file: ur5e.urdf"
        defaults = {"file": ...} | {
            p.name: p.default for p in inspect.signature(kind).parameters.values() if p.name != "path"
        }
    else:
        defaults = {f.name: ... if f.default is MISSING else f.default for f in fields(kind)}
    return {
        name: Parameter(name, _allowed(hints.get(name, Any)), default)
        for name, default in defaults.items()
        if name not in SET_BY_SCENARIO
    }


def parameters_of_law(kind: str) -> Mapping[str, Parameter]:
    """Return the parameters of a law of tarc.laws, or of one from a user's own file.

    Raises
    ------
    InvalidParameter
        For an unknown kind, and as in `load_law`.
    """
    if is_user_law(kind):
        return parameters(load_law(kind))
    kinds = catalogue("law")
    return parameters(kinds[check.one_of("law.kind", kind, kinds)])


def _allowed(hint: Any) -> Any:
    """Return the types of an annotation that YAML can write."""
    members = typing.get_args(hint) if typing.get_origin(hint) in (Union, types.UnionType) else (hint,)
    result: list[Any] = []
    for member in members:
        origin = typing.get_origin(member)
        if inspect.isclass(member) and issubclass(member, ModelTerms):
            result.append(dict[str, Any])
        elif member is Path or (inspect.isclass(member) and issubclass(member, tarc.plants.Plant)):
            result.append(str)
        elif origin in (list, tuple, Sequence) or (origin is not None and issubclass(origin, Sequence)):
            result.append(list[typing.get_args(member)[0]] if typing.get_args(member) else list)
        elif origin in (dict, Mapping):
            key, value = typing.get_args(member)
            result.append(dict[key, value])
        elif member in (float, int, bool, str, type(None), Any):
            result.append(member)
    return Union[tuple(dict.fromkeys(result))] if result else Any  # noqa: UP007 - `|` takes no tuple of types


def _words(allowed: Any) -> str:
    """Return types in words."""
    names = {
        float: "a number",
        int: "a whole number",
        bool: "true or false",
        str: "a text",
        type(None): "null",
        Any: "anything",
    }
    members = typing.get_args(allowed) if typing.get_origin(allowed) in (Union, types.UnionType) else (allowed,)
    words = []
    for member in members:
        if typing.get_origin(member) is dict or (inspect.isclass(member) and issubclass(member, BaseModel)):
            words.append("keys and values")
        elif typing.get_origin(member) is list and typing.get_origin(typing.get_args(member)[0]) is dict:
            words.append("a list of keys and values")
        elif typing.get_origin(member) is list:
            inner = typing.get_args(member)[0]
            rows = typing.get_origin(inner) is not None
            words.append(
                "rows of numbers"
                if rows
                else "a list of texts"
                if inner is str
                else "a list"
                if inner is Any
                else "a list of numbers"
            )
        else:
            words.append(names.get(member, str(member)))
    return " or ".join(dict.fromkeys(words))


@dataclass(frozen=True)
class Component:
    """A part of a scenario whose keys and types are checked.

    Attributes
    ----------
    path
        Its place in the scenario, such as ``law.1``.
    kind
        Its class, or the function that builds it.
    options
        Parameters that the user gave.
    """

    path: str
    kind: Callable[..., Any]
    options: dict[str, Any]

    def build(self, **more: object) -> Any:
        """Construct the object with further parameters; a refused parameter gets its path in the scenario.

        Raises
        ------
        InvalidParameter
            For a parameter that the class refuses.
        """
        try:
            return self.kind(**{**self.options, **more})
        except InvalidParameter as error:
            raise InvalidParameter(f"{self.path}.{error}", f"{self.path}.{error.path}".rstrip(".")) from None


def check_component(section: str, part: dict[str, Any], path: str = "") -> Component:
    """Check the keys and types of a part of a scenario against the class of its kind.

    Parameters
    ----------
    section
        Name in `SECTIONS`.
    part
        ``kind``, or for a robot ``file``, and parameters.
    path
        Place in the scenario for the messages; by default the section.

    Raises
    ------
    ScenarioError
        For an unknown kind, unknown and missing keys and values of a wrong type, all of them in one message.
    """
    path = path or section
    if section == "robot" and "file" in part:
        options = _checked_options(load_robot, part, path, "a robot from a file")
        options["path"] = options.pop("file")
        return Component(path, load_robot, options)
    kinds = catalogue(section)
    name = part.get("kind")
    if name is None:
        hint = ", or file: for MJCF, URDF and shipped robots" if section == "robot" else ""
        raise InvalidParameter(f"{path}.kind: missing; known are {', '.join(kinds)}{hint}", f"{path}.kind")
    if section == "law" and is_user_law(name):
        kinds = {str(name): load_law(str(name), f"{path}.kind")}
    check.one_of(f"{path}.kind", str(name), kinds)
    options = {key: value for key, value in part.items() if key != "kind"}
    kind = kinds[str(name)]
    return Component(path, kind, _checked_options(kind, options, path, getattr(kind, "__name__", str(name))))


def _checked_options(kind: Callable[..., Any], options: dict[str, Any], path: str, label: str) -> dict[str, Any]:
    """Return the options, converted to the types of the parameters."""
    inertia = options.get("inertia")
    is_fraction = isinstance(inertia, dict) and "inertia" in parameters(kind)  # {fraction: 0.1}, resolved later
    model = _parameter_model(kind, label)
    try:
        valid = model(**({**options, "inertia": 1.0} if is_fraction else options))
    except ValidationError as error:
        raise scenario_error(error, model, path, label) from None
    except TypeError:
        raise InvalidParameter(f"{path}: its keys must be words; got {list(options)}", path) from None
    converted = {name: getattr(valid, name) for name in options}
    return {**converted, "inertia": inertia} if is_fraction else converted


@cache
def _parameter_model(kind: Callable[..., Any], label: str) -> type[BaseModel]:
    """Return the pydantic class of a kind's parameters; each kind has one."""
    shape: dict[str, Any] = {
        name: (parameter.allowed, ... if parameter.needed else parameter.default)
        for name, parameter in parameters(kind).items()
    }
    return create_model(label, __config__=ConfigDict(extra="forbid", arbitrary_types_allowed=True), **shape)


def scenario_error(error: ValidationError, model: type[BaseModel], section: str, label: str) -> ScenarioError:
    """Return an error whose message has one line per key at fault, and whose path is the first of them."""
    lines = explain(error, model, section, label)
    return ScenarioError("\n".join(lines.values()), next(iter(lines)))


def explain(error: ValidationError, model: type[BaseModel], section: str, label: str) -> dict[str, str]:
    """Return a line per key at fault, by its path: what came, what is allowed, the nearest spelling."""
    prefix = f"{section}." if section else ""
    lines: dict[str, str] = {}
    for fault in error.errors():
        key = str(fault["loc"][0]) if fault["loc"] else ""
        if key in lines:
            continue
        where = f"{prefix}{key}"
        keys = list(model.model_fields)
        if fault["type"] == "extra_forbidden" and len(fault["loc"]) == 1:
            lines[key] = f"{where}: unknown key; {label} has {', '.join(keys)}.{check.did_you_mean(key, keys)}"
        elif fault["type"] == "missing":
            lines[key] = f"{where}: missing; {label} needs it, {_words(model.model_fields[key].annotation)}"
        elif (key in keys and len(fault["loc"]) == 1) or (
            key in keys and typing.get_args(model.model_fields[key].annotation)
        ):
            given = fault["input"] if len(fault["loc"]) == 1 else error.errors()[0]["input"]
            lines[key] = f"{where}: got {given!r}; needs {_words(model.model_fields[key].annotation)}"
        else:
            path = ".".join(str(step) for step in fault["loc"])
            lines[key] = f"{prefix}{path}: {fault['msg']}"
    return {f"{prefix}{key}": line for key, line in lines.items()}
