"""The loop on robots in this process, on a clock that does not wait."""

import numpy as np
import pytest

import tarc
from live_robots import INERTIA, PERIOD, QUICK, REFERENCE, WEIGHT, SlidingMasses, example_law, rows_of
from tarc.core.errors import InvalidParameter
from tarc.runtime import Push, SafetyLimits, SimulatedClock, StartUp, run_live
from tarc.runtime.log_format import Phase
from tarc.signals.log_file import read_log

GENTLE = StartUp(hold_time=0.05, ramp_time=0.4, brake_time=0.02, stop_time=0.2)


class LateRobot(SlidingMasses):
    """Takes its time in one period."""

    def __init__(self, clock: SimulatedClock, late_at: int, seconds: float) -> None:
        super().__init__()
        self.clock, self.late_at, self.seconds = clock, late_at, seconds

    def write(self, torque: np.ndarray) -> None:
        super().write(torque)
        if len(self.written) == self.late_at:
            self.clock.advance(self.seconds)


class LossyRobot(SlidingMasses):
    """Loses all samples from a period on."""

    def __init__(self, lost_from: int) -> None:
        super().__init__()
        self.lost_from = lost_from

    def read(self) -> np.ndarray:
        return super().read() if len(self.written) < self.lost_from else np.full(2, np.nan)


def test_a_run_goes_from_brakes_to_brakes():
    robot = SlidingMasses()
    start = robot.position.copy()
    result, rows = rows_of(robot, duration=0.5, start_up=GENTLE)
    assert result.ended == "completed"
    assert not result.is_safe_stop
    assert robot.is_braked
    phases = rows["phase"]
    assert list(dict.fromkeys(phases)) == [Phase.HOLD, Phase.RAMP, Phase.TRACK, Phase.STOP]
    np.testing.assert_array_equal(rows["torque"][0], WEIGHT)  # taken over from the brakes
    np.testing.assert_allclose(rows["reference"][phases == Phase.RAMP][0], start, atol=1e-6)
    np.testing.assert_allclose(np.diff(rows["period"]), 1)
    tracked = phases == Phase.TRACK
    times = PERIOD * np.arange(np.count_nonzero(tracked))
    np.testing.assert_allclose(rows["reference"][tracked], REFERENCE.sample(times)[0].T)
    error = rows["measured_position"] - rows["reference"]
    assert np.max(np.abs(error[tracked][100:])) < 1e-3
    np.testing.assert_allclose(rows["velocity_reference"][-1], 0, atol=1e-12)


def test_a_log_is_a_bag_as_well(tmp_path):
    pytest.importorskip("mcap_ros2")
    result, _ = rows_of(SlidingMasses(), duration=0.1, log=tmp_path / "log.mcap")
    assert result.log == tmp_path / "log.nc"
    measured = result.load().data["measured_position"].transpose("time", "joint").values
    in_bag = read_log(tmp_path / "log.mcap").position
    np.testing.assert_array_equal(in_bag, measured)


def test_reference_and_its_derivatives_fit_over_the_whole_run():
    _, rows = rows_of(SlidingMasses(), start_up=GENTLE)
    moving = rows["phase"] >= Phase.RAMP
    q, v, a = (rows[name][moving] for name in ("reference", "velocity_reference", "acceleration_reference"))
    np.testing.assert_allclose(np.diff(q, axis=0) / PERIOD, (v[1:] + v[:-1]) / 2, atol=2e-4)
    assert np.max(np.abs(np.diff(v, axis=0) / PERIOD - (a[1:] + a[:-1]) / 2)) < 0.02


def test_the_torque_is_that_of_a_controller_in_a_loop_of_ones_own():
    _, rows = rows_of(SlidingMasses())
    robot, law = SlidingMasses(), example_law()
    controller = tarc.Controller(law)
    controller.reset(robot.position, WEIGHT)
    robot.release_brakes()
    targets = zip(rows["reference"], rows["velocity_reference"], rows["acceleration_reference"], strict=True)
    for k, target in enumerate(targets):
        if k < 20:  # the brakes take their time
            continue
        if rows["phase"][k] == Phase.STOP:
            break
        torque = controller.step(robot.read(), *target)
        np.testing.assert_array_equal(torque, rows["torque"][k])
        robot.write(torque)


