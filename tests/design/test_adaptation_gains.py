"""The switching gain's parameters against the slope they must keep to and against simulations of the adaptive law."""

from dataclasses import replace

import numpy as np
import pytest

import tarc
from tarc import TarcError, laws, plants, signals
from tarc.analysis import Workspace
from tarc.certificates import certify_varying_ratio
from tarc.design.adaptation import MIN_LAYER_TO_NOISE, RISE_TO_FALL, Adaptation, choose_adaptation, expected_step
from tarc.design.assessment import assess_candidates
from tarc.design.candidates import enumerate_candidates, peak_error
from tarc.design.robustness import RobustnessSpec

PERIOD = 1e-3


@pytest.fixture(scope="module")
def loops():
    """Loops that tolerate a spread and a slope as steep as K1."""
    trials = enumerate_candidates(PERIOD, natural_frequencies=[5.0, 10.0, 25.0], windows=[4, 10], degrees=[2])
    return [one for one in assess_candidates(trials, RobustnessSpec.from_spread(3.0), slope_ratio=1.0) if one.feasible]


def tarc_of_loop(one, values):
    return laws.TARC(inertia=one.inertia_scale, estimator=one.estimator, **one.law_options(), **values.law_options())


@pytest.mark.parametrize("expected", [0.0123, 1.0, 77.7])
def test_slope_at_the_cap_is_the_certified_one_and_never_above(loops, expected):
    assert len(loops) > 10
    for one in loops:
        law = tarc_of_loop(one, choose_adaptation(one, expected))
        assert law.robust_slope_bound <= one.robust_slope
        assert law.robust_slope_bound == pytest.approx(one.robust_slope, rel=2e-4)
        assert law.max_gain is not None
        assert law.start_gain < law.max_gain
    one = loops[0]
    law = tarc_of_loop(one, choose_adaptation(one, expected))
    assert certify_varying_ratio(
        law, ratio_range=(one.inertia_scale, 3.0 * one.inertia_scale), slope=law.robust_slope_bound
    ).certified


def test_rounding_never_steepens_the_slope():
    rng = np.random.default_rng(0)
    for _ in range(2000):
        boundary_layer, slope, gain_factor = np.exp(rng.uniform(-12, 3)), np.exp(rng.uniform(0, 10)), rng.uniform(1, 3)
        values = Adaptation(
            rise_rate=1.0,
            fall_rate=1.0,
            min_gain=1e-6,
            boundary_layer=boundary_layer,
            max_gain=slope * boundary_layer / gain_factor,
            gain_factor=gain_factor,
        ).law_options()
        assert (1 - 3e-4) * slope < values["gain_factor"] * values["max_gain"] / values["boundary_layer"] <= slope


def test_scaling_laws(loops):
    for one in loops:
        small, large = choose_adaptation(one, 2.0), choose_adaptation(one, 10.0)
        for name in ("boundary_layer", "max_gain", "min_gain"):
            assert getattr(large, name) == pytest.approx(5.0 * getattr(small, name))
        assert (large.rise_rate, large.fall_rate) == (
            small.rise_rate,
            small.fall_rate,
        )  # which are rates over the error's size
        assert small.rise_rate == pytest.approx(RISE_TO_FALL * small.fall_rate)
        assert small.max_gain == pytest.approx(one.robust_slope * small.boundary_layer)
        assert small.min_gain == pytest.approx(small.max_gain / 100)
        steeper = choose_adaptation(replace(one, robust_slope=2 * one.robust_slope), 2.0)
        assert steeper.boundary_layer == small.boundary_layer
        assert steeper.max_gain == pytest.approx(2 * small.max_gain)
        assert steeper.fall_rate == pytest.approx(2 * small.fall_rate)


def test_boundary_is_the_greatest_error_after_the_step_and_above_the_noise(loops):
    for one in loops:
        least = 2.0 * max(peak_error(one.channel(), ratio * one.inertia_scale) for ratio in (1.0, 3.0))
        assert choose_adaptation(one, 2.0).boundary_layer == pytest.approx(least)
        assert choose_adaptation(one, 2.0, noise=least / MIN_LAYER_TO_NOISE / 2).boundary_layer == pytest.approx(least)
        assert choose_adaptation(one, 2.0, noise=least).boundary_layer == pytest.approx(MIN_LAYER_TO_NOISE * least)


@pytest.mark.parametrize("spread", [1.1, 1.5, 2.0])
def test_a_narrow_spread_near_the_upper_end_does_not_widen_the_layer(spread):
    """Ratios beyond the spread, where the loop may be unstable, do not come into it."""
    trials = enumerate_candidates(PERIOD, natural_frequencies=[10.0], windows=[4, 10, 20], degrees=[2])
    able = [
        one for one in assess_candidates(trials, RobustnessSpec.from_spread(spread), slope_ratio=1.0) if one.feasible
    ]
    assert len(able) > 10
    for one in able:
        values = choose_adaptation(one, 1.0)
        # at rest the stiffness that an integrating loop shows is no less than some share of ρ K1
        assert values.boundary_layer < 20.0 / (one.natural_frequency**2 * one.inertia_scale)
        assert np.isfinite(values.max_gain)


