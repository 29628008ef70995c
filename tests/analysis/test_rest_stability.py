"""Stability at rest against simulations from beside the posture, and the two ways to decide it against each other."""

import numpy as np
import pytest

import tarc
from tarc.analysis.linearise import _required_states
from tarc.analysis.rest_stability import RobotAtRest, _unstable_among, fastest_at_rest, unstable_posture
from tarc.estimators import Algebraic
from tarc.laws import PID, TARC, TDC, ComputedTorque
from tarc.plants import TwoLinkArm
from tarc.signals import Sinusoid

PERIOD = 0.001
POSTURE = np.array([0.4, 0.9])
ARM = TwoLinkArm(viscous=0.3)
COMMON = {"period": PERIOD, "estimator": Algebraic(window=0.010, degree=2)}


def growth_in_simulation(law):
    """Return the rate at which the distance from the posture grows [1/s]; negative where it shrinks."""
    run = tarc.simulate(
        ARM,
        law,
        Sinusoid(amplitude=0.0, frequency=1.0, offset=POSTURE),
        0.4,
        initial_position=POSTURE + np.array([1e-9, -1e-9]),
        initial_torque="rest",
        progress=False,
    )
    distance = np.linalg.norm(run.data["position"].values - POSTURE, axis=1)
    peaks = [distance[start : start + 50].max() for start in range(100, len(distance) - 50, 50)]
    return np.polyfit(0.05 * np.arange(len(peaks)), np.log(peaks), 1)[0]


UNSTABLE = [
    ComputedTorque(model=ARM, natural_frequency=185.0, **COMMON),
    PID(inertia=ARM.inertia(POSTURE), natural_frequency=190.0, model=ARM, **COMMON),
    TDC(inertia=[0.1, 0.1], natural_frequency=[60.0, 20.0], **COMMON),
]


@pytest.mark.filterwarnings("ignore::tarc.DesignWarning")
@pytest.mark.parametrize("law", UNSTABLE, ids=lambda law: type(law).__name__)
def test_a_mode_grows_in_simulation_as_predicted(law):
    mode = unstable_posture(law, ARM, POSTURE[:, None])
    assert mode is not None
    assert growth_in_simulation(law) == pytest.approx(mode.growth_rate, rel=0.05)


STABLE = [
    ComputedTorque(model=ARM, natural_frequency=60.0, **COMMON),
    PID(inertia=ARM.inertia(POSTURE), natural_frequency=40.0, model=ARM, **COMMON),
    TDC(inertia=[0.5, 0.5], natural_frequency=[12.0, 9.0], synchronised=True, **COMMON),
]


@pytest.mark.parametrize("law", STABLE, ids=lambda law: type(law).__name__)
def test_what_counts_as_stable_comes_to_rest(law):
    assert unstable_posture(law, ARM, POSTURE[:, None]) is None
    assert growth_in_simulation(law) < -1


@pytest.mark.parametrize("delay", [0, 2])
@pytest.mark.parametrize("synchronised", [False, True])
def test_both_ways_find_the_same_mode(synchronised, delay):
    law = TARC(
        inertia=[0.5, 0.5], natural_frequency=30.0, rise_rate=1e3, fall_rate=1e3, synchronised=synchronised, **COMMON
    )
    postures = np.array([[0.0, 0.4, 1.0], [0.3, 0.9, 2.0]])
    robots = [RobotAtRest(ARM, postures)]
    quick, general = fastest_at_rest(law, robots, delay), _unstable_among(law, robots, delay)
    assert quick is not None
    assert general is not None
    assert general.growth_rate == pytest.approx(quick.growth_rate, rel=1e-6)


@pytest.mark.filterwarnings("ignore::tarc.DesignWarning")
def test_several_robots_give_the_fastest_mode():
    """Also where the first mode found is not the fastest, and beside a robot that is stable."""
    law = UNSTABLE[0]
    light, heavy = (RobotAtRest(TwoLinkArm(payload=payload), POSTURE[:, None]) for payload in (0.0, 2.0))
    modes = [fastest_at_rest(law, [robot]) for robot in (light, heavy)]
    rates = [0.0 if mode is None else mode.growth_rate for mode in modes]
    assert rates[0] != rates[1]
    for robots in ([light, heavy], [heavy, light]):
        fastest = fastest_at_rest(law, robots)
        assert fastest is not None
        assert fastest.growth_rate == max(rates)


def test_required_states_are_those_on_a_walk_from_input_to_output():
    """Against powers of the matrix, which count the walks; a cycle among the others keeps all."""
    rng, kept = np.random.default_rng(0), set()
    for _ in range(300):
        n = int(rng.integers(1, 7))
        F, inputs, outputs = (rng.random(shape) < 0.2 for shape in ((n, n), (n, 1), (1, n)))
        walks = sum(np.linalg.matrix_power(F.astype(int), k) for k in range(n))
        expected = (walks @ inputs)[:, 0] * (outputs @ walks)[0] > 0
        rest = F[np.ix_(~expected, ~expected)].astype(int)
        if np.linalg.matrix_power(rest, len(rest)).any() and len(rest):
            expected = np.ones(n, dtype=bool)
        np.testing.assert_array_equal(_required_states(F, inputs, outputs), expected)
        kept.add((bool(expected.all()), bool(expected.any())))
    assert len(kept) == 3  # all, some and none of the states
