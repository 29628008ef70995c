from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("nicegui")

from tarc.analysis.optimum import law_distances
from tarc.analysis.stability import stable_intervals, widest_interval
from tarc.scenario.model import Scenario
from tarc.studio.analysis import analyse_loop, robot_facts, stability_map
from tarc.studio.design_state import DesignState
from tarc.studio.figures import cloud_figure, curves_figure, gain_figure, map_figure
from tarc.studio.results import RobotFacts
from tarc.studio.robots import Robots
from tarc.studio.runs import run_pair

FACTS = RobotFacts(min_ratio=0.5, max_ratio=1.5, mean_inertia=np.diag([3.0, 1.0]))
DESIGNS = [
    DesignState(),
    DesignState(window=16, damping_ratio=0.7),
    DesignState(synchronised=True),
    DesignState(degree=3, window=20, control_rate=2000),
    DesignState(delay=3, window=8),
]


def law_of(state):
    scenario = Scenario.parse(state.to_content(Robots().content(state.robot)))
    return next(iter(scenario.build().laws.values()))


@pytest.mark.parametrize("state", DESIGNS)
def test_map_is_that_of_the_eigenvalues(state):
    """The map interpolates between angles; `stable_intervals` solves for the ends at each natural frequency."""
    frequencies = np.array([4.0, 25.0, 90.0])
    found = stability_map(state, frequencies=frequencies)
    for frequency, low, high in zip(frequencies, found.low, found.high, strict=True):
        law = law_of(state.with_changes(natural_frequency=float(frequency)))
        exact = widest_interval(stable_intervals(law))
        if exact is None:
            assert np.isnan(low)
        else:
            assert (low, high) == pytest.approx(exact, rel=2e-2)


def test_computation_delay_of_a_scenario_is_in_the_map():
    state = DesignState()
    prompt, late = (analyse_loop(state, replace(FACTS, computation_delay=delay)).stable for delay in (0, 1))
    exact = widest_interval(stable_intervals(law_of(state), computation_delay=1))
    assert prompt is not None
    assert late is not None
    assert late == pytest.approx(exact, rel=1e-9)
    assert late[1] < 0.9 * prompt[1]


def test_even_delay_is_stable_nowhere():
    assert np.isnan(stability_map(DesignState(delay=2)).low).all()


def test_numbers_of_the_loop_are_those_of_the_package():
    state = DesignState(natural_frequency=18.0)
    found = analyse_loop(state, FACTS)
    law = law_of(state)
    assert found.stable == pytest.approx(widest_interval(stable_intervals(law)))
    distance = law_distances(law, [found.ratios[1]])[0]
    assert found.error_over_optimum == pytest.approx(distance.ratio)
    assert found.change_over_optimum == pytest.approx(distance.change_ratio)
    assert found.ratios[0] == pytest.approx(0.08 * 0.5)
    assert found.is_stable == (True, True, True)
    assert np.isfinite(found.torque_noise)


def test_large_share_is_unstable():
    found = analyse_loop(DesignState(inertia_share=1.0), FACTS)
    assert not any(found.is_stable)
    assert np.isinf(found.torque_noise)
    assert np.isinf(found.error_over_optimum)


def test_shares_hold_every_inertia_of_the_motion():
    found = stability_map(DesignState())
    low, high = found.shares(FACTS)
    is_there = np.isfinite(low)
    assert is_there.any()
    assert np.all(low[is_there] * FACTS.min_ratio >= found.low[is_there] * (1 - 1e-12))
    assert np.all(high[is_there] * FACTS.max_ratio <= found.high[is_there] * (1 + 1e-12))


def test_facts_enclose_those_of_the_mean_inertia():
    facts = robot_facts(DesignState(payload=0.0), Robots())
    loaded = robot_facts(DesignState(payload=4.0), Robots())
    assert robot_facts(DesignState(payload=0.0), Robots()).min_ratio == facts.min_ratio
    assert facts.min_ratio < 1 < facts.max_ratio
    assert loaded.min_ratio < facts.min_ratio  # more mass, smaller M⁻¹M̄


@pytest.mark.slow
def test_figures_are_plain_data():
    state = DesignState()
    loop = analyse_loop(state, FACTS)
    figure = map_figure(state, loop, FACTS)
    dot = figure["layout"]["shapes"][0]
    assert (dot["xanchor"], dot["yanchor"]) == (15.0, 0.08)
    assert len(gain_figure(loop)["data"]) == 3
    pair = run_pair(state, Robots())
    joint = pair.curves.design.joints[0]
    for quantity in ("error", "torque"):
        assert [line["name"] for line in curves_figure(pair.curves, quantity, joint)["data"]] == ["PID (rival)", "TDC"]
    error = curves_figure(pair.curves, "error", joint)
    assert error["layout"]["yaxis"]["title"]["text"].endswith("[mrad]")
    data = pair.design.data.sel(joint=joint)
    largest = np.max(np.abs(data["position"].values - data["reference"].values))
    assert max(np.abs(error["data"][1]["y"])) == pytest.approx(1e3 * largest, rel=0.05)
    again = run_pair(state.with_changes(inertia_share=0.1), Robots(), pair)
    assert again.curves.rival is pair.curves.rival
    assert again.design is not pair.design
    completed = np.array([[True, True], [False, True]])
    cloud = cloud_figure(np.array([1.0, 2.0]), np.ones((2, 2)), completed, ["TDC", "PID"], ("mass", "error"), False)
    assert [part["name"] for part in cloud["data"]] == ["TDC", "TDC, diverged", "PID (rival)"]
