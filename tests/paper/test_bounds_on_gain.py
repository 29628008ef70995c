"""The paper's bounds on the gain: each formula by hand, each constant against the run by another route."""

from itertools import groupby

import numpy as np
import pytest

import tarc
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.paper.gain_bounds import Constants, GainRise, evaluate_gain_bounds, paper_bounds
from tarc.simulation.run import Run

ARM = tarc.plants.TwoLinkArm()
REFERENCE = tarc.signals.Sinusoid(amplitude=[0.6, 0.6], frequency=[2.0, 2.5])


def make_tarc(**options):
    common = {
        "inertia": 0.05 * np.array([[3.0, 1.0], [1.0, 1.0]]),
        "natural_frequency": 10.0,
        "period": 1e-3,
        "estimator": tarc.estimators.Algebraic(window=0.010, degree=2),
        "boundary_layer": 0.01,
    }
    return tarc.laws.TARC(**{"rise_rate": 2e3, "fall_rate": 1e3, **common, **options})


def simulate_law(law, duration=3.0, **options):
    return tarc.simulate(ARM, law, REFERENCE, duration, **options)


LAW = make_tarc(delay=0.002, rise_rate=500.0)
RUN = simulate_law(LAW)


def test_formulas_by_hand():
    """Υ+c = 3, ‖ι1‖ = 1, λ−z = 1, Γ = 16: μ1 = 3, ϖ0 = 3 + √(16+9) = 8 and l(0) = 3·8 + 8 = 32."""
    law = make_tarc(rise_rate=4.0, gain_factor=2.0, boundary_layer=0.5)
    constants = Constants(
        tde_error=2.0,
        correction_jump=1.0,
        forcing=16.0,
        iota_norm=1.0,
        decay_rate=2.0,
        decay_share=0.5,
        max_eigenvalue=3.0,
    )
    outside = GainRise(min_sliding=2.0, longest_duration=0.1, functional_ratio=np.e, peak_gain=5.0)
    inside = GainRise(min_sliding=0.25, longest_duration=0.2, functional_ratio=np.e**2, peak_gain=6.0)
    bounds = dict(paper_bounds(law, constants, outside, inside, max_error=7.0).by_name())
    expected = {
        "error": 8.0,
        "rise time outside": 32 / (2 * 4 * 4),
        "fade time outside": 1.5,
        "gain outside": ((3 + 4 * 1.5) * 8 + 8) / (2 * 2),
        "rise time inside": 0.5 * 32 / (2 * 4 / 64),
        "fade time inside": 3.0,
        "gain inside": 0.5 * ((3 + 4 * 3.0) * 8 + 8) / (2 / 16),
        "gain": 512.0,
    }
    assert {name: bound.value for name, bound in bounds.items()} == pytest.approx(expected, rel=1e-12)
    assert [bounds[name].observed for name in ("error", "rise time outside", "rise time inside", "gain")] == [
        7.0,
        0.1,
        0.2,
        6.0,
    ]


def test_as_printed_there_is_no_bound():
    """λmin(Θ) is never positive."""
    found = evaluate_gain_bounds(RUN, LAW)
    values = [bound.value for _, bound in found.bounds.by_name()]
    assert not np.isfinite(values).any()
    text = str(found)
    for part in ("λmin(Θ), which is positive for no gains", "ĉ_M", "inf", "is read as ĉ' ≥ c̄ϖ"):
        assert part in text


def test_tde_error_is_what_the_law_did_not_ask_for():
    """Without noise û and Δu add up to the recorded u, and σ1 = (q̈ − q̈d) − (u − q̈d)_h."""
    data = RUN.data
    asked = (data["auxiliary"] - data["acceleration_reference"]).values
    got = (data["acceleration"] - data["acceleration_reference"]).values
    m = LAW.delay_periods
    known = np.linalg.norm(got[m:] - asked[:-m], axis=1).max()
    assert evaluate_gain_bounds(RUN, LAW).constants.tde_error == pytest.approx(known, rel=1e-9)


def test_jump_is_that_of_the_switching_term():
    data = RUN.data
    estimated = (data["velocity_estimate"] - data["velocity_reference"]).values
    error = (data["position"] - data["reference"]).values
    nominal = data["acceleration_reference"].values - estimated @ LAW.K2.T - error @ LAW.K1.T
    correction = data["auxiliary"].values - nominal
    known = np.linalg.norm(correction[2:] - correction[:-2], axis=1).max()
    assert evaluate_gain_bounds(RUN, LAW).constants.correction_jump == pytest.approx(known, rel=1e-6)


