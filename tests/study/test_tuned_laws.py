"""Every tuned law in every scenario of the comparison, for a while."""

import numpy as np
import pytest

from tarc import Scenario
from tarc.scenario.loader import shipped_scenarios
from tarc.study import compare, tuned_laws

LAWS = list(tuned_laws())
SCENARIOS = [
    name for name in shipped_scenarios() if name not in ("ur5e", "ur5e_model") and not name.startswith("train_")
]
LONG = {"ur5e_load", "underwater", "panda_multisine", "wheeled_figure_eight"}
WITH_MODEL = {name for name, part in tuned_laws().items() if "model" in part | part.get("inertia", {})}
KNOWN_TO_DIVERGE = {"tdc-difference", "tdc-differentiator"}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name in LONG else ()) for name in SCENARIOS]
)
def test_torque_is_bounded_at_the_tuned_gains(name):
    """Finite always; and, of laws that keep the robot, within ten times what the median law takes at most."""
    periods = Scenario.load(name).period / 1e-3
    settings = [f"duration={1.5 * periods}", f"metrics_start={0.5 * periods}"]
    found = compare(Scenario.load(name, settings), LAWS, jobs=1)
    assert set(found.failures) <= WITH_MODEL
    assert all("bounds" in reason or "model" in reason for reason in found.failures.values())
    peaks = {law: float(np.abs(run.data["torque"].values).max()) for law, run in found.runs.items()}
    assert all(np.isfinite(peak) for peak in peaks.values())
    lost = {law for law, run in found.runs.items() if not run.status.completed}
    assert lost <= KNOWN_TO_DIVERGE
    typical = float(np.median(list(peaks.values())))
    assert all(peak < 10 * typical for law, peak in peaks.items() if law not in KNOWN_TO_DIVERGE), peaks
