"""The least value of a function in an interval, against minima that are known."""

import numpy as np
import pytest

from tarc.numerics.interval_minimum import minimise_in_interval


@pytest.mark.parametrize("tolerance", [1e-3, 1e-7])
def test_minimum_inside_the_interval(tolerance):
    place, value = minimise_in_interval(lambda x: abs(x - 0.3) + 1, -1.0, 2.0, tolerance)
    assert place == pytest.approx(0.3, abs=tolerance)
    assert value == 1 + abs(place - 0.3)


def test_minimum_at_an_end_of_the_interval():
    place, value = minimise_in_interval(np.exp, 1.0, 2.0, 1e-6)
    assert place == pytest.approx(1.0, abs=1e-5)
    assert value == pytest.approx(np.e, rel=1e-5)
