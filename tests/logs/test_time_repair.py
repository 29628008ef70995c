"""Times of rows are found again from the motion that the joints share."""

import numpy as np
import pytest

from tarc.core.errors import InvalidParameter
from tarc.logs.time_repair import repair_time
from tarc.signals import RobotLog

T = 0.001


def motion(times: np.ndarray) -> np.ndarray:
    return np.column_stack([0.5 * np.sin(3 * times), 0.4 * np.cos(4 * times), 0.6 * np.sin(2.3 * times + 1)])


def clocked_log(seed: int, noise: float = 2e-6) -> tuple[RobotLog, np.ndarray]:
    """Rows of a recorder that reads the newest sample of a faster clock now and then, and the true ticks."""
    rng = np.random.default_rng(seed)
    stamps = 1.02 * T * np.arange(3000) + 0.0002 * rng.random(3000)
    ticks = np.maximum.accumulate(np.floor(stamps / T - 0.3 * rng.random(3000)).astype(int))
    ticks -= ticks[0]
    samples = motion(T * np.arange(ticks[-1] + 1))
    samples += noise * rng.standard_normal(samples.shape)
    return RobotLog(times=stamps, position=samples[ticks]), ticks


@pytest.mark.parametrize("seed", [1, 2])
def test_ticks_of_a_clock_are_found(seed):
    log, ticks = clocked_log(seed)
    timing = repair_time(log)
    assert timing.on_clock
    assert timing.period == T
    wrong = np.count_nonzero(np.diff(np.round(timing.times / T)) != np.diff(ticks))
    assert wrong <= 3  # where all joints turn at once
    assert timing.stale == pytest.approx(np.mean(np.diff(ticks) == 0), abs=1e-3)
    assert timing.missing == pytest.approx(1 - len(np.unique(ticks)) / (ticks[-1] + 1), abs=1e-3)
    assert np.all(timing.residual < 8e-6)  # 2 µrad of noise, and the ends of the smooth motion
    assert np.all(timing.residual_before > 20 * timing.residual)
    assert timing.rate == pytest.approx(len(np.unique(ticks)) / (T * (ticks[-1] + 1)), rel=1e-3)


def test_rows_without_a_clock_get_one_shift_each():
    rng = np.random.default_rng(3)
    stamps = T * np.arange(3000)
    true = stamps + 0.00025 * rng.standard_normal(3000)
    log = RobotLog(times=stamps, position=motion(true) + 2e-6 * rng.standard_normal((3000, 3)))
    timing = repair_time(RobotLog(times=stamps + 1e-4 * rng.random(3000), position=log.position), cutoff=10.0)
    error = timing.times - true
    inner = slice(300, -300)
    assert np.std((error - np.mean(error))[inner]) < 5e-5
    assert np.all(timing.residual < 0.2 * timing.residual_before)


def test_encoders_without_noise_at_rest_are_not_stale():
    moving = T * np.arange(3000)
    share = np.clip(moving - 1.0, 0.0, 1.0)[:, None]
    smooth = share**3 * (10 - 15 * share + 6 * share**2) * (motion(moving) - motion(np.ones(1)))
    position = 1e-5 * np.round(smooth / 1e-5)
    stamps = np.delete(moving, [500, 2000])  # two rows are missing, one of them at rest
    timing = repair_time(RobotLog(times=stamps, position=np.delete(position, [500, 2000], axis=0)))
    assert timing.period == T
    assert timing.stale < 1e-2
    wrong = np.round(timing.times / T) != np.round(stamps / T)
    assert np.count_nonzero(wrong) <= 10  # where the slowest motion begins


def test_even_stamps_are_left_alone():
    times = 0.004 * np.arange(800)
    timing = repair_time(RobotLog(times=times, position=motion(times)))
    assert np.array_equal(timing.times, times)
    assert timing.stale == timing.missing == timing.lost == 0
    assert timing.step_deviation < 1e-12


def test_a_lost_sample_is_no_missing_row():
    times = 0.004 * np.arange(800)
    position = motion(times)
    position[100:104, 1] = np.nan
    timing = repair_time(RobotLog(times=times, position=position))
    assert timing.missing == 0
    assert timing.lost == pytest.approx(4 / 2400)
    assert not np.any(timing.is_new[100:104])


def test_what_never_moves_shows_no_time():
    with pytest.raises(InvalidParameter, match="no joint of log moves"):
        repair_time(RobotLog(times=T * np.arange(100), position=np.ones((100, 2))))
