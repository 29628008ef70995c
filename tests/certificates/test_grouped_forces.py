"""Bounds on stiffness and damping by groups: closed forms, random motions, and proofs of robots by them."""

import numpy as np
import pytest

from law_catalogue import make_tdc
from tampering import reread
from tarc.analysis import Workspace, stored_proof
from tarc.analysis.inertia_ratio import inertia_spread
from tarc.analysis.motion_forces import MotionCorners
from tarc.analysis.workspace_boxes import workspace_boxes
from tarc.certificates import bound_prover, certify_robot, grouped_forces, prove_robot, strengthen_robot
from tarc.certificates.grouped_forces import GroupsLeftOut, group_bounds
from tarc.numerics import trig_polynomial
from tarc.numerics.trig_polynomial import too_large
from tarc.plants import NLinkArm, TwoLinkArm, load_robot
from two_link_certificate import ARM, LOADED, WORKSPACE, strengthened


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(stored_proof, "proofs_folder", lambda: tmp_path / "proofs")


@pytest.fixture(scope="module")
def affine():
    return strengthened(30.0)


@pytest.fixture
def by_groups(monkeypatch):
    """Leave too few corners for two joints, so that they are proven as six are."""
    monkeypatch.setattr(bound_prover, "MAX_CORNERS", 8)


def bounds_of(plant, speed, acceleration=(8.0, 8.0), *, has_friction=False):
    n = plant.n_joints
    corners = MotionCorners((speed,) * n, acceleration, has_friction=has_friction)
    boxes = workspace_boxes(Workspace.from_joint_limits(plant))
    return {bound.group.name: bound for bound in group_bounds([plant], np.eye(n), corners, boxes)}


def cover_of(proven):
    cover = proven.certificate.evidence.affine
    assert cover is not None
    return cover


def test_bounds_of_two_links_are_those_of_their_equations():
    """N = h sin q2 (−2 v1 v2 − v2², v1²): its slope over q2 is h √10 v² at most."""
    bounds = bounds_of(ARM, 2.0)
    h = abs((ARM.inertia([0.0, 0.0]) - ARM.inertia([0.0, np.pi / 2]))[0, 1])
    assert bounds["stiffness by speeds"].largest == pytest.approx(h * np.sqrt(10) * 4, rel=1e-5)
    damping = 2 * h * 2.0 * np.linalg.norm([[1, 2], [-1, 0]], 2)
    assert bounds["damping"].largest == pytest.approx(damping, rel=1e-5)


@pytest.mark.parametrize("negligible", [0.01, 2.0])
@pytest.mark.parametrize("viscous", [0.0, 3.0])
@pytest.mark.parametrize("links", [2, 3])
def test_no_motion_is_above_its_groups(links, viscous, negligible, monkeypatch):
    """With a share of two, all joints are bounded by constants; friction is anything between none and all of it."""
    monkeypatch.setattr(grouped_forces, "NEGLIGIBLE_JOINT", negligible)
    arm = TwoLinkArm(viscous=viscous) if links == 2 else NLinkArm(viscous=viscous)
    bounds = bounds_of(arm, 2.0, (8.0,) * links, has_friction=viscous > 0)
    largest = {}
    rng = np.random.default_rng(2)
    for _ in range(40):
        q, v, a = rng.uniform(-np.pi, np.pi, links), *(s * rng.uniform(-1, 1, links) for s in (2.0, 8.0))
        if rng.random() < 0.7:
            v, a = 2.0 * np.sign(v), 8.0 * np.sign(a)
        G = arm.linearised(q, 0 * v, a)[2]
        _, D, total = arm.linearised(q, v, a)
        friction = arm.damping(q)
        assert bool(np.abs(friction).max() > 1e-6) == (viscous > 0)
        D = D - friction * rng.choice([0.0, 0.5, 1.0])
        parts = {"stiffness by gravity and acceleration": G, "stiffness by speeds": total - G, "damping": D}
        for name, part in parts.items():
            bound = bounds[name]
            at = [f(q[None, bound.angles])[0] for f in bound.functions]
            limit = max(np.linalg.eigvalsh(F)[-1] + f.left_out for F, f in zip(at, bound.functions, strict=True))
            assert np.linalg.norm(part, 2) <= limit * (1 + 1e-6) + 1e-9
            largest[name] = max(largest.get(name, 0.0), limit)
    assert all(largest[name] <= bound.largest * (1 + 1e-4) for name, bound in bounds.items())


def test_a_robot_is_proven_by_groups(affine, by_groups):
    certificate, law = affine
    proven = prove_robot(certificate, law, [ARM, LOADED], WORKSPACE, progress=False)
    assert proven.complete
    names = ["stiffness by gravity and acceleration", "stiffness by speeds", "damping", "all forces"]
    assert [part.name for part in proven.parts[3:]] == names
    assert proven.certificate.verdict_in_words == "certified for every posture"
    assert reread(proven.certificate).verify()
    assert any("times the largest found" in line for line in proven.certificate.assumptions)
    ratios = cover_of(proven).proof.ratios
    points = proven.certificate.evidence.uncertainty(certificate.evidence.affine.force_points)
    for lead_time, limit in zip(ratios.lead_times, ratios.stiffness, strict=True):
        assert 1.05 <= limit / points.force_norms(float(lead_time)).max() < 2.5


