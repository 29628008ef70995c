"""Diagnosis of logs whose truth is known: made from formulas, and simulated with a fault injected."""

import json
import re

import numpy as np
import pytest
import xarray as xr
from typer.testing import CliRunner

import tarc
from tarc.cli.main import app
from tarc.core.errors import InvalidParameter
from tarc.logs.diagnosis import diagnose
from tarc.logs.encoder_check import check_encoders
from tarc.logs.limit_cycles import find_limit_cycles
from tarc.logs.loop_log import LoopLog
from tarc.simulation.run import Run

PERIOD = 1e-3
TIMES = PERIOD * np.arange(8000)
RATES = np.array([[3.0, 7.1], [4.3, 8.3]])
FAST = ["reference.frequency=[5.0,8.3]", "reference.amplitude=[0.1,0.1]", "duration=8", "disturbance=[]"]


def motion(times, order=0):
    """Return two sines per joint, or a derivative, shape (k, 2)."""
    phase = np.pi / 2 * order
    return np.sum(0.3 * RATES**order * np.sin(RATES * times[:, None, None] + phase), axis=2)


def made_log(measured, torque=None, **variables):
    """Return a log of two joints from positions and torques."""
    torque = 5 * motion(TIMES) if torque is None else torque
    names = ("reference", "velocity_reference", "acceleration_reference")
    arrays = {name: motion(TIMES, order) for order, name in enumerate(names)}
    arrays |= {"measured_position": measured, "torque": torque}
    data = {name: (("time", "joint"), values) for name, values in arrays.items()}
    data |= {"torque_limit": ("joint", [50.0, 50.0]), **variables}
    coordinates = {"time": TIMES, "joint": ["shoulder", "elbow"]}
    return Run(xr.Dataset(data, coords=coordinates, attrs={"period": PERIOD}))


def noise(size, seed=0):
    return size * np.random.default_rng(seed).standard_normal((len(TIMES), 2))


def kinds(found):
    return {finding.kind for finding in found.findings}


@pytest.mark.parametrize("step", [1e-4, 2 * np.pi / 2**17, 3.3e-3])
@pytest.mark.parametrize("size", [0.0, 2e-4])
def test_step_and_noise_of_the_encoder_are_found(step, size):
    measured = step * np.round((motion(TIMES) + noise(size)) / step)
    found = check_encoders(LoopLog.from_run(made_log(measured)))
    np.testing.assert_allclose(found.resolution, step, rtol=1e-6)
    if step < 1e-3:
        np.testing.assert_allclose(found.noise, np.hypot(size, step / np.sqrt(12)), rtol=0.06)


def test_an_encoder_without_a_step_shows_none():
    found = check_encoders(LoopLog.from_run(made_log(motion(TIMES) + noise(5e-5))))
    assert np.isnan(found.resolution).all()
    np.testing.assert_allclose(found.noise, 5e-5, rtol=0.03)
    assert found.jitter < max(3 * found.jitter_error, 2e-5)


def test_jitter_is_told_from_noise():
    age = 0.5 * PERIOD * np.random.default_rng(1).random(len(TIMES))
    run = made_log(motion(TIMES - age) + noise(2e-5))
    found = check_encoders(LoopLog.from_run(run))
    assert found.jitter == pytest.approx(np.std(age), rel=0.05)
    assert np.isnan(found.noise).all()  # jitter hides it
    assert kinds(diagnose(run)) == {"jitter"}


def test_stamps_of_the_robot_count_where_it_has_them():
    late = 2e-4 * np.random.default_rng(1).standard_normal(len(TIMES))
    found = check_encoders(LoopLog.from_run(made_log(motion(TIMES), sample_time=("time", TIMES + late + 7.0))))
    assert found.jitter == pytest.approx(2e-4, rel=0.03)


def test_missing_and_stale_samples_are_counted():
    measured = motion(TIMES) + noise(1e-5)
    measured[1000:1004, 0] = np.nan
    measured[5000::40, 1] = np.nan
    found = diagnose(made_log(measured))
    assert found.encoders.missing.tolist() == [4 / 8000, 75 / 8000]
    assert found.encoders.longest_gap == 4
    assert kinds(found) == {"missing"}
    assert found.findings[0].joint == "elbow"
    measured = motion(TIMES) + noise(1e-5)
    measured[1::20] = measured[::20]
    found = diagnose(made_log(measured))
    assert found.encoders.stale == pytest.approx(0.05, rel=0.1)
    assert kinds(found) == {"stale"}