def test_lost_samples_lead_to_a_safe_stop():
    robot = LossyRobot(200)
    result, rows = rows_of(robot)
    assert result.is_safe_stop
    assert "samples missing in a row" in result.ended
    assert robot.is_braked
    np.testing.assert_array_equal(robot.written[-1], 0)  # the law's safe torque
    assert rows["phase"][-1] == Phase.SAFE_STOP


def test_the_watchdog_stops_where_the_law_would_bridge_on():
    robot = LossyRobot(200)
    result, rows = rows_of(robot, example_law(max_missing=1000), watchdog=0.03)
    assert "watchdog" in result.ended
    stopped = int(np.flatnonzero(rows["phase"] == Phase.SAFE_STOP)[0])
    assert 29 <= stopped - 199 <= 30  # the last sample came in period 199
    np.testing.assert_array_equal(rows["torque"][stopped:], 0)


@pytest.mark.parametrize("policy", ["bridge", "skip"])
def test_missed_periods_are_counted_and_the_reference_keeps_its_time(policy):
    clock = SimulatedClock()
    result, rows = rows_of(LateRobot(clock, 400, 4.2e-3), clock=clock, overrun=policy)
    assert result.overruns == 3
    assert result.ended == "completed"
    missed = np.setdiff1d(np.arange(rows["period"][-1]), rows["period"])
    assert len(missed) == 3
    tracked = rows["phase"] == Phase.TRACK
    steps = np.diff(rows["period"][tracked])
    assert np.max(steps) == 4
    first = rows["period"][tracked][0]
    times = PERIOD * (rows["period"][tracked] - first)
    np.testing.assert_allclose(rows["reference"][tracked], REFERENCE.sample(times)[0].T)


def test_a_robot_that_waits_has_later_deadlines_after_a_missed_period():
    clock = SimulatedClock()
    result, rows = rows_of(LateRobot(clock, 400, 4.2e-3), clock=clock, overrun="shift")
    _, in_time = rows_of(SlidingMasses())
    assert result.overruns == 3
    np.testing.assert_array_equal(rows["period"], in_time["period"])
    np.testing.assert_array_equal(rows["torque"], in_time["torque"])
    late = rows["lateness"] > 1e-9
    assert rows["lateness"][late] == pytest.approx([3.2e-3], abs=1e-9)


def test_a_missed_period_stops_the_run_on_request():
    clock = SimulatedClock()
    result, _ = rows_of(LateRobot(clock, 400, 4.2e-3), clock=clock, overrun="stop")
    assert result.ended == "the loop missed 3 periods"


def test_a_period_too_late_to_bridge_says_how_many_samples_were_missing():
    clock = SimulatedClock()
    law = example_law()
    result, _ = rows_of(LateRobot(clock, 400, (law.max_missing + 2.2) * PERIOD), law, clock=clock)
    assert result.is_safe_stop
    assert result.ended == f"{law.max_missing + 1} samples missing in a row"


def test_bridging_is_what_the_law_does_with_missing_samples_under_the_held_torque():
    clock = SimulatedClock()
    law = example_law()
    _, rows = rows_of(LateRobot(clock, 400, 2.0e-3), law, clock=clock)
    controller = tarc.Controller(law)
    controller.reset([0.3, -0.2], WEIGHT)
    start, late = 20, int(np.flatnonzero(np.diff(rows["period"]) > 1)[0])
    for k in range(start, late + 1):
        controller.step(*(rows[name][k] for name in ("measured_position", *TARGET)))
    held = rows["torque"][late]
    for _ in range(int(rows["period"][late + 1] - rows["period"][late]) - 1):
        # the reference in between does not matter to the estimator, and its torque did not act
        controller.step(np.full(2, np.nan), *(rows[name][late] for name in TARGET), applied_torque=held)
    torque = controller.step(*(rows[name][late + 1] for name in ("measured_position", *TARGET)), applied_torque=held)
    np.testing.assert_allclose(torque, rows["torque"][late + 1], rtol=1e-12)


