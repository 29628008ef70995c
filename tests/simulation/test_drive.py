"""Lag, delay and jitter between controller and plant, against closed forms."""

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.signal import lfilter

from tarc import estimators, laws, plants, simulate
from tarc.core.errors import InvalidParameter
from tarc.scenario.model import Scenario
from tarc.signals import Drive, Encoder, Sinusoid, StepDisturbance

PERIOD = 1e-3
MASS = plants.MassSpringDamper(masses=[2.0, 2.0], springs=0.0, dampers=0.0)
REFERENCE = Sinusoid(amplitude=[0.3, 0.2], frequency=[4.0, 7.0])


def law(**options):
    return laws.TDC(
        inertia=[0.3, 0.3],
        natural_frequency=10.0,
        period=PERIOD,
        estimator=estimators.Algebraic(window=0.01),
        **options,
    )


def torques_of(drive, commands, substeps=1, period=PERIOD):
    """Return the segments of a period, and the mean torque (k, segments, n) for commands (k, n) after rest at zero."""
    segments = drive.segments(substeps, period)
    state, rows = drive.init(np.zeros(commands.shape[1])), []
    for command in commands:
        state, torques = drive.step(state, command, period, segments)
        rows.append(torques)
    return segments, np.array(rows)


@pytest.mark.parametrize(("constant", "delay"), [(0.002, 0.0), (3e-4, 0.3), (0.004, 2.75), (0.0, 1.5)])
def test_a_step_comes_as_a_lag_of_first_order(constant, delay):
    """1 − exp(−(t − δT) / T_d), averaged over each segment."""
    segments, torques = torques_of(Drive(time_constant=constant, delay=delay), np.ones((12, 1)), substeps=2)

    def response(t):
        t = t - delay * PERIOD
        return 0.0 if t < 0 else 1.0 if constant == 0 else 1 - np.exp(-t / constant)

    for k in range(12):
        for segment, torque in zip(segments, torques[k, :, 0], strict=True):
            start, stop = (k + segment.start) * PERIOD, (k + segment.stop) * PERIOD
            mean = quad(response, start, stop, points=[(start + stop) / 2], epsabs=1e-12)[0] / (stop - start)
            assert torque == pytest.approx(mean, abs=1e-9)


def test_delays_of_joints_differ():
    commands = np.array([[1.0, 1.0], [3.0, 3.0], [7.0, 7.0]])
    segments, torques = torques_of(Drive(delay=[0.25, 1.0]), commands)
    assert [(segment.start, segment.stop) for segment in segments] == [(0.0, 0.25), (0.25, 1.0)]
    np.testing.assert_array_equal(torques[:, :, 0], [[0.0, 1.0], [1.0, 3.0], [3.0, 7.0]])
    np.testing.assert_array_equal(torques[:, :, 1], [[0.0, 0.0], [1.0, 1.0], [3.0, 3.0]])


def test_a_sine_is_late_by_the_delay():
    """The torque is held for a period, so that its sine is late by δ + 1/2 periods."""
    times = PERIOD * np.arange(4000)
    frequency = 2 * np.pi * 10.0
    for delay in (0.0, 0.4, 1.7):
        segments, torques = torques_of(Drive(delay=delay), np.sin(frequency * times)[:, None])
        phases = []
        for segment, held in zip(segments, torques[100:, :, 0].T, strict=True):
            # the integral of exp(−iωt) over the segment, from period to period, after one turn
            edges = [np.exp(-1j * frequency * PERIOD * edge) for edge in (segment.start, segment.stop)]
            phases.append(np.sum(held * np.exp(-1j * frequency * times[100:])) * (edges[0] - edges[1]))
        lateness = -(np.angle(np.sum(phases)) - np.angle(-1j * 1j)) / frequency
        assert np.mod(lateness, 2 * np.pi / frequency) == pytest.approx((delay + 0.5) * PERIOD, abs=1e-6)


@pytest.mark.parametrize("substeps", [1, 3, None])
def test_the_plant_gets_exactly_the_torque_of_the_drive(substeps):
    """The impulse of each period, and the recorded torque by a discrete filter of its own."""
    drive = Drive(time_constant=[0.003, 0.0], delay=[0.0, 1.4])
    run = simulate(MASS, law(), REFERENCE, 0.3, drive=drive, substeps=substeps, sensor=Encoder(bits=16)).data
    assert run.attrs["divergence_time"] != run.attrs["divergence_time"]
    torque, applied = run["torque"].values, run["drive_torque"].values
    np.testing.assert_allclose(np.diff(run["velocity"].values, axis=0) * 2.0, applied[:-1] * PERIOD, atol=1e-12)
    decay = np.exp(-PERIOD / 0.003)
    lagged = np.concatenate([[0.0], lfilter([1 - decay], [1, -decay], torque[:-1, 0])])
    mean = torque[:, 0] + (lagged - torque[:, 0]) * 3.0 * (1 - decay)
    np.testing.assert_allclose(applied[:, 0], mean, atol=1e-9)
    older = np.concatenate([np.zeros(2), torque[:-2, 1]])
    newer = np.concatenate([np.zeros(1), torque[:-1, 1]])
    np.testing.assert_allclose(applied[:, 1], 0.4 * older + 0.6 * newer, atol=1e-12)


