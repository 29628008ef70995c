"""Semidefinite programs with a known solution, and those at which the solver fails."""

from typing import Any

import cvxpy as cp
import numpy as np
import pytest

from tarc.numerics.sdp import bisect, max_feasible, min_scaled_eigenvalue, solve


def stability_program(pole: float) -> tuple[cp.Problem, cp.Variable]:
    """Return the program of AᵀP + PA ≤ −t I with tr P = 2, A = −diag(pole, 1)."""
    P, t = cp.Variable((2, 2), symmetric=True), cp.Variable()
    A = -np.diag([pole, 1.0])
    constraints: list[Any] = [-(A.T @ P + P @ A) >> t * np.eye(2), cp.trace(P) == 2]
    return cp.Problem(cp.Maximize(t), constraints), P


def test_known_solution():
    """With poles 3 and 1 the best P is diag(1/2, 3/2)."""
    problem, P = stability_program(3.0)
    values = solve(problem, P)
    assert values is not None
    np.testing.assert_allclose(values[0], np.diag([0.5, 1.5]), atol=1e-6)
    np.testing.assert_array_equal(values[0], values[0].T)


@pytest.mark.parametrize(("pole", "error"), [(1e300, cp.SolverError), (np.inf, ValueError), (np.nan, ValueError)])
def test_no_values_where_cvxpy_raises(pole, error):
    with pytest.raises(error):
        stability_program(pole)[0].solve(solver=cp.CLARABEL)
    assert solve(*stability_program(pole)) is None


def test_no_values_of_an_infeasible_program():
    x = cp.Variable()
    assert solve(cp.Problem(cp.Minimize(x), [x >= 1, x <= 0]), x) is None


def test_another_error_passes():
    """A program that is not convex is a mistake of the caller."""
    x = cp.Variable()
    with pytest.raises(cp.DCPError):
        solve(cp.Problem(cp.Minimize(-(x**2))), x)


def test_searches_find_the_limit():
    assert bisect(lambda x: x <= 0.7, 1e-9, 10.0) == pytest.approx(0.7, rel=1e-9)
    assert bisect(lambda x: False, 1e-9, 10.0) == 0.0
    limit = max_feasible(lambda x: x if x <= 0.7 else None, lambda point: min(1.1 * point, 0.7), 1e-3)
    assert limit == pytest.approx(0.7, rel=1e-6)
    assert max_feasible(lambda x: None, lambda point: 1.0, 1e-3) == 0.0


def test_scaled_eigenvalue_does_not_depend_on_units():
    form = np.array([[2.0, -0.5], [-0.5, 1.0]])
    units = np.diag([1.0, 1e4])
    value, direction = min_scaled_eigenvalue(form)
    scaled_value, scaled_direction = min_scaled_eigenvalue(units @ form @ units)
    assert scaled_value == pytest.approx(value, rel=1e-12)
    back = units @ scaled_direction
    np.testing.assert_allclose(np.abs(back / np.linalg.norm(back)), np.abs(direction), rtol=1e-9)
