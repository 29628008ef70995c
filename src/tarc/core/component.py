"""Frozen parameter classes that refuse unknown and missing keywords with a helpful `InvalidParameter`."""

import inspect
from abc import ABCMeta
from dataclasses import MISSING, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter


class _Checked(ABCMeta):
    if not TYPE_CHECKING:  # so that a type checker sees the dataclass's own signature

        def __call__(cls, *args: object, **keywords: object) -> object:
            if not cls.__abstractmethods__:
                _check_keywords(cls, args, keywords)
            return super().__call__(*args, **{name: _read_only(value) for name, value in keywords.items()})

        @property
        def __signature__(cls) -> inspect.Signature:
            """Return the signature of the dataclass, which ``help`` and notebooks show."""
            signature = inspect.signature(cls.__init__)
            return signature.replace(parameters=list(signature.parameters.values())[1:], return_annotation=cls)


class Component(metaclass=_Checked):
    """Base of every keyword-only dataclass that a user constructs: laws, estimators, plants, signals."""


def _read_only(value: object) -> object:
    """Return a read-only copy of an array, and anything else unchanged."""
    if isinstance(value, np.ndarray):
        value = value.copy()
        value.setflags(write=False)
    return value


def _check_keywords(kind: type[Any], args: tuple[object, ...], keywords: dict[str, object]) -> None:
    parameters = {field.name: field for field in fields(kind) if field.init}
    label = kind.__name__
    if args:
        raise InvalidParameter(f"{label}: takes its parameters by name; it has {', '.join(parameters)}")
    for name in keywords:
        if name not in parameters:
            raise InvalidParameter(
                f"{label}: unknown parameter {name!r}; it has {', '.join(parameters)}."
                f"{check.did_you_mean(name, parameters)}"
            )
    for name, field in parameters.items():
        if name not in keywords and field.default is MISSING and field.default_factory is MISSING:
            raise InvalidParameter(f"{label}: parameter {name!r} is missing; see help(tarc) or `tarc show {label}`")
