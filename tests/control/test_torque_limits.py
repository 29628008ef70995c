"""Limits of magnitude, rate and resolution between law and robot, in simulation and on the machine."""

import tracemalloc
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from law_catalogue import concrete_laws, make_law
from tarc import Controller, laws, plants, simulate
from tarc.control.digital_controller import ControllerInput, DigitalController, limited_step
from tarc.core.errors import InvalidParameter
from tarc.core.tracing import trace
from tarc.core.trees import pack
from tarc.laws import LawInput
from tarc.signals import Encoder, Sinusoid, TorqueLimits

PERIOD = 1e-3
LIMITS = TorqueLimits(magnitude=[3.0, 5.0], rate=[400.0, 1e3], resolution=[0.05, 0.0])
EVERY_LIMIT = [
    TorqueLimits(magnitude=2.0),
    TorqueLimits(rate=150.0),
    TorqueLimits(resolution=0.02),
    TorqueLimits(magnitude=[0.33, np.inf], rate=[30.0, np.inf], resolution=[0.01, 0.5]),
    LIMITS,
]


def assert_within(limits, torques, first):
    """Check torques (k, n) that follow a first one (n,)."""
    steps = np.broadcast_to(0.0 if limits.resolution is None else np.asarray(limits.resolution), first.shape)
    magnitude = np.inf if limits.magnitude is None else np.asarray(limits.magnitude)
    rate = np.inf if limits.rate is None else np.asarray(limits.rate)
    assert np.all(np.abs(torques) <= magnitude)
    change = np.abs(np.diff(torques, axis=0, prepend=first[None]))
    assert np.all(change <= rate * PERIOD * (1 + 1e-9) + 1e-12)
    for joint in np.flatnonzero(steps > 0):
        count = torques[:, joint] / steps[joint]
        np.testing.assert_allclose(count, np.round(count), atol=1e-9)


@pytest.mark.parametrize("limits", EVERY_LIMIT, ids=range(5))
@pytest.mark.parametrize("kind", concrete_laws(), ids=lambda kind: kind.__name__)
@settings(max_examples=5)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_law_leaves_the_limits(kind, limits, seed):
    """Random positions and references, lost samples included; the applied torque is the newest past one."""
    law = make_law(kind, max_missing=3)
    rng = np.random.default_rng(seed)
    state = DigitalController(Encoder(), law, 0, limits).init(np.zeros(2), rng.normal(size=2)).law
    first, torques = np.array(state.torque[:, 0]), []
    for _ in range(30):
        value = LawInput(*rng.normal(size=(4, 2)) * rng.choice([0.01, 1.0, 100.0]))
        if rng.random() < 0.2:
            value.position[0] = np.nan
        state, output = limited_step(law, limits, state, value)
        np.testing.assert_array_equal(state.torque[:, 0], output.torque)
        torques.append(output.torque)
    assert_within(limits, np.array(torques), first)


def test_the_applied_torque_is_the_nearest_allowed_one():
    limits = TorqueLimits(magnitude=2.0, rate=500.0, resolution=0.2)
    apply = [
        (0.0, 0.0, 0.0),
        (0.29, 0.0, 0.2),
        (0.31, 0.0, 0.4),
        (5.0, 0.0, 0.4),  # 0.5 in a period, in whole steps
        (5.0, 1.8, 2.0),
        (-5.0, 2.0, 1.6),
    ]
    for command, past, expected in apply:
        assert limits.apply(np.array([command]), np.array([past]), PERIOD)[0] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("limits", EVERY_LIMIT, ids=range(5))
