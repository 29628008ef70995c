"""What the robot certificate states without a search: payloads between both ends, and the way from its centre."""

import numpy as np
import pytest

from tarc.analysis.inertia_rate import InertiaRate
from tarc.analysis.operating_points import OperatingPoint, UncertaintySamples, uncertainty_samples
from tarc.plants import TwoLinkArm, load_robot


def norms_at(plants, nominal, points, norm):
    """Return a norm of each plant at the same postures and motions, shape (plants, points)."""
    return np.array([norm.values([OperatingPoint(plant, *point) for point in points]) for plant in plants])


@pytest.mark.parametrize("robot", ["two_link", "ur5e"])
def test_both_ends_of_the_payload_stand_for_those_between(robot):
    """With δ ≤ ρ0 the points inside a ball are convex in the payload, and so are ratios, rates and torques."""
    shares = (0.0, 0.1, 0.3, 0.5, 0.8, 1.0)
    if robot == "two_link":
        plants = [TwoLinkArm(payload=3.0 * share) for share in shares]
    else:
        plants = [load_robot("ur5e", armature=0.1, payload=5.0 * share) for share in shares]
    n, rng = plants[0].n_joints, np.random.default_rng(3)
    nominal = 0.1 * plants[2].inertia(plants[0].home)
    points = [
        (rng.uniform(-3, 3, n), rng.uniform(-2, 2, n), rng.uniform(-5, 5, n)) for _ in range(40 if n == 2 else 15)
    ]
    samples = [uncertainty_samples(nominal, [OperatingPoint(plant, *point) for point in points]) for plant in plants]
    ratios = np.array([np.linalg.eigvalsh(sample.inertia) for sample in samples])
    ends = ratios[[0, -1]]
    assert np.all(ratios[:, :, 0] >= ends[:, :, 0].min(axis=0) * (1 - 1e-9))
    assert np.all(ratios[:, :, -1] <= ends[:, :, -1].max(axis=0) * (1 + 1e-9))
    for power in (0.5, 1.0):
        sizes = np.array([sample.force_norms(0.05, power) for sample in samples])
        assert np.all(sizes <= sizes[[0, -1]].max(axis=0) * (1 + 1e-9))
    rates = norms_at(plants, nominal, points, InertiaRate(nominal, np.full(n, 2.0)))
    assert np.all(rates <= rates[[0, -1]].max(axis=0) * (1 + 1e-9))
    n_inside = 0
    for centre in (0.05, 0.2, 0.6):
        for weight in (30.0, 300.0, 3000.0):
            for period in (0.0, 1e-3):
                norms = np.array(
                    [
                        sample.grown(0.05, period)
                        .joint_norms(centre, weight, 0.05)
                        .reshape(-1, len(points))
                        .max(axis=0)
                        for sample in samples
                    ]
                )
                needed = norms[[0, -1]].max(axis=0)
                inside = needed <= centre
                n_inside += inside.sum()
                assert np.all(norms[:, inside] <= needed[inside] * (1 + 1e-9))
    assert n_inside > 50


def test_the_way_from_the_centre_stays_in_the_ball():
    """E_τ⁻¹ = (1 − τ)/ρ0 + τ E⁻¹ and H_τ = F_τ H, with ‖F_τ‖ ≤ 1: the norms grow from zero to those of the robot."""
    rng, centre = np.random.default_rng(1), 0.7
    one = np.eye(3)
    for _ in range(50):
        root = rng.normal(size=(3, 3))
        E = root @ root.T * rng.uniform(0.05, 0.5) + 0.02 * one
        H, C = rng.normal(size=(2, 3, 3)) * 10
        whole = UncertaintySamples(E[None], H[None], C[None])
        previous = 0.0
        for way in (0.0, 0.2, 0.5, 0.9, 1.0):
            F = way * centre * np.linalg.inv((1 - way) * E + way * centre * one) if way else 0 * E
            part = np.linalg.inv((1 - way) / centre * one + way * np.linalg.inv(E))
            assert np.allclose(part - centre * one, F @ (E - centre * one), atol=1e-12)
            assert np.linalg.norm(F, 2) <= 1 + 1e-12
            sample = UncertaintySamples(part[None], (F @ H)[None], (F @ C)[None])
            for norm in (lambda s: s.joint_norms(centre, 40.0, 0.1)[0], lambda s: s.stiffness_norms(0.1)[0]):
                assert norm(sample) <= norm(whole) * (1 + 1e-12)
            size = sample.joint_norms(centre, 40.0, 0.1)[0]
            assert size >= previous * (1 - 1e-12)
            previous = size