@pytest.mark.parametrize("frequency", [12.3, 57.0, 160.0])
def test_a_limit_cycle_has_its_frequency_amplitude_and_time(frequency):
    wave = np.sin(2 * np.pi * frequency * TIMES + 0.4) * (TIMES > 3.0)
    measured, torque = motion(TIMES) + noise(2e-5), 5 * motion(TIMES)
    measured[:, 1] += 4e-4 * wave
    torque[:, 1] -= 2.0 * wave
    log = LoopLog.from_run(made_log(measured, torque + noise(0.05, 3)))
    (cycle,) = find_limit_cycles(log, np.full(2, 2e-5))
    assert cycle.joint == 1
    assert cycle.frequency == pytest.approx(frequency, rel=1e-3)
    assert cycle.amplitude == pytest.approx(4e-4, rel=0.1)
    assert cycle.torque_amplitude == pytest.approx(2.0, rel=0.1)
    assert cycle.start_time == pytest.approx(3.0, abs=5 / frequency)
    assert cycle.stop_time == pytest.approx(8.0, abs=5 / frequency)


def test_noise_and_decaying_transients_are_no_limit_cycle():
    rng = np.random.default_rng(2)
    decay = np.exp(-((TIMES % 2.0) * 12)) * np.sin(2 * np.pi * 20 * TIMES)
    resonance = np.convolve(
        rng.standard_normal(len(TIMES)), np.exp(-np.arange(200) / 30) * np.sin(0.3 * np.arange(200))
    )
    slow = 6 * np.sin(2 * np.pi * 4.0 * TIMES)  # below the band, from outside
    for wave in (slow, decay, 0.3 * resonance[: len(TIMES)], rng.standard_normal(len(TIMES))):
        measured, torque = motion(TIMES) + noise(2e-5), 5 * motion(TIMES)
        measured[:, 0] += 5e-5 * wave
        torque[:, 0] -= wave
        assert not find_limit_cycles(LoopLog.from_run(made_log(measured, torque)), np.full(2, 2e-5))


def test_saturation_and_rate_are_counted_per_joint():
    torque = 5 * motion(TIMES)
    torque[2000:2100, 0] = 50.0
    rate = np.array([np.inf, 15.0])
    found = diagnose(made_log(motion(TIMES), torque, torque_rate_limit=("joint", rate)))
    assert found.torque.saturated.tolist() == [100 / 8000, 0.0]
    assert found.torque.longest[0] == pytest.approx(0.1)
    steps = np.abs(np.diff(torque[:, 1])) >= 15.0 * PERIOD * (1 - 1e-6)
    assert found.torque.rate_limited[1] == np.mean(steps)
    assert kinds(found) == {"saturation", "rate"}


def test_the_certified_range_is_held_against_the_log():
    measured = motion(TIMES)
    measured[4000:4400, 1] += 0.012
    found = diagnose(made_log(measured))
    tube, speed = found.assumptions
    assert tube.share == pytest.approx(400 / 8000)
    assert tube.first_time == pytest.approx(4.0)
    assert tube.worst == pytest.approx(1.2, rel=0.1)
    assert speed.holds
    assert kinds(found) == {"certificate"}
    assert diagnose(made_log(motion(TIMES), 5 * motion(TIMES))).is_clean
    assert not diagnose(made_log(measured), tube=0.02).assumptions[0].share


def test_flags_and_deadlines_of_a_machine_are_reported():
    flags, late, computation = np.zeros(8000), np.full(8000, 2e-5), np.full(8000, 9e-4)
    flags[100:180] = 2
    late[500] = 4e-3
    overrun = np.zeros(8000)
    overrun[501:504] = 1
    names = {"assumption_flags": flags, "lateness": late, "computation_time": computation, "overrun": overrun}
    run = made_log(motion(TIMES), **{name: ("time", values) for name, values in names.items()})
    found = diagnose(run.with_attributes(flag_names='["POSITION", "ERROR"]', tracking_start=0.05))
    position, error = found.assumptions
    assert position.holds
    assert error.share == pytest.approx(80 / 7950)
    assert found.timing is not None
    assert found.timing.overruns == pytest.approx(3 / 7950)
    assert kinds(found) == {"certificate", "overruns", "computation"}
    assert error.name == "distance from the reference"
    stopped = diagnose(run.with_attributes(flag_names='["POSITION", "ERROR"]', ended="joint 1: its error is 0.31 rad"))
    assert stopped.findings[0].kind == "stop"
    assert "its error is 0.31 rad" in stopped.findings[0].text


