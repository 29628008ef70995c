"""What loops are to be had: against loops written by hand, simulations, and the certificates of their laws."""

import numpy as np
import pytest
from scipy.signal import lfilter

import tarc
from law_catalogue import make_tdc
from reference.constant_loop import loop_polynomials
from reference.law_parameters import LawParameters
from reference.law_recurrence import recurrence
from reference.uncertain_case import UncertainCase, state_matrices
from slow_cases import slow
from tarc import TarcError, laws, plants, signals
from tarc.analysis import Workspace
from tarc.analysis.inertia_ratio import inertia_spread
from tarc.analysis.inertia_shape import best_inertia_shape
from tarc.analysis.operating_points import UncertaintySamples
from tarc.certificates import certify_robot, certify_varying_ratio
from tarc.design.assessment import assess_candidates
from tarc.design.candidates import enumerate_candidates, pareto_front, peak_error, step_error
from tarc.design.robustness import RobustnessSpec

PERIOD = 1e-3


def tdc_of_candidate(one, shape: object = 1.0):
    """Return the law that a candidate stands for."""
    return laws.TDC(inertia=one.inertia_scale * np.asarray(shape), estimator=one.estimator, **one.law_options())


def hand_recurrence(one):
    """Return the same loop as a recurrence, which shares no code with it."""
    late = one.computation_delay
    return recurrence(
        LawParameters(
            natural_frequency=one.natural_frequency,
            damping_ratio=one.damping_ratio,
            window=one.window,
            degree=one.degree,
            synchronised=one.synchronised,
            delay_periods=one.delay,
            computation_delay=late,
            actuation_delay=late,
        )
    )


def recurrence_errors(one, ratio, steps):
    """Error after a step of 1 rad/s², by running the recurrence."""
    A, B, _, _ = state_matrices(UncertainCase(hand_recurrence(one), ratio))
    x, errors = np.zeros(len(A)), np.zeros(steps)
    for k in range(steps):
        errors[k] = x[0]
        x = A @ x + B
    return errors


