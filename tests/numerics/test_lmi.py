"""Linear matrix inequalities against closed forms and a second formulation."""

from typing import Any

import cvxpy as cp
import numpy as np
import pytest

from tarc.numerics.lmi import Inequalities, solve_lmi


def solution(sizes, at):
    values = solve_lmi(sizes, at)
    assert values is not None
    return values


def random_matrix(seed, n):
    return np.random.default_rng(seed).normal(size=(n, n))


@pytest.mark.parametrize("n", [1, 2, 5])
def test_the_least_eigenvalue(n):
    A = random_matrix(n, n)
    A = A + A.T
    (t,) = solution([0], lambda t: Inequalities(t, [A - t * np.eye(n)]))
    assert t == pytest.approx(np.linalg.eigvalsh(A)[0], abs=1e-6)


def test_the_order_of_entries_by_a_matrix_that_is_bounded_on_both_sides():
    A = random_matrix(4, 3)
    A = A + A.T

    def at(X, t):
        return Inequalities(-t, [X - A + t * np.eye(3), A - X + t * np.eye(3)])

    X, t = solution([3, 0], at)
    assert pytest.approx(A, abs=1e-5) == X
    assert t == pytest.approx(0.0, abs=1e-6)


def test_a_lyapunov_matrix_as_cvxpy_finds_it():
    A = random_matrix(1, 3) - 3 * np.eye(3)

    def at(t, P):
        return Inequalities(t, [-(A.T @ P + P @ A) - t * np.eye(3), P], [np.trace(P) - 3])

    t, P = solution([0, 3], at)
    Q, s = cp.Variable((3, 3), symmetric=True), cp.Variable()
    form = -(A.T @ Q + Q @ A)
    constraints: list[Any] = [(form + form.T) / 2 >> s * np.eye(3), Q >> 0, cp.trace(Q) == 3]
    problem = cp.Problem(cp.Maximize(s), constraints)
    problem.solve(solver=cp.CLARABEL)
    assert t == pytest.approx(s.value, rel=1e-5)
    assert pytest.approx(P, abs=1e-4) == Q.value


def test_no_values_without_a_solution_or_for_data_that_are_not_finite():
    assert solve_lmi([0], lambda x: Inequalities(x, [np.diag([x - 1, -x])])) is None
    assert solve_lmi([0], lambda x: Inequalities(x, [np.diag([np.nan * x, -x])])) is None