def test_bad_logs_are_refused(tmp_path):
    with pytest.raises(InvalidParameter, match="no file"):
        diagnose(tmp_path / "none.nc")
    run = made_log(motion(TIMES))
    with pytest.raises(InvalidParameter, match="rows lie after 7.95 s"):
        diagnose(run, start_time=7.95)
    with pytest.raises(InvalidParameter, match="lacks torque"):
        diagnose(Run(run.data.drop_vars("torque")))
    measured = motion(TIMES)
    measured[:, 0] = np.nan
    with pytest.raises(InvalidParameter, match="shoulder has fewer than two valid samples"):
        diagnose(made_log(measured))
    with pytest.raises(InvalidParameter, match="its robot has 6 joints, the log 2"):
        diagnose(run, "ur5e")


def simulated(settings):
    scenario = tarc.Scenario.load("two_link_payload", [*FAST, *settings])
    return scenario.run(progress=False)["TDC"]


def against_design(settings):
    return diagnose(simulated(settings), tarc.Scenario.load("two_link_payload", FAST), start_time=1.0)


@pytest.mark.slow
def test_a_clean_run_has_no_finding():
    found = against_design([])
    assert found.is_clean, found.findings
    assert found.delay is not None
    assert abs(found.delay.delay) < 3 * found.delay.error < 1.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "kind", "change"),
    [
        (["sensor.noise=1e-4"], "noise", r"estimator.window=0.01[678]"),
        (["sensor.bits=13"], "resolution", "estimator.window="),
        (["sensor.dropout=0.03"], "missing", "bus"),
        (["sensor.timing_jitter=0.5"], "jitter", "stamp"),
        (["sensor.stale=0.03"], "stale", "NaN"),
        (["computation_delay=2"], "delay", "law.actuation_delay=2 and computation_delay: 2"),
        (["sensor.delay=2.5"], "delay", "computation_delay: [23] in the scenario"),
        (["law.torque_limit=[40,15]"], "saturation", "slow the reference"),
    ],
    ids=lambda part: part if isinstance(part, str) else part[0],
)
def test_an_injected_fault_is_found_first(settings, kind, change):
    found = against_design(settings)
    first = found.findings[0]
    assert first.kind == kind
    assert re.search(change, first.change), first.change
    allowed = {kind, "certificate"} | ({"noise"} if kind in ("jitter", "stale") else set())
    assert kinds(found) <= allowed


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0, 1, 2, 4])
@pytest.mark.parametrize("age", [0.0, 0.5])
def test_the_delay_is_found_within_its_error(delay, age):
    found = against_design([f"computation_delay={delay}", f"sensor.delay={age}"])
    assert found.delay is not None
    assert abs(found.delay.delay - delay - age) < 2 * found.delay.error
    assert found.delay.error < 0.6


@pytest.mark.slow
def test_a_loop_whose_inertia_is_too_large_oscillates_and_the_change_cures_it():
    settings = ["law.torque_limit=[100,50]"]
    found = against_design([*settings, "law.inertia.fraction=0.3"])
    cycle = found.limit_cycles[0]
    signal = simulated([*settings, "law.inertia.fraction=0.3"]).data["position"].values[1000:, 0]
    spectrum = np.abs(np.fft.rfft(np.hanning(len(signal)) * np.diff(signal, 2, append=[0, 0])))
    frequencies = np.fft.rfftfreq(len(signal), PERIOD)
    assert cycle.frequency == pytest.approx(frequencies[np.argmax(spectrum[:-5])], rel=0.05)
    assert found.findings[0].kind == "limit_cycle"
    assert "Halve law.inertia" in found.findings[0].change
    assert not against_design([*settings, "law.inertia.fraction=0.15"]).limit_cycles


@pytest.mark.slow
def test_the_command_prints_findings_draws_and_has_a_status(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = CliRunner().invoke
    quick = [word for setting in FAST for word in ("--set", setting)]
    assert run(app, ["run", "two_link_payload", *quick, "--no-figures", "-o", "good"]).exit_code == 0
    clean = run(app, ["diagnose", "good/TDC.nc", "--start-time", "1", "--figure", "good.png"])
    assert clean.exit_code == 0, clean.output
    assert "nothing found that is wrong" in clean.output
    assert (tmp_path / "good.png").stat().st_size > 10_000
    limited = ["--set", "law.torque_limit=[40,15]"]
    assert run(app, ["run", "two_link_payload", *quick, *limited, "--no-figures", "-o", "bad"]).exit_code == 0
    bad = run(app, ["diagnose", "bad/TDC.nc", "--start-time", "1", "--json"])
    assert bad.exit_code == 1
    assert json.loads(bad.stdout)["findings"][0]["kind"] == "saturation"
    assert run(app, ["diagnose", "none.nc"]).exit_code != 0
