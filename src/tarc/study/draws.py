"""Draws of a study: one row of values, and one seed, per run."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.stats import norm, qmc

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.study.distributions import Distribution

SAMPLINGS = ("independent", "latin_hypercube", "sobol")
"""Ways to fill the unit cube: independent numbers, one per stratum of each key, a scrambled Sobol sequence."""

EXTENDABLE = ("independent", "sobol")
"""Those whose first rows stay the same with more runs."""

MARGIN = 2.0**-53
"""Distance of the drawn probabilities from 0 and 1, where quantiles may be infinite."""

MIN_EIGENVALUE = 1e-9
"""Smallest eigenvalue of a correlation matrix that counts as positive."""


@dataclass(frozen=True, eq=False)
class Draws:
    """Values and seeds of the runs of a study.

    Attributes
    ----------
    keys
        Keys of the scenario that are drawn, in the order of the study.
    values
        One row per run and one column per key, (runs, keys).
    seed
        Seed of the study.
    texts
        By key: texts that are drawn by their numbers.
    """

    keys: tuple[str, ...]
    values: Array
    seed: int
    texts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @cached_property
    def seeds(self) -> Array:
        """Seed of each run, (runs,)."""
        return run_seeds(self.seed, np.arange(len(self.values)))

    def shown(self, key: str, column: Array) -> Array:
        """Return values of a key as results have them: texts in place of their numbers, empty ones for NaN."""
        if key not in self.texts:
            return column
        return np.array(["", *self.texts[key]])[np.where(np.isnan(column), 0, column + 1).astype(int)]


def run_seeds(seed: int, indices: Array) -> Array:
    """Return the seeds of runs, whole numbers below 2^63, from that of the study and their indices.

    Parameters
    ----------
    seed
        Seed of the study.
    indices
        Numbers of the runs, (k,).
    """
    states = [np.random.SeedSequence(seed, spawn_key=(int(i),)).generate_state(1, np.uint64)[0] for i in indices]
    return (np.array(states, dtype=np.uint64) >> np.uint64(1)).astype(np.int64)


def draw(
    distributions: Mapping[str, Distribution],
    runs: int,
    seed: int,
    sampling: str,
    correlation: tuple[Sequence[str], Array] | None = None,
) -> Draws:
    """Draw the values of all runs.

    Row i depends on the seed and i alone; with a Latin hypercube also on the number of runs. Correlated keys have a
    Gaussian copula: with Φ the normal distribution function and R = L Lᵀ the matrix, their probabilities are
    Φ(L Φ⁻¹(u)) for u in the unit cube. R is thus the correlation of the normal scores, and each key keeps its own
    distribution. The strata of a Latin hypercube are kept by the first correlated key and by those without correlation.

    Parameters
    ----------
    distributions
        By key.
    runs
        Number of rows.
    seed
        Seed of the study.
    sampling
        One of `SAMPLINGS`.
    correlation
        Keys and their correlation matrix (k, k), as `checked_correlation` returns them; None for independent keys.

    Raises
    ------
    InvalidParameter
        For a distribution that gives a value that is no finite number.

    References
    ----------
    A. B. Owen, Scrambling Sobol' and Niederreiter-Xing points, Journal of Complexity 14(4), 1998; R. B. Nelsen,
    An Introduction to Copulas, 2006.
    """
    points = unit_points(runs, len(distributions), seed, sampling)
    texts = {key: one.texts for key, one in distributions.items() if one.texts}
    return Draws(tuple(distributions), values_at(distributions, points, correlation), seed, texts)


def unit_points(runs: int, n_keys: int, seed: int, sampling: str) -> Array:
    """Return the points of the unit cube from which `draw` makes the values of each run, (runs, keys)."""
    return np.clip(_unit_cube(runs, n_keys, seed, sampling), MARGIN, 1 - MARGIN)


def values_at(
    distributions: Mapping[str, Distribution], points: Array, correlation: tuple[Sequence[str], Array] | None = None
) -> Array:
    """Return the values of the keys at points of the unit cube, as `draw` does, (runs, keys).

    Raises
    ------
    InvalidParameter
        For a distribution that gives a value that is no finite number.
    """
    keys = tuple(distributions)
    cube = np.clip(points, MARGIN, 1 - MARGIN)
    if correlation is not None:
        names, matrix = correlation
        places = [keys.index(name) for name in names]
        scores = norm.ppf(cube[:, places]) @ np.linalg.cholesky(matrix).T
        cube[:, places] = np.clip(norm.cdf(scores), MARGIN, 1 - MARGIN)
    values = np.empty(cube.shape)
    for column, (key, distribution) in enumerate(distributions.items()):
        values[:, column] = distribution.quantile(cube[:, column])
        faults = np.flatnonzero(~np.isfinite(values[:, column]))
        if len(faults):
            raise InvalidParameter(
                f"draws.{key}: run {faults[0]} drew {values[faults[0], column]}; needs finite numbers",
                f"draws.{key}",
            )
    return values


def _unit_cube(runs: int, n_keys: int, seed: int, sampling: str) -> Array:
    """Return points in the unit cube, (runs, keys)."""
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    if n_keys == 0 or sampling == "independent":
        return rng.random((runs, n_keys))
    if sampling == "latin_hypercube":
        return qmc.LatinHypercube(n_keys, rng=rng).random(runs)
    sequence = qmc.Sobol(n_keys, rng=rng)
    return sequence.random_base2(max(runs - 1, 0).bit_length())[:runs]


def checked_correlation(given: object, keys: Sequence[str]) -> tuple[tuple[str, ...], Array] | None:
    """Return keys and matrix of a study's ``correlation``; None for none.

    Parameters
    ----------
    given
        A mapping with ``keys`` and ``matrix``, or None.
    keys
        All keys that are drawn.

    Raises
    ------
    InvalidParameter
        For keys that are not drawn, and a matrix that is no correlation matrix or not positive definite.
    """
    if given is None:
        return None
    if not isinstance(given, Mapping) or set(given) != {"keys", "matrix"}:
        raise InvalidParameter(f"correlation: got {given!r}; needs keys and matrix", "correlation")
    names = given["keys"]
    if isinstance(names, str) or not isinstance(names, Sequence) or len(names) < 2:
        raise InvalidParameter(f"correlation.keys: got {names!r}; needs a list of two keys or more", "correlation.keys")
    for name in names:
        if name not in keys:
            raise InvalidParameter(
                f"correlation.keys: {name!r} is not among draws, which has {', '.join(keys)}."
                f"{check.did_you_mean(str(name), keys)}",
                "correlation.keys",
            )
    if len(set(names)) < len(names):
        raise InvalidParameter(f"correlation.keys: got {list(names)}, one twice; name each once", "correlation.keys")
    return tuple(names), _checked_matrix(given["matrix"], len(names))


def _checked_matrix(given: object, size: int) -> Array:
    """Return a correlation matrix as an array."""
    path = "correlation.matrix"
    matrix = check.array(path, given)
    if matrix.shape != (size, size):
        raise InvalidParameter(f"{path}: got shape {matrix.shape}; needs ({size}, {size}), one row per key", path)
    if not np.allclose(np.diag(matrix), 1, rtol=0, atol=1e-12):
        raise InvalidParameter(f"{path}: its diagonal is {np.diag(matrix).tolist()}; each entry must be 1", path)
    if not np.allclose(matrix, matrix.T, rtol=0, atol=1e-12):
        raise InvalidParameter(f"{path}: got {matrix.tolist()}, which is not symmetric", path)
    least = float(np.linalg.eigvalsh(matrix)[0])
    if least < MIN_EIGENVALUE:
        raise InvalidParameter(
            f"{path}: its smallest eigenvalue is {least:.3g}; needs a positive definite matrix: no quantities have "
            "these correlations, or one follows from the others. Lower the largest correlations",
            path,
        )
    return matrix
