"""The real-time face."""

import logging
import tracemalloc

import numpy as np
import pytest

from law_catalogue import make_law
from tarc import Controller, laws
from tarc.core.errors import ControllerNotReset, InvalidParameter
from tarc.estimators import Algebraic


@pytest.fixture
def controller():
    reset_controller = Controller(make_law(laws.TARC, max_missing=2))
    reset_controller.reset(np.zeros(2))
    return reset_controller


def test_allocates_nothing_after_the_first_call(controller):
    arguments = [np.zeros(2), np.full(2, 0.1), np.zeros(2), np.zeros(2)]
    first = controller.step(*arguments)
    for _ in range(100):  # let interpreter caches fill
        controller.step(*arguments)
    second = first
    tracemalloc.start()
    before = tracemalloc.take_snapshot()
    for _ in range(2000):
        second = controller.step(*arguments)
    after = tracemalloc.take_snapshot()
    tracemalloc.stop()
    grown = sum(
        max(entry.size_diff, 0) for entry in after.compare_to(before, "filename") if "tarc" in str(entry.traceback)
    )
    assert grown < 500, "a leak or an array a call would be 2000 times more"
    assert second is first


def test_torque_cannot_be_overwritten(controller):
    torque = controller.step(np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2))
    with pytest.raises(ValueError, match="read-only"):
        torque[0] = 1.0


def test_says_when_it_gives_up(controller, caplog):
    zero, missing = np.zeros(2), np.array([0.0, np.nan])
    with caplog.at_level(logging.ERROR, logger="tarc"):
        torque = np.ones(2)
        for _ in range(5):
            torque = controller.step(missing, zero + 0.1, zero, zero)
    assert controller.fault
    assert controller.missing == 5
    assert [record.message for record in caplog.records] == [
        "3 samples missing in a row: the safe torque (zero) is applied until reset"
    ]
    np.testing.assert_array_equal(torque, 0.0)
    controller.reset(zero)
    assert not controller.fault
    assert np.any(controller.step(zero, zero + 0.1, zero, zero) != 0)


def test_signals_are_readable(controller):
    controller.step(np.zeros(2), np.full(2, 0.1), np.zeros(2), np.zeros(2))
    assert controller.signals["gain"][0] == controller.law.start_gain


def test_misuse_is_refused():
    controller = Controller(make_law(laws.TDC))
    zero = np.zeros(2)
    with pytest.raises(ControllerNotReset, match="called before reset"):
        controller.step(zero, zero, zero, zero)
    with pytest.raises(InvalidParameter, match="position: .*finite numbers, not NaN"):
        controller.reset([0.0, np.nan])
    with pytest.raises(InvalidParameter, match=r"position: got shape \(3,\)"):
        controller.reset(np.zeros(3))
    controller.reset(zero)
    with pytest.raises(InvalidParameter, match=r"got shapes .*\(3,\).* needs \(2,\) each"):
        controller.step(np.zeros(3), zero, zero, zero)
    with pytest.raises(InvalidParameter, match="law: got .*constructed"):
        Controller(laws.TDC)  # type: ignore[arg-type]


