"""Ramp and stop against their closed forms, and the ring of a log."""

import numpy as np
import pytest

from tarc.runtime.motion import Motion, ramp, rest, sampled, stop
from tarc.runtime.push import evaluate, unit_responses
from tarc.runtime.ring import Ring
from tarc.signals import Sinusoid

PERIOD = 1e-3


def integrated(rates: np.ndarray) -> np.ndarray:
    """Trapezoidal sums."""
    return np.concatenate([np.zeros((1, rates.shape[1])), np.cumsum((rates[1:] + rates[:-1]) / 2, axis=0)]) * PERIOD


@pytest.mark.parametrize("phase", [0.0, np.pi / 2])
def test_a_ramp_joins_rest_and_reference(phase):
    target = sampled(Sinusoid(amplitude=[0.3, 0.5], frequency=[2.0, 3.0], phase=phase), 0.1, PERIOD)
    start = np.array([1.0, -0.4])
    motion = ramp(start, target, PERIOD, time=0.5, speed=1.0)
    assert len(motion) == 500
    np.testing.assert_array_equal(motion.position[0], start)
    np.testing.assert_array_equal(motion.velocity[0], 0)
    np.testing.assert_array_equal(motion.acceleration[0], 0)
    rows = [np.concatenate([getattr(motion, name), getattr(target, name)]) for name in motion.__dataclass_fields__]
    np.testing.assert_allclose(integrated(rows[1]) + start, rows[0], atol=1e-5)
    np.testing.assert_allclose(integrated(rows[2]), rows[1], atol=1e-4)


def test_a_ramp_between_points_of_rest_keeps_to_its_speed():
    target = rest(np.array([2.0, 0.1]), 1)
    motion = ramp(np.zeros(2), target, PERIOD, time=None, speed=0.5)
    assert np.max(np.abs(motion.velocity)) == pytest.approx(0.5, rel=1e-4)


def test_a_stop_comes_to_rest_where_it_says():
    q, v, a = np.array([0.5, 0.1]), np.array([1.0, -0.5]), np.array([2.0, 0.3])
    motion = stop(q, v, a, PERIOD, 0.4)
    np.testing.assert_allclose(motion.velocity[-1], 0, atol=1e-12)
    np.testing.assert_allclose(motion.position[-1], q + 0.4 * v / 2 + 0.16 * a / 12)
    path = Motion(*(np.vstack(pair) for pair in ((q, motion.position), (v, motion.velocity), (a, motion.acceleration))))
    np.testing.assert_allclose(integrated(path.velocity) + q, path.position, atol=1e-6)
    np.testing.assert_allclose(integrated(path.acceleration) + v, path.velocity, atol=1e-5)


@pytest.mark.parametrize("friction", [0.0, 0.5, 1.2])
@pytest.mark.parametrize("inertia", [0.2, 3.0])
def test_a_push_tells_inertia_from_dry_friction(friction, inertia):
    torque = 2.0 * np.repeat([1.0, -1.0, -1.0, 1.0, 0.0], 20)
    moved = unit_responses(torque, np.array([friction]), PERIOD)[0] / inertia
    s = np.arange(len(torque)) / len(torque)
    positions = moved + 0.3 - 0.002 * s + 0.001 * s**2  # the holding torque was a little wrong
    mobility, certainty, found = evaluate(torque, positions, PERIOD)
    assert certainty > 100
    assert found == pytest.approx(friction, abs=0.05)
    assert mobility * inertia == pytest.approx(1.0, abs=0.05)


def test_responses_of_a_unit_inertia_are_those_of_finer_steps():
    torque = np.repeat([1.0, -1.0, -1.0, 1.0, 0.0], 20)
    frictions = np.array([0.0, 0.3])
    coarse = unit_responses(torque, frictions, PERIOD)
    fine = unit_responses(np.repeat(torque, 50), frictions, PERIOD / 50)[:, ::50]
    np.testing.assert_allclose(coarse, fine, atol=1e-9)


def test_no_samples_show_nothing():
    assert evaluate(np.ones(20), np.full(20, np.nan), PERIOD) == (0.0, 0.0, 0.0)
    assert evaluate(np.zeros(20), np.ones(20), PERIOD) == (0.0, 0.0, 0.0)


def test_a_ring_gives_every_row_once_and_counts_what_it_lost(tmp_path):
    ring = Ring.create(tmp_path / "ring", 8, 3)
    reader = Ring(tmp_path / "ring", "r")
    assert reader.newest() is None
    for k in range(5):
        ring.append(np.full(3, float(k)))
    np.testing.assert_array_equal(reader.read()[:, 0], np.arange(5))
    assert len(reader.read()) == 0
    for k in range(5, 25):
        ring.append(np.full(3, float(k)))
    rows = reader.read()[:, 0]
    assert rows[-1] == 24
    np.testing.assert_array_equal(np.diff(rows), 1)
    assert not reader.is_ended
    ring.end()
    assert reader.is_ended
