"""The best shape of M̂: closed forms, real robots, and its lower bound against every other shape."""

import sys
import sysconfig
from pathlib import Path

import cvxpy as cp
import numpy as np
import pytest
from scipy.linalg import eigh

from tarc.analysis.inertia_ratio import inertia_spread
from tarc.analysis.inertia_shape import best_inertia_shape, lower_bound
from tarc.analysis.workspace import Workspace
from tarc.core.errors import NotConverged
from tarc.plants import MassSpringDamper, MujocoPlant, NLinkArm, TwoLinkArm, WheeledMobileRobot

ROBOTS = Path(sysconfig.get_path("purelib"), "cmeel.prefix", "share", "example-robot-data", "robots")
ARM = TwoLinkArm()


def test_best_shape_of_one_joint_is_the_ratio_of_its_masses():
    robots = [MassSpringDamper(masses=[m], springs=[0.0], dampers=[0.0]) for m in (2.0, 7.0)]
    X, t = best_inertia_shape(robots, Workspace.box([0.0], [1.0]))
    assert t == pytest.approx(3.5, rel=1e-6)
    np.testing.assert_allclose(X, [[7.0]], rtol=1e-6)


def test_best_diagonal_shape_in_closed_form():
    """Stretched out, M = [5 2; 2 1]: the best diagonal leaves [1 r; r 1], r = 2/√5, hence a ratio (1+r)/(1−r)."""
    X, t = best_inertia_shape(ARM, Workspace.from_joint_limits(ARM), diagonal=True, tolerance=0.001)
    assert np.count_nonzero(X) == 2
    assert t == pytest.approx((2 + np.sqrt(5)) ** 2, rel=1e-3)


def test_best_shape_of_two_matrices_is_their_own_ratio():
    """X ≽ M_2 and X ≼ t M_1 need t ≥ λmax(M_1⁻¹M_2), which X = M_2 has where M_2 ≽ M_1."""
    robots = [WheeledMobileRobot(mass=mass) for mass in (10.0, 40.0)]
    X, t = best_inertia_shape(robots, Workspace.from_joint_limits(robots[0]), tolerance=0.001)
    M = [robot.inertia([0, 0]) for robot in robots]
    assert t == pytest.approx(np.linalg.eigvals(np.linalg.solve(M[0], M[1])).real.max(), rel=2e-3)
    for one in M:
        ratios = np.linalg.eigvals(np.linalg.solve(one, X)).real
        assert 1 - 1e-9 <= ratios.min() <= ratios.max() <= t * (1 + 1e-9)


@pytest.mark.parametrize("diagonal", [False, True])
def test_best_shape_is_no_worse_than_any_near_it(diagonal):
    postures = Workspace.from_joint_limits(ARM)
    X, t = best_inertia_shape(ARM, postures, diagonal=diagonal, tolerance=0.002)
    found = inertia_spread(ARM, X, postures)
    assert (found.min_ratio, found.ratio) == pytest.approx((1.0, t), rel=1e-9)
    rng = np.random.default_rng(1)
    for _ in range(20):
        root = np.linalg.cholesky(X) @ (np.eye(2) + 0.05 * rng.normal(size=(2, 2)))
        other = root @ root.T
        assert inertia_spread(ARM, np.diag(np.diag(other)) if diagonal else other, postures, refine=2).ratio > t / 1.002


@pytest.mark.parametrize(("folder", "file", "known"), [("ur", "ur5_robot", 11.4), ("panda", "panda", 31.3)])
def test_ratios_that_real_robots_need(folder, file, known):
    """With rotor inertia 0.1 kg m² a UR5 needs a ratio of about 11, a Panda one of about 31 (theory, varying ratio)."""
    path = next((ROBOTS / f"{folder}_description").rglob(f"{file}.urdf"))
    names = [name for name in MujocoPlant.from_file(path, armature=0.1).joint_names if "finger" not in name]
    robot = MujocoPlant.from_file(path, armature=0.1, joints=names)
    _, t = best_inertia_shape(robot, Workspace.from_joint_limits(robot))
    assert t == pytest.approx(known, rel=0.015)