@pytest.mark.slow
def test_a_norm_that_search_missed_is_met(affine, by_groups, monkeypatch):
    """The bound then begins at what was met, and the proof ends with the same result."""
    certificate, law = affine
    expected = prove_robot(certificate, law, [ARM, LOADED], WORKSPACE, progress=False)
    found = grouped_forces.largest_eigenvalue
    monkeypatch.setattr(grouped_forces, "largest_eigenvalue", lambda *arguments: 0.7 * found(*arguments))
    proven = prove_robot(certificate, law, [ARM, LOADED], WORKSPACE, progress=False)
    assert proven.complete
    limits = [cover_of(robot).proof.ratios.stiffness.min() for robot in (proven, expected)]
    assert limits[0] == pytest.approx(limits[1], rel=0.12)


def test_bounds_that_no_function_covers_rest_on_search(affine, by_groups, monkeypatch):
    certificate, law = affine
    monkeypatch.setattr(grouped_forces, "FORCE_ROOM", 100.0)
    proven = prove_robot(certificate, law, [ARM, LOADED], WORKSPACE, progress=False)
    assert [part.complete for part in proven.parts] == [True, True, True, False]
    assert "32 corners of the motions are too many, and no Lyapunov function covers" in str(proven.parts[-1])
    assert proven.certificate.verdict_in_words == (
        "certified on 30 sampled postures and local search; proven for every posture: inertia ratios, "
        "rate of the inertia, relative rate of the inertia"
    )


def test_groups_that_need_too_much_memory_are_left_out(affine, by_groups, monkeypatch):
    monkeypatch.setattr(trig_polynomial, "MAX_NUMBERS", 2000)
    certificate, law = affine
    proven = prove_robot(certificate, law, [ARM, LOADED], WORKSPACE, progress=False)
    assert [part.complete for part in proven.parts] == [True, True, True, False]
    assert proven.parts[-1].reason == (
        "bounds by groups are left out: stiffness by gravity and acceleration: 6 functions of 25 coefficients per "
        "entry need 1.9e-05 GB of at most 1.6e-05 GB; search decides"
    )
    assert proven.certificate.certified
    assert proven.certificate.verdict_in_words.startswith("certified on 30 sampled postures and local search; proven")


@pytest.fixture
def three_links():
    arm = NLinkArm()
    return [arm], np.eye(3), MotionCorners((2.0,) * 3, (8.0,) * 3), workspace_boxes(Workspace.from_joint_limits(arm))


def test_memory_is_known_before_it_is_needed(three_links, monkeypatch):
    """The second estimate of each group is the size of its functions, and the sums are made after it alone."""
    estimates, made = [], []
    members = trig_polynomial.PolynomialFamily.members

    def estimate(*sizes):
        estimates.append((sizes, len(made)))
        return too_large(*sizes)

    def count(family):
        made.append(family)
        return members(family)

    monkeypatch.setattr(grouped_forces, "too_large", estimate)
    monkeypatch.setattr(trig_polynomial.PolynomialFamily, "members", count)
    bounds = group_bounds(*three_links)
    assert len(estimates) == 2 * len(bounds) == 6
    for i, bound in enumerate(bounds):
        sizes = [2 * part.cosines.shape[0] for part in bound.functions]
        assert estimates[2 * i + 1] == ((len(sizes), max(sizes), 6), i)
        assert estimates[2 * i][0][1] >= min(sizes)
    monkeypatch.setattr(grouped_forces, "too_large", lambda *sizes: "large" if sizes == estimates[-1][0] else "")
    with pytest.raises(GroupsLeftOut, match="damping"):
        group_bounds(*three_links)


@pytest.mark.parametrize(("deadline", "group"), [(0, 1), (10, 1), (40, 2), (55, 2), (81, 3)])
def test_groups_end_in_time(three_links, monkeypatch, deadline, group):
    """The clock goes on by a second each time that it is read."""
    seconds = iter(range(10**6))
    monkeypatch.setattr(grouped_forces.time, "monotonic", lambda: next(seconds))
    with pytest.raises(GroupsLeftOut, match=f"the time ended at group {group} of 3"):
        group_bounds(*three_links, deadline=deadline)
    assert next(seconds) == deadline + 1


@pytest.mark.parametrize("in_groups", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_friction_that_was_left_out_is_met(affine, in_groups, monkeypatch):
    if in_groups:
        monkeypatch.setattr(bound_prover, "MAX_CORNERS", 8)
    certificate, law = affine
    arms = [arm.with_parameters({"viscous": 60.0}) for arm in (ARM, LOADED)]
    proven = prove_robot(certificate, law, arms, WORKSPACE, progress=False)
    assert not proven.complete


@pytest.mark.slow
def test_six_joints_in_a_box():
    plants = [load_robot("ur5e", armature=0.1, payload=payload) for payload in (0.0, 5.0)]
    centre = np.array([0.0, -1.2, 1.4, -1.0, -1.5, 0.0])
    space = Workspace.box(centre - 0.5, centre + 0.5, speed=1.0)
    shape = plants[1].inertia(centre)
    law = make_tdc(
        window=6,
        natural_frequency=30.0,
        synchronised=True,
        inertia=1.0 / inertia_spread(plants, shape, space, samples=100).max_ratio * shape,
    )
    certificate = certify_robot(law, plants, space, samples=100)
    certificate = strengthen_robot(certificate, law, plants, space, samples=100)
    assert certificate.evidence.method == "affine Lyapunov function"
    proven = prove_robot(certificate, law, plants, space, progress=False)
    assert proven.certificate.verdict_in_words == "certified for every posture"
