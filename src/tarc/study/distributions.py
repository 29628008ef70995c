"""Distributions of a study's draws: quantile functions of numbers between 0 and 1."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import norm

from tarc.core import validation as check
from tarc.core.component import Component
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array

LEAST_PROBABILITY = 1e-6
"""Probability of the tails beyond what counts as the extremes of a distribution without bounds."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Distribution(Component):
    """A distribution of one number."""

    @abstractmethod
    def quantile(self, probability: Array) -> Array:
        """Return the values that are not exceeded with a probability in (0, 1), of the same shape."""

    @property
    def extremes(self) -> tuple[float, float]:
        """Return the least and the largest value, or those exceeded with `LEAST_PROBABILITY` where there is none."""
        low, high = self.quantile(np.array([LEAST_PROBABILITY, 1 - LEAST_PROBABILITY]))
        return float(low), float(high)

    @property
    def texts(self) -> tuple[str, ...]:
        """Texts that are drawn by their number, from 0 on; empty where numbers are drawn."""
        return ()

    def plain(self, value: float) -> float | int | str:
        """Return a drawn value as a scenario has it: a whole number for a choice of those, the text for its number."""
        return float(value)


@dataclass(frozen=True, kw_only=True, eq=False)
class Uniform(Distribution):
    """Every value between two bounds alike.

    Parameters
    ----------
    low, high
        Bounds, low < high.
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        _check_bounds(self.low, self.high)

    def quantile(self, probability: Array) -> Array:
        """Return low + p (high − low)."""
        return self.low + probability * (self.high - self.low)

    @property
    def extremes(self) -> tuple[float, float]:
        """Return the bounds."""
        return float(self.low), float(self.high)


@dataclass(frozen=True, kw_only=True, eq=False)
class LogUniform(Distribution):
    """The logarithm of the value is uniform.

    Parameters
    ----------
    low, high
        Bounds, 0 < low < high.
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        _check_bounds(self.low, self.high)
        check.number("low", self.low, 0, strict=True)

    def quantile(self, probability: Array) -> Array:
        """Return low (high/low)^p."""
        return np.clip(self.low * np.exp(probability * np.log(self.high / self.low)), self.low, self.high)

    @property
    def extremes(self) -> tuple[float, float]:
        """Return the bounds."""
        return float(self.low), float(self.high)


@dataclass(frozen=True, kw_only=True, eq=False)
class Normal(Distribution):
    """A normal distribution, truncated where bounds are given.

        p = (Φ(z) − Φ(a)) / (Φ(b) − Φ(a)),    z = (x − mean)/deviation,  a, b the bounds likewise

    Parameters
    ----------
    mean, deviation
        Those of the distribution before truncation.
    low, high
        Bounds; None for none.
    """

    mean: float
    deviation: float
    low: float | None = None
    high: float | None = None

    def __post_init__(self) -> None:
        check.number("mean", self.mean)
        check.number("deviation", self.deviation, 0, strict=True)
        for name in ("low", "high"):
            if getattr(self, name) is not None:
                check.number(name, getattr(self, name))
        if self.low is not None and self.high is not None:
            _check_bounds(self.low, self.high)
        a, b = self._bounds
        if not max(norm.sf(a) - norm.sf(b), norm.cdf(b) - norm.cdf(a)) > 0:
            raise InvalidParameter(
                f"low, high: got {self.low!r} and {self.high!r}, between which a normal distribution of mean "
                f"{self.mean:g} and deviation {self.deviation:g} has no probability; move them towards the mean",
                "low",
            )

    @property
    def _bounds(self) -> tuple[float, float]:
        """Bounds of the normal scores."""
        low = -np.inf if self.low is None else (self.low - self.mean) / self.deviation
        high = np.inf if self.high is None else (self.high - self.mean) / self.deviation
        return low, high

    def quantile(self, probability: Array) -> Array:
        """Return the quantile by the tail in which it is accurate."""
        a, b = self._bounds
        if a > 0:  # in the upper tail: by the complement, which keeps its digits
            z = norm.isf(norm.sf(a) - probability * (norm.sf(a) - norm.sf(b)))
        else:
            z = norm.ppf(norm.cdf(a) + probability * (norm.cdf(b) - norm.cdf(a)))
        low = -np.inf if self.low is None else self.low
        high = np.inf if self.high is None else self.high
        return np.clip(self.mean + self.deviation * z, low, high)

    @property
    def extremes(self) -> tuple[float, float]:
        """Return the bounds, or the values that are exceeded with `LEAST_PROBABILITY` where there is none."""
        low, high = super().extremes
        return (low if self.low is None else float(self.low), high if self.high is None else float(self.high))


