"""The torque variation that laws may have: the task's and the noise's, whatever laws the scenario has."""

import itertools

import numpy as np
import pytest

import tarc
from tarc.core.errors import InvalidParameter
from tarc.study import torque_variation_budget

INERTIA, PERIOD = 2.0, 1e-3
STEP = 1e-4
AMPLITUDE, FREQUENCY = 0.3, 2.0
LAWS = [
    {"kind": "TDC", "inertia": {"fraction": 0.9}, "natural_frequency": 30.0},
    {"kind": "TDC", "inertia": {"fraction": 0.1}, "natural_frequency": 10.0},
    {"kind": "PID", "inertia": {"fraction": 0.5}, "natural_frequency": 5.0},
]


def one_mass(**changes):
    return tarc.Scenario.parse(
        {
            "robot": {"kind": "MassSpringDamper", "masses": [INERTIA], "springs": [0.0], "dampers": [0.0]},
            "law": LAWS,
            "estimator": {"kind": "Algebraic", "window": 0.01, "degree": 2},
            "reference": {"kind": "Sinusoid", "amplitude": [AMPLITUDE], "frequency": [FREQUENCY]},
            "sensor": {"resolution": STEP},
            "duration": 2 * np.pi / FREQUENCY,
            **changes,
        }
    )


def test_does_not_depend_on_the_laws_or_their_order():
    budgets = {torque_variation_budget(one_mass(law=list(order))) for order in itertools.permutations(LAWS)}
    assert len(budgets) == 1


def test_motion_is_the_variation_of_the_inverse_dynamics():
    """The mean of |d/dt m a ω² sin ωt| over a period is (2/π) m a ω³."""
    expected = 2 / np.pi * INERTIA * AMPLITUDE * FREQUENCY**3
    assert torque_variation_budget(one_mass()).motion == pytest.approx(expected, rel=1e-3)


def test_disturbances_and_payloads_count():
    push = {"kind": "StepDisturbance", "amplitude": [5.0], "start_time": 1.0}
    still = {"kind": "Sinusoid", "amplitude": [0.0], "frequency": [FREQUENCY]}
    scenario = one_mass(disturbance=[push], reference=still, duration=2.0)
    assert torque_variation_budget(scenario).motion == pytest.approx(5.0 / 2.0, rel=1e-2)


def test_noise_is_that_of_a_pd_loop_on_a_recorded_white_noise():
    rng = np.random.default_rng(0)
    noise = STEP / np.sqrt(12) * rng.standard_normal(100_000)
    line = np.polynomial.polynomial.polyvander(-PERIOD * np.arange(11), 1)
    omega = 0.03 / PERIOD
    values = np.lib.stride_tricks.sliding_window_view(noise, 11)[:, ::-1] @ np.linalg.pinv(line).T
    torque = -INERTIA * (omega**2 * values[:, 0] + 2 * omega * values[:, 1])
    expected = np.mean(np.abs(np.diff(torque))) / PERIOD
    assert torque_variation_budget(one_mass()).noise == pytest.approx(expected, rel=0.02)


def test_a_perfect_sensor_makes_no_noise():
    assert torque_variation_budget(one_mass(sensor={})).noise == 0.0


def test_the_shipped_gains_were_found_under_much_the_same_limits():
    assert torque_variation_budget(tarc.Scenario.load("train_two_link")).total == pytest.approx(1230, rel=0.05)


def test_a_robot_with_passive_joints_has_no_inverse_dynamics():
    with pytest.raises(InvalidParameter, match="unless --budget gives a number"):
        torque_variation_budget(tarc.Scenario.load("series_elastic"))
