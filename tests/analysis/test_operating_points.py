"""Derivatives that the searches over postures follow, against differences."""

import numpy as np
import pytest
from scipy.linalg import expm

import tarc
from tarc.analysis import Workspace
from tarc.analysis.inertia_rate import InertiaRate
from tarc.analysis.inertia_ratio import extreme_ratio_functions
from tarc.analysis.operating_points import OperatingPoint, UncertaintySamples, linearise_point, linearise_points
from tarc.analysis.point_functions import UncertaintyNorm
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


def motion_within_a_period(E, H, C, start, period, steps=400):
    """Return x, ẋ and ẍ of ẍ = E v − H x − C ẋ over a period, (steps + 1, n) each, from x, ẋ and v."""
    n = len(E)
    zero, one = np.zeros((n, n)), np.eye(n)
    step = expm(np.block([[zero, one, zero], [-H, -C, E], [zero, zero, zero]]) * period / steps)
    states = [np.concatenate(start)]
    for _ in range(steps):
        states.append(step @ states[-1])
    path = np.array(states)
    return path[:, :n], path[:, n : 2 * n], path @ np.hstack([-H, -C, E]).T


def mean_square(values):
    return np.sqrt(np.trapezoid(np.sum(values**2, axis=1)) / (len(values) - 1))


def test_a_radius_with_a_period_bounds_the_acceleration_within_it():
    """|ẍ − ρ0 v| ≤ δ |(v, η x, η θ ẋ)| in the mean square over a period, x at its start and ẋ its mean."""
    rng, T, centre, weight, lead, shares = np.random.default_rng(5), 0.02, 0.8, 60.0, 0.1, []
    for _ in range(100):
        E = np.diag(rng.uniform(0.5, 1.0, 2))
        H, C = rng.normal(size=(2, 2)) * rng.uniform(0, 60), rng.normal(size=(2, 2)) * rng.uniform(0, 5)
        radius = UncertaintySamples(E[None], H[None], C[None]).grown(0.0, T).needed_radius(centre, weight, lead, T)
        x, speed, v = rng.normal(size=(3, 2)) * [[rng.uniform(0, 0.03)], [rng.uniform(0, 1)], [1.0]]
        positions, _, accelerations = motion_within_a_period(E, H, C, (x, speed, v), T)
        mean_speed = (positions[-1] - x) / T
        known = np.linalg.norm(np.concatenate([v, weight * x, weight * lead * mean_speed]))
        shares.append(mean_square(accelerations - centre * v) / (radius * known))
    assert 0.5 < max(shares) <= 1


def test_without_the_end_of_the_period_the_radius_is_too_small():
    """A spring of E = ρ0 that is moved towards its longer side."""
    T, lead, one = 0.02, 0.1, np.eye(1)
    found = UncertaintySamples(one[None], 50.0 * one[None], 0.0 * one[None])
    plain, radius = found.needed_radius(1.0, 50.0, lead), found.grown(0.0, T).needed_radius(1.0, 50.0, lead, T)
    assert plain == pytest.approx(1.0)
    assert radius > np.hypot(1.0, T / lead)
    positions, _, accelerations = motion_within_a_period(one, 50.0 * one, 0 * one, ([1.0], [1.5], [0.0]), T)
    known = np.hypot(50.0, 50.0 * lead * (positions[-1, 0] - 1.0) / T)
    assert plain * known < mean_square(accelerations) < radius * known
