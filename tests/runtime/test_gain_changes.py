"""Gains that change while a loop runs."""

import json
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from threading import Thread
from typing import Any

import numpy as np
import pytest

import tarc
from live_robots import WEIGHT, SlidingMasses, example_law, rows_of
from tarc.certificates.base import Verdict
from tarc.certificates.certified_gains import CertifiedGains
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.laws.pole_placement import PolePlacement
from tarc.runtime import GainChanges
from tarc.runtime.log_format import Phase
from tarc.signals.log_file import read_log

CHANGE = 300
TRACKED = 0.5
TARGET = ("reference", "velocity_reference", "acceleration_reference")


def has_compiler() -> bool:
    return any(map(shutil.which, ("cc", "gcc", "clang")))


class Verdictless:
    """A certificate of which the verdict alone counts."""

    verdict = Verdict.INCONCLUSIVE


def certified(law: PolePlacement, slopes: Mapping[float, float]) -> CertifiedGains:
    certificate: Any = Verdictless()
    return CertifiedGains(law=law, slopes=slopes, certificate=certificate)


class TurnedRobot(SlidingMasses):
    """Calls a function in one period."""

    def __init__(self, turn: Callable[[], object]) -> None:
        super().__init__()
        self.turn = turn

    def write(self, torque: Array) -> None:
        super().write(torque)
        if len(self.written) == CHANGE:
            self.turn()


def test_a_change_is_that_of_a_simulation_whose_law_changes_then(tmp_path: Any) -> None:
    law = example_law()
    changes = GainChanges(certified(law, {20.0: 0.0, 30.0: 0.0}))
    robot = TurnedRobot(lambda: changes.change(natural_frequency=30.0, wait=False))
    result, rows = rows_of(robot, law, changes=changes, log=tmp_path / "log.nc")
    assert result.ended == "completed"
    assert changes.law.natural_frequency == 30.0
    simulated = SlidingMasses()
    controller = tarc.Controller(law)
    controller.reset(simulated.position, WEIGHT)
    simulated.release_brakes()
    for k in range(20, int(np.flatnonzero(rows["phase"] == Phase.STOP)[0])):
        if k == CHANGE:
            controller.change_law(controller.prepare(replace(law, natural_frequency=30.0)))
        torque = controller.step(simulated.read(), *(rows[name][k] for name in TARGET))
        np.testing.assert_array_equal(torque, rows["torque"][k])
        simulated.write(torque)
    data = result.load().data
    np.testing.assert_array_equal(np.flatnonzero(np.diff(data["gain_changes"].values)), [CHANGE - 1])
    assert json.loads(data.attrs["gain_changes"]) == [{"natural_frequency": 30.0}]
    log = read_log(tmp_path / "log.nc")
    assert log.gain_changes == ((pytest.approx(CHANGE * law.period), {"natural_frequency": 30.0}),)
    options: dict[str, Any] = {
        "law": law,
        "start_time": float(data.attrs["tracking_start"]),
        "stop_time": TRACKED,
        "period": law.period,
    }
    with_changes = tarc.replay(log, **options).shadow
    without = tarc.replay(replace(log, gain_changes=()), **options).shadow
    assert with_changes is not None
    assert without is not None
    assert np.all(with_changes.difference < 0.01 * without.difference)  # of the reference, which is smoothed


def test_a_log_without_the_values_of_its_changes_is_refused(tmp_path: Any) -> None:
    law = example_law()
    changes = GainChanges(certified(law, {20.0: 0.0, 30.0: 0.0}))
    robot = TurnedRobot(lambda: changes.change(natural_frequency=30.0, wait=False))
    result, _ = rows_of(robot, law, changes=changes, log=tmp_path / "log.nc")
    data = result.load().data
    del data.attrs["gain_changes"]
    data.to_netcdf(tmp_path / "killed.nc", engine="h5netcdf")
    with pytest.raises(InvalidParameter, match="has 1 changes of the law's gains, and the values of 0"):
        read_log(tmp_path / "killed.nc")


@pytest.mark.skipif(not has_compiler(), reason="needs a C compiler")
def test_another_thread_changes_gains_of_machine_code_and_is_told_when_the_loop_ends() -> None:
    law = example_law()
    changes = GainChanges(certified(law, {20.0: 0.0, 30.0: 0.0}))
    threads = [Thread(target=changes.change, kwargs={"natural_frequency": 30.0})]

    def change() -> None:
        threads[0].start()
        end = time.monotonic() + 300
        while changes.law is law:  # the loop goes on when the change is prepared
            assert time.monotonic() < end
            time.sleep(1e-3)

    rows_of(TurnedRobot(change), law, changes=changes, native=True)
    threads[0].join(300)
    assert not threads[0].is_alive()
    assert changes.count == 1
    with pytest.raises(InvalidParameter, match="the loop does not run"):
        changes.change(natural_frequency=20.0)


@pytest.mark.parametrize(
    ("gains", "message"),
    [
        (
            {"natural_frequency": 40.0},
            r"natural_frequency: got 40; certified .*: one of 15, 20, 25\. Give",
        ),
        ({"natural_frequency": 17.0}, "natural_frequency: got 17"),
        ({"max_gain": 13.0}, r"max_gain: got 13; certified .*: 0\.02 to 12"),
        ({"damping_ratio": 2.0}, "damping_ratio: it has no certified range"),
        ({"natural_frequency": 25.0, "max_gain": 11.0}, "not together"),
        ({"rise_rate": -1.0}, "rise_rate: got -1; certified .*: any above 0"),
    ],
)
def test_what_is_not_certified_is_refused(gains: dict[str, Any], message: str) -> None:
    law = adaptive_law()
    changes = GainChanges(certified(law, {15.0: 600.0, 20.0: 1200.0, 25.0: 600.0}))
    with pytest.raises(InvalidParameter, match=message):
        changes.change(**gains)
    assert changes.law is law


def adaptive_law() -> tarc.laws.TARC:
    plain = example_law()
    return tarc.laws.TARC(
        inertia=plain.inertia,
        natural_frequency=20.0,
        period=plain.period,
        estimator=plain.estimator,
        rise_rate=1e4,
        fall_rate=5e3,
        max_gain=6.0,
        boundary_layer=0.01,
    )


def test_another_frequency_needs_a_certificate_for_the_gain_that_acts_meanwhile() -> None:
    law = adaptive_law()
    gains = certified(law, {20.0: 1200.0, 25.0: 600.0})
    risen = gains.change(law, {"max_gain": 11.0})
    assert gains.ranges(risen)["natural_frequency"].values == (20.0,)
    with pytest.raises(InvalidParameter, match=r"natural_frequency: got 25; .*: one of 20\."):
        gains.change(risen, {"natural_frequency": 25.0, "max_gain": 5.0})
    lowered = gains.change(risen, {"max_gain": 5.0})
    assert gains.change(lowered, {"natural_frequency": 25.0}).natural_frequency == 25.0


def test_no_gain_changes_where_the_law_is_not_certified_or_no_loop_runs() -> None:
    law = example_law()
    none = GainChanges(certified(law, {}))
    assert none.ranges == {}
    with pytest.raises(InvalidParameter, match="the law is inconclusive on this robot"):
        none.change(natural_frequency=21.0)
    idle = GainChanges(certified(law, {20.0: 0.0, 30.0: 0.0}))
    with pytest.raises(InvalidParameter, match="the loop does not run"):
        idle.change(natural_frequency=30.0)
    with pytest.raises(InvalidParameter, match="certified for another law"):
        rows_of(SlidingMasses(), example_law(), changes=idle)