TARGET = ("reference", "velocity_reference", "acceleration_reference")


@pytest.mark.parametrize(
    ("limits", "reason"),
    [
        (SafetyLimits(error=[0.001, np.inf]), "joint 1 is"),
        (SafetyLimits(speed=0.1), "has a speed of"),
    ],
)
def test_error_and_speed_beyond_their_limits_are_a_safe_stop(limits, reason):
    robot = SlidingMasses()
    robot.applied_torque = np.zeros(2)  # it sags at the start
    result, rows = rows_of(robot, limits=limits)
    assert result.is_safe_stop
    assert reason in result.ended
    assert robot.is_braked
    stopped = rows["phase"] == Phase.SAFE_STOP
    np.testing.assert_array_equal(rows["torque"][stopped], 0)


def test_torque_and_its_rate_are_clipped():
    robot = SlidingMasses()
    limits = SafetyLimits(torque=[3.5, 1.2], torque_rate=200.0)
    rows_of(robot, limits=limits)
    written = np.array(robot.written)
    assert np.all(np.abs(written) <= [3.5, 1.2])
    assert np.max(np.abs(np.diff(written, axis=0))) <= 0.2 + 1e-12


def test_a_sample_that_jumps_counts_as_missing():
    class Jumping(SlidingMasses):
        def read(self) -> np.ndarray:
            return super().read() + (5.0 if len(self.written) % 50 == 49 else 0.0)

    result, rows = rows_of(Jumping(), limits=SafetyLimits(max_step=0.05, error=0.1))
    assert result.ended == "completed"
    assert result.counts["rejected"] > 10
    assert np.isnan(rows["measured_position"]).any()


def test_positions_that_wrap_start_in_the_turn_of_the_first_one():
    robot = SlidingMasses(np.array([6.5, -0.2]))
    result, rows = rows_of(robot, limits=SafetyLimits(span=2 * np.pi))
    assert result.ended == "completed"
    np.testing.assert_allclose(robot.position[0], rows["reference"][-1, 0], atol=1e-2)
    assert robot.position[0] > 6.0


@pytest.mark.parametrize("constant", [1.0, 0.7])
def test_a_push_measures_the_torque_constant(constant):
    robot = SlidingMasses()
    robot.torque_constant[:] = constant
    robot.applied_torque = WEIGHT / constant
    push = Push(inertia=INERTIA, share=0.1)
    result, rows = rows_of(robot, start_up=StartUp(push=push, ramp_time=0.2, hold_time=0.05, brake_time=0.02))
    assert result.ended == "completed"
    for response, inertia in zip(result.push, INERTIA, strict=True):
        np.testing.assert_allclose(response.mobility, constant / inertia, rtol=1e-3)
        np.testing.assert_allclose(response.torque_constant, constant, rtol=1e-3)
        np.testing.assert_allclose(response.ratio, 0.1 * constant, rtol=1e-3)
        least, most = response.tolerance
        assert least < 1 < most
    assert Phase.PUSH in rows["phase"]


@pytest.mark.parametrize(
    ("constants", "reason"),
    [
        ([1.0, -1.0], "joint 2 moved against the push"),
        ([0.0, 1.0], "joint 1 did not move"),
        ([1.0, 0.2], "joint 2 has 0.20 to 0.20 times the torque"),
        ([10.0, 1.0], "joint 1 has an inertia ratio of 1"),
    ],
)
def test_a_push_refuses_wrong_signs_and_constants(constants, reason):
    robot = SlidingMasses()
    robot.torque_constant = np.array(constants)
    robot.applied_torque = np.divide(WEIGHT, constants, out=np.zeros(2), where=robot.torque_constant != 0)
    if constants[0] == 0:
        robot.read = lambda: np.array([0.3, -0.2])
    result, _ = rows_of(robot, start_up=StartUp(push=Push(inertia=INERTIA, max_travel=1.0)))
    assert result.is_safe_stop
    assert reason in result.ended


