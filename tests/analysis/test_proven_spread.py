"""Proven ranges of inertia ratios against dense grids, and where there is no proof."""

import numpy as np
import pytest

import tarc
from tarc.analysis import Workspace, prove_inertia_spread
from tarc.analysis.workspace_boxes import workspace_boxes
from tarc.numerics.eigenvalue_proof import prove_below
from tarc.numerics.trig_polynomial import TrigPolynomial
from tarc.plants import MassSpringDamper, NLinkArm, TwoLinkArm


def grid_ratios(plants, nominal, workspace, count):
    axes = [np.linspace(low, high, count) for low, high in zip(workspace.low, workspace.high, strict=True)]
    postures = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    values = [np.linalg.eigvals(np.linalg.solve(p.inertia(q), nominal)).real for p in plants for q in postures]
    return np.min(values), np.max(values)


@pytest.mark.parametrize(
    ("plants", "count"),
    [
        ([TwoLinkArm(), TwoLinkArm(payload=2.0)], 41),
        ([NLinkArm()], 13),
        ([NLinkArm(masses=(3.0, 1.0, 0.5), payload=1.0)], 13),
    ],
)
def test_the_proven_range_contains_all_and_little_more(plants, count):
    n = plants[0].n_joints
    workspace = Workspace.box(np.full(n, -2.0), np.full(n, 2.5))
    nominal = np.diag(np.arange(n, 0, -1.0))
    proven = prove_inertia_spread(plants, nominal, workspace, tolerance=0.01, samples=300, progress=False)
    low, high = grid_ratios(plants, nominal, workspace, count)
    assert proven.complete
    assert proven.min_ratio < low < 1.05 * proven.min_ratio
    assert proven.max_ratio / 1.05 < high < proven.max_ratio


def test_what_the_search_missed_is_met_by_the_proof():
    """One sample in the middle and no search: the range that it gives is far too small."""
    arm, workspace = TwoLinkArm(), Workspace.box([-3.0, -3.0], [3.0, 3.0])
    low, high = grid_ratios([arm], np.eye(2), workspace, 41)
    for seed in range(3):
        proven = prove_inertia_spread(arm, np.eye(2), workspace, samples=1, seed=seed, progress=False)
        assert proven.complete
        assert proven.min_ratio < low
        assert high < proven.max_ratio


def test_boxes_contain_the_tube_about_a_reference_and_one_turn_of_each_angle():
    reference = tarc.signals.Sinusoid(amplitude=[0.6, 0.9], frequency=1.3)
    workspace = Workspace.from_reference(reference, 3.0, tube=[0.05, 0.0])
    centres, halves = workspace_boxes(workspace)
    assert len(centres) > 10
    for posture in workspace.sample(300, 2):
        assert np.any(np.all(np.abs(posture - centres) <= halves, axis=1))
    assert halves.max() < 0.1
    turns = workspace_boxes(Workspace.box([-7.0, 0.0], [7.0, 1.0]))
    assert turns[1].tolist() == [[np.pi, 0.5]]


def test_two_links_in_closed_form():
    """Unit masses and lengths: the eigenvalues of M are 2 + c ± √((2 + c)² − 2 + c²), c = cos q2; the ends at c = 1."""
    proven = prove_inertia_spread(
        TwoLinkArm(), np.eye(2), Workspace.from_joint_limits(TwoLinkArm()), tolerance=1e-4, progress=False
    )
    assert proven.complete
    assert proven.min_ratio == pytest.approx(1 / (3 + 8**0.5), rel=2e-4)
    assert proven.max_ratio == pytest.approx(1 / (3 - 8**0.5), rel=2e-4)
    assert proven.min_ratio < 1 / (3 + 8**0.5) < 1 / (3 - 8**0.5) < proven.max_ratio


