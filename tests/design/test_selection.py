"""What is chosen of the loops on the front, and that the search for it is not blind beside."""

from importlib import import_module

import numpy as np
import pytest

from slow_cases import slow
from tarc import plants
from tarc.core.errors import InfeasibleDesign, InvalidParameter
from tarc.design import design_controller, try_design
from tarc.design.requirements import DEFAULT_NOISE_BUDGET
from tarc.design.selection import MAX_BUDGET_FACTOR

ARM = plants.TwoLinkArm()
LIMITS = np.array([100.0, 50.0])


def design_arm(**options):
    return design_controller(ARM, payload=(0.0, 1.0), torque_limits=LIMITS, samples=100, progress=False, **options)


def noise_levels(found):
    """RMS torque change over the limit of each loop on the front, where it is greatest, and of the one chosen."""
    sigma = found.sensor.step_size / 12**0.5
    share = np.max(np.linalg.norm(found.shape * sigma, axis=1) / LIMITS)
    return np.array([one.change for one in found.front]) * share, found.candidate.change * share


@pytest.fixture(scope="module", params=["few candidates", slow("all candidates")])
def speed(request):
    """Return the speed of the usual design; all designs of a module have the same candidates."""
    with pytest.MonkeyPatch.context() as patch:
        if request.param == "all candidates":
            yield 1.0
        else:
            patch.setattr(import_module("tarc.design.candidates"), "WINDOWS", (8, 16))
            patch.setattr(import_module("tarc.design.candidates"), "NATURAL_FREQUENCIES", (4.0, 8.0))
            yield np.inf


@pytest.fixture(scope="module")
def default_design(speed):
    return design_arm(speed=speed)


@pytest.fixture(scope="module")
def slower_design(speed):
    return design_arm(speed=0.2)


def test_noise_beyond_the_budget_is_traded_against_error(speed, default_design):
    noise, level = noise_levels(default_design)
    free = max(DEFAULT_NOISE_BUDGET, noise.min())
    assert level <= MAX_BUDGET_FACTOR * free
    assert level == pytest.approx(np.max(default_design.torque_change / LIMITS))
    worth = np.maximum(noise, free) ** 2 * [one.error for one in default_design.front]
    # at any rate the certificate needs more than the least margin of the front
    is_wide = [one.spread_margin >= (0.2 if np.isinf(speed) else 0.1) for one in default_design.front]
    is_quiet = noise <= MAX_BUDGET_FACTOR * free
    chosen = max(level, free) ** 2 * default_design.candidate.error
    assert worth[is_quiet].min() <= (1 + 1e-9) * chosen <= (1 + 2e-9) * worth[is_quiet & is_wide].min()


def test_a_budget_that_is_given_is_kept_and_used(speed, default_design):
    _, level = noise_levels(default_design)
    for share in (0.5, 3.0):
        given = design_arm(speed=speed, noise_budget=share * level)
        noise, now = noise_levels(given)
        assert now <= share * level
        quiet = [one for one, size in zip(given.front, noise, strict=True) if size <= share * level]
        # at any rate the certificate needs more than the least margin of the front
        wide = [one.error for one in quiet if one.spread_margin >= (0.2 if np.isinf(speed) else 0.1)]
        assert min(one.error for one in quiet) <= given.candidate.error <= min(wide)
        assert given.certificates["robot"].certified
        assert (given.candidate.error < default_design.candidate.error) == (share > 1)


def test_a_slower_robot_has_no_worse_a_loop(default_design, slower_design):
    assert slower_design.candidate.error <= 1.1 * default_design.candidate.error
    rates = [made.certificates["robot"].evidence.rate or np.inf for made in (slower_design, default_design)]
    assert rates[0] < rates[1]


def test_the_region_of_a_bounded_speed_is_drawn(slower_design, tmp_path):
    figure = slower_design.plot("reach")
    drawn = [axes.get_title() for axes in figure.axes]
    assert drawn[:2] == ["literal", "synchronised"]
    points = sum(len(one.get_offsets()) for axes in figure.axes[:2] for one in axes.collections)
    assert points == sum(one.feasible for one in slower_design.candidates)
    assert "% of its limit" in figure.axes[2].get_ylabel()
    figure.savefig(tmp_path / "reach.png")


@pytest.fixture
def design_with_rate(monkeypatch):
    """Design the arm without payload from few candidates, with a limit of the torque's rate."""
    monkeypatch.setattr(import_module("tarc.design.candidates"), "WINDOWS", (8, 16))
    monkeypatch.setattr(import_module("tarc.design.candidates"), "NATURAL_FREQUENCIES", (4.0, 8.0))
    return lambda rate: design_controller(ARM, torque_limits=LIMITS, samples=50, progress=False, torque_rate=rate)


@pytest.mark.slow
def test_a_limit_of_the_torque_rate_is_kept_by_the_trial_run(design_with_rate):
    usual = design_with_rate(np.inf)
    limit = 0.5 * try_design(usual).torque_rate
    slow = design_with_rate(limit)
    reached = try_design(slow).torque_rate
    assert np.all(reached <= limit)
    assert slow.candidate.change < usual.candidate.change
    label, value = slow.choices[-1].label, slow.choices[-1].value
    assert (label, value.split(" N m/s")[0]) == ("torque rate", f"at most {reached.max():.4g}")
    np.testing.assert_allclose(slow.scenario().torque_limits["rate"], limit, rtol=1e-6)


@pytest.mark.slow
def test_a_torque_rate_that_no_loop_keeps_is_refused_with_one_that_admits_a_design(design_with_rate):
    with pytest.raises(InfeasibleDesign, match=r"torque_rate: the slowest of the loops tried reached") as info:
        design_with_rate(0.3)
    assert [one.requirement for one in info.value.relaxations] == ["torque_rate", "sensor"]
    needed = info.value.relaxations[0].value
    assert np.all(try_design(design_with_rate(needed)).torque_rate <= needed)


@pytest.mark.parametrize("rate", [0.0, [1.0, 2.0, 3.0], [np.nan, 1.0]])
def test_a_torque_rate_that_is_none_is_refused(rate):
    with pytest.raises(InvalidParameter, match="torque_rate: got .*; needs one number above 0, or 2 of them"):
        design_arm(torque_rate=rate)