@pytest.mark.parametrize("seed", range(4))
def test_shape_of_a_light_arm_whose_solver_stops_short(seed):
    """Clarabel ends optimal_inaccurate on this arm; the bound is taken from its dual and not from its word."""
    file = ROBOTS / "so_arm_description/urdf/so101.urdf"
    arm = MujocoPlant.from_file(file, armature=0.028)
    X, t = best_inertia_shape(
        [arm, arm.with_parameters({"payload": 0.3})], Workspace.from_joint_limits(arm), samples=200, seed=seed
    )
    assert t == pytest.approx(3.62, rel=0.01)
    assert np.linalg.eigvalsh(X).min() > 0


@pytest.mark.parametrize("starts", [1, 3, 8])
@pytest.mark.parametrize(
    ("both", "low", "high", "known"),
    [
        ([NLinkArm(), NLinkArm(payload=1.0)], [-np.pi, -1.5, 0.3], [np.pi, 1.5, 1.5], 21.48),
        ([ARM, TwoLinkArm(payload=2.0)], [-np.pi, 0.5], [np.pi, 2.6], 11.4),
    ],
)
def test_bounds_meet_however_little_is_searched(both, low, high, known, starts, monkeypatch):
    """No posture comes and goes for ever."""
    monkeypatch.setattr(sys.modules["tarc.analysis.inertia_shape"], "N_SEARCHES", starts)
    for seed in range(3):
        _, t = best_inertia_shape(both, Workspace.box(low, high), samples=200, seed=seed)
        assert t == pytest.approx(known, rel=0.015)


def random_definite(rng, count, n):
    roots = rng.normal(size=(count, n, n))
    return roots @ roots.transpose(0, 2, 1) + 0.1 * np.eye(n)


@pytest.mark.parametrize("diagonal", [False, True])
def test_lower_bound_holds_for_any_duals(diagonal):
    """No X is better than the bound, be the duals right, rough or senseless."""
    rng = np.random.default_rng(3)
    for n in (1, 2, 3, 5):
        below, above = random_definite(rng, 4, n), random_definite(rng, 4, n)
        least, duals = solved_by_cvxpy(below, above, diagonal)
        for less, more in (
            duals,
            tuple(one + 0.1 * rng.normal(size=one.shape) for one in duals),
            (rng.normal(size=below.shape), rng.normal(size=above.shape)),
            (0 * below, 0 * above),
            (np.nan * below, above),
        ):
            assert lower_bound(below, above, less, more, diagonal) <= least * (1 + 1e-6)
        assert lower_bound(below, above, *duals, diagonal) >= least * (1 - 1e-3)


def solved_by_cvxpy(below, above, diagonal):
    """Return what the best X of the program needs, an upper bound of the least t, and its duals."""
    n = below.shape[1]
    t = cp.Variable()
    X = cp.diag(cp.Variable(n)) if diagonal else cp.Variable((n, n), symmetric=True)
    constraints = [*(X - M >> 0 for M in below), *(t * M - X >> 0 for M in above)]
    cp.Problem(cp.Minimize(t), constraints).solve(solver=cp.CLARABEL)
    shape = np.asarray(X.value)
    grow = max(eigh(M, shape, eigvals_only=True)[-1] for M in below)
    need = grow * max(eigh(shape, M, eigvals_only=True)[-1] for M in above)
    duals = [np.asarray(one.dual_value) for one in constraints]
    return need, (np.array(duals[: len(below)]), np.array(duals[len(below) :]))


def test_bounds_that_do_not_meet_are_an_error(monkeypatch):
    monkeypatch.setattr(sys.modules["tarc.analysis.inertia_shape"], "MAX_ROUNDS", 1)
    with pytest.raises(NotConverged, match="exceeds its lower bound .* raise the tolerance"):
        best_inertia_shape([ARM, TwoLinkArm(payload=2.0)], Workspace.box([-np.pi, 0.5], [np.pi, 2.6]), samples=50)