def test_no_payload_between_and_no_posture_is_left_out():
    arm, rng = NLinkArm(), np.random.default_rng(4)
    nominal, workspace = np.diag([3.0, 2.0, 1.0]), Workspace.box(np.full(3, -7.0), np.full(3, 7.0))
    plants = [arm, arm.with_parameters({"payload": 2.0})]
    proven = prove_inertia_spread(plants, nominal, workspace, samples=200, progress=False)
    assert proven.complete
    for payload in rng.uniform(0, 2, 8):
        between = arm.with_parameters({"payload": payload})
        for q in rng.uniform(-7, 7, (100, 3)):
            ratios = np.linalg.eigvals(np.linalg.solve(between.inertia(q), nominal)).real
            assert proven.min_ratio <= ratios.min() <= ratios.max() <= proven.max_ratio


def test_time_that_ends_leaves_a_share():
    arm = tarc.plants.load_robot("ur5e", armature=0.1)
    nominal = 0.5 * arm.mean_inertia(arm.home[:, None])
    workspace = Workspace.box(np.full(6, -3.0), np.full(6, 3.0))
    proven = prove_inertia_spread(arm, nominal, workspace, time_limit=0.2, samples=50, progress=False)
    assert not proven.complete
    assert 0 <= proven.share < 1


def test_a_posture_and_a_robot_of_constant_inertia_are_proven_at_once():
    masses = MassSpringDamper()
    nominal = np.eye(masses.n_joints)
    workspace = Workspace.box(np.zeros(masses.n_joints), np.ones(masses.n_joints))
    assert prove_inertia_spread(masses, nominal, workspace, progress=False).complete
    posture = Workspace.box([0.3, 0.4], [0.3, 0.4])
    assert prove_inertia_spread(TwoLinkArm(), np.eye(2), posture, progress=False).n_boxes == 2


def test_the_tube_about_a_reference_is_covered():
    arm = TwoLinkArm()
    reference = tarc.signals.Sinusoid(amplitude=[0.6, 0.9], frequency=1.0)
    workspace = Workspace.from_reference(reference, 3.0, tube=0.05)
    proven = prove_inertia_spread(arm, np.eye(2), workspace, tolerance=0.01, progress=False)
    values = [np.linalg.eigvals(np.linalg.inv(arm.inertia(q))).real for q in workspace.sample(2000, 5)]
    assert proven.complete
    assert proven.min_ratio < np.min(values) < 1.05 * proven.min_ratio
    assert proven.max_ratio / 1.05 < np.max(values) < proven.max_ratio


def test_polynomials_and_their_derivatives_are_those_of_the_function():
    rng = np.random.default_rng(0)
    A, B, C = (part + part.T for part in rng.standard_normal((3, 2, 2)))

    def function(q):
        x, y = q.T[:, :, None, None]
        return A + B * np.cos(2 * x - y) + C * np.sin(x) * np.cos(2 * y)

    q = rng.uniform(-3, 3, (20, 2))
    polynomial = TrigPolynomial.from_samples(function, 2)
    assert polynomial(q) == pytest.approx(function(q), abs=1e-12)
    step = 1e-5 * np.array([0.0, 1.0])
    slope = (function(q + step) - function(q - step)) / 2e-5
    assert polynomial.derivative(1)(q) == pytest.approx(slope, abs=1e-8)
    assert np.linalg.norm(function(q), 2, axis=(1, 2)).max() <= polynomial.sup_norm()


@pytest.mark.parametrize("excess", [1e-3, -1e-3])
def test_a_bound_is_proven_exactly_where_it_holds(excess):
    """The largest eigenvalue of diag(cos(x) + sin(2y), −3) is 2."""
    polynomial = TrigPolynomial.from_samples(
        lambda q: np.array([np.diag([np.cos(x) + np.sin(2 * y), -3.0]) for x, y in q]), 2
    )
    proof = prove_below([polynomial], [2 + excess], (np.zeros((1, 2)), np.full((1, 2), np.pi)))
    assert proof.complete is (excess > 0)
    assert (proof.counterexample is None) is (excess > 0)
