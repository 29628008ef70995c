from dataclasses import fields

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("nicegui")

from tarc.core.errors import InvalidParameter
from tarc.scenario.model import Scenario
from tarc.studio.controls import slider_position, slider_value
from tarc.studio.design_state import CONTROLS, LAWS, PRESETS, RIVALS, DesignState, History
from tarc.studio.robots import SHIPPED, Robots, state_of

numbers = {
    control.name: st.floats(control.low, control.high).map(lambda value: float(f"{value:.3g}")) for control in CONTROLS
}
states = st.builds(
    lambda law, rival, model_known, synchronised, **values: DesignState().with_changes(
        law=law, rival=rival, model_known=model_known, synchronised=synchronised, **values
    ),
    law=st.sampled_from(LAWS),
    rival=st.sampled_from(RIVALS),
    model_known=st.booleans(),
    synchronised=st.booleans(),
    **numbers,
)


@given(states)
@settings(max_examples=30, deadline=None)
def test_url_carries_the_design(state):
    assert DesignState.from_query(state.to_query()) == (state, [])


@given(st.text("abz_=&%0.19-", max_size=40))
@settings(max_examples=25, deadline=None)
def test_any_query_gives_a_valid_design(query):
    state, _ = DesignState.from_query(query)
    for control in CONTROLS:
        assert control.low <= getattr(state, control.name) <= control.high


def test_query_says_what_it_does_not_understand():
    query = "natural_frequency=20&speed=3&window=many&law=LQG&damping_ratio=nan&synchronised=maybe"
    state, notes = DesignState.from_query(query)
    assert state == DesignState(natural_frequency=20.0)
    assert [note.partition("=")[0] for note in notes] == ["speed", "window", "law", "damping_ratio", "synchronised"]


def test_values_stay_in_their_ranges():
    state = DesignState().with_changes(natural_frequency=1e9, payload=-3, encoder_bits=16.4)
    assert (state.natural_frequency, state.payload, state.encoder_bits) == (100.0, 0.0, 16)
    assert isinstance(state.encoder_bits, int)
    assert DesignState().with_changes(degree=4, window=3).window == 5
    with pytest.raises(InvalidParameter, match="law"):
        DesignState().with_changes(law="LQG")


def test_slider_gives_back_the_value_of_its_position():
    for control in CONTROLS:
        value = getattr(DesignState(), control.name)
        assert slider_value(control, slider_position(control, value)) == pytest.approx(value, rel=1e-2)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_scenario_becomes_a_design_and_back(name):
    base = Robots().content(name)
    state, _ = state_of(base)
    scenario = Scenario.parse(state.to_content(base))
    written = base["law"][0] if isinstance(base["law"], list) else base["law"]
    law = next(iter(scenario.laws.values()))
    assert {key: law[key] for key in written} == written
    assert scenario.sensor["bits"] == base["sensor"]["bits"]


def test_scenario_says_what_the_page_cannot_express():
    base = Robots().content("two_link_payload") | {
        "law": {"kind": "SuperTwisting", "inertia": [1.0, 1.0], "disturbance_rate": 3.0, "natural_frequency": 500.0},
        "estimator": {"kind": "LevantDifferentiator"},
        "jitter": 0.2,
    }
    state, notes = state_of(base)
    assert state.law == "TDC"
    text = "; ".join(notes)
    for part in ("jitter", "SuperTwisting", "law.inertia", "LevantDifferentiator", "disturbance_rate", "outside"):
        assert part in text


def test_limits_of_the_robot_reach_the_runs():
    base = Robots().content("two_link_payload") | {
        "law": {"kind": "TDC", "inertia": {"fraction": 0.1}, "natural_frequency": 15.0, "torque_limit": [30.0, 20.0]},
        "torque_limits": {"rate": 500.0},
        "computation_delay": 1,
    }
    state, notes = state_of(base)
    assert notes == ["torque_limits: in the runs; map and certificates do not know it"]
    for content in (state.to_content(base), state.rival_content(base)):
        scenario = Scenario.parse(content)
        assert next(iter(scenario.laws.values()))["torque_limit"] == [30.0, 20.0]
        assert (scenario.torque_limits, scenario.computation_delay) == ({"rate": 500.0}, 1)


@given(states)
@settings(max_examples=10, deadline=None)
def test_every_design_is_a_scenario(state):
    robots = Robots()
    base = robots.content(state.robot)
    for content in (state.to_content(base), state.rival_content(base)):
        scenario = Scenario.parse(content)
        assert scenario.period == pytest.approx(1 / state.control_rate)


def test_presets_are_designs():
    names = {part.name for part in fields(DesignState)}
    for changes in PRESETS.values():
        assert set(changes) <= names
        DesignState().with_changes(**changes)


def test_undo_and_redo():
    history = History()
    start = history.state
    for value in (16.0, 17.0, 18.0):
        history.move(start.with_changes(natural_frequency=value), "natural_frequency")
    history.move(history.state.with_changes(payload=1.0), "payload")
    assert history.undo().payload == start.payload
    assert history.undo() == start  # the moves of one slider are one
    assert not history.can_undo
    assert history.redo().natural_frequency == 18.0
    history.move(start)
    assert not history.can_redo
