"""Definite matrix polynomials against dense grids, in floats and in balls."""

import numpy as np
import pytest

from tarc.numerics.ball_arithmetic import balls
from tarc.numerics.matrix_polynomial import (
    bernstein_coefficients,
    definite_pieces,
    evaluate,
    is_definite_on,
)

LOW, HIGH = 0.05, 3.0


def random_polynomial(seed: int, size: int = 4) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [part + part.T for part in rng.normal(size=(4, size, size))]


def least_eigenvalue(coefficients: list[np.ndarray]) -> float:
    grid = np.geomspace(LOW, HIGH, 4001)
    return min(float(np.linalg.eigvalsh(evaluate(coefficients, point))[0]) for point in grid)


def test_a_polynomial_is_the_mean_of_its_bernstein_coefficients():
    coefficients = random_polynomial(0)
    parts = bernstein_coefficients(coefficients, LOW, HIGH)
    for t in (0.0, 0.3, 1.0):
        weights = [(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3]
        mean = sum(weight * part for weight, part in zip(weights, parts, strict=True))
        assert mean == pytest.approx(evaluate(coefficients, LOW + t * (HIGH - LOW)), abs=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_definite_exactly_where_a_dense_grid_says_so(seed):
    coefficients = random_polynomial(seed)
    least = least_eigenvalue(coefficients)
    for share, is_definite in ((1e-3, True), (-1e-3, False)):
        shifted = [coefficients[0] - (least - share * abs(least)) * np.eye(4), *coefficients[1:]]
        ends = definite_pieces(shifted, LOW, HIGH)
        assert (ends is not None) == is_definite
        if ends is not None:
            assert (ends[0], ends[-1]) == (LOW, HIGH)
            assert is_definite_on([balls(part) for part in shifted], ends)
            wrong = [shifted[0] + 2 * share * least * np.eye(4) - 0.1 * abs(least) * np.eye(4), *shifted[1:]]
            assert not is_definite_on([balls(part) for part in wrong], ends)


def test_a_single_point_is_an_interval():
    assert definite_pieces([np.eye(2), np.eye(2)], 1.0, 1.0) is not None
    assert definite_pieces([-np.eye(2), np.eye(2)], 0.5, 0.5) is None
