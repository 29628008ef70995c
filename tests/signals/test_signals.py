"""References, sensors and disturbances against their definitions."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tarc.core.errors import InvalidParameter
from tarc.core.tracing import trace
from tarc.core.trees import pack
from tarc.signals import (
    BandLimitedNoise,
    Chirp,
    Disturbance,
    Encoder,
    ImpulseDisturbance,
    Multisine,
    ParameterSchedule,
    Payload,
    Quintic,
    RecordedReference,
    Reference,
    SineDisturbance,
    Sinusoid,
    StepDisturbance,
)
from tarc.signals.disturbances import payload_schedule
from tarc.signals.readings import ReadingCheck
from tarc.signals.sensors import EncoderInput

sampled = settings(max_examples=50)
POINTS = [[0.0, 1.0], [0.5, -0.2], [-0.3, 0.4], [1.0, 0.0]]
PASSED = [0.5, 1.0, 2.0, 3.0]
SINUSOID = Sinusoid(amplitude=[0.5, 0.2], frequency=[2.0, 5.0], phase=[0.3, 0.0], offset=[0.1, -0.4])
CLOSED = {
    "sinusoid": SINUSOID,
    "multisine": Multisine(amplitude=[0.3, 0.1], frequency=[1.0, 2.0, 3.5], offset=[0.2, 0.0]),
    "multisine, all given": Multisine(amplitude=[[0.3, 0.1]], frequency=[1.0, 4.0], phase=[[0.5, -1.0]]),
    "chirp": Chirp(amplitude=[0.3, 0.2], start_frequency=1.0, stop_frequency=6.0, sweep_time=2.0, offset=0.1),
    "quintic": Quintic(points=POINTS, times=PASSED),
    "quintic with stops": Quintic(points=POINTS, times=PASSED, stop_at_points=True),
}
every_reference = pytest.mark.parametrize("reference", CLOSED.values(), ids=CLOSED.keys())


@every_reference
def test_derivatives_are_what_central_differences_converge_to(reference: Reference) -> None:
    times = np.linspace(0.07, 3.93, 38)  # a centisecond off each way-point and the end of the sweep

    def errors(h: float) -> list[float]:
        before, present, after = (reference.sample(times + shift) for shift in (-h, 0, h))
        differences = [(after[j] - before[j]) / (2 * h) - present[j + 1] for j in (0, 1)]
        return [float(np.max(np.abs(error))) for error in differences]

    for coarse, fine in zip(errors(4e-3), errors(2e-3), strict=True):
        assert coarse == pytest.approx(4 * fine, rel=0.05)  # second order
        assert fine < 5e-3


@every_reference
def test_samples_have_a_row_a_joint_and_a_column_a_time(reference: Reference) -> None:
    for values in reference.sample(np.linspace(0, 1, 7)):
        assert values.shape == (reference.n_joints, 7)


def test_sinusoid_is_its_formula_and_one_number_stands_for_all_joints() -> None:
    t = np.linspace(0, 3, 11)
    position, velocity, acceleration = Sinusoid(amplitude=[0.5, 0.2], frequency=2.0, phase=np.pi / 2).sample(t)
    assert np.allclose(position, np.outer([0.5, 0.2], np.cos(2 * t)))
    assert np.allclose(velocity[:, 0], 0)
    assert np.allclose(acceleration, -4 * position)


def test_multisine_is_the_sum_of_sinusoids() -> None:
    t = np.linspace(0, 3, 11)
    tones = Multisine(amplitude=[[0.3, 0.1]], frequency=[1.0, 4.0], phase=[[0.5, -1.0]], offset=0.2).sample(t)
    first = Sinusoid(amplitude=0.3, frequency=1.0, phase=0.5, offset=0.2).sample(t)
    second = Sinusoid(amplitude=0.1, frequency=4.0, phase=-1.0).sample(t)
    assert all(np.allclose(tones[j], first[j] + second[j], rtol=0, atol=1e-14) for j in range(3))


@pytest.mark.parametrize("tones", [5, 10, 30])
@pytest.mark.parametrize("same", [0.0, np.pi / 2], ids=["sines", "cosines"])
def test_schroeder_s_phases_keep_the_crest_below_that_of_equal_phases(tones: int, same: float) -> None:
    frequency = np.arange(1.0, tones + 1)

    def crest(phase: Any) -> np.ndarray:
        wave = Multisine(amplitude=[0.1, 0.1], frequency=frequency, phase=phase).sample(np.linspace(0, 2 * np.pi, 4000))
        return np.max(np.abs(wave[0]), axis=1) / wave[0].std(axis=1)

    assert np.all(crest(None) < 0.9 * crest(np.full((2, tones), same)))
    assert np.all(crest(None) < 2.1)  # a sine has 1.41, Schroeder's phases promise some 1.7


def test_chirp_sweeps_its_frequency_linearly_and_then_stays() -> None:
    chirp = Chirp(amplitude=1.0, start_frequency=1.0, stop_frequency=6.0, sweep_time=2.0)
    t = np.linspace(0, 4, 2001)
    position, velocity, _ = (values[0] for values in chirp.sample(t))
    expected = 1.0 + 5.0 * np.minimum(t, 2.0) / 2.0
    clear = np.abs(position) < 0.9  # where the cosine of the phase can be divided by
    frequency = np.abs(velocity[clear]) / np.sqrt(1 - position[clear] ** 2)
    assert np.allclose(frequency, expected[clear], rtol=1e-9)
    assert position[0] == 0


@pytest.mark.parametrize("stop", [False, True])
def test_quintic_passes_its_points_and_rests_at_both_ends(stop: bool) -> None:
    reference = Quintic(points=POINTS, times=PASSED, stop_at_points=stop)
    position, velocity, acceleration = reference.sample(PASSED)
    assert np.allclose(position.T, POINTS, rtol=0, atol=1e-12)
    resting = slice(None) if stop else [0, -1]
    assert np.allclose(velocity[:, resting], 0, atol=1e-11)
    assert np.allclose(acceleration[:, resting], 0, atol=1e-10)
    if not stop:
        assert np.all(np.abs(velocity[:, 1:-1]).max(axis=0) > 0.1)


@pytest.mark.parametrize("stop", [False, True])
def test_quintic_holds_its_ends_before_and_after(stop: bool) -> None:
    position, velocity, acceleration = Quintic(points=POINTS, times=PASSED, stop_at_points=stop).sample(
        [-1.0, 0.4, 3.1, 9.0]
    )
    assert np.allclose(position.T, [POINTS[0], POINTS[0], POINTS[-1], POINTS[-1]], rtol=0, atol=1e-12)
    assert not velocity.any()
    assert not acceleration.any()


def test_quintic_between_two_points_is_the_minimum_jerk_curve() -> None:
    s = np.linspace(0, 1, 11)
    for stop in (False, True):
        position = Quintic(points=[[1.0], [3.0]], times=[0, 2], stop_at_points=stop).sample(2 * s)[0][0]
        assert np.allclose(position, 1 + 2 * (10 * s**3 - 15 * s**4 + 6 * s**5), rtol=1e-12)


def test_quintic_through_its_points_is_smooth_up_to_the_fourth_derivative() -> None:
    reference, steps = Quintic(points=POINTS, times=PASSED), 1e-2 * np.arange(4)

    def acceleration_and_its_slopes(times: np.ndarray, knot: float) -> np.ndarray:
        """Coefficients of the cubic that the acceleration is on one side of a knot: four samples tell them."""
        return np.polynomial.polynomial.polyfit(times - knot, reference.sample(times)[2].T, 3)

    for knot in PASSED[1:-1]:
        before = acceleration_and_its_slopes(knot - steps, knot)
        after = acceleration_and_its_slopes(knot + steps, knot)
        assert np.allclose(before[:3], after[:3], rtol=1e-6, atol=1e-6)
        assert not np.allclose(before[3], after[3], rtol=1e-2)  # the fifth derivative does jump


def write_table(path: Path, table: np.ndarray, header: str | None, delimiter: str) -> Path:
    if path.suffix == ".npy":
        np.save(path, table)
    else:
        np.savetxt(path, table, fmt="%.17g", delimiter=delimiter, header=header or "", comments="")
    return path


@pytest.mark.parametrize(
    ("name", "header", "delimiter"),
    [("r.csv", None, ","), ("r.csv", "time,q1,q2", ","), ("r.txt", "t  q1 q2", " "), ("r.npy", None, "")],
)
def test_recorded_reproduces_a_smooth_trajectory_from_any_file(
    name: str, header: str | None, delimiter: str, tmp_path: Path
) -> None:
    t = np.linspace(0.5, 2.5, 201)
    table = np.vstack([t, SINUSOID.sample(t)[0]]).T
    path = write_table(tmp_path / name, table, header, delimiter)
    reference = RecordedReference(path=path, starts_at_zero=False)
    assert reference.n_joints == 2
    between = np.linspace(0.5, 2.5, 333)
    errors = [np.max(np.abs(a - b)) for a, b in zip(reference.sample(between), SINUSOID.sample(between), strict=True)]
    # h⁶, h⁵ and h⁴ of h = 0.01 s times 5⁶ and the amplitude, larger by a factor at the two ends
    assert np.all(np.array(errors) < [1e-9, 1e-7, 1e-4])


def test_recorded_converges_and_holds_its_ends(tmp_path: Path) -> None:
    def error(rows: int) -> float:
        t = np.linspace(0, 2, rows)
        path = tmp_path / f"{rows}.npy"
        reference = RecordedReference(path=write_table(path, np.vstack([t, SINUSOID.sample(t)[0]]).T, None, ""))
        inside = np.linspace(0.8, 1.2, 200)
        return float(np.max(np.abs(reference.sample(inside)[2] - SINUSOID.sample(inside)[2])))

    assert np.log2(error(41) / error(81)) > 3.5  # a quintic spline's second derivative is of fourth order
    position, velocity, _ = RecordedReference(path=tmp_path / "81.npy").sample([-1.0, 3.0])
    assert np.allclose(position, SINUSOID.sample([0.0, 2.0])[0])
    assert not velocity.any()


def record_file(tmp_path: Path, header: str | None, start: float = 0.0, joints: int = 2) -> Path:
    """Return a record whose joint k stays at k + 1, for one second."""
    times = start + np.linspace(0, 1, 11)
    table = np.column_stack([times, *(np.full(11, k + 1.0) for k in range(joints))])
    return write_table(tmp_path / "record.csv", table, header, ",")


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("time,shoulder,elbow", [1.0, 2.0]),
        ("time,elbow,shoulder", [2.0, 1.0]),
        ('"time [s]", "elbow [rad]", "shoulder [m]"', [2.0, 1.0]),
        ("# time, elbow, shoulder", [2.0, 1.0]),
        ("\ufefftime,elbow,shoulder", [2.0, 1.0]),
        ("# made by hand, on Monday\n# t,elbow,shoulder", [2.0, 1.0]),
        ("# no header, a remark", [1.0, 2.0]),
        ("time,q1,q2", [1.0, 2.0]),
        ("t,q[0],q[1]", [1.0, 2.0]),
        (None, [1.0, 2.0]),
    ],
)
def test_columns_follow_the_names_of_the_joints(header: str | None, expected: list[float], tmp_path: Path) -> None:
    reference = RecordedReference(path=record_file(tmp_path, header)).for_run(["shoulder", "elbow"], 1.0)
    assert np.allclose(reference.sample([0.5])[0][:, 0], expected)
    again = reference.for_run(["shoulder", "elbow"], 1.0)
    assert np.allclose(again.sample([0.5])[0][:, 0], expected)


def test_numbered_joints_of_the_robot_are_names_too(tmp_path: Path) -> None:
    reference = RecordedReference(path=record_file(tmp_path, "time,joint2,joint1"))
    assert np.allclose(reference.for_run(["joint1", "joint2"], 1.0).sample([0.5])[0][:, 0], [2.0, 1.0])


def test_given_names_are_the_order_of_the_robot(tmp_path: Path) -> None:
    reference = RecordedReference(path=record_file(tmp_path, "time,a,b"), joint_names=["b", "a"])
    assert np.allclose(reference.for_run(["shoulder", "elbow"], 1.0).sample([0.5])[0][:, 0], [2.0, 1.0])


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("time,elbow,sholder", r"columns elbow, sholder; .* joints are shoulder, elbow. Did you mean 'shoulder'\?"),
        ("time,elbow,elbow", "columns elbow, elbow; the robot's joints are shoulder, elbow"),
        ("time,q2,q1", "columns q2, q1; .* q1, q2, … for the robot's order"),
        ("time,q1 [deg],q2 [deg]", r"columns q1 \[deg\], q2 \[deg\]; the robot's joints are"),
    ],
)
def test_columns_of_other_joints_are_refused(header: str, message: str, tmp_path: Path) -> None:
    reference = RecordedReference(path=record_file(tmp_path, header))
    with pytest.raises(InvalidParameter, match=message):
        reference.for_run(["shoulder", "elbow"], 1.0)


@pytest.mark.parametrize(
    ("header", "names", "message"),
    [
        ("time,a,b", ["a", "c"], "joint_names: got a, c; .*record.csv has the columns a, b; needs the name of every"),
        (None, ["a", "b"], "joint_names: got a, b; .*record.csv has no header"),
        ("time,a", None, r"header of .* has 2 names \(time, a\), its rows 3 numbers"),
    ],
)
def test_names_at_fault_are_refused(header: str | None, names: Any, message: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidParameter, match=message):
        RecordedReference(path=record_file(tmp_path, header), joint_names=names)


def test_one_column_means_the_one_joint(tmp_path: Path) -> None:
    reference = RecordedReference(path=record_file(tmp_path, "time,angle", joints=1))
    assert reference.for_run(["joint1"], 1.0) is reference


def test_times_count_from_the_first_stamp(tmp_path: Path) -> None:
    t = np.linspace(0, 2, 201)
    table = np.vstack([1.7e9 + t, SINUSOID.sample(t)[0]]).T
    path = write_table(tmp_path / "stamps.npy", table, None, "")
    sampled = RecordedReference(path=path).for_run(["a", "b"], 2.0).sample([0.3, 1.2])
    assert np.allclose(sampled[0], SINUSOID.sample([0.3, 1.2])[0], rtol=0, atol=1e-5)  # stamps have steps of 0.24 µs
    with pytest.raises(InvalidParameter, match="from 1.7e[+]09 s to .*, the run from 0 to 2 s; they do not overlap"):
        RecordedReference(path=path, starts_at_zero=False).for_run(["a", "b"], 2.0)


def encoder_readings(encoder: Encoder, positions: np.ndarray, noise: Any = None) -> np.ndarray:
    """Return the readings of the encoder at positions (n, k)."""
    noise = np.zeros(positions.shape) if noise is None else noise
    state, readings = encoder.init(positions[:, 0]), []
    for position, disturbance in zip(positions.T, noise.T, strict=True):
        state, reading = encoder.step(state, EncoderInput(position, 0 * position, disturbance))
        readings.append(reading)
    return np.array(readings).T


positions_of_three = arrays(float, (3, 5), elements=st.floats(-20, 20, allow_subnormal=False))


@sampled
@given(bits=st.integers(4, 20), positions=positions_of_three)
def test_encoder_rounds_to_the_nearest_of_its_steps(bits: int, positions: np.ndarray) -> None:
    encoder, step = Encoder(bits=bits), 2 * np.pi / 2**bits
    assert encoder.step_size == step
    readings = encoder_readings(encoder, positions)
    assert np.allclose(readings / step, np.round(readings / step), rtol=0, atol=1e-9)
    assert np.max(np.abs(readings - positions)) <= step / 2 * (1 + 1e-9)


def test_encoder_steps_cover_its_span_or_are_given() -> None:
    assert Encoder(bits=10, span=0.3).step_size == 0.3 / 1024
    assert Encoder(resolution=0.01).step_size == 0.01
    assert Encoder().step_size == 0


@sampled
@given(delay=st.integers(0, 4), positions=positions_of_three)
def test_encoder_delays_by_whole_periods(delay: int, positions: np.ndarray) -> None:
    readings = encoder_readings(Encoder(delay=delay), positions)
    assert np.array_equal(readings[:, delay:], positions[:, : 5 - delay])
    assert np.array_equal(readings[:, :delay], np.repeat(positions[:, :1], delay, axis=1))


@pytest.mark.parametrize("period", [1e-2, 5e-3])
def test_a_fractional_delay_reads_the_continuous_position(period: float) -> None:
    """Of a sine, to the error of cubic Hermite interpolation: T⁴/384 of the largest fourth derivative."""
    delays, frequency = np.array([0.0, 0.25, 0.5, 1.75, 3.0]), 40.0
    times = period * np.arange(60)
    positions = np.tile(np.sin(frequency * times), (5, 1))
    travels = period * frequency * np.tile(np.cos(frequency * times), (5, 1))
    encoder = Encoder(delay=delays)
    state, readings = encoder.init(positions[:, 0]), []
    for position, travel in zip(positions.T, travels.T, strict=True):
        state, reading = encoder.step(state, EncoderInput(position, travel, np.zeros(5)))
        readings.append(reading)
    true = np.sin(frequency * (times - period * delays[:, None]))
    error = np.abs(np.transpose(readings) - true)[:, 5:].max(axis=1)
    bound = (period * frequency) ** 4 / 384
    assert np.all(error <= bound * (1 + 1e-6) + 1e-12)
    assert error[2] > 0.7 * bound


def test_bits_and_noise_may_differ_from_joint_to_joint() -> None:
    encoder = Encoder(bits=[10, 12], noise=[1e-3, 0.0], span=[1.0, np.inf])
    assert np.array_equal(encoder.step_size, [1 / 1024, 2 * np.pi / 4096])
    noise = encoder.sample_noise(2, 50_000, np.random.default_rng(0))
    assert noise[0].std() == pytest.approx(1e-3, rel=0.02)
    assert not np.any(noise[1])


def test_encoder_loses_the_given_share_of_samples_and_never_the_first() -> None:
    noise = Encoder(dropout=0.2).sample_noise(500, 200, np.random.default_rng(0))
    lost = np.isnan(noise)
    assert not lost[:, 0].any()
    assert lost[:, 1:].mean() == pytest.approx(0.2, abs=5 * np.sqrt(0.2 * 0.8 / (500 * 199)))
    assert np.array_equal(
        np.isnan(encoder_readings(Encoder(bits=10, delay=1), np.ones((500, 200)), noise))[:, 1:], lost[:, :-1]
    )


def test_encoder_loses_packets_of_all_joints_and_repeats_readings() -> None:
    encoder = Encoder(packet_loss=0.1, stale=0.2)
    noise = encoder.sample_noise(3, 20_000, np.random.default_rng(1))
    lost, stale = np.isnan(noise), np.isposinf(noise)
    assert np.array_equal(lost, np.tile(lost[0], (3, 1)))
    assert np.array_equal(stale, np.tile(stale[0], (3, 1)))
    assert lost[0].mean() == pytest.approx(0.1, abs=0.01)
    assert stale[0].mean() == pytest.approx(0.2 * 0.9, abs=0.01)
    assert not (lost | stale)[:, 0].any()
    positions = np.tile(np.arange(200.0), (3, 1))
    readings = encoder_readings(encoder, positions, noise[:, :200])
    newest = np.where(stale[0, :200], np.nan, positions[0])
    for k in range(1, 200):
        before = readings[0, k - 1]
        expected = np.nan if lost[0, k] else before if stale[0, k] else newest[k]
        assert np.array_equal(readings[:, k], np.full(3, expected), equal_nan=True)


def test_an_age_by_jitter_reads_the_position_before() -> None:
    """Of a parabola, to rounding, since the interpolation is exact on cubics; on top of a delay."""
    period, delay = 1e-2, 1.25
    encoder = Encoder(timing_jitter=0.6, delay=delay)
    times = period * np.arange(40)
    ages = encoder.sample_age(40, np.random.default_rng(2))
    assert ages is not None
    assert 0 <= ages.min() < 0.1 < 0.5 < ages.max() <= 0.6
    state, readings = encoder.init(np.array([2.0])), []
    for time, age in zip(times, ages, strict=True):
        value = EncoderInput(np.array([2 + time**2]), period * np.array([2 * time]), np.zeros(1), np.array([age]))
        state, reading = encoder.step(state, value)
        readings.append(reading[0])
    # a whole period of delay hands on the reading of the instant before, with its own age
    true = 2 + (times[1:-1] - period * (0.25 + ages[1:-1])) ** 2
    assert readings[2:] == pytest.approx(true, abs=1e-12)
    assert Encoder().sample_age(5, np.random.default_rng(0)) is None
    with pytest.raises(InvalidParameter, match="at most one together with the fraction of the delay"):
        Encoder(timing_jitter=0.8, delay=1.25)


def test_encoder_noise_has_its_standard_deviation_and_follows_the_seed() -> None:
    encoder = Encoder(noise=1e-3)
    noise = encoder.sample_noise(2, 100_000, np.random.default_rng(7))
    # the standard deviation of 2e5 samples is known to 0.16 %
    assert noise.std() == pytest.approx(1e-3, rel=0.01)
    assert abs(np.corrcoef(noise)[0, 1]) < 0.02
    assert np.array_equal(noise, encoder.sample_noise(2, 100_000, np.random.default_rng(7)))
    assert not np.any(noise == encoder.sample_noise(2, 100_000, np.random.default_rng(8)))


@pytest.mark.parametrize("noise_share", [0.0, 0.4])
@pytest.mark.parametrize("offset", [0.0, np.pi])
def test_wrapped_readings_become_the_continuous_position(offset: float, noise_share: float) -> None:
    """Whether the encoder reads 0 … 2π or −π … π, over several turns and lost samples."""
    check = ReadingCheck(span=2 * np.pi)
    rng = np.random.default_rng(2)
    true = 9.0 + np.cumsum(rng.uniform(-0.3, 0.5, (2, 400)), axis=1)
    readings = (true + offset) % (2 * np.pi) - offset
    readings[rng.random(readings.shape) < noise_share] = np.nan
    last = true[:, 0]
    for reading, position in zip(readings.T, true.T, strict=True):
        last, unwrapped = check.step(last, reading)
        assert np.array_equal(np.isnan(unwrapped), np.isnan(reading))
        assert np.allclose(unwrapped, np.where(np.isnan(reading), np.nan, position), rtol=0, atol=1e-12, equal_nan=True)
    assert true[0, -1] > 6 * np.pi


def test_encoder_that_wraps_gives_the_positions_of_one_that_does_not() -> None:
    times = np.linspace(0, 3, 300)
    positions = np.array([8 * np.sin(3 * times), 0.4 * np.sin(3 * times)])
    plain = encoder_readings(Encoder(bits=12, delay=1), positions)
    for span in (2 * np.pi, [2 * np.pi, np.inf]):
        assert np.array_equal(encoder_readings(Encoder(bits=12, delay=1, span=span), positions), plain)


def test_bits_cover_the_span_of_each_joint() -> None:
    assert np.array_equal(Encoder(bits=10, span=[0.5, np.inf]).step_size, np.array([0.5, 2 * np.pi]) / 1024)


def test_a_motion_of_more_than_half_a_span_between_samples_gets_the_nearest_turn() -> None:
    readings = encoder_readings(Encoder(span=0.1), np.array([[0.0, 0.04, 0.12]]))
    assert np.allclose(readings, [[0.0, 0.04, 0.02]])


def test_a_sample_that_jumps_is_missing_and_the_next_good_one_is_not() -> None:
    positions = np.array([[0.0, 0.01, 0.51, 0.02, 0.02], [0.0, 0.5, 1.0, 1.5, 2.0]])
    readings = encoder_readings(Encoder(max_step=[0.1, np.inf]), positions)
    assert np.array_equal(readings[0], [0.0, 0.01, np.nan, 0.02, 0.02], equal_nan=True)
    assert np.array_equal(readings[1], positions[1])


@pytest.mark.parametrize(
    "encoder",
    [
        Encoder(),
        Encoder(bits=12),
        Encoder(resolution=0.02, delay=3),
        Encoder(span=2.0),
        Encoder(bits=8, span=[2.0, np.inf], max_step=[0.7, 2.0], delay=1),
        Encoder(bits=[8, 12], delay=[1.3, 3]),
        Encoder(resolution=[0.02, 0.0], delay=[0.0, 2]),
    ],
    ids=repr,
)
def test_encoder_traced_step_is_the_numpy_step_lost_samples_included(encoder: Encoder) -> None:
    rng = np.random.default_rng(5)
    positions, noise = rng.uniform(-3, 3, (2, 12)), rng.normal(0, 0.1, (2, 12))
    noise[0, 4] = noise[:, 7] = np.nan
    state = encoder.init(positions[:, 0])
    zero = EncoderInput(np.zeros(2), np.zeros(2), np.zeros(2))
    function, _ = trace(encoder.step, state, zero, symbol=ca.SX)
    packed, traced = pack(state), []
    for k in range(12):
        packed, reading = function(packed, np.concatenate([positions[:, k], np.zeros(2), noise[:, k]]))
        traced.append(np.array(reading).ravel())
    assert np.allclose(
        np.transpose(traced), encoder_readings(encoder, positions, noise), rtol=0, atol=1e-12, equal_nan=True
    )


TIMES = np.arange(1000) * 1e-3


def disturbance_torque(
    disturbance: Disturbance, times: np.ndarray = TIMES, joints: int = 2, seed: int = 0
) -> np.ndarray:
    return disturbance.sample(times, joints, np.random.default_rng(seed))


def test_step_acts_from_its_start_up_to_before_its_end() -> None:
    values = disturbance_torque(StepDisturbance(amplitude=[2.0, -1.0], start_time=0.3, stop_time=0.7))
    on = (np.arange(1000) >= 300) & (np.arange(1000) < 700)
    assert np.array_equal(values, np.outer([2.0, -1.0], on))
    assert np.array_equal(disturbance_torque(StepDisturbance(amplitude=3.0)), np.full((2, 1000), 3.0))


def test_sine_starts_at_its_instant_on_the_clock_s_phase() -> None:
    values = disturbance_torque(SineDisturbance(amplitude=2.0, frequency=30.0, phase=0.5, start_time=0.1), joints=1)[0]
    assert not values[:100].any()
    assert np.allclose(values[100:], 2 * np.sin(30 * TIMES[100:] + 0.5))


@sampled
@given(start_time=st.floats(0, 0.99), step=st.floats(1e-5, 0.1), amplitude=st.floats(-10, 10))
def test_impulse_is_the_same_whatever_the_step(start_time: float, step: float, amplitude: float) -> None:
    times = np.arange(int(np.ceil(1 / step))) * step
    values = disturbance_torque(ImpulseDisturbance(amplitude=amplitude, start_time=start_time), times, joints=1)[0]
    assert np.sum(values) * step == pytest.approx(amplitude, rel=1e-9)
    assert np.count_nonzero(values) == (1 if amplitude else 0)
    if amplitude:
        struck = times[np.flatnonzero(values)[0]]
        assert struck - 2e-9 <= start_time < struck + step


def test_band_noise_has_its_standard_deviation_and_follows_the_seed() -> None:
    noise = BandLimitedNoise(amplitude=[2.0, 0.5], min_frequency=20.0, max_frequency=60.0)
    values = disturbance_torque(noise)
    long = disturbance_torque(noise, np.arange(200_000) * 1e-3)  # some 8000 independent samples: 1 % standard error
    assert np.allclose(long.std(axis=1), [2.0, 0.5], rtol=0.04)
    assert np.array_equal(values, disturbance_torque(noise))
    assert not np.any(values == disturbance_torque(noise, seed=1))
    assert abs(np.corrcoef(values)[0, 1]) < 0.5  # a joint's own noise, of some 40 independent samples


def test_band_noise_keeps_its_size_on_a_record_shorter_than_its_waves() -> None:
    """Over a whole ensemble of short records: neither scaled up nor down by its own length."""
    times = np.arange(50) * 1e-3
    values = [
        disturbance_torque(BandLimitedNoise(amplitude=1.0, max_frequency=5.0), times, 1, seed=seed)[0]
        for seed in range(400)
    ]
    assert np.sqrt(np.mean(np.square(values))) == pytest.approx(1.0, rel=0.15)  # 400 samples: 3.5 % standard error
    assert np.max(np.abs(values)) < 5.0


def test_resolution_may_differ_from_joint_to_joint() -> None:
    encoder = Encoder(resolution=[0.1, 0.25])
    state = encoder.init(np.zeros(2))
    _, measured = encoder.step(state, EncoderInput(np.array([0.33, 0.33]), np.zeros(2), np.zeros(2)))
    assert np.allclose(measured, [0.3, 0.25])


def test_what_is_under_way_at_the_start_is_quantised_too() -> None:
    encoder = Encoder(resolution=0.5, delay=2)
    assert np.all(encoder.init(np.array([0.3])).delay_line == 0.5)


@pytest.mark.parametrize(
    ("schedule", "message"),
    [
        (lambda: ParameterSchedule(parameter="viscous", times=[0.0], values=3.0), "needs increasing times"),  # type: ignore[arg-type]
        (lambda: ParameterSchedule(parameter="viscous", times=[], values=[]), "needs increasing times"),
        (
            lambda: ParameterSchedule(parameter="viscous", times=[0.0], values=[[1, 2, 3]]).sample(
                np.zeros(2), np.zeros(2)
            ),
            r"schedule of 'viscous', values: got shape \(3,\); needs one number or 2",
        ),
        (lambda: SineDisturbance(amplitude=1.0, frequency=np.nan), "frequency: got nan"),
        (lambda: StepDisturbance(amplitude=1.0, start_time="x"), "start_time: got 'x'; needs one number"),  # type: ignore[arg-type]
        (
            lambda: StepDisturbance(amplitude=1.0, start_time=2.0, stop_time=1.0),
            "stop_time: got 1.0; needs a time after start_time = 2",
        ),
        (lambda: Encoder(bits=12.5), "bits: got 12.5; needs a whole number from 1 to 52"),  # type: ignore[arg-type]
        (lambda: Encoder(delay="a"), "delay: got 'a'; needs numbers"),  # type: ignore[arg-type]
    ],
)
def test_bad_numbers_are_refused(schedule: Callable[[], object], message: str) -> None:
    with pytest.raises(InvalidParameter, match=message):
        schedule()


@pytest.mark.parametrize(("low", "high"), [(0.0, 50.0), (100.0, 300.0), (30.0, 40.0)])
def test_band_noise_keeps_its_energy_inside_the_band(low: float, high: float) -> None:
    times = np.arange(2**15) * 1e-3
    spectrum = (
        np.abs(
            np.fft.rfft(
                disturbance_torque(BandLimitedNoise(amplitude=1.0, min_frequency=low, max_frequency=high), times, 1)[0]
            )
        )
        ** 2
    )
    frequency = 2 * np.pi * np.fft.rfftfreq(len(times), 1e-3)
    width = (high - low) / 2
    is_in_band = (frequency >= low - width) & (frequency <= high + width)
    # eighth order forth and back: at half a band's width outside, the power is below 1 %
    assert spectrum[is_in_band].sum() / spectrum.sum() > 0.99
    assert spectrum[(frequency >= low) & (frequency <= high)].sum() / spectrum.sum() > 0.85


def test_schedule_steps_from_the_plant_s_own_value() -> None:
    schedule = ParameterSchedule(parameter="viscous", times=[0.25, 0.5], values=[[1.0, 2.0], 3.0])
    values = schedule.sample(TIMES, np.array([0.1, 0.2]))
    for begin, end, expected in ((0, 250, [0.1, 0.2]), (250, 500, [1.0, 2.0]), (500, 1000, [3.0, 3.0])):
        assert np.array_equal(values[:, begin:end], np.repeat(np.array([expected]).T, end - begin, axis=1))


def test_linear_schedule_joins_its_values_and_then_stays() -> None:
    schedule = ParameterSchedule(parameter="payload", times=[0.2, 0.6], values=[1.0, 3.0], interpolate=True)
    values = schedule.sample(TIMES, np.array(0.5))[0]
    assert np.array_equal(values[:200], np.full(200, 0.5))
    # 1e-9 s of tolerance in time, at 5 units a second
    assert np.allclose(values[200:600], 1 + 5 * (TIMES[200:600] - 0.2), rtol=0, atol=1e-8)
    assert np.allclose(values[600:], 3.0, rtol=0, atol=1e-8)


def test_payload_is_a_schedule_of_the_payload() -> None:
    values = payload_schedule([Payload(mass=2.0, start_time=0.4)], 0.5).sample(TIMES, np.array(0.5))
    assert payload_schedule([Payload(mass=2.0)], 0.0).parameter == "payload"
    assert np.array_equal(values, [np.where(np.arange(1000) < 400, 0.5, 2.0)])


def test_payloads_add_and_leave_the_plant_its_own() -> None:
    payloads = [
        Payload(mass=2.0, start_time=0.2, stop_time=0.6),
        Payload(mass=0.5, start_time=0.4),
        Payload(mass=1.0, start_time=0.4, stop_time=0.8),
    ]
    times = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
    own = np.array(0.25)
    assert payload_schedule(payloads, 0.25).sample(times, own)[0].tolist() == [0.25, 2.0, 3.5, 1.5, 0.5]
    first = payload_schedule(payloads[:1], 0.25).sample(times, own)[0]
    assert first.tolist() == [0.25, 2.0, 2.0, 0.25, 0.25]
    in_turn = [Payload(mass=3.0, stop_time=0.4), Payload(mass=4.0, start_time=0.4, stop_time=0.6)]
    assert payload_schedule(in_turn, 0.25).sample(times, own)[0].tolist() == [3.0, 3.0, 4.0, 0.25, 0.25]


@pytest.mark.parametrize(
    ("attempt", "message"),
    [
        (lambda: Sinusoid(amplitude=[1.0, 2.0], frequency=[1.0, 2.0, 3.0]), "amplitude: .* needs one number or 3"),
        (lambda: Sinusoid(amplitude=np.nan, frequency=1.0), "amplitude: .* finite numbers"),
        (lambda: Multisine(amplitude=[[1.0, 2.0]], frequency=[1.0]), r"amplitude: got shape \(1, 2\)"),
        (lambda: Multisine(amplitude=1.0, frequency=[1.0], phase=[[1.0, 2.0]]), "phase: got shape"),
        (
            lambda: Chirp(amplitude=1.0, start_frequency=1.0, stop_frequency=2.0, sweep_time=0.0),
            "sweep_time: got 0; .* above 0",
        ),
        (
            lambda: Chirp(
                amplitude=[1.0, 2.0], start_frequency=1.0, stop_frequency=2.0, sweep_time=1.0, offset=[1.0] * 3
            ),
            "offset: got shape",
        ),
        (lambda: Quintic(points=[[0.0], [1.0]], times=[0.0]), r"points: got shape \(2, 1\) with 1 times"),
        (lambda: Quintic(points=[0.0, 1.0], times=[0.0, 1.0]), "one row per time"),  # pyright: ignore[reportArgumentType]
        (lambda: Quintic(points=[[0.0], [1.0]], times=[1.0, 0.5]), r"times: got \[1.0, 0.5\]; must increase"),
        (lambda: Encoder(bits=12, resolution=1e-3), "bits, resolution: both are given"),
        (lambda: Encoder(bits=0), "bits: got 0"),
        (lambda: Encoder(resolution=-1.0), "resolution: got -1.0; needs one number of at least 0"),
        (lambda: Encoder(dropout=1.0), "dropout: got 1; .* at most 0.99"),
        (lambda: Encoder(span=-1.0), "span: got -1.0; needs one number above 0"),
        (lambda: Encoder(span="wide"), "span: got 'wide'; needs numbers"),  # pyright: ignore[reportArgumentType]
        (lambda: Encoder(max_step=[0.1, 0.0]), r"max_step: got \[0.1, 0.0\]; needs one number above 0"),
        (lambda: Encoder(max_step=np.nan), "max_step: got nan; needs one number above 0"),
        (lambda: Encoder(span=1.0, max_step=0.5), "max_step: got 0.5 with a span of 1.0; needs less than half"),
        (lambda: Encoder(span=[1.0, 1.0], max_step=[0.1] * 3), "span, max_step: got 2 and 3 numbers"),
        (lambda: Encoder(delay=-1), "delay: got -1; needs one number of at least 0"),
        (lambda: Encoder(noise=[1e-3, -1.0]), r"noise: got \[0.001, -1.0\]; needs one number of at least 0"),
        (lambda: Encoder(bits=[12, 60]), "bits: got 60; needs a whole number from 1 to 52"),
        (lambda: StepDisturbance(amplitude=np.inf), "amplitude: .* not NaN or infinity"),
        (
            lambda: disturbance_torque(StepDisturbance(amplitude=[1.0, 2.0, 3.0])),
            "disturbance amplitude: .* needs one number or 2",
        ),
        (
            lambda: BandLimitedNoise(amplitude=1.0, min_frequency=5.0, max_frequency=2.0),
            "min_frequency, max_frequency: got 5 and 2; needs 0 ≤ min_frequency < max_frequency",
        ),
        (
            lambda: disturbance_torque(BandLimitedNoise(amplitude=1.0, max_frequency=4000.0)),
            "max_frequency: got 4000 rad/s; .* allows up to 3142",
        ),
        (
            lambda: ParameterSchedule(parameter="payload", times=[1.0, 0.5], values=[1, 2]),
            "'payload': .* increasing times",
        ),
        (
            lambda: ParameterSchedule(parameter="payload", times=[1.0], values=[1, 2]),
            r"got times \[1.0\] and values \[1, 2\]",
        ),
        (lambda: Payload(mass=-1.0), "mass: got -1"),
        (lambda: Payload(mass=1.0, start_time=2.0, stop_time=2.0), "stop_time: got 2.0; needs a time after start_time"),
    ],
)
def test_bad_input_is_refused_with_the_remedy(attempt: Any, message: str) -> None:
    with pytest.raises(InvalidParameter, match=message):
        attempt()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,q1\n" + "now,later\n" * 6, "does not read as numbers .* needs columns time, q1"),
        ("0,1\n1,2\n2,3\n", r"has shape \(3, 2\); needs 6 rows or more"),
        ("\n".join(str(k) for k in range(9)), r"has shape \(9, 1\)"),
        ("\n".join(f"{k % 4},1" for k in range(9)), "do not increase"),
        ("\n".join(f"{k},{'nan' if k == 5 else 1}" for k in range(9)), "needs finite numbers"),
    ],
)
def test_a_record_at_fault_is_refused(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "record.csv"
    file.write_text(text)
    with pytest.raises(InvalidParameter, match=message):
        RecordedReference(path=file)


def test_a_missing_record_names_where_it_looked(tmp_path: Path) -> None:
    with pytest.raises(InvalidParameter, match=rf"no trajectory file .*none\.csv'; looked in {tmp_path}"):
        RecordedReference(path=tmp_path / "none.csv")