def test_traced_controller_is_the_numpy_one(limits):
    controller = DigitalController(Encoder(), make_law(laws.TARC), 1, limits)
    state = controller.init(np.zeros(2))
    rng = np.random.default_rng(3)
    function, _ = trace(controller.step, state, ControllerInput(*np.zeros((6, 2))))
    packed = pack(state)
    for _ in range(40):
        value = ControllerInput(*rng.normal(size=(6, 2)))
        state, output = controller.step(state, value)
        packed, traced = function(packed, pack(value))
        np.testing.assert_allclose(np.array(traced).ravel(), pack(output), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(np.array(packed).ravel(), pack(state), rtol=1e-9, atol=1e-9)


def test_without_limits_the_function_is_that_of_the_law():
    law = make_law(laws.TARC)
    state, value = law.example()
    plain, _ = trace(law.step, state, value)
    limited, _ = trace(lambda state, value: limited_step(law, None, state, value), state, value)
    assert plain.serialize() == limited.serialize()


@pytest.mark.parametrize("kind", [laws.PID, laws.TDC, laws.TARC, laws.ADRC], ids=lambda kind: kind.__name__)
def test_simulated_is_deployed(kind):
    """The controller, with the same limits and the measured positions of a run, gives the torques of that run."""
    options: Any = {"integral_gain": 3.0} if kind is laws.PID else {}
    law = make_law(kind, **options)
    arm = plants.TwoLinkArm()
    reference = Sinusoid(amplitude=[0.4, 0.4], frequency=3.0)
    run = simulate(arm, law, reference, 0.5, sensor=Encoder(bits=14), torque_limits=LIMITS).data
    controller = Controller(law, torque_limits=LIMITS)
    controller.reset(run["measured_position"].values[0])
    names = ("measured_position", "reference", "velocity_reference", "acceleration_reference")
    torques = [
        controller.step(*arguments).copy() for arguments in zip(*(run[name].values for name in names), strict=True)
    ]
    np.testing.assert_allclose(torques, run["torque"].values, atol=1e-9)
    assert_within(LIMITS, run["torque"].values, np.zeros(2))
    np.testing.assert_array_equal(run["torque_limit"].values, LIMITS.magnitude)


@pytest.mark.parametrize("kind", [laws.PID, laws.TDC, laws.TARC], ids=lambda kind: kind.__name__)
def test_a_reported_torque_is_as_good_as_a_limit_of_ones_own(kind):
    """A robot that limits the torque itself and reports it, against limits in the controller."""
    options: Any = {"integral_gain": 3.0} if kind is laws.PID else {}
    law = make_law(kind, **options)
    knows = Controller(law, torque_limits=LIMITS)
    informed = Controller(law)
    rng = np.random.default_rng(1)
    applied = np.zeros(2)
    knows.reset(np.zeros(2))
    informed.reset(np.zeros(2))
    for _ in range(200):
        arguments = 0.3 * rng.normal(size=(4, 2))
        expected = knows.step(*arguments)
        command = informed.step(*arguments, applied_torque=applied)
        applied = LIMITS.apply(command, applied, PERIOD)
        np.testing.assert_allclose(applied, expected, atol=1e-9)


def test_a_reported_torque_allocates_nothing():
    controller = Controller(make_law(laws.PID, integral_gain=1.0), torque_limits=LIMITS)
    controller.reset(np.zeros(2))
    arguments, applied = np.zeros((4, 2)), np.full(2, 0.1)
    for _ in range(100):  # let interpreter caches fill
        controller.step(*arguments, applied_torque=applied)
    tracemalloc.start()
    before = tracemalloc.take_snapshot()
    for _ in range(2000):
        controller.step(*arguments, applied_torque=applied)
    after = tracemalloc.take_snapshot()
    tracemalloc.stop()
    grown = sum(
        max(entry.size_diff, 0) for entry in after.compare_to(before, "filename") if "tarc" in str(entry.traceback)
    )
    assert grown < 500


def test_an_unknown_torque_leaves_the_returned_one():
    law = make_law(laws.TDC)
    plain, informed = Controller(law, span=20.0), Controller(law, span=20.0)
    plain.reset(np.zeros(2))
    informed.reset(np.zeros(2))
    rng = np.random.default_rng(1)
    for unknown in ([np.nan, np.nan], None, [np.inf, np.nan]):
        arguments = 0.3 * rng.normal(size=(4, 2))
        np.testing.assert_array_equal(plain.step(*arguments), informed.step(*arguments, applied_torque=unknown))
    past = plain.step(*np.zeros((4, 2))).copy()
    informed.step(*np.zeros((4, 2)))
    informed.step(*np.zeros((4, 2)), applied_torque=[np.nan, 7.0])
    plain.step(*np.zeros((4, 2)), applied_torque=[past[0], 7.0])
    np.testing.assert_array_equal(plain.step(*np.zeros((4, 2))), informed.step(*np.zeros((4, 2))))


@pytest.mark.parametrize("kind", [laws.PID, laws.TDC, laws.TARC], ids=lambda kind: kind.__name__)
def test_a_law_that_knows_the_applied_torque_does_not_wind_up(kind):
    """After two seconds against a limit, the torque turns as soon as the error does."""
    options: Any = {"integral_gain": 3.0} if kind is laws.PID else {}
    law = make_law(kind, joints=1, **options)
    limits = TorqueLimits(magnitude=1.0, rate=100.0)
    times = {}
    for name in ("known", "unknown"):
        controller = Controller(law, torque_limits=limits if name == "known" else None)
        controller.reset([0.0])
        for _ in range(2000):
            controller.step([0.0], [2.0], [0.0], [0.0])
        count = 0
        while controller.step([0.0], [-2.0], [0.0], [0.0])[0] > 0 and count < 3000:
            count += 1
        times[name] = count
    assert times["known"] <= 30
    if kind is not laws.TARC:
        assert times["unknown"] > 300


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"magnitude": -1.0}, "magnitude: got -1.0; needs one number above 0"),
        ({"rate": [1.0, 0.0]}, r"rate: got \[1.0, 0.0\]; needs one number above 0"),
        ({"resolution": np.nan}, "resolution: got nan; needs one number of at least 0"),
        ({"rate": [1.0] * 3, "magnitude": [1.0] * 2}, "magnitude, rate: got 2, 3 numbers"),
        ({"magnitude": 0.1, "resolution": 0.2}, "magnitude: got 0.1 with a resolution of 0.2; needs at least one step"),
        ({"rate": 10.0, "resolution": 0.2}, "torque_limits.rate: got 10.0, which is below one step of 0.2 per period"),
        ({"rate": [1e3] * 3}, "torque_limits.rate: got 3 numbers; needs one number or 2"),
    ],
)
def test_limits_that_make_no_sense_are_refused(options, message):
    with pytest.raises(InvalidParameter, match=message):
        Controller(make_law(laws.TDC), torque_limits=TorqueLimits(**options))


def test_other_arguments_are_refused():
    law = make_law(laws.TDC)
    with pytest.raises(InvalidParameter, match=r"torque_limits: got 3.0; needs a tarc.signals.TorqueLimits"):
        Controller(law, torque_limits=3.0)  # type: ignore[arg-type]
    controller = Controller(law)
    controller.reset(np.zeros(2))
    with pytest.raises(InvalidParameter, match=r"got shape \(3,\) for applied_torque; needs \(2,\)"):
        controller.step(*np.zeros((4, 2)), applied_torque=np.zeros(3))
