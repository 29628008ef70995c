"""Numbers in the parts of a loop: which of them differ from run to run, and symbols in their place."""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, Self

import casadi as ca
import numpy as np

from tarc.core.errors import UnsupportedLaw
from tarc.core.types import Array
from tarc.plants.base import Plant
from tarc.plants.symbolic import SymbolicPlant

Path = tuple[str | int, ...]
"""Attributes, keys and indices from a part to one of its numbers."""

DERIVED = ("_functions", "_calls")
"""Attributes of plants that hold functions and no numbers."""


PLACES = ("_arrays", "_parameters")
"""Attributes in which plants keep their parameters by name."""


DRAWN_BEFORE = ("noise", "dropout", "packet_loss")
"""Parameters of the encoder that are drawn beforehand, and so are no part of a traced loop."""

TOLERANCE = 1e-9
"""Largest difference that counts as rounding, over one more than the number."""


class Numbers:
    """Numbers of a part by their paths, and what else it consists of.

    Attributes
    ----------
    values
        Arrays of floating-point numbers, by path.
    structure
        Counts, names and shapes, by path; loops that differ in them are different loops.
    """

    def __init__(self, part: object):
        self.values: dict[Path, Array] = {}
        self.structure: dict[Path, object] = {}
        self._walk(part, ())

    def _walk(self, value: object, path: Path) -> None:
        numbers = _as_numbers(value)
        if numbers is not None:
            self.values[path] = numbers
            self.structure[path] = numbers.shape
            return
        if isinstance(value, np.ndarray):
            self.structure[path] = (value.shape, value.tobytes())
        elif value is None or isinstance(value, bool | int | str | np.integer | np.bool_):
            self.structure[path] = value
        elif isinstance(value, Plant):
            self.structure[path] = type(value).__name__
            for inner, numbers in _parameters(value):
                self._walk(numbers, (*path, *inner))
        else:
            children = _children(value)
            is_collection = isinstance(value, dict | list | tuple)
            self.structure[path] = (type(value).__name__, len(children) if is_collection else None)
            for key, child in children.items():
                self._walk(child, (*path, key))


def _parameters(plant: Plant) -> list[tuple[Path, Array]]:
    """Return the parameters of a plant that is part of a law, and where the plant keeps them."""
    place = next((name for name in PLACES if hasattr(plant, name)), "parameters")
    return [((place, name), np.asarray(value, dtype=float)) for name, value in plant.parameters.items()]


def _as_numbers(value: object) -> Array | None:
    """Return floating-point numbers as an array; None for everything else."""
    if isinstance(value, float | np.floating):
        return np.array(float(value))
    if isinstance(value, np.ndarray):
        return value if value.dtype == float else None
    if isinstance(value, list | tuple) and value and all(isinstance(one, float | int) for one in value):
        is_counts = all(isinstance(one, int) for one in value)
        return None if is_counts else np.array(value, dtype=float)
    return None


def _children(value: object) -> Mapping[Any, object]:
    """Return what a part consists of, by attribute, key or index."""
    if isinstance(value, dict):
        return value
    if isinstance(value, list | tuple):
        return dict(enumerate(value))
    if isinstance(value, ca.SX | ca.MX | ca.DM | ca.Function) or callable(value):
        return {}
    return (
        {name: child for name, child in sorted(vars(value).items()) if name not in DERIVED} if _has_vars(value) else {}
    )


def _has_vars(value: object) -> bool:
    return hasattr(value, "__dict__")


def replaced(part: Any, values: Mapping[Path, object]) -> Any:
    """Return a copy of a part with other values at some paths; what has none of them is shared.

    Nothing is checked, and nothing computed again: a value that others were computed from leaves those as they are.
    """
    if not values:
        return part
    if () in values:
        return values[()]
    inner: dict[str | int, dict[Path, object]] = {}
    for path, value in values.items():
        inner.setdefault(path[0], {})[path[1:]] = value
    children = {key: replaced(_children(part)[key], more) for key, more in inner.items()}
    if isinstance(part, dict):
        return {**part, **children}
    if isinstance(part, list | tuple):
        items = [children.get(i, item) for i, item in enumerate(part)]
        return type(part)(*items) if hasattr(part, "_fields") else type(part)(items)
    changed = copy.copy(part)
    if isinstance(part, SymbolicPlant):
        vars(changed)["_functions"] = part._functions  # their inputs include the parameters
    for name, child in children.items():
        vars(changed)[str(name)] = child
    return changed


def at(part: Any, path: Path) -> Array:
    """Return the numbers of a part at a path."""
    key: Any
    for key in path:
        part = part[key] if isinstance(part, dict | list | tuple) else getattr(part, str(key))
    return np.asarray(part, dtype=float)