def test_the_motion_is_that_of_the_differential_equation():
    """A pendulum behind a lag and a delay, against an integrator of its own; the error falls as the square."""
    pendulum = plants.Pendulum()
    one = laws.TDC(inertia=0.05, natural_frequency=10.0, period=PERIOD, estimator=estimators.Algebraic(window=0.01))
    drive = Drive(time_constant=0.004, delay=0.3)
    reference = Sinusoid(amplitude=[0.5], frequency=5.0)

    def error(substeps):
        run = simulate(pendulum, one, reference, 0.05, drive=drive, substeps=substeps).data
        torque = np.concatenate([[0.0], run["torque"].values[:, 0]])
        state = np.array([run["position"].values[0, 0], run["velocity"].values[0, 0], 0.0])
        errors = []
        for k in range(49):
            for command, length in ((torque[k], 0.3 * PERIOD), (torque[k + 1], 0.7 * PERIOD)):

                def slope(_, x, command=command):
                    acceleration = pendulum.evaluate("acceleration", x[:1], x[1:2], x[2:])
                    return [x[1], acceleration[0], (command - x[2]) / 0.004]

                state = solve_ivp(slope, (0, length), state, rtol=1e-12, atol=1e-13).y[:, -1]
            errors.append(state[0] - run["position"].values[k + 1, 0])
        return np.max(np.abs(errors)), np.ptp(run["position"].values)

    (coarse, moved), (fine, _) = error(5), error(20)
    assert coarse < 1e-4 * moved
    assert fine < 0.08 * coarse


@pytest.mark.parametrize("estimator", [estimators.Algebraic(window=0.01), estimators.TrueDerivatives()], ids=repr)
def test_mujoco_and_symbols_agree(estimator):
    options = {"joints": ["shoulder_pan_joint", "elbow_joint"], "armature": 0.1}
    given = {"inertia": 0.05 * np.eye(2), "natural_frequency": 10.0, "period": PERIOD}
    runs = []
    for backend in ("symbolic", "mujoco"):
        arm = plants.load_robot("ur5e", backend=backend, **options)
        reference = Sinusoid(amplitude=[0.2, 0.2], frequency=3.0, offset=arm.home)
        run = simulate(
            arm,
            laws.TDC(estimator=estimator, **given),
            reference,
            0.5,
            drive=Drive(time_constant=0.002, delay=[0.5, 0.2]),
            jitter=0.3,
            substeps=8,
            initial_torque="rest",
            disturbance=StepDisturbance(amplitude=2.0, start_time=0.2),
        )
        assert run.status.completed
        runs.append(run.data)
    for name, tolerance in (("position", 2e-4), ("drive_torque", 0.5)):
        assert np.max(np.abs(runs[0][name].values - runs[1][name].values)) < tolerance
    np.testing.assert_array_equal(runs[0]["time"], runs[1]["time"])


def test_periods_jitter_as_stated():
    run = simulate(MASS, law(), REFERENCE, 20.0, jitter=0.4, substeps=1, seed=3).data
    late = run["time"].values / PERIOD - np.arange(20_000)
    assert late[0] == 0
    assert late[1:].min() >= -1e-9
    assert late.max() <= 0.4
    # uniform: mean 0.2 and variance 0.4²/12, each known to a standard error
    assert late.mean() == pytest.approx(0.2, abs=5 * 0.4 / np.sqrt(12 * 20_000))
    assert late.var() == pytest.approx(0.4**2 / 12, rel=0.05)
    assert abs(np.corrcoef(late[1:-1], late[2:])[0, 1]) < 0.03
    periods = np.diff(run["time"].values)[:, None]
    q, dq, torque = run["position"].values, run["velocity"].values, run["torque"].values
    np.testing.assert_allclose(q[1:], q[:-1] + periods * dq[:-1] + periods**2 * torque[:-1] / 4, atol=1e-12)
    np.testing.assert_allclose(run["reference"].values, REFERENCE.sample(run["time"].values)[0].T)
    again = simulate(MASS, law(), REFERENCE, 1.0, jitter=0.4, substeps=1, seed=3).data
    np.testing.assert_array_equal(again["position"], run["position"][:1000])


def test_a_scenario_has_drive_and_jitter():
    content = {
        "robot": {"kind": "TwoLinkArm"},
        "law": {"kind": "TDC", "inertia": [0.15, 0.05], "natural_frequency": 10.0},
        "estimator": {"kind": "Algebraic", "window": 0.010},
        "reference": {"kind": "Sinusoid", "amplitude": [0.2, 0.2], "frequency": 2.0},
        "duration": 0.2,
        "drive": {"time_constant": 0.001, "delay": [0.5, 0.0]},
        "jitter": 0.2,
    }
    run = Scenario.parse(content).run()["TDC"].data
    assert "drive_torque" in run
    assert run.attrs["jitter"] == 0.2
    assert np.ptp(np.diff(run["time"].values)) > 1e-4


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"drive": 0.1}, "drive: got 0.1; needs a tarc.signals.Drive"),
        ({"drive": Drive(delay=[0.1] * 3)}, "drive.delay: got 3 numbers; needs one number or 2 of them"),
        ({"jitter": 1.0}, "jitter: got 1; needs a finite number of at least 0 and at most 0.9"),
    ],
)
def test_what_does_not_fit_is_refused(options, message):
    with pytest.raises(InvalidParameter, match=message):
        simulate(MASS, law(), REFERENCE, 0.1, **options)


def test_other_drives_are_refused():
    with pytest.raises(InvalidParameter, match="time_constant: got -0.1; needs one number of at least 0"):
        Drive(time_constant=-0.1)
    with pytest.raises(InvalidParameter, match="time_constant, delay: got 2 and 3 numbers"):
        Drive(time_constant=[0.1] * 2, delay=[0.1] * 3)
