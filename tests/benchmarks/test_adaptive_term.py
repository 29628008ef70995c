"""Comparison at equal torque variation: between TDC's natural frequencies, with gains of the design or of the case."""

import math

import pytest
from benchmarks.adaptive_term import DESIGN, Result, chosen, hindsight, over_tdc

NAN = math.nan
RESULTS = {
    "TDC; 25 rad/s": Result(4.0, 100.0, NAN),
    "TDC; 40 rad/s": Result(1.0, 400.0, NAN),
    "TDC; 45 rad/s": Result(1.5, 800.0, NAN),
    "TARC, difference; soft": Result(1.0, 200.0, 0.5),
    "TARC, difference; stiff": Result(0.9, 402.0, 1.0),
    "TARC, difference; too stiff": Result(0.1, 500.0, 2.0),
    "TARC, window; soft": Result(1.8, 200.0, 0.5),
    "TARC, window, uncertified slope; stiff": Result(0.8, 400.0, 2.0),
    "constant gain; beyond": Result(2.0, 50.0, 1.0),
    "constant gain; soft": Result(3.0, 100.0, 1.0),
}


def test_tdc_is_interpolated_in_logarithms():
    """Error falls as one over the torque variation from 100 to 400, and beyond it the least error counts."""
    assert over_tdc(RESULTS, "TARC, difference; soft") == pytest.approx(0.5)
    assert over_tdc(RESULTS, "TARC, difference; too stiff") == pytest.approx(0.1)
    assert over_tdc(RESULTS, "TDC; 45 rad/s") == pytest.approx(1.5)
    assert math.isnan(over_tdc(RESULTS, "constant gain; beyond"))


def test_gains_keep_to_the_torque_variation_of_tdc():
    names = chosen({DESIGN: RESULTS, "another": {}})
    assert names["TDC"] == "TDC; 40 rad/s"
    assert names["TARC, difference"] == "TARC, difference; stiff"
    assert names["TARC, window"] == "TARC, window; soft"
    assert names["constant gain"] == "constant gain; beyond"


def test_hindsight_is_the_least_ratio():
    assert hindsight(RESULTS, "TARC, difference") == pytest.approx(0.5)
    assert hindsight(RESULTS, "TARC, window") == pytest.approx(0.9)
    assert hindsight(RESULTS, "constant gain") == pytest.approx(0.75)
