"""Watched assumptions: each flag at its limit, in NumPy, in the virtual machine and after odd inputs."""

import numpy as np
import pytest

import tarc
from tarc.analysis import Workspace, watch_workspace
from tarc.control.watch import WatchInput
from tarc.core.errors import InvalidParameter

LIMITS = {"low": [-1.0, -2.0], "high": 1.5, "tube": 0.1, "speed": [2.0, 3.0], "rest_torque": 5.0, "period": 1e-3}


def watch(**options):
    return tarc.Watch(n_joints=2, rest_periods=4, rest_speed=0.1, **(LIMITS | options))


def plain_flags(limits, position, reference, velocity, elapsed):
    """Return the flags without that of the load, written anew with loops."""
    low, high, tube, speed = (np.broadcast_to(limits[name], 2) for name in ("low", "high", "tube", "speed"))
    flags = 0
    for i in range(2):
        if np.isfinite(position[i]):
            flags |= 1 * bool(position[i] < low[i] or position[i] > high[i])
            flags |= 2 * bool(abs(position[i] - reference[i]) > tube[i])
        flags |= 4 * bool(abs(velocity[i]) > speed[i])
    is_known = elapsed != 0 and not np.isnan(elapsed)
    return flags | 16 * bool(is_known and abs(elapsed - 1e-3) > 1e-4)


def test_flags_are_those_of_the_definition_in_numpy_and_in_the_virtual_machine():
    rng = np.random.default_rng(0)
    watcher, state = tarc.Watcher(watch()), watch().init()
    seen = 0
    for _ in range(300):
        position = rng.uniform(-2.5, 2.5, 2)
        reference = position + rng.uniform(-0.15, 0.15, 2)
        velocity = rng.uniform(-3.5, 3.5, 2)
        if rng.random() < 0.2:
            position[rng.integers(2)] = rng.choice([np.nan, np.inf, -np.inf])
        elapsed = rng.choice([0.0, np.nan, 1e-3, 0.95e-3, 1.2e-3, 0.8e-3])
        expected = plain_flags(LIMITS, position, reference, velocity, elapsed)
        seen |= expected
        assert watcher.step(position, reference, velocity, [0.0, 0.0], elapsed=elapsed) == expected
        assert watcher.flags_seen == seen
        state, output = watch().step(state, WatchInput(position, reference, velocity, np.zeros(2), elapsed))
        assert (output.flags, output.flags_seen) == (expected, seen)
    watcher.reset()
    assert watcher.flags_seen == 0


def test_limits_themselves_are_allowed():
    watcher = tarc.Watcher(watch(tube=None))
    assert watcher.step([-1.0, 1.5], [0.0, 0.0], [2.0, -3.0], [0.0, 0.0], elapsed=1e-3) == 0


def test_the_load_is_the_mean_torque_at_rest():
    watcher = tarc.Watcher(tarc.Watch(n_joints=2, rest_torque=[5.0, 1.0], rest_periods=4, rest_speed=0.1))
    zero, load = np.zeros(2), tarc.WatchFlag.LOAD

    def rest(torque, periods=4, velocity=0.0):
        return [watcher.step(zero, zero, [velocity, 0.0], torque) for _ in range(periods)]

    assert rest([5.0, -1.0]) == [0, 0, 0, 0]
    assert rest([5.0, -1.1]) == [0, 0, 0, load]
    assert rest([0.0, 0.0]) == [load, load, load, 0]
    assert rest([9.0, 9.0], 20, velocity=0.2) == [0] * 20  # motion says nothing about the load
    assert rest([9.0, 9.0], 3) + rest([9.0, 9.0], 1, velocity=-0.2) + rest([0.0, 0.0]) == [0] * 8
    alternating = [watcher.step(zero, zero, zero, [20.0 * sign, 0.0]) for sign in (1, -1, 1, -1)]
    assert alternating == [0] * 4
    assert rest([np.nan, 9.0], 8) == [0] * 8
    assert watcher.flags_seen == load


def test_only_what_has_a_limit_is_watched():
    assert tarc.Watch(n_joints=2, speed=[np.inf, 1.0]).watched == tarc.WatchFlag.SPEED
    watcher = tarc.Watcher(tarc.Watch(n_joints=2, speed=[np.inf, 1.0]))
    assert watcher.step([9.0, 9.0], [0.0, 0.0], [9.0, 0.5], [9.0, 9.0], elapsed=1.0) == 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"low": 2.0}, "joint 1 goes from 2 to 1.5"),
        ({"speed": -1.0}, "speed"),
        ({"speed": [1.0, 2.0, 3.0]}, "one number or 2 of them"),
        ({"tube": np.nan}, "tube"),
        ({"period": 0.0}, "period"),
        ({"tolerance": -1.0}, "tolerance"),
        (dict.fromkeys(LIMITS), "nothing to watch"),
    ],
)
def test_bad_limits_are_refused(options, message):
    with pytest.raises(InvalidParameter, match=message):
        watch(**options)


def test_a_watch_of_a_workspace_has_its_limits():
    arm = tarc.plants.TwoLinkArm()
    box = watch_workspace(Workspace.box([-1.0, 0.0], [1.0, 0.5], speed=2.0), 1e-3, [arm])
    np.testing.assert_array_equal(box.low, [-1.0, 0.0])
    np.testing.assert_array_equal(box.speed, [2.0, 2.0])
    assert box.tube is None
    rng = np.random.default_rng(7)
    torques = [np.abs(arm.gravity_torque(rng.uniform([-1, 0], [1, 0.5]))) for _ in range(2000)]
    largest = np.max(torques, axis=0)
    assert np.all(largest <= np.asarray(box.rest_torque))
    assert np.all(np.asarray(box.rest_torque) <= 1.25 * largest + 1e-9)

    sine = tarc.signals.Sinusoid(amplitude=[0.5, 0.2], frequency=[3.0, 2.0], offset=[0.0, 1.0])
    tube = watch_workspace(Workspace.from_reference(sine, 5.0, tube=0.1).with_reference_speeds(), 1e-3)
    np.testing.assert_array_equal(tube.tube, [0.1, 0.1])
    np.testing.assert_allclose(np.asarray(tube.high, dtype=float), [0.6, 1.3], atol=1e-3)
    np.testing.assert_allclose(np.asarray(tube.low, dtype=float), [-0.6, 0.7], atol=1e-3)
    np.testing.assert_allclose(np.asarray(tube.speed, dtype=float), [1.2 * 1.5, 1.2 * 0.4], rtol=1e-3)
    assert tube.rest_torque is None
