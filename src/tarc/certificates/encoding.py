"""Frozen dataclasses of numbers and arrays as plain data for JSON, and back."""

import math
import types
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from tarc.core.types import Array

T = TypeVar("T")


def to_plain(value: object) -> Any:
    """Return a value as dictionaries, lists, numbers, text and None, ready for JSON.

    Dataclasses and named tuples become dictionaries of their fields, arrays nested lists. Numbers that are
    not finite become the text ``inf``, ``-inf`` or ``nan``, since JSON has no number for them.
    """
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: to_plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, np.ndarray):
        return to_plain(value.tolist())
    if isinstance(value, tuple) and (names := getattr(value, "_fields", ())):
        return {name: to_plain(entry) for name, entry in zip(names, value, strict=True)}
    if isinstance(value, list | tuple):
        return [to_plain(entry) for entry in value]
    if isinstance(value, dict):
        return {str(key): to_plain(entry) for key, entry in value.items()}
    if isinstance(value, float) and not math.isfinite(value):
        return str(float(value))
    return value.item() if isinstance(value, np.generic) else value


def from_plain(kind: Any, content: object, path: str = "evidence") -> Any:
    """Return the value of a declared type that `to_plain` wrote.

    Parameters
    ----------
    kind
        A frozen dataclass or named tuple, or the declared type of one of its fields.
    content
        Plain data.
    path
        Name of the place in the content, for messages.

    Raises
    ------
    ValueError
        For content that does not have the declared type.
    """
    options = get_args(kind) if get_origin(kind) in (Union, types.UnionType) else (kind,)
    if content is None:
        if type(None) in options:
            return None
        raise ValueError(f"{path}: got nothing; needs a value")
    kind = next(option for option in options if option is not type(None))
    if is_dataclass(kind) or hasattr(kind, "_fields"):
        return _dataclass_from_plain(kind, content, path)
    if get_origin(kind) is tuple:
        return _tuple_from_plain(get_args(kind), content, path)
    if get_origin(kind) is dict:
        if not isinstance(content, dict):
            raise ValueError(f"{path}: got {content!r}; needs a dictionary")
        return {key: from_plain(get_args(kind)[1], entry, f"{path}.{key}") for key, entry in content.items()}
    if kind is np.ndarray:
        return np.array(content, dtype=float)
    if kind is float and (isinstance(content, int | float | str) and not isinstance(content, bool)):
        return float(content)
    if kind in (bool, int, str) and type(content) is kind:
        return content
    raise ValueError(f"{path}: got {content!r}; needs {getattr(kind, '__name__', kind)}")


def _dataclass_from_plain(kind: Any, content: object, path: str) -> Any:
    make: Any = kind
    names: list[str] = [field.name for field in fields(kind)] if is_dataclass(kind) else list(kind._fields)
    if not isinstance(content, dict) or set(content) != set(names):
        given = sorted(content) if isinstance(content, dict) else content
        raise ValueError(f"{path}: got {given}; needs the fields {', '.join(names)}")
    hints = get_type_hints(kind)
    return make(**{name: from_plain(hints[name], content[name], f"{path}.{name}") for name in names})


def _tuple_from_plain(kinds: tuple[Any, ...], content: object, path: str) -> tuple[Any, ...]:
    if not isinstance(content, list):
        raise ValueError(f"{path}: got {content!r}; needs a list")
    if len(kinds) == 2 and kinds[1] is Ellipsis:
        kinds = (kinds[0],) * len(content)
    if len(kinds) != len(content):
        raise ValueError(f"{path}: got {len(content)} entries; needs {len(kinds)}")
    return tuple(
        from_plain(kind, entry, f"{path}[{i}]") for i, (kind, entry) in enumerate(zip(kinds, content, strict=True))
    )


def arrays(value: object) -> Iterator[Array]:
    """Yield all arrays in a dataclass and in the dataclasses, lists, tuples and dictionaries that it contains."""
    if isinstance(value, np.ndarray):
        yield value
    elif is_dataclass(value):
        for field in fields(value):
            yield from arrays(getattr(value, field.name))
    elif isinstance(value, list | tuple):
        for entry in value:
            yield from arrays(entry)
    elif isinstance(value, dict):
        for entry in value.values():
            yield from arrays(entry)