def feasible_candidates(spread, seed=0, count=12, **options):
    """Return some loops that tolerate a spread, of a random choice of all."""
    slope_ratio = options.pop("slope_ratio", 0.0)
    trials = enumerate_candidates(PERIOD, **options)
    some = [trials[i] for i in np.random.default_rng(seed).choice(len(trials), 60, replace=False)]
    able = [
        one
        for one in assess_candidates(some, RobustnessSpec.from_spread(spread), slope_ratio=slope_ratio)
        if one.feasible
    ]
    return able[:: max(len(able) // count, 1)]


@pytest.mark.parametrize(
    ("window", "synchronised", "known"),
    [(10, False, 8.6), (5, False, 14.7), (20, True, 12.2), (10, True, 22.2), (5, True, 39.5)],
)
def test_reach_is_the_ratio_of_the_widest_ball(window, synchronised, known):
    """Known for a mismatch held over each period; one that changes within it costs up to two per cent."""
    trials = enumerate_candidates(
        PERIOD, natural_frequencies=[10.0], windows=[window], degrees=[2], synchronised=[synchronised]
    )
    (reach,) = {one.max_spread for one in assess_candidates(trials, RobustnessSpec.from_spread(2.0))}
    widest = certify_varying_ratio(make_tdc(window, synchronised)).evidence.ratio_spread
    assert 0.98 * widest < reach < 1.001 * widest
    assert 0.96 * known < reach < 1.01 * known


@pytest.mark.parametrize(("slope_ratio", "rate"), [(0.0, 5.0), slow(0.0, 0.3), slow(1.0, 0.3)])
def test_what_tolerates_a_spread_within_a_speed_is_certified(slope_ratio, rate):
    """By the ball for the rate that M̂ = scale X makes of it; most of them are not for any speed."""
    spread = 12.0
    trials = enumerate_candidates(PERIOD, natural_frequencies=[5.0, 10.0, 20.0], windows=[5, 10], degrees=[2])
    looked = assess_candidates(trials, RobustnessSpec.from_spread(spread, rate), slope_ratio=slope_ratio)
    able = [one for one in looked if one.feasible]
    at_once = []
    for one in able:
        ends = one.inertia_scale, one.inertia_scale * spread
        slow = certify_varying_ratio(
            tdc_of_candidate(one), ratio_range=ends, slope=one.robust_slope, rate=rate / one.inertia_scale
        )
        assert slow.certified, one
        at_once.append(certify_varying_ratio(tdc_of_candidate(one), ratio_range=ends, slope=one.robust_slope).certified)
    assert len(able) > 3
    assert not all(at_once)


def test_a_slower_robot_is_borne_at_more_bandwidth():
    trials = enumerate_candidates(PERIOD, windows=[8], degrees=[2])

    def fastest(rate):
        looked = assess_candidates(trials, RobustnessSpec.from_spread(15.0, rate))
        return max((one.natural_frequency for one in looked if one.feasible), default=0.0)

    speeds = [fastest(rate) for rate in (np.inf, 3.0, 0.1)]
    assert speeds[0] < speeds[2]
    assert speeds == sorted(speeds)


@pytest.mark.parametrize("delay", [0, slow(1), slow(2), slow(3)])
@pytest.mark.parametrize("slope_ratio", [0.0, 1.0])
@pytest.mark.parametrize("spread", [slow(1.7), 5.0])
def test_what_tolerates_a_spread_is_certified(delay, slope_ratio, spread):
    able = feasible_candidates(spread, computation_delay=delay, slope_ratio=slope_ratio)
    assert len(able) > 3
    for one in able:
        assert one.robust_slope == pytest.approx(slope_ratio * one.natural_frequency**2)
        assert one.required_spread == spread
        options = {"slope": one.robust_slope, "computation_delay": delay}
        assert certify_varying_ratio(
            tdc_of_candidate(one), ratio_range=(one.inertia_scale, one.inertia_scale * spread), **options
        ).certified, one
        there = certify_varying_ratio(tdc_of_candidate(one), one.inertia_scale * (1 + spread) / 2, **options).evidence
        borne = spread * (1 + one.spread_margin)
        assert there.radius / there.centre == pytest.approx((borne - 1) / (borne + 1), rel=0.03)
        assert one.spread_margin > 0.09


def test_what_tolerates_a_robot_with_gravity_is_certified_on_it():
    """Bandwidths so low that gravity's stiffness takes much of the ball."""
    both = [plants.TwoLinkArm(), plants.TwoLinkArm(payload=2.0)]
    box = Workspace.box([-np.pi, 0.8], [np.pi, 2.2])
    shape, _ = best_inertia_shape(both, box, samples=200)
    ends = inertia_spread(both, shape, box, samples=200)
    shape = shape / ends.min_ratio
    demand = RobustnessSpec.from_robot(both, box, shape, ends)
    assert np.all(demand.radius_ratios > RobustnessSpec.from_spread(ends.ratio).radius_ratios)
    assert np.all(np.diff(demand.radius_ratios) <= 0)  # more weight, less share of the stiffness
    trials = enumerate_candidates(PERIOD, natural_frequencies=[2.0, 5.0, 10.0], windows=[3, 6, 12], degrees=[2])
    able = [one for one in assess_candidates(trials, demand) if one.feasible]
    without = [one for one in assess_candidates(trials, RobustnessSpec.from_spread(ends.ratio)) if one.feasible]
    # gravity takes what a small inertia would do without it
    assert min(one.inertia_scale for one in able) > 1.5 * min(one.inertia_scale for one in without)
    for one in able[:: max(len(able) // 8, 1)]:
        verdict = certify_robot(tdc_of_candidate(one, shape), both, box, samples=200)
        assert verdict.certified or one.spread_margin < 0.2, one  # the margin of the search
        assert verdict.margin > -0.02
    low = min(without, key=lambda one: one.inertia_scale)
    assert not certify_robot(tdc_of_candidate(low, shape), both, box, samples=200).certified


def test_peaks_between_the_frequencies_are_seen():
    """A torque that comes back after three periods rings at a third of the rate, barely damped, in a narrow peak."""
    for delay in (1, 2):
        for degree, window, natural_frequency in ((3, 12, 10.0), (3, 15, 5.0), (2, 10, 2.0)):
            trials = enumerate_candidates(
                PERIOD,
                natural_frequencies=[natural_frequency],
                windows=[window],
                degrees=[degree],
                synchronised=[False],
                delays=[3 - delay],
                computation_delay=delay,
            )
            (one,) = assess_candidates(trials, RobustnessSpec.from_spread(4.0))
            assert not one.feasible
            assert one.max_spread < 3.0


@pytest.mark.parametrize("delay", [slow(0), 2])
def test_settling_and_peak_are_those_of_the_loop_run(delay):
    checked = 0
    for one in feasible_candidates(4.0, seed=1, computation_delay=delay):
        for ratio in (one.inertia_scale, 4.0 * one.inertia_scale):
            steps = int(40 / (one.natural_frequency * PERIOD)) + 5000
            errors = recurrence_errors(one, ratio, steps)
            if abs(errors[-1]) > 1e-6 * np.abs(errors).max():  # too slow to be seen to settle
                continue
            checked += 1
            channel = one.channel()
            assert step_error(channel, ratio) == pytest.approx(np.sqrt(PERIOD * np.sum(errors**2)), rel=1e-5)
            assert peak_error(channel, ratio) == pytest.approx(np.abs(errors[:4000]).max(), rel=1e-6)
    assert checked > 10


@pytest.mark.parametrize("delay", [slow(0), 2])
def test_noise_and_error_are_those_of_the_loop_run(delay):
    """The response to a single measurement off by one holds the root mean square of white noise."""
    for one in feasible_candidates(4.0, seed=2, count=6, computation_delay=delay):
        ratios = one.inertia_scale * np.array([1.0, 2.0, 4.0])
        sizes, changes = [], []
        for ratio in ratios:
            law = hand_recurrence(one)
            pulse = np.zeros(400_000)
            pulse[0] = 1.0
            top = np.polynomial.polynomial.polymul(law.q, [1.0, -2.0, 1.0])
            answer = np.asarray(lfilter(top, loop_polynomials(law, ratio).closed, pulse))
            sizes.append(np.sqrt(np.sum(answer**2)))
            changes.append(np.sqrt(np.sum(np.diff(answer, prepend=0.0) ** 2)))
        assert one.noise == pytest.approx(one.inertia_scale * max(sizes), rel=1e-4)
        assert one.change == pytest.approx(one.inertia_scale * max(changes), rel=1e-4)
        assert one.error == pytest.approx(
            max(r / one.inertia_scale * step_error(one.channel(), r) for r in ratios), rel=1e-9
        )


@pytest.mark.parametrize("synchronised", [False, True])
def test_noise_and_error_of_a_simulated_robot(synchronised):
    """The law of the package on a mass, whose M⁻¹X takes the ends of the spread, an encoder with noise, a step."""
    trials = enumerate_candidates(
        PERIOD, natural_frequencies=[20.0], windows=[8], degrees=[2], synchronised=[synchronised]
    )
    one = assess_candidates(trials, RobustnessSpec.from_spread(4.0))[1]
    still = signals.Sinusoid(amplitude=[0.0], frequency=1.0, offset=[0.0])
    noises, changes, errors = [], [], []
    for ratio in (1.0, 2.0, 4.0):
        mass = plants.MassSpringDamper(masses=(1 / ratio,), springs=(0.0,), dampers=(0.0,))
        sensor = signals.Encoder(noise=1e-5)
        run = tarc.simulate(mass, tdc_of_candidate(one), still, 25.0, sensor=sensor, seed=3, progress=False)
        noises.append(np.std(run.data["torque"].values[1000:]) / 1e-5)
        changes.append(np.std(np.diff(run.data["torque"].values[1000:], axis=0)) / 1e-5)
        step = signals.StepDisturbance(amplitude=[0.1], start_time=0.0)
        run = tarc.simulate(mass, tdc_of_candidate(one), still, 10.0, disturbance=step, progress=False)
        errors.append(np.sqrt(PERIOD * np.sum((run.data["position"].values / 0.1) ** 2)))
    assert max(noises) == pytest.approx(one.noise, rel=0.05)
    assert max(changes) == pytest.approx(one.change, rel=0.05)
    assert max(errors) == pytest.approx(one.error, rel=0.01)


def test_front_is_not_dominated_and_dominates_the_rest():
    looked = assess_candidates(
        enumerate_candidates(PERIOD, windows=[4, 8, 15], degrees=[2]), RobustnessSpec.from_spread(4.0)
    )
    best = pareto_front(looked)
    assert len(best) > 5
    assert [one.change for one in best] == sorted(one.change for one in best)

    def beats(one, two):
        both = one.change <= two.change, one.error <= two.error
        return all(both) and (one.change < two.change or one.error < two.error)

    for one in best:
        assert one.feasible
        assert not any(beats(two, one) for two in looked if two.feasible)
    for two in looked:
        if two.feasible and two not in best:
            assert any(one.change <= two.change and one.error <= two.error for one in best)
    assert pareto_front([one for one in looked if not one.feasible]) == []


@pytest.mark.parametrize(("late", "delays"), [(0, {1}), (1, {1, 2}), (2, {1}), (3, {1, 2})])
def test_delays_of_literal_laws(late, delays):
    """With an odd computation delay one period leaves a torque that alternates undamped, and two do not."""
    trials = enumerate_candidates(PERIOD, windows=[5, 10, 20], natural_frequencies=[5.0, 10.0], computation_delay=late)
    assert {one.delay for one in trials if not one.synchronised} == delays
    assert {one.delay for one in trials if one.synchronised} == {1}
    literal = [
        one
        for one in assess_candidates(trials, RobustnessSpec.from_spread(1.4))
        if one.feasible and not one.synchronised
    ]
    assert {one.delay for one in literal} == {max(delays)}
    for one in literal[:3]:
        assert tdc_of_candidate(one).delay_periods == max(delays)
        assert tdc_of_candidate(one).actuation_delay == late


def test_candidates_are_all_combinations_that_make_a_law():
    trials = enumerate_candidates(2e-3, windows=[2, 3, 5], degrees=[2, 3])
    assert len(trials) == 2 * 5 * 13  # a window of two periods has no cubic
    assert max(one.natural_frequency for one in trials) == pytest.approx(
        65.0
    )  # half the rate, half the natural frequency
    assert all(one.period == 2e-3 and not one.feasible and np.isinf(one.noise) for one in trials)
    one = trials[0]
    assert one.estimator.window == pytest.approx(one.window * 2e-3)


@pytest.mark.slow
def test_more_is_asked_for_fewer_do():
    trials = enumerate_candidates(PERIOD, natural_frequencies=[10.0, 40.0], windows=[4, 8, 15, 25])
    steps = []

    def able(spread, **options):
        steps.clear()
        looked = assess_candidates(trials, RobustnessSpec.from_spread(spread), done=lambda: steps.append(1), **options)
        assert len(steps) == len(trials)
        return {(o.window, o.degree, o.synchronised, o.natural_frequency) for o in looked if o.feasible}

    some, wider, roomier, steeper = able(4.0), able(12.0), able(4.0, min_margin=1.5), able(4.0, slope_ratio=3.0)
    for fewer in (wider, roomier, steeper):
        assert fewer < some
    assert not able(200.0)
    closely = assess_candidates(trials[:30], RobustnessSpec.from_spread(4.0), exhaustive=True)
    few = assess_candidates(trials[:30], RobustnessSpec.from_spread(4.0))
    assert {one.inertia_scale for one in few} < {one.inertia_scale for one in closely}


def test_a_spread_of_nothing_and_gains_that_make_no_law():
    trials = enumerate_candidates(PERIOD, natural_frequencies=[10.0], windows=[5], degrees=[2])
    single = assess_candidates(trials, RobustnessSpec.from_spread(1.0))
    assert any(one.feasible for one in single)
    for one in single:
        if one.feasible:
            assert certify_varying_ratio(
                tdc_of_candidate(one), ratio_range=(one.inertia_scale, one.inertia_scale)
            ).certified
    with pytest.raises(TarcError, match="damping_ratio"):
        enumerate_candidates(PERIOD, natural_frequencies=[10.0], windows=[5], damping_ratio=-1.0)


def test_demand():
    plain = RobustnessSpec.from_spread(4.0)
    np.testing.assert_allclose(plain.radius_ratios, [0.6])
    np.testing.assert_array_equal(plain.stiffness_weights, [0.0])
    E = np.array([np.eye(2), 4.0 * np.eye(2), np.diag([1.0, 4.0])])
    none = RobustnessSpec.from_samples(4.0, UncertaintySamples(E, 0 * E, 0 * E))
    np.testing.assert_array_equal(none.radius_ratios, plain.radius_ratios)
    H = np.array([10.0 * np.eye(2), 0 * np.eye(2), 0 * np.eye(2)])
    some = RobustnessSpec.from_samples(4.0, UncertaintySamples(E, H, 0 * E))
    # the first posture alone: [1 − 2.5, 10/η] over 2.5
    expected = np.hypot(1.5, 10.0 / some.stiffness_weights) / 2.5
    np.testing.assert_allclose(some.radius_ratios, np.maximum(expected, 0.6))
    for wrong in (0.5, np.nan, np.inf):
        with pytest.raises(TarcError, match="spread"):
            RobustnessSpec.from_spread(wrong)
    with pytest.raises(TarcError, match="period"):
        enumerate_candidates(0.0)