def test_a_push_that_moves_too_far_stops():
    result, _ = rows_of(SlidingMasses(), start_up=StartUp(push=Push(share=0.5, max_travel=1e-4)))
    assert "a push moved a joint" in result.ended


def test_nothing_starts_without_a_torque_limit():
    law = example_law(torque_limit=None)
    with pytest.raises(InvalidParameter, match=r"joint 1, 2 has none.*allow_unlimited_torque"):
        rows_of(SlidingMasses(), law)
    result, _ = rows_of(SlidingMasses(), law, allow_unlimited_torque=True)
    assert result.ended == "completed"


def test_policies_and_limits_are_checked():
    with pytest.raises(InvalidParameter, match="overrun"):
        rows_of(SlidingMasses(), overrun="ignore")
    with pytest.raises(InvalidParameter, match="error: got 3 numbers"):
        rows_of(SlidingMasses(), limits=SafetyLimits(error=[1.0, 2.0, 3.0]))
    with pytest.raises(InvalidParameter, match="reference: it has 1 joints, the law 2"):
        run_live(example_law(), SlidingMasses(), tarc.signals.Sinusoid(amplitude=[0.1], frequency=1.0), 1.0)
    with pytest.raises(InvalidParameter, match="watchdog"):
        rows_of(SlidingMasses(), watchdog=1.5 * PERIOD)
    with pytest.raises(InvalidParameter, match="speed: got -1"):
        SafetyLimits(speed=-1.0)


def test_joints_in_another_order_are_refused():
    with pytest.raises(InvalidParameter, match=r"its joints are first, second, those of the law second, first; the or"):
        rows_of(SlidingMasses(), joint_names=["second", "first"])


def test_a_robot_without_a_valid_position_is_refused():
    robot = LossyRobot(0)
    with pytest.raises(InvalidParameter, match=r"no valid position within 0\.2 s"):
        rows_of(robot, start_up=StartUp(patience=0.2))
    assert robot.is_braked


def test_a_period_that_no_machine_holds_is_refused():
    law = example_law(period=1e-7, estimator=tarc.estimators.Algebraic(window=1e-6))
    with pytest.raises(InvalidParameter, match=r"cannot hold: it wakes up \d+ µs late and takes \d+ µs"):
        run_live(law, SlidingMasses(), REFERENCE, 1e-3, priority=0, native=False)


def test_an_error_of_the_robot_closes_the_brakes():
    class Broken(SlidingMasses):
        def read(self) -> np.ndarray:
            if len(self.written) > 100:
                raise OSError("cable")
            return super().read()

    robot = Broken()
    with pytest.raises(OSError, match="cable"):
        rows_of(robot)
    assert robot.is_braked


def test_assumptions_are_watched():
    watch = tarc.Watch(n_joints=2, low=-0.1, high=1.0, period=PERIOD)
    result, rows = rows_of(SlidingMasses(), watch=watch)
    assert result.flags_seen == tarc.WatchFlag.POSITION
    outside = np.any(rows["measured_position"] < -0.1, axis=1)
    np.testing.assert_array_equal(rows["assumption_flags"][20:] == 1, outside[20:])


def test_the_holding_torque_may_be_given():
    _, rows = rows_of(SlidingMasses(), start_up=StartUp(holding_torque=[1.0, 2.0], ramp_time=0.4))
    np.testing.assert_array_equal(rows["torque"][0], [1.0, 2.0])


def test_a_run_without_a_log_says_so():
    result, _ = rows_of(SlidingMasses(), start_up=QUICK)
    assert result.log is None
    with pytest.raises(InvalidParameter, match="this run has none"):
        result.load()