def drive(controller, n_periods=3000, speed=4.0, wrap=lambda position: position, glitch=0.0):
    """Errors and torques of a joint of 0.1 kg m² that turns at a speed; one sample in the middle is off by a glitch."""
    position = velocity = 0.0
    controller.reset([wrap(position)])
    errors, torques = [], []
    for k in range(n_periods):
        goal = speed * k * 1e-3
        reading = wrap(position + (glitch if k == n_periods // 2 else 0.0))
        torque = controller.step([reading], [wrap(goal)], [speed], [0.0])[0]
        velocity += 1e-3 * torque / 0.1
        position += 1e-3 * velocity
        errors.append(position - goal)
        torques.append(torque)
    return np.array(errors), np.array(torques)


def one_joint_law(**options):
    return make_law(laws.TDC, 1, inertia=[0.005], torque_limit=[5.0], **options)


@pytest.mark.parametrize("low", [0.0, -np.pi])
@pytest.mark.parametrize("native", [False, True])
def test_positions_and_references_that_wrap_are_unwrapped(low, native, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    plain = drive(Controller(one_joint_law()))
    wrapping = Controller(one_joint_law(), native, span=2 * np.pi)
    wrapped = drive(wrapping, wrap=lambda position: (position - low) % (2 * np.pi) + low)
    for expected, found in zip(plain, wrapped, strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)


def test_turns_start_at_the_reset_and_go_on_after_missing_samples():
    controller = Controller(make_law(laws.TDC), span=[1.0, np.inf])
    plain = Controller(make_law(laws.TDC))
    zero = np.zeros(2)
    for face in (controller, plain):
        face.reset([7.9, 0.0])
    for reading, true in (([0.95, 0.0], 7.95), ([np.nan, np.nan], np.nan), ([0.05, 0.0], 8.05), ([0.15, 3.0], 8.15)):
        torque = controller.step(reading, [0.9, 0.0], zero, zero)
        expected = plain.step([true, reading[1]], [7.9, 0.0], zero, zero)
        np.testing.assert_allclose(torque, expected, rtol=0, atol=1e-8)
        assert controller.missing == plain.missing


def test_a_sample_that_jumps_counts_as_missing():
    _, torques = drive(Controller(one_joint_law()), glitch=0.5)
    assert np.max(np.abs(torques[1000:])) == 5.0
    errors, torques = drive(Controller(one_joint_law(), max_step=0.05), glitch=0.5)
    assert np.max(np.abs(torques[1000:])) < 1e-3
    assert np.ptp(errors[1000:]) < 1e-3


def test_a_position_that_stays_away_is_a_fault(caplog):
    controller = Controller(one_joint_law(max_missing=3), max_step=0.05)
    controller.reset([0.0])
    for k in range(1, 6):
        controller.step([0.2], [0.0], [0.0], [0.0])
        assert (controller.missing, controller.fault) == (k, k > 3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"span": 0.0}, "span: got 0.0; needs one number above 0"),
        ({"span": [1.0] * 3}, "Controller: span: got 3 numbers; needs one number or 2 of them"),
        ({"max_step": [0.1] * 3}, "Controller: max_step: got 3 numbers; needs one number or 2 of them"),
        ({"span": 1.0, "max_step": 0.6}, "max_step: got 0.6 with a span of 1.0; needs less than half the span"),
    ],
)
def test_bad_spans_are_refused(options, message):
    with pytest.raises(InvalidParameter, match=message):
        Controller(make_law(laws.TDC), **options)


@pytest.mark.parametrize("short", [0.1, [0.1], None, "1", np.zeros((2, 2))])
def test_nothing_is_broadcast(controller, short):
    """A truncated packet does not move the robot."""
    zero = np.zeros(2)
    for place in range(4):
        arguments = [zero, zero, zero, zero]
        arguments[place] = short
        with pytest.raises(InvalidParameter, match="Controller.step: got shapes"):
            controller.step(*arguments)


def test_a_controller_says_what_it_is():
    controller = Controller(make_law(laws.TDC))
    assert repr(controller) == "Controller(TDC, n_joints=2, period=0.001 s, not reset)"
    controller.reset(np.zeros(2))
    assert repr(controller).endswith(", ready)")
    html = controller._repr_html_()
    assert html.startswith("<p><b>Controller of TDC</b>, 2 joints, ready</p>")
    assert "<td>period</td><td>0.001</td>" in html


@pytest.mark.parametrize("max_step", [None, 1.0])
def test_gives_up_on_request_until_reset(max_step):
    law = laws.TDC(
        inertia=[0.1, 0.2],
        natural_frequency=10.0,
        period=1e-3,
        estimator=Algebraic(window=0.010),
        safe_torque="hold",
    )
    controller = Controller(law, max_step=max_step)
    with pytest.raises(ControllerNotReset, match="give_up"):
        controller.give_up()
    zero = np.zeros(2)
    controller.reset(zero, [1.0, 2.0])
    last = controller.step(zero, zero + 0.1, zero, zero).copy()
    controller.give_up()
    for _ in range(3):
        np.testing.assert_array_equal(controller.step(zero, zero + 0.1, zero, zero), last)
    assert controller.fault
    assert controller.missing == 0
    controller.reset(zero)
    controller.step(zero, zero, zero, zero)
    assert not controller.fault
