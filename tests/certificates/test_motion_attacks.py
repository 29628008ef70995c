"""No motion breaks what the robot certificate certifies, and the attacks break what is unstable."""

import numpy as np
import pytest
from scipy.linalg import expm

from reference.motion_attacks import PERIODS, Motion, MotionAttacker
from tarc.analysis import Workspace
from tarc.analysis.linearise import decoupled_channels
from tarc.certificates.robot import certify_robot
from tarc.estimators import Algebraic
from tarc.laws import TDC
from tarc.plants import TwoLinkArm

PERIOD = 1e-3


def law(inertia, natural_frequency, **options):
    return TDC(
        inertia=inertia,
        natural_frequency=natural_frequency,
        period=PERIOD,
        estimator=Algebraic(window=0.006, degree=2),
        **options,
    )


def attacker(law, plants, workspace):
    return MotionAttacker(decoupled_channels(law)[0], law.M, plants, workspace)


@pytest.fixture(scope="module")
def two_link():
    plant = TwoLinkArm(masses=(2.0, 1.0), inertias=(0.1, 0.1), viscous=(0.0, 0.0))
    workspace = Workspace(low=np.full(2, -2.0), high=np.full(2, 2.0)).with_speed_limits(2.0)
    return plant, 0.2 * plant.mean_inertia(workspace.sample(100).T), workspace


def test_growth_at_rest_is_that_of_the_eigenvalues(two_link):
    plant, inertia, workspace = two_link
    posture = np.array([0.3, 1.0])
    for scale in (1.0, 3.0):
        design = law(scale * inertia, 10.0)
        attack = attacker(design, [plant], workspace)
        resting = Motion(0, PERIODS[0], posture, np.zeros(2), np.ones(2), np.zeros(2))
        found = attack.growth([resting], np.random.default_rng(0))[0]
        channel, n = attack.channel, 2
        M, D, G = plant.linearised(posture)
        root = np.kron(np.eye(len(channel.F)), np.eye(n))
        # one period of M q̈ = M̂ v − D q̇ − G q with v held, by the matrix exponential
        A = np.zeros((3 * n, 3 * n))
        A[:n, n : 2 * n] = np.eye(n)
        A[n : 2 * n] = np.linalg.solve(M, np.hstack([-G, -D, scale * inertia]))
        held = expm(A * PERIOD)[: 2 * n]
        K = np.hstack([np.kron(channel.D, np.eye(n)), np.zeros((n, n)), np.kron(channel.C, np.eye(n))])
        closed = np.vstack(
            [
                held[:, : 2 * n] @ np.eye(2 * n, 2 * n + len(root)) + held[:, 2 * n :] @ K,
                np.hstack([np.kron(channel.G, np.eye(n)), np.zeros((len(root), n)), np.kron(channel.F, np.eye(n))]),
            ]
        )
        exact = np.log(np.max(np.abs(np.linalg.eigvals(closed)))) / PERIOD
        assert found == pytest.approx(exact, rel=0.05, abs=0.5)


def test_no_motion_breaks_a_certified_two_link_arm(two_link):
    plant, inertia, workspace = two_link
    design = law(inertia, 15.0)
    assert certify_robot(design, plant, workspace, samples=300).certified
    assert attacker(design, [plant], workspace).attack(96).broken == 0


def test_motions_break_an_unstable_arm(two_link):
    plant, inertia, workspace = two_link
    found = attacker(law(2 * inertia, 10.0), [plant], workspace).attack(64, until_broken=True)
    assert found.broken > 0