@pytest.mark.parametrize("synchronised", [False, True])
def test_boundary_of_a_simulated_step(synchronised):
    """TDC on a mass, hit by a step of the acceleration expected, errs by the boundary at most."""
    trials = enumerate_candidates(
        PERIOD, natural_frequencies=[10.0], windows=[8], degrees=[2], synchronised=[synchronised]
    )
    one = assess_candidates(trials, RobustnessSpec.from_spread(2.0), slope_ratio=1.0)[0]
    values = choose_adaptation(one, 3.0)
    still = signals.Sinusoid(amplitude=[0.0], frequency=1.0, offset=[0.0])
    greatest = []
    for mass in (1.0, 0.5):
        robot = plants.MassSpringDamper(masses=(mass,), springs=(0.0,), dampers=(0.0,))
        law = laws.TDC(inertia=one.inertia_scale, estimator=one.estimator, **one.law_options())
        step = signals.StepDisturbance(amplitude=[3.0 * mass])
        run = tarc.simulate(robot, law, still, 3.0, disturbance=step, progress=False)
        greatest.append(np.abs(run.data["position"].values).max())
    assert max(greatest) == pytest.approx(values.boundary_layer, rel=1e-3)


def test_time_to_empty_and_to_fill_the_cap(loops):
    """A constant error as wide as the layer takes the gain from cap to nothing in 1/ωn, a rising one up in a third."""

    def step(law, state, size):
        error = np.array([size])
        tracking = type("ControlInput", (), {"error": error, "error_rate": 0 * error, "fault": np.array(False)})
        return law.robust(state, tracking)[0]

    for one in loops[::5]:
        values = choose_adaptation(one, 1.0)
        law = tarc_of_loop(one, values)
        assert law.max_gain is not None
        periods = round(1 / (one.natural_frequency * PERIOD))
        state = law.robust_init()._replace(gain=np.array(law.max_gain))
        gains = []
        for _ in range(periods + 50):
            state = step(law, state, values.boundary_layer)  # the first rises, at the cap, and all the others do not
            gains.append(float(np.asarray(state.gain)))
        emptied = np.argmax(np.array(gains) < 1.5 * law.min_gain)
        assert emptied == pytest.approx(periods, abs=0.03 * periods + 2)
        state = law.robust_init()
        gains = []
        for k in range(periods):
            state = step(law, state, values.boundary_layer * (1 + 1e-6 * k))
            gains.append(float(np.asarray(state.gain)))
        filled = np.argmax(np.array(gains) > 0.9999 * law.max_gain)
        assert filled == pytest.approx(periods / RISE_TO_FALL, abs=0.03 * periods + 2)


@pytest.mark.parametrize("payload", [0.0, 0.5, 2.0])
def test_expected_step_of_a_pendulum(payload):
    """The payload's own weight over the inertia with it; a tenth of the holding torque without one."""
    bare = plants.Pendulum(mass=1.5, length=0.8, rotor=0.1)
    both = [bare, plants.Pendulum(mass=1.5, length=0.8, rotor=0.1, payload=payload)]
    across = Workspace.box([np.pi / 2], [np.pi / 2])
    if payload:
        expected = payload * 9.81 * 0.8 / ((1.5 + payload) * 0.8**2 + 0.1)
    else:
        both = [bare]
        expected = 0.1 * 1.5 * 9.81 * 0.8 / (1.5 * 0.8**2 + 0.1)
    assert expected_step(both, across) == pytest.approx(expected)
    # it hangs nowhere across in a narrow box, and grows with the sine
    lower = expected_step(both, Workspace.box([0.2], [0.3]))
    assert np.sin(0.2) * expected < lower <= np.sin(0.3) * expected
    assert expected_step(both, Workspace.box([-np.pi], [np.pi])) == pytest.approx(expected, rel=0.01)


def test_expected_step_of_friction_is_its_reversal():
    rubs = plants.Pendulum(coulomb=2.0)
    assert expected_step([rubs], Workspace.box([0.0], [1.0])) == pytest.approx(4.0)
    heavy = [rubs, plants.Pendulum(coulomb=2.0, payload=3.0)]
    across = Workspace.box([np.pi / 2], [np.pi / 2])
    assert expected_step(heavy, across) == pytest.approx(max(4.0, 3.0 * 9.81 / 4.0))
    chain = plants.MassSpringDamper(masses=(1.0, 0.25), springs=(0.0, 0.0), dampers=(0.0, 0.0))
    assert expected_step([chain], Workspace.box([0.0, 0.0], [1.0, 1.0])) == 1.0  # nothing to go by


def test_expected_step_of_an_arm_is_in_its_worst_posture():
    arm, loaded = plants.TwoLinkArm(), plants.TwoLinkArm(payload=1.0)
    box = Workspace.box([-np.pi, 0.5], [np.pi, 2.5])
    value = expected_step([arm, loaded], box, samples=2000)
    best = 0.0
    for q1 in np.linspace(-np.pi, np.pi, 61):
        for q2 in np.linspace(0.5, 2.5, 31):
            change = 9.81 * np.array([np.cos(q1) + np.cos(q1 + q2), np.cos(q1 + q2)])
            best = max(best, float(np.linalg.norm(np.linalg.solve(loaded.inertia([q1, q2]), change))))
    assert 0.95 * best < value < 1.02 * best


def test_bad_input(loops):
    one = loops[0]
    for expected in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(TarcError, match="expected"):
            choose_adaptation(one, expected)
    with pytest.raises(TarcError, match="slope"):
        choose_adaptation(replace(one, robust_slope=0.0), 1.0)