@dataclass(frozen=True, kw_only=True, eq=False)
class Choice(Distribution):
    """One of several numbers or texts; a text is drawn by its number, from 0 on.

    Parameters
    ----------
    values
        The numbers, in any order, or the texts.
    weights
        Their probabilities up to a common factor; None for equal ones.
    """

    values: Sequence[float] | Sequence[str]
    weights: Sequence[float] | None = None

    def __post_init__(self) -> None:
        if isinstance(self.values, str | bytes) or not isinstance(self.values, Sequence) or not self.values:
            raise InvalidParameter(f"choice: got {self.values!r}; needs a list of numbers or texts", "choice")
        n_texts = sum(isinstance(value, str) for value in self.values)
        if n_texts == 0:
            for value in self.values:
                check.number("choice", value)
        elif n_texts < len(self.values):
            raise InvalidParameter(f"choice: got {list(self.values)}; needs numbers alone or texts alone", "choice")
        if len(set(self.values if n_texts else map(float, self.values))) < len(self.values):
            raise InvalidParameter(f"choice: got {list(self.values)}, some twice; give weights instead", "choice")
        if self.weights is None:
            return
        if isinstance(self.weights, str | bytes) or not isinstance(self.weights, Sequence):
            raise InvalidParameter(f"weights: got {self.weights!r}; needs a list of numbers", "weights")
        if len(self.weights) != len(self.values):
            raise InvalidParameter(
                f"weights: got {len(self.weights)} for {len(self.values)} values; give one each", "weights"
            )
        for weight in self.weights:
            check.number("weights", weight, 0)
        if not sum(self.weights) > 0:
            raise InvalidParameter(f"weights: got {list(self.weights)}; at least one must be above 0", "weights")

    @property
    def texts(self) -> tuple[str, ...]:
        """Texts that are drawn by their number."""
        return tuple(value for value in self.values if isinstance(value, str))

    @property
    def numbers(self) -> Array:
        """What is drawn: the numbers themselves, or those of the texts."""
        return np.arange(float(len(self.values))) if self.texts else np.asarray(self.values, dtype=float)

    def quantile(self, probability: Array) -> Array:
        """Return the number in whose share of [0, 1] the probability lies; the numbers are in increasing order."""
        order = np.argsort(self.numbers)
        values = self.numbers[order]
        weights = np.ones(len(values)) if self.weights is None else np.asarray(self.weights, dtype=float)[order]
        ends = np.cumsum(weights) / np.sum(weights)
        last = int(np.flatnonzero(weights)[-1])
        return values[np.minimum(np.searchsorted(ends, probability, side="right"), last)]

    @property
    def extremes(self) -> tuple[float, float]:
        """Return the least and the largest number."""
        return float(np.min(self.numbers)), float(np.max(self.numbers))

    def plain(self, value: float) -> float | int | str:
        """Return a whole number where all are whole, true or false where all are, and the text of a number of one."""
        if self.texts:
            return self.texts[int(value)]
        if all(isinstance(number, bool) for number in self.values):
            return bool(value)
        return int(value) if all(isinstance(number, int) for number in self.values) else float(value)


KINDS = ("uniform", "log_uniform", "normal", "choice")
"""Names of the distributions in a study."""


def read_distribution(path: str, given: object) -> Distribution:
    """Return the distribution that an entry of ``draws`` describes.

    Parameters
    ----------
    path
        Place of the entry in the study, for the messages.
    given
        A mapping with one of `KINDS`, such as ``{uniform: [0, 3]}``, and for a choice ``weights``.

    Raises
    ------
    InvalidParameter
        For an unknown distribution, bounds that are no numbers or in the wrong order, and unknown keys.
    """
    example = "{uniform: [0, 3]}, {log_uniform: [1e-6, 1e-4]}, {normal: {mean: 1, deviation: 0.1}} or {choice: [1, 2]}"
    if not isinstance(given, Mapping) or not given:
        raise InvalidParameter(f"{path}: got {given!r}; needs a distribution, such as {example}", path)
    names = [str(name) for name in given]
    kinds = [name for name in names if name in KINDS]
    for name in names:
        if name not in KINDS and not (name == "weights" and "choice" in names):
            raise InvalidParameter(
                f"{path}.{name}: unknown distribution; known are {', '.join(KINDS)}, such as {example}."
                f"{check.did_you_mean(name, KINDS)}",
                f"{path}.{name}",
            )
    if len(kinds) > 1:
        raise InvalidParameter(f"{path}: got {' and '.join(kinds)}; give one distribution", path)
    kind = kinds[0]
    try:
        return _read(kind, given)
    except InvalidParameter as error:
        raise InvalidParameter(f"{path}.{kind}: {error}", f"{path}.{kind}") from None


def _read(kind: str, given: Mapping[str, Any]) -> Distribution:
    """Return a distribution of a kind from its keys and values."""
    content = given[kind]
    if kind == "choice":
        return Choice(values=content, weights=given.get("weights"))
    if kind == "normal":
        if not isinstance(content, Mapping):
            raise InvalidParameter(f"got {content!r}; needs keys and values, such as {{mean: 1, deviation: 0.1}}")
        return Normal(**{str(key): value for key, value in content.items()})
    if isinstance(content, str) or not isinstance(content, Sequence) or len(content) != 2:
        raise InvalidParameter(f"got {content!r}; needs two numbers, [low, high]")
    shape = Uniform if kind == "uniform" else LogUniform
    return shape(low=content[0], high=content[1])


def _check_bounds(low: float, high: float) -> None:
    """Refuse bounds that are no finite numbers in increasing order."""
    if not np.isfinite(check.number("high", high) - check.number("low", low)):
        raise InvalidParameter(f"low, high: got {low:g} and {high:g}, which are too far from each other", "low")
    if not low < high:
        raise InvalidParameter(f"low, high: got {low:g} and {high:g}; low must be below high", "low")