def test_forcing_is_the_largest_integral():
    """Γ with D/β = diag(d), by a sum over each stretch of two periods."""
    d = np.array([1.0, 2.0, 3.0, 4.0])
    found = evaluate_gain_bounds(RUN, LAW, delay_weight=d, decay_rate=1.0)
    data, m = RUN.data, 2
    rate = (data["velocity"] - data["velocity_reference"]).values
    estimated = (data["velocity_estimate"] - data["velocity_reference"]).values
    # σ = ë1 + K1 e1_h + K2 ė̂1_h + K2 ė1_h
    error = (data["position"] - data["reference"]).values
    got = (data["acceleration"] - data["acceleration_reference"]).values
    sigma = got[m:] + error[:-m] @ LAW.K1.T + (estimated[:-m] + rate[:-m]) @ LAW.K2.T
    power = sigma**2 @ d[2:]
    known = max(0.002 * 0.001 * power[k : k + m].sum() for k in range(len(power) - m + 1))
    assert found.constants.forcing == pytest.approx(known, rel=1e-9)
    assert not any("left out" in note for note in found.notes)
    assert found.bounds.error.value > evaluate_gain_bounds(RUN, LAW, decay_rate=1.0).bounds.error.value


def test_rises_are_those_of_the_run():
    found = evaluate_gain_bounds(RUN, LAW, decay_rate=1.0)
    rising, sliding = RUN.data["rising"].values[2:] > 0, RUN.data["sliding"].values[2:]
    far = sliding >= LAW.boundary_layer
    for side, rise in ((far, found.rise_outside), (~far, found.rise_inside)):
        stretches = [len(list(group)) for up, group in groupby(rising & side) if up]
        assert rise.longest_duration == pytest.approx(1e-3 * max(stretches))
        assert rise.min_sliding == sliding[rising & side].min()
        assert rise.peak_gain == RUN.data["gain"].values[2:][side].max()
    assert found.rise_outside.min_sliding >= LAW.boundary_layer > found.rise_inside.min_sliding


def test_bounds_hold_for_the_run_and_explode_where_s_passes_zero():
    found = evaluate_gain_bounds(RUN, LAW, decay_rate=1.0)
    outside, inside = found.bounds.outside, found.bounds.inside
    for bound in (outside.rise_time, inside.rise_time, outside.gain, inside.gain, found.bounds.gain):
        assert bound.observed <= bound.value < np.inf
    assert inside.gain.value > 1e6 * inside.gain.observed
    assert any("passes zero" in note for note in found.notes)


def test_a_run_that_never_leaves_the_layer():
    found = evaluate_gain_bounds(RUN, LAW, decay_rate=1.0, start_time=2.0)
    assert np.isnan(found.bounds.outside.gain.value)
    assert found.bounds.gain.value == found.bounds.inside.gain.value
    assert "outside the boundary layer the gain never rises" in str(found)
    assert "–" in str(found)


def test_a_saved_run(tmp_path):
    loaded = Run.load(RUN.save(tmp_path / "run.nc"))
    assert evaluate_gain_bounds(loaded, LAW).constants == evaluate_gain_bounds(RUN, LAW).constants


def test_a_gain_that_runs_away():
    """A delay of three periods and a fast rise: the gain grows until the run diverges, and is evaluated up to there."""
    law = make_tarc(delay=0.003)
    run = simulate_law(law)
    assert not run.status.completed
    found = evaluate_gain_bounds(run, law, decay_rate=1.0)
    assert found.bounds.gain.observed == run.data["gain"].values.max() > 1000


@pytest.mark.parametrize(
    ("call", "message", "error"),
    [
        (
            lambda: evaluate_gain_bounds(RUN, make_tarc(delay=0.002, rise_rate=1e3)),
            r"law: its rise_rate is 1000\.0, and that of the run's law 500",
            InvalidParameter,
        ),
        (lambda: evaluate_gain_bounds(RUN, make_tarc(rise_rate=500.0)), "law: its delay", InvalidParameter),
        (
            lambda: evaluate_gain_bounds(RUN, make_tarc(delay=0.002, rise_rate=500.0, lyapunov_weight=1.0)),
            "its P2 is not that of the run's law",
            InvalidParameter,
        ),
        (lambda: evaluate_gain_bounds(RUN, make_tarc(inertia=0.1)), "law: its n_joints is 1", InvalidParameter),
        (lambda: evaluate_gain_bounds(RUN, "TARC"), "law: got str", UnsupportedLaw),  # type: ignore[arg-type]
        (lambda: evaluate_gain_bounds(RUN, LAW, decay_rate=0.0), "decay_rate: got 0; .* above 0", InvalidParameter),
        (lambda: evaluate_gain_bounds(RUN, LAW, decay_share=1.0), "decay_share: got 1; z must lie", InvalidParameter),
        (
            lambda: evaluate_gain_bounds(RUN, LAW, delay_weight=-1.0),
            "delay_weight: its smallest eigenvalue",
            InvalidParameter,
        ),
        (
            lambda: evaluate_gain_bounds(RUN, LAW, start_time=5.0),
            "run: 0 samples of it can be used after 5 s",
            InvalidParameter,
        ),
    ],
)
def test_bad_input(call, message, error):
    with pytest.raises(error, match=message):
        call()
