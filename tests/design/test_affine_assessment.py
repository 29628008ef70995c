"""Loops that the affine certificate adds to those of the balls."""

from dataclasses import replace

import numpy as np
import pytest

from tarc import plants
from tarc.analysis.inertia_rate import max_rate_point
from tarc.analysis.worst_points import SampledPoints
from tarc.certificates.affine_cover import robot_ratios
from tarc.certificates.robot_evidence import MaxRatePoint
from tarc.design.affine_assessment import LOWER_SLOPE, AffineAssessment, scaled_ratios
from tarc.design.candidates import Candidate, enumerate_candidates
from tarc.design.problem import DesignProblem
from tarc.design.requirements import DesignRequirements
from tarc.design.robustness import RobustnessSpec
from tarc.design.selection import LoopSelection
from tarc.design.synthesis import _inertia_shape

PERIOD = 1e-3


@pytest.fixture(scope="module")
def problem():
    arm = plants.TwoLinkArm()
    given = DesignRequirements(payload=(0.0, 1.0), torque_limits=[100.0, 50.0], samples=60, speed=1.0)
    return DesignProblem.from_plant(arm, given)


@pytest.fixture(scope="module")
def robot(problem):
    shape, spread = _inertia_shape(problem)
    spec = RobustnessSpec.from_robot(problem.plants, problem.workspace, shape, spread)
    return shape, spread, spec


@pytest.fixture(scope="module")
def affine(problem, robot):
    return AffineAssessment.from_robot(problem, *robot)


def loop(natural_frequency, window=6):
    options = {"degrees": [3], "synchronised": [True], "windows": [window]}
    return enumerate_candidates(PERIOD, natural_frequencies=[natural_frequency], **options)


def test_bounds_of_another_scale_are_those_of_the_scaled_inertia(problem, robot, affine):
    shape, spread, _ = robot
    scale, plants_, workspace = 0.3, problem.plants, problem.workspace
    scaled = replace(spread, min_ratio=scale, max_ratio=scale * spread.ratio)
    sampled = SampledPoints.from_robot(plants_, scaled, scale * shape, workspace, spread.samples, 0)
    points = tuple(
        MaxRatePoint.from_point(max_rate_point(plants_, nominal, workspace, spread.samples, 0), workspace)
        for nominal in (scale * shape, None)
    )
    direct, *_ = robot_ratios(scaled, sampled, points, PERIOD)
    found = scaled_ratios(affine.ratios, scale)
    for name in ("min_ratio", "max_ratio", "rate", "relative_rate"):
        assert getattr(found, name) == pytest.approx(getattr(direct, name), rel=1e-3)
    np.testing.assert_allclose(found.stiffness, direct.stiffness, rtol=1e-3)
    np.testing.assert_allclose(found.lead_times, direct.lead_times, rtol=1e-3)


def test_decay_rate_is_that_of_the_slowest_constant(affine):
    channel = loop(20.0)[0].channel()
    A, B, C = channel.closed_loop(0.0)[:3]
    bare = AffineAssessment(affine.ratios.without_norms(), affine.spec, 0.0)
    ratios = scaled_ratios(bare.ratios, 0.2)
    radii = [
        np.abs(np.linalg.eigvals(channel.state_matrix(ratio))).max()
        for ratio in np.geomspace(ratios.min_ratio, ratios.max_ratio, 4)
    ]
    assert bare.decay_rate((A, B, C), 0.2) == pytest.approx(-np.log(max(radii)) / PERIOD)
    assert affine.decay_rate((A, B, C), 0.2) <= bare.decay_rate((A, B, C), 0.2)


def test_a_loop_is_proven_where_it_decays_and_is_not_where_it_is_slow(affine):
    fast = affine.candidates(loop(20.0))
    assert fast
    assert all(candidate.is_affine and candidate.feasible for candidate in fast)
    assert affine.proof(fast[0])
    slow = replace(fast[0], inertia_scale=fast[0].inertia_scale / 20)
    assert affine.proof(slow) is None


def test_only_what_costs_less_than_the_loops_of_the_balls_is_added(problem, robot, affine):
    shape, _, spec = robot
    steps = []
    none = LoopSelection(problem, shape, spec, [])
    found = affine.best(loop(20.0), none, lambda: steps.append(1))
    assert len(found) == len(steps) == 1
    (best,) = found
    cheaper = replace(best, error=best.error / 2, is_affine=False)
    assert not affine.best(loop(20.0), replace(none, candidates=[cheaper]), lambda: None)


def test_a_quarter_of_the_slope_is_tried_where_the_largest_has_no_proof(problem, robot, affine, monkeypatch):
    shape, _, spec = robot
    largest = 20.0**2
    tried = []

    def proof(self, candidate):
        tried.append(candidate.robust_slope)
        return "a proof" if candidate.robust_slope < largest else None

    monkeypatch.setattr(AffineAssessment, "proof", proof)
    (found,) = affine.best(loop(20.0), LoopSelection(problem, shape, spec, []), lambda: None)
    assert tried == [largest, LOWER_SLOPE * largest]
    assert found.robust_slope == LOWER_SLOPE * largest
    # its neighbours have the same share
    again = LoopSelection(problem, shape, spec, [replace(found, error=2 * found.error)])
    affine.best(loop(20.0), again, lambda: None)
    assert tried[2:] == [LOWER_SLOPE * largest]


def test_the_loop_does_not_depend_on_its_assessment():
    bare = loop(20.0)[0]
    assessed: Candidate = replace(bare, noise=1.0, error=2.0, inertia_scale=0.1, required_spread=3.0, is_affine=True)
    assert bare.channel() is assessed.channel()
