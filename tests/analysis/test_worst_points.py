"""The search for the worst operating points finds those that samples and local search from the best of them missed."""

import numpy as np
import pytest

import tarc
from slow_cases import slow
from tarc.analysis import Workspace, best_inertia_shape, inertia_spread
from tarc.analysis.operating_points import OperatingPoint
from tarc.analysis.point_functions import UncertaintyNorm
from tarc.analysis.worst_points import SampledPoints

MISSED = np.array([0.3941, -4.7125, 3.1416, 1.5702, 3.1432, 2.0162])
"""A posture of the UR5e without load that needs a larger radius than a certificate with 5 kg allowed."""


def arm(name: str, payload: float):
    return [tarc.plants.load_robot(name, armature=0.1, payload=mass) for mass in (0.0, payload)]


@pytest.mark.parametrize("speed", [None, slow(1.0)])
def test_a_posture_of_the_ur5e_that_was_missed(speed):
    plants = arm("ur5e", 5.0)
    space = Workspace.from_joint_limits(plants[0], speed=speed)
    shape, _ = best_inertia_shape(plants, space, samples=100)
    nominal = 0.0192 * shape
    spread = inertia_spread(plants, nominal, space, samples=200)
    norm = UncertaintyNorm(nominal, 0.469, 900.0, 0.05)
    sampled = SampledPoints.from_robot(plants, spread, nominal, space, 100, 0)
    missed = norm.values([OperatingPoint.at_rest(plants[0], MISSED)])[0]
    found = sampled.search_globally(norm)
    assert norm.values(found.points).max() > missed * (1 - 1e-3)


def test_each_point_found_is_added_with_every_plant():
    lone = tarc.plants.TwoLinkArm()
    plants = [lone, lone.with_parameters({"payload": 2.0})]
    space, nominal = Workspace.from_joint_limits(lone, speed=1.0), 0.1 * np.eye(2)
    spread = inertia_spread(plants, nominal, space, samples=50)
    sampled = SampledPoints.from_robot(plants, spread, nominal, space, 50, 0)
    added = sampled.add_stiffest(0.05).points[len(sampled.points) :]
    assert added
    for first, second in zip(added[::2], added[1::2], strict=True):
        assert (first.plant, second.plant) == tuple(plants)
        assert np.array_equal(first.position, second.position)
