"""Smoothing of records: gain at the cut-off, no delay, bounded noise of the derivatives."""

import numpy as np
import pytest

from tarc.core.errors import InvalidParameter
from tarc.signals import RecordedReference
from tarc.signals.smoothing import smoothing_curve

PERIOD = 2e-3
TIMES = np.arange(0, 8, PERIOD)
MIDDLE = (TIMES > 3) & (TIMES < 5)


def phasor(signal, frequency):
    """Amplitude of the sine, and of the cosine, in the middle of a record."""
    angle = 2 * np.pi * frequency * TIMES[MIDDLE]
    return np.linalg.lstsq(np.column_stack([np.sin(angle), np.cos(angle)]), signal[MIDDLE], rcond=None)[0]


def smoothed_gain(frequency, cutoff):
    curve = smoothing_curve(TIMES, np.sin(2 * np.pi * frequency * TIMES)[:, None], cutoff)
    return phasor(curve(TIMES)[:, 0], frequency)


@pytest.mark.parametrize("cutoff", [2.0, 10.0, 60.0, 200.0])
def test_a_sine_at_the_cutoff_keeps_half_its_power_and_its_phase(cutoff):
    sine, cosine = smoothed_gain(cutoff, cutoff)
    assert sine == pytest.approx(1 / np.sqrt(2), rel=1e-6)
    assert abs(cosine) < 1e-6


@pytest.mark.parametrize("cutoff", [2.0, 10.0])
@pytest.mark.parametrize("factor", [0.1, 0.5, 2.0, 4.0])
def test_sines_below_pass_and_sines_above_fall_with_the_fourth_power(cutoff, factor):
    sine, cosine = smoothed_gain(factor * cutoff, cutoff)
    assert sine == pytest.approx(1 / (1 + (np.sqrt(2) - 1) * factor**4), rel=5e-3)  # the equivalent kernel's gain
    assert abs(cosine) < 1e-4


def test_a_line_passes_unchanged():
    curve = smoothing_curve(TIMES, np.column_stack([1 - 0.3 * TIMES, TIMES]), 1.0)
    assert np.allclose(curve(TIMES)[:, 0], 1 - 0.3 * TIMES, rtol=0, atol=1e-6)
    assert np.allclose(curve(TIMES, 1), [-0.3, 1.0], rtol=0, atol=1e-6)


@pytest.mark.parametrize("cutoff", [5.0, 20.0])
def test_noise_of_the_derivatives_is_that_of_the_gain_whatever_the_sampling(cutoff):
    """White noise of density S through |H|² ω^2m, integrated: the sampling period falls out."""
    omega = np.linspace(0, 100 * cutoff, 200_000)
    gain = 1 / (1 + (np.sqrt(2) - 1) * (omega / (2 * np.pi * cutoff)) ** 4)
    for period in (2e-3, 1e-3):
        times = np.arange(0, 8, period)
        noise = np.sqrt(1 / period) * np.random.default_rng(0).standard_normal((len(times), 4))  # density 1
        curve = smoothing_curve(times, noise, cutoff)
        middle = times[(times > 1) & (times < 7)]
        for order in (1, 2):
            expected = np.sqrt(np.trapezoid(gain**2 * omega ** (2 * order), omega) / np.pi)
            assert np.std(curve(middle, order)) == pytest.approx(expected, rel=0.1)


def test_uneven_samples_are_smoothed_alike():
    rng = np.random.default_rng(1)
    times = np.sort(rng.choice(TIMES, 2 * len(TIMES) // 3, replace=False))
    curve = smoothing_curve(times, np.sin(2 * np.pi * 5 * times)[:, None], 5.0)
    sine, cosine = phasor(curve(TIMES)[:, 0], 5.0)
    assert sine == pytest.approx(1 / np.sqrt(2), rel=0.02)
    assert abs(cosine) < 0.02


def noisy_record(path):
    rng = np.random.default_rng(2)
    positions = np.column_stack([0.5 * np.sin(TIMES), 0.2 * np.cos(TIMES)])
    table = np.column_stack([TIMES, positions + 1e-4 * rng.standard_normal(positions.shape)])
    np.save(path / "record.npy", table)
    return path / "record.npy"


def test_a_noisy_record_has_usable_derivatives(tmp_path):
    path = noisy_record(tmp_path)
    raw, smooth = RecordedReference(path=path), RecordedReference(path=path, cutoff=3.0)
    inside = np.linspace(1, 7, 999)
    truth = [0.5 * np.sin(inside), 0.5 * np.cos(inside), -0.5 * np.sin(inside)]
    errors = np.array([[np.std(x[0] - y) for x, y in zip(r.sample(inside), truth, strict=True)] for r in (raw, smooth)])
    assert errors[0, 2] > 50  # rad/s²
    assert np.all(errors[1] < [5e-5, 5e-4, 2e-2])


def test_derivatives_of_the_smoothed_record_are_consistent(tmp_path):
    reference = RecordedReference(path=noisy_record(tmp_path), cutoff=20.0)
    times, h = np.linspace(1, 7, 50) + 1e-4, 1e-6
    before, after = reference.sample(times - h), reference.sample(times + h)
    for j in (0, 1):
        assert np.allclose((after[j] - before[j]) / (2 * h), reference.sample(times)[j + 1], rtol=0, atol=1e-4)


@pytest.mark.parametrize("cutoff", [0.0, -1.0, 250.0, 1e6])
def test_a_cutoff_beyond_the_sampling_is_refused(cutoff, tmp_path):
    with pytest.raises(InvalidParameter, match=r"cutoff: got .* a sample every 0.002 s, .* below 250 Hz"):
        RecordedReference(path=noisy_record(tmp_path), cutoff=cutoff)
