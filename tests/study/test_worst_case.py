"""Search for the worst point on functions whose largest value is known."""

import numpy as np
import pytest

from tarc.core.errors import InvalidParameter
from tarc.study.worst_case import EDGE, search_worst_point

STARTS = np.array([[0.3, 0.6], [0.5, 0.5]])


def hills(points):
    """Return a broad hill at the middle, and a narrow one, twice as high, near a corner."""
    broad = np.exp(-8 * np.sum((points - 0.5) ** 2, axis=1))
    narrow = 2 * np.exp(-200 * np.sum((points - [0.9, 0.1]) ** 2, axis=1))
    return broad + narrow


def hills_gradient(point, step=1e-6):
    shifts = step * np.eye(point.size)
    return (hills(point + shifts) - hills(point - shifts)) / (2 * step)


def test_global_search_leaves_the_nearest_hill():
    found = search_worst_point(hills, STARTS, gradient=hills_gradient, generations=40, seed=1)
    assert found.point == pytest.approx([0.9, 0.1], abs=2e-3)
    assert found.value == pytest.approx(hills(np.array([[0.9, 0.1]]))[0], abs=1e-3)
    assert found.start_value == pytest.approx(1.0, abs=1e-3)
    assert found.value >= found.global_value >= found.start_value
    assert list(found.history) == sorted(found.history)


def test_gradients_polish():
    """Without a global search they climb the hill on which they begin."""
    found = search_worst_point(hills, np.array([[0.3, 0.6]]), gradient=hills_gradient, generations=0)
    assert found.n_steps > 2
    assert found.point == pytest.approx([0.5, 0.5], abs=0.01)


def test_gradients_stop_at_a_face():
    found = search_worst_point(
        lambda points: points @ [1.0, -1.0], STARTS, gradient=lambda _: np.array([1.0, -1.0]), generations=0
    )
    assert found.point == pytest.approx([1 - EDGE, EDGE])


def test_useless_gradient_ends_at_once():
    found = search_worst_point(hills, STARTS, gradient=lambda _: np.full(2, np.nan), generations=2, seed=2)
    assert found.n_steps == 0


def test_worst_start_is_never_lost():
    rng = np.random.default_rng(3)
    spike = np.array([0.123, 0.456])

    def noisy(points):
        return rng.random(len(points)) + 10.0 * np.all(points == spike, axis=1)

    found = search_worst_point(noisy, np.array([[0.5, 0.5], spike]), generations=3, seed=3)
    assert found.point.tolist() == spike.tolist()


def test_bad_input_is_refused():
    with pytest.raises(InvalidParameter, match="starts"):
        search_worst_point(hills, np.array([[1.5, 0.0]]))
    with pytest.raises(InvalidParameter, match="objective"):
        search_worst_point(lambda points: np.full(len(points), np.nan), STARTS)
