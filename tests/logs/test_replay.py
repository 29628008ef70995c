"""A log of a simulated robot, of which all is known, is replayed."""

import numpy as np
import pytest

import tarc
from tarc.core.errors import InvalidParameter
from tarc.signals import Encoder, RobotLog

T = 0.001
ESTIMATOR = tarc.estimators.Algebraic(window=0.010)
NOISE = 3e-6


@pytest.fixture(scope="module")
def arm():
    return tarc.plants.TwoLinkArm()


@pytest.fixture(scope="module")
def law():
    return tarc.laws.TDC(
        inertia=[[1.5, 0.6], [0.6, 0.3]], natural_frequency=20.0, period=T, estimator=ESTIMATOR, synchronised=True
    )


@pytest.fixture(scope="module")
def log(arm, law):
    """Record of a law on an arm, with the motion that it was to follow."""
    reference = tarc.signals.Sinusoid(amplitude=[0.6, 0.4], frequency=[2.0, 3.1], offset=[0.2, -0.1])
    run = tarc.simulate(
        arm, law, reference, 6.0, sensor=Encoder(noise=NOISE), initial_torque="rest", native=False, progress=False
    )
    data = run.data
    return RobotLog(
        times=data["time"].values,
        position=data["measured_position"].values,
        velocity=data["velocity"].values,
        torque=data["torque"].values,
        reference=data["reference"].values,
    )


@pytest.fixture(scope="module")
def found(log, arm, law):
    return tarc.replay(log, arm, law=law)


def test_delay_and_noise_of_the_window_are_as_predicted(found):
    check = found.windows[0]
    assert check.predicted_delay == pytest.approx(0.005)
    assert check.delay == pytest.approx([0.005, 0.005], abs=1e-5)
    assert found.record.position_noise() == pytest.approx([NOISE, NOISE], rel=0.05)
    assert check.error_without_delay == pytest.approx(check.noise, rel=0.15)
    assert np.all(np.abs(found.velocity.delay) < 2e-4)
    assert np.all(found.velocity.correlation > 0.9999)


def test_the_true_model_explains_the_torque_and_a_wrong_one_less(found, log, arm):
    assert np.all(found.model.explained > 0.999)
    wrong = tarc.replay(log, tarc.plants.TwoLinkArm(gravity=0.0)).model
    assert wrong is not None
    assert np.all(wrong.explained < 0.97)


def test_the_law_that_ran_commands_what_was_recorded(found):
    assert np.all(found.shadow.difference < 0.01)
    assert found.shadow.faults == 0
    assert found.shadow.error == pytest.approx(found.shadow.predicted_error, rel=0.1)


def test_a_design_that_assumes_the_true_noise_predicts_that_of_the_command(log, arm, law):
    from tarc.logs.replayed import EvenRecord, repair_time
    from tarc.logs.shadow import check_shadow

    record = EvenRecord.from_log(log, repair_time(log), 25.0)
    shadow = check_shadow(record, law, Encoder(noise=NOISE), arm, 25.0)
    assert shadow is not None
    assert shadow.torque_noise == pytest.approx(shadow.predicted_torque_noise, rel=0.05)
    replayed = tarc.replay(log, law=law).shadow
    assert replayed is not None
    assert replayed.predicted_error is None


def test_delay_estimation_leaves_what_its_transfer_functions_say():
    """A mass m on a sine: the part left is |m (1 − z⁻¹) − M̂ (1 − z⁻¹ H₂/(jω)²)| / m, or with C(z) for z⁻¹."""
    mass, inertia, omega = 2.0, 0.5, 6 * np.pi
    times = T * np.arange(8000)
    position = np.sin(omega * times)[:, None]
    log = RobotLog(times=times, position=position, torque=-mass * omega**2 * position)
    law = tarc.laws.TDC(inertia=[inertia], natural_frequency=10.0, period=T, estimator=ESTIMATOR)
    left = tarc.replay(log, law=law).delay_estimation
    assert left is not None
    window = ESTIMATOR.with_period(T)
    gain = window.frequency_response(omega, 2) / -(omega**2)
    back = np.exp(-1j * omega * T)
    averaged = back * np.polynomial.polynomial.polyval(back, window.matched_torque_filter().weights)
    literal = abs(mass * (1 - back) - inertia * (1 - back * gain)) / mass
    synchronised = abs(mass * (1 - averaged) - inertia * (1 - gain)) / mass
    assert left.literal == pytest.approx([literal], rel=0.01)
    assert left.synchronised == pytest.approx([synchronised], rel=0.01)
    assert left.synchronised_raw == pytest.approx([synchronised], rel=0.01)


def test_refusals(log, arm, law):
    three = RobotLog(times=log.times, position=np.hstack([log.position, log.position[:, :1]]), torque=None)
    with pytest.raises(InvalidParameter, match=r"has 2 joints .* the log 3"):
        tarc.replay(three, arm)
    every = log.select(np.arange(0, len(log.times), 2))
    with pytest.raises(InvalidParameter, match=r"period of 0.001 s; the log has 2 joints and 0.002 s"):
        tarc.replay(every, law=law, window=0.010)


def test_figure_page_and_summary(found, tmp_path):
    import json

    page = found.save_report(tmp_path / "page.html").read_text(encoding="utf-8")
    assert "data:image/png;base64," in page
    assert "http" not in page
    for title in ("Timing", "Acceleration of a window of 10 ms", "Torque that the model explains", "shadow mode"):
        assert title in page
    summary = json.loads(json.dumps(found.summary(), allow_nan=False))
    assert summary["timing"]["rate"] == pytest.approx(1000, rel=1e-3)
    assert len(summary["model"]["explained"]) == 2
    with pytest.raises(InvalidParameter, match="cannot write"):
        found.save_report(tmp_path / "none" / "page.html")
