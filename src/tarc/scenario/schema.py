"""What each section of a scenario may hold: kinds and parameters, taken from the classes themselves."""

import inspect
import types
import typing
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any, Union

from pydantic import BaseModel, ConfigDict, ValidationError, create_model

import tarc.estimators
import tarc.laws
import tarc.plants
import tarc.signals
from tarc.core import validation as check
from tarc.core.errors import TarcError

SECTIONS: dict[str, tuple[types.ModuleType, type]] = {
    "robot": (tarc.plants, tarc.plants.EulerLagrange),
    "law": (tarc.laws, tarc.laws.Law),
    "estimator": (tarc.estimators, tarc.estimators.Estimator),
    "reference": (tarc.signals, tarc.signals.Reference),
    "sensor": (tarc.signals, tarc.signals.Encoder),
    "disturbance": (tarc.signals, object),
}
EVENTS = ("BandNoise", "Impulse", "Payload", "Schedule", "Sine", "Step")
SET_BY_SCENARIO = {"period", "estimator"}


def catalogue(section: str) -> dict[str, Any]:
    """The kinds that a section of a scenario may have, by name."""
    module, base = SECTIONS[section]
    found = {name: getattr(module, name) for name in module.__all__}
    if section == "disturbance":
        return {name: found[name] for name in EVENTS}
    return {
        name: kind
        for name, kind in found.items()
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


def parameters(kind: Any) -> dict[str, Parameter]:
    """The parameters that a scenario may give to a kind (a class, or a factory such as a robot from a file)."""
    hints = typing.get_type_hints(kind)
    if inspect.ismethod(kind):
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


def _allowed(hint: Any) -> Any:
    """The types that YAML can write, out of an annotation."""
    members = typing.get_args(hint) if typing.get_origin(hint) in (Union, types.UnionType) else (hint,)
    result: list[Any] = []
    for member in members:
        origin = typing.get_origin(member)
        if member is Path or (inspect.isclass(member) and issubclass(member, tarc.plants.Plant)):
            result.append(str)
        elif origin in (list, tuple, Sequence) or (origin is not None and issubclass(origin, Sequence)):
            result.append(list[typing.get_args(member)[0]] if typing.get_args(member) else list)
        elif member in (float, int, bool, str, type(None), Any):
            result.append(member)
    return Union[tuple(dict.fromkeys(result))] if result else Any  # noqa: UP007


def _words(allowed: Any) -> str:
    """Types in words."""
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


def validate(section: str, part: dict[str, Any]) -> dict[str, Any]:
    """Check the keys and types of one component against its class; the options, with the kind."""
    if section == "robot" and "file" in part:
        factory: Any = tarc.plants.MujocoPlant.from_file
        return _against(factory, part, "robot", "a robot from a file")
    kinds = catalogue(section)
    name = part.get("kind")
    if name is None:
        hint = ", or file: for MJCF, URDF and shipped robots" if section == "robot" else ""
        raise TarcError(f"{section}.kind: missing; known are {', '.join(kinds)}{hint}")
    check.one_of(f"{section}.kind", str(name), kinds)
    options = {key: value for key, value in part.items() if key != "kind"}
    return {"kind": name, **_against(kinds[str(name)], options, section, str(name))}


def _against(kind: Any, options: dict[str, Any], section: str, label: str) -> dict[str, Any]:
    known = parameters(kind)
    special = {}
    if section == "law" and isinstance(options.get("inertia"), dict):
        special = {"inertia": options["inertia"]}
        options = {**options, "inertia": 1.0}
    shape: dict[str, Any] = {
        name: (parameter.allowed, ... if parameter.needed else parameter.default) for name, parameter in known.items()
    }
    model = create_model(label, __config__=ConfigDict(extra="forbid", arbitrary_types_allowed=True), **shape)
    try:
        valid = model(**options)
    except ValidationError as error:
        raise TarcError(explain(error, model, section, label)) from None
    except TypeError:
        raise TarcError(f"{section}: its keys must be words; got {list(options)}") from None
    return {name: getattr(valid, name) for name in options} | special


def construct(section: str, options: dict[str, Any]) -> Any:
    """The object itself; its own complaints get the section's name."""
    kind = catalogue(section)[options["kind"]]
    try:
        return kind(**{key: value for key, value in options.items() if key != "kind"})
    except TarcError as error:
        raise TarcError(f"{section}.{error}") from None


def explain(error: ValidationError, model: type[BaseModel], section: str, label: str) -> str:
    """One line a key at fault: what came, what is allowed, the nearest spelling."""
    prefix = f"{section}." if section else ""
    lines: dict[str, str] = {}
    for fault in error.errors():
        key = str(fault["loc"][0]) if fault["loc"] else ""
        if key in lines:
            continue
        where = f"{prefix}{key}"
        known = list(model.model_fields)
        if fault["type"] == "extra_forbidden" and len(fault["loc"]) == 1:
            lines[key] = f"{where}: unknown key; {label} has {', '.join(known)}.{check.did_you_mean(key, known)}"
        elif fault["type"] == "missing":
            lines[key] = f"{where}: missing; {label} needs it, {_words(model.model_fields[key].annotation)}"
        elif (key in known and len(fault["loc"]) == 1) or (
            key in known and typing.get_args(model.model_fields[key].annotation)
        ):
            given = fault["input"] if len(fault["loc"]) == 1 else error.errors()[0]["input"]
            lines[key] = f"{where}: got {given!r}; needs {_words(model.model_fields[key].annotation)}"
        else:
            path = ".".join(str(step) for step in fault["loc"])
            lines[key] = f"{prefix}{path}: {fault['msg']}"
    return "\n".join(lines.values())
