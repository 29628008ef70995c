"""The front of a search: points that no others beat, its knee, its table."""

import numpy as np
import pytest

from tarc import TarcError
from tarc.study.front import FrontPoint, TuningFront, front_csv, is_on_front


def test_on_the_front_is_what_no_other_beats():
    rng = np.random.default_rng(0)
    errors, variations = rng.integers(0, 6, (2, 40)).astype(float)
    pairs = list(zip(errors, variations, strict=True))
    beaten = [
        any((e <= error and v <= variation and (e, v) != (error, variation)) for e, v in pairs)
        for error, variation in pairs
    ]
    chosen = is_on_front(errors, variations)
    assert {pairs[i] for i in np.flatnonzero(chosen)} == {
        pair for pair, lost in zip(pairs, beaten, strict=True) if not lost
    }
    assert len({pairs[i] for i in np.flatnonzero(chosen)}) == chosen.sum()


def test_the_knee_of_a_hyperbola_is_its_middle():
    points = [
        FrontPoint({"kind": "TDC"}, {"a": x}, 1 / x**2 if x < 4 else 1 / (8 * x**0.5), x)
        for x in (16.0, 8.0, 4.0, 2.0, 1.0)
    ]
    front = TuningFront(tuple(points), 5)
    assert front.knee.torque_variation == 4.0
    assert front.pick(1) is front.points[0]
    assert front.pick("variation").torque_variation == 1.0
    for wrong, words in ((6, "points 1 to 5"), ("elbow", "knee")):
        with pytest.raises(TarcError, match=words):
            front.pick(wrong)
    assert front_csv({"x": front}).splitlines()[1] == "x,1,0.03125,16.0,,,16.0"