def changes(ours: object, theirs: object, path: Path = ()) -> list[tuple[Path, object, object]]:
    """Return the fields in which two parts differ: path, and the values of both."""
    if ours is theirs:
        return []
    if type(ours) is not type(theirs):
        return [(path, ours, theirs)]
    if isinstance(ours, Plant) and isinstance(theirs, Plant):
        pairs = zip(_parameters(ours), _parameters(theirs), strict=True)
        return [((*path, *place), our, their) for (place, our), (_, their) in pairs]
    if is_dataclass(ours):
        names = [one.name for one in fields(ours)]
        return [one for name in names for one in changes(getattr(ours, name), getattr(theirs, name), (*path, name))]
    if isinstance(ours, float | int | str) and ours == theirs:
        return []
    return [(path, ours, theirs)]


def differing(parts: list[Numbers]) -> dict[Path, Array]:
    """Return the numbers that differ between parts of the same structure, as masks of their elements by path."""
    first = parts[0]
    masks: dict[Path, Array] = {}
    for path, value in first.values.items():
        others = [other.values[path] for other in parts[1:]]
        mask = np.zeros(value.shape, dtype=bool)
        for other in others:
            mask |= _differ(value, other)
        if np.any(mask):
            masks[path] = mask
    return masks


def _differ(ours: Array, theirs: Array) -> Array:
    """Return which numbers differ; NaN equals NaN."""
    return ~((ours == theirs) | (np.isnan(ours) & np.isnan(theirs)))


def with_symbols(value: Array, mask: Array, symbols: ca.SX) -> ca.SX:
    """Return an array with symbols at the places of a mask, in the order of `numbers_at`; vectors become columns."""
    result = ca.SX(value if value.ndim else float(value))
    places = np.argwhere(np.atleast_1d(mask))
    for symbol, place in zip(ca.vertsplit(symbols), places, strict=True):
        result[tuple(int(i) for i in place) if len(place) > 1 else int(place[0])] = symbol
    return result


def numbers_at(value: Array, mask: Array) -> Array:
    """Return the numbers at the places of a mask, row by row."""
    return np.atleast_1d(value)[np.atleast_1d(mask)]


def are_close(ours: Array, theirs: Array) -> bool:
    """Return whether all numbers are equal to rounding, or both are NaN."""
    is_close = np.abs(ours - theirs) <= TOLERANCE * (1 + np.abs(theirs))
    return bool(np.all(is_close | (np.isnan(ours) & np.isnan(theirs)) | (ours == theirs)))


class VaryingParts:
    """Parts of a loop, with numbers of their own in each run and symbols in their place.

    Parameters
    ----------
    examples
        The parts of some runs, all of which have computed what they keep. What differs between them varies.

    Raises
    ------
    UnsupportedLaw
        For examples that differ in more than numbers.
    """

    def __init__(self, examples: Sequence[Any]):
        numbers = [Numbers(example) for example in examples]
        self._base, self._first = examples[0], numbers[0]
        if any(one.structure != self._first.structure for one in numbers):
            raise UnsupportedLaw("the runs differ in more than numbers")
        self._masks = {path: mask for path, mask in differing(numbers).items() if path[-1] not in DRAWN_BEFORE}
        self._inputs = dict(self._masks)

    @property
    def paths(self) -> list[Path]:
        """Return the paths of the numbers that have symbols."""
        return list(self._inputs)

    def with_paths(self, paths: Sequence[Path]) -> Self:
        """Return the same parts with symbols at these paths alone, and the first example's numbers at the others."""
        changed = copy.copy(self)
        changed._inputs = {path: self._masks[path] for path in paths}
        return changed

    @property
    def size(self) -> int:
        """Return how many numbers have symbols."""
        return sum(int(np.sum(mask)) for mask in self._inputs.values())

    def covers(self, parts: Any) -> bool:
        """Return whether parts differ from the examples in nothing but what varies."""
        numbers = Numbers(parts)  # which may lack what the examples have computed
        ours, structure = self._first.values, self._first.structure
        if any(structure.get(path, one) != one for path, one in numbers.structure.items()):
            return False
        common = [path for path in numbers.values if path in ours and path[-1] not in DRAWN_BEFORE]
        return not any(
            np.any(_differ(ours[path], numbers.values[path]) & ~self._masks.get(path, np.zeros((), dtype=bool)))
            for path in common
        )

    def numbers(self, parts: Any) -> Array:
        """Return the numbers of parts that have symbols, (size,)."""
        values = [numbers_at(at(parts, path), mask) for path, mask in self._inputs.items()]
        return np.concatenate(values) if values else np.zeros(0)

    def with_symbols(self, symbols: ca.SX) -> Any:
        """Return the first example with symbols in the order of `numbers`."""
        changed: dict[Path, object] = {}
        start = 0
        for path, mask in self._inputs.items():
            stop = start + int(np.sum(mask))
            changed[path] = with_symbols(self._first.values[path], mask, symbols[start:stop])
            start = stop
        return replaced(self._base, changed)
