"""Operations on arrays and on symbols give the same numbers."""

import casadi as ca
import numpy as np
import pytest

from tarc.core import array_ops as ops

POINTS = np.array([-0.9, -0.3, 0.2, 0.8])
POSITIVE = POINTS + 1.5
UNARY = ["abs", "arccos", "arcsin", "arctan", "cos", "cosh", "exp", "floor", "sign", "sin", "sinh", "tan", "tanh"]


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
@pytest.mark.parametrize(
    ("name", "points"), [*((name, POINTS) for name in UNARY), ("log", POSITIVE), ("sqrt", POSITIVE)]
)
def test_functions_of_one_vector(kind, name, points):
    x = kind.sym("x", len(points))
    function = getattr(ops, name)
    expected = getattr(np, name)(points)
    assert np.array_equal(function(points), expected)
    assert np.allclose(np.array(ca.Function("f", [x], [function(x)])(points))[:, 0], expected, rtol=1e-15)


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
@pytest.mark.parametrize("name", ["arctan2", "maximum", "minimum"])
def test_functions_of_two_vectors(kind, name):
    x, y = kind.sym("x", 4), kind.sym("y", 4)
    function = getattr(ops, name)
    expected = getattr(np, name)(POINTS, POSITIVE)
    assert np.array_equal(function(POINTS, POSITIVE), expected)
    assert np.allclose(np.array(ca.Function("f", [x, y], [function(x, y)])(POINTS, POSITIVE))[:, 0], expected)
