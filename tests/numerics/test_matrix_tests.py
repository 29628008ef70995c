"""Powers of a matrix against its eigenvalues."""

import numpy as np
import pytest

from tarc.numerics.matrix_tests import powers_vanish


@pytest.mark.parametrize("n", [2, 12, 40])
@pytest.mark.parametrize(("radius", "vanishes"), [(0.0, True), (0.999, True), (1.0, False), (1.001, False)])
def test_powers_vanish_below_the_unit_circle_alone(n, radius, vanishes):
    """Of matrices that are not normal, so that their powers grow at first."""
    rng = np.random.default_rng(n)
    A = np.triu(rng.normal(size=(n, n)), 1) / n
    np.fill_diagonal(A, radius * rng.choice([-1, 1], n) * rng.uniform(0.2, 1.0, n))
    A[0, 0] = radius
    Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    assert powers_vanish(Q @ A @ Q.T) == vanishes


def test_powers_that_are_no_numbers_do_not_vanish():
    assert not powers_vanish(np.full((2, 2), np.nan))
