"""The real-time face."""

import logging
import tracemalloc

import numpy as np
import pytest

from law_catalogue import make_law
from tarc import Controller, laws
from tarc.core.errors import ControllerNotReset, InvalidParameter


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
