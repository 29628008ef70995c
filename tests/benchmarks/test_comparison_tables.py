"""The tables that the comparison of all laws writes."""

import numpy as np
from benchmarks.comparison import markdown, ranks

from tarc import Scenario
from tarc.study import compare, tuned_laws


def test_table_ranks_by_relative_error_and_says_what_failed():
    parts = {
        "tdc": tuned_laws()["tdc"],
        "wild": {"kind": "TDC", "inertia": {"fraction": 1.0}, "natural_frequency": 10.0},
    }
    found = {
        "dropout_delay": compare(Scenario.load("dropout_delay", ["duration=1.5", "metrics_start=0.5"]), parts, jobs=1)
    }
    order = ranks(found, list(parts))
    assert order["tdc"] == 1.0
    assert order["wild"] == np.inf
    assert "| wild | diverged |" in markdown(found, list(parts))
