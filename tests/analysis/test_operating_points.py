"""Derivatives that the searches over postures follow, against differences."""

import numpy as np
import pytest

import tarc
from tarc.analysis import Workspace
from tarc.analysis.inertia_ratio import extreme_ratio_functions
from tarc.analysis.operating_points import OperatingPoint, linearise_point, linearise_points
from tarc.analysis.worst_points import InertiaRate, UncertaintyNorm
from tarc.plants.base import Plant
from tarc.signals.references import Sinusoid

ROBOTS = {
    "two_link": tarc.plants.TwoLinkArm(),
    "wheeled": tarc.plants.WheeledMobileRobot(),
    "ur5e": tarc.plants.load_robot("ur5e"),
    "panda": tarc.plants.load_robot("panda", viscous=0.5, coulomb=0.3),
}


def differences(function, point, step=1e-5):
    """Return central differences over each number of a point, the point's number first."""
    steps = step * np.eye(len(point))
    return np.array([(function(point + d) - function(point - d)) / (2 * step) for d in steps])


@pytest.fixture(params=ROBOTS)
def robot(request):
    return ROBOTS[request.param]


@pytest.fixture
def motion(robot):
    rng = np.random.default_rng(5)
    return rng.uniform(-1, 1, (3, robot.n_joints))


@pytest.fixture
def nominal(robot):
    rng = np.random.default_rng(6)
    root = np.eye(robot.n_joints) + 0.1 * rng.standard_normal((robot.n_joints, robot.n_joints))
    return root @ root.T


def close(found, expected):
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max() + 1e-12)


def test_the_inertia_over_each_joint(robot, motion):
    close(robot.inertia_slopes(motion[0]), differences(robot.inertia, motion[0]))


def test_weighted_derivatives_are_those_of_the_weighted_sum(robot, motion):
    rng = np.random.default_rng(7)
    n = robot.n_joints
    weight, tangent_weight, direction = rng.standard_normal((n, n)), rng.standard_normal((n, 3 * n)), motion[1]
    q, v, a = motion
    close(robot.inertia_gradient(q, weight), differences(lambda q: np.sum(weight * robot.inertia(q)), q))

    def rate(q):
        return np.sum(weight * np.tensordot(direction, robot.inertia_slopes(q), 1))

    close(robot.inertia_rate_gradient(q, direction, weight), differences(rate, q))
    for state in ((), (v, a)):

        def tangent(q, state=state):
            return np.sum(tangent_weight * np.hstack(robot.linearised(q, *state)))

        close(robot.tangent_gradient(q, tangent_weight, *state), differences(tangent, q))


def test_the_tangent_at_rest_is_the_limit_of_slow_motion(robot, motion):
    slow = robot.linearised(motion[0], 1e-9 * motion[1], 1e-9 * motion[2])
    for at_rest, moving in zip(robot.linearised(motion[0]), slow, strict=True):
        np.testing.assert_allclose(at_rest, moving, atol=1e-6)


def test_plants_without_derivatives_use_differences(robot, motion):
    rng = np.random.default_rng(8)
    n = robot.n_joints
    weight, tangent_weight = rng.standard_normal((n, n)), rng.standard_normal((n, 3 * n))
    q, v, a = motion
    for exact, approximate in (
        (robot.inertia_slopes(q), Plant.inertia_slopes(robot, q)),
        (robot.inertia_gradient(q, weight), Plant.inertia_gradient(robot, q, weight)),
        (robot.inertia_rate_gradient(q, v, weight), Plant.inertia_rate_gradient(robot, q, v, weight)),
        (robot.tangent_gradient(q, tangent_weight, v, a), Plant.tangent_gradient(robot, q, tangent_weight, v, a)),
    ):
        close(exact, approximate)


@pytest.mark.parametrize("is_moving", [False, True])
@pytest.mark.parametrize(("centre", "lead_time"), [(None, 0.0), (None, 0.1), (0.4, 0.0), (0.4, 0.1)])
def test_the_norm_of_the_uncertainty_over_the_posture(robot, motion, nominal, centre, lead_time, is_moving):
    norm = UncertaintyNorm(nominal, centre, 30.0, lead_time)
    q, v, a = motion
    point = OperatingPoint(robot, q, v, a) if is_moving else OperatingPoint.at_rest(robot, q)
    value, gradient = norm.value_and_gradient(point)
    assert value == pytest.approx(norm.values([point])[0], rel=1e-9)
    close(gradient, differences(lambda q: norm.values([point._replace(position=q)])[0], q))


def test_the_rate_of_the_inertia_over_the_posture(robot, motion, nominal):
    function = InertiaRate(nominal, np.abs(motion[1]))
    point = OperatingPoint.at_rest(robot, motion[0])
    value, gradient = function.value_and_gradient(point)
    assert value == pytest.approx(function.values([point])[0], rel=1e-12)
    close(gradient, differences(lambda q: function.values([point._replace(position=q)])[0], motion[0]))


def test_the_rate_of_more_joints_than_corners_are_tried():
    arm = tarc.plants.NLinkArm(masses=[1.0] * 10, lengths=[0.3] * 10, centres=[0.15] * 10, inertias=[0.01] * 10)
    function = InertiaRate(np.eye(10), np.full(10, 0.5))
    point = OperatingPoint.at_rest(arm, np.linspace(0.1, 0.9, 10))
    value, gradient = function.value_and_gradient(point)
    assert value == pytest.approx(function.values([point])[0], rel=1e-12)
    close(gradient, differences(lambda q: function.values([point._replace(position=q)])[0], point.position))


def test_the_extreme_ratios_over_the_inertia(robot, motion, nominal):
    M = robot.inertia(motion[0])
    direction = np.random.default_rng(9).standard_normal(M.shape)
    direction = 0.01 * (direction + direction.T)
    for function in extreme_ratio_functions(nominal):
        change = differences(lambda t, function=function: function.values((M + t * direction)[None])[0], np.zeros(1))
        assert np.sum(function.gradient(M) * direction) == pytest.approx(change[0], rel=1e-5)


def test_postures_over_the_variables_of_a_workspace():
    reference = Sinusoid(amplitude=[0.3, 0.5], frequency=[1.0, 2.0])
    for workspace in (Workspace.box([-1, 0], [1, 3]), Workspace.from_reference(reference, 2.0, tube=0.1)):
        point = np.full(len(workspace.low), 0.3)
        found = workspace.unit_slopes(point)
        close(found, differences(lambda u, w=workspace: w.at_unit_points(u[None])[0], point).T)


@pytest.mark.parametrize("is_moving", [False, True])
def test_many_points_at_once(robot, is_moving):
    motions = np.random.default_rng(10).uniform(-1, 1, (40, 3, robot.n_joints))
    points = [OperatingPoint(robot, *motion) for motion in motions]
    if not is_moving:
        points = [OperatingPoint.at_rest(robot, point.position) for point in points]
    for found, expected in zip(linearise_points(points), zip(*map(linearise_point, points), strict=True), strict=True):
        np.testing.assert_allclose(found, np.array(expected), rtol=1e-12, atol=1e-9)
