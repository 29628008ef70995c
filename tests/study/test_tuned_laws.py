"""Every tuned law in every scenario of the comparison, for a while."""

import numpy as np
import pytest
from benchmarks.comparison import SCENARIOS, markdown, ranks

from tarc import Scenario
from tarc.study import compare, tuned_laws

LAWS = list(tuned_laws())
KNOWN_TO_DIVERGE = {"tdc-difference", "tdc-differentiator"}


@pytest.mark.parametrize("name", SCENARIOS)
def test_torque_is_bounded_at_the_tuned_gains(name):
    """Finite always; and, of laws that keep the robot, within ten times what the median law takes at most."""
    found = compare(Scenario.load(name, ["duration=1.5", "measure_from=0.5"]), LAWS, jobs=1)
    assert set(found.failures) <= {"projection"}
    assert all("bounds" in reason or "model" in reason for reason in found.failures.values())
    peaks = {law: float(np.abs(run.data["torque"].values).max()) for law, run in found.runs.items()}
    assert all(np.isfinite(peak) for peak in peaks.values())
    lost = {law for law, run in found.runs.items() if not run.status.completed}
    assert lost <= KNOWN_TO_DIVERGE
    typical = float(np.median(list(peaks.values())))
    assert all(peak < 10 * typical for law, peak in peaks.items() if law not in KNOWN_TO_DIVERGE), peaks


def test_table_ranks_by_relative_error_and_says_what_failed():
    parts = {"tdc": tuned_laws()["tdc"], "wild": {"kind": "TDC", "inertia": {"fraction": 1.0}, "bandwidth": 10.0}}
    found = {
        "dropout_delay": compare(Scenario.load("dropout_delay", ["duration=1.5", "measure_from=0.5"]), parts, jobs=1)
    }
    order = ranks(found, list(parts))
    assert order["tdc"] == 1.0
    assert order["wild"] == np.inf
    assert "| wild | diverged |" in markdown(found, list(parts))
