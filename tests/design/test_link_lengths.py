"""Robots from files whose links may be shorter or longer."""

import numpy as np
import pytest

from tarc import simulate
from tarc.analysis import Workspace
from tarc.analysis.operating_points import SEARCH_MARGIN
from tarc.certificates import certify_known_inertia
from tarc.core.errors import InvalidParameter
from tarc.design.link_lengths import robots_with_lengths, with_lengths
from tarc.estimators import Algebraic
from tarc.laws import TDC
from tarc.laws.nominal_inertia import NominalInertia
from tarc.plants import NLinkArm, load_robot
from tarc.signals import Sinusoid
from urdf_text import robot

LENGTHS, CENTRES, MASSES, INERTIAS = (0.5, 0.4, 0.3), (0.25, 0.22, 0.1), (2.0, 1.5, 1.0), (0.05, 0.03, 0.01)
ARM = NLinkArm(lengths=LENGTHS, centres=CENTRES, masses=MASSES, inertias=INERTIAS, payload=1.0)
UR5E = load_robot("ur5e", armature=0.1, viscous=1.0)
SPEEDS = Workspace.from_joint_limits(UR5E).with_speed_limits(1.0, 4.0)


@pytest.fixture(scope="module")
def planar(tmp_path_factory):
    """Return the planar arm as a file, with the payload at its tip."""
    links, joints, place, parent = ['<link name="base"/>'], [], 0.0, "base"
    for i, (length, centre, mass, inertia) in enumerate(zip(LENGTHS, CENTRES, MASSES, INERTIAS, strict=True)):
        moments = f'ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"'
        inertial = f'<origin xyz="{centre} 0 0"/><mass value="{mass}"/><inertia {moments}/>'
        links.append(f'<link name="l{i}"><inertial>{inertial}</inertial></link>')
        ends = f'<parent link="{parent}"/><child link="l{i}"/><origin xyz="{place} 0 0"/><axis xyz="0 -1 0"/>'
        limit = '<limit lower="-3" upper="3" effort="100" velocity="3"/>'
        joints.append(f'<joint name="j{i}" type="revolute">{ends}{limit}</joint>')
        place, parent = length, f"l{i}"
    links.append('<link name="tip"/>')
    tip = f'<parent link="{parent}"/><child link="tip"/><origin xyz="{place} 0 0"/>'
    joints.append(f'<joint name="j" type="fixed">{tip}</joint>')
    path = tmp_path_factory.mktemp("planar") / "planar.urdf"
    path.write_text(robot(*links, *joints), encoding="utf-8")
    return load_robot(path, payload=1.0)


def test_a_planar_arm_from_a_file_has_the_inertia_of_its_lengths(planar):
    """And torques; the payload is a ball of 5 cm in a file, whose own inertia is left out."""
    random, free = np.random.default_rng(0), {"payload": 0.0}
    for _ in range(5):
        factors = random.uniform(0.8, 1.2, 3)
        longer = planar.with_parameters({"length_factors": factors, **free})
        values = {"lengths": factors * LENGTHS, "centres": factors * CENTRES, **free}
        q, v = random.uniform(-2, 2, (2, 3))
        np.testing.assert_allclose(longer.inertia(q), ARM.with_parameters(values).inertia(q), rtol=1e-10)
        np.testing.assert_allclose(longer.bias(q, v), ARM.with_parameters(values).bias(q, v), rtol=1e-10, atol=1e-12)
        assert not longer.file_options
    assert planar.file_options


def test_both_have_the_same_ratios(planar):
    """The ends that are chosen have the extreme ratios of all ends of the planar arm, here without the load."""
    planar, arm = (one.with_parameters({"payload": 0.0}) for one in (planar, ARM))
    workspace = Workspace.from_joint_limits(planar).with_speed_limits(1.0, 4.0)
    postures = workspace.sample(200, 0)

    def extremes(plants):
        M = [[plant.inertia(q) for q in postures] for plant in plants]
        ratios = np.linalg.eigvals(np.linalg.solve(M, [arm.inertia(q) for q in postures])).real
        return np.array([np.min(ratios), np.max(ratios)])

    chosen, arms = (robots_with_lengths([one], 0.02, workspace, 0) for one in (planar, arm))
    assert len(arms) == 27
    assert 2 <= len(chosen) <= 5
    np.testing.assert_allclose(extremes(chosen), extremes(arms), rtol=1e-9)


def test_ratios_of_every_robot_within_the_lengths_are_within_the_margin():
    ends = [UR5E.with_parameters({"payload": mass}) for mass in (0.0, 5.0)]
    chosen = robots_with_lengths(ends, 0.02, SPEEDS, 0)
    assert 2 < len(chosen) <= 6
    random = np.random.default_rng(1)
    postures = SPEEDS.sample(300, seed=5).T
    nominal = UR5E.inertia_matrices(postures)

    def ratios(plant):
        return np.linalg.eigvals(np.linalg.solve(plant.inertia_matrices(postures), nominal)).real

    found = np.array([ratios(plant) for plant in chosen])
    for _ in range(40):
        inside = {"payload": random.uniform(0, 5), "length_factors": random.uniform(0.98, 1.02, 6)}
        inner = ratios(UR5E.with_parameters(inside))
        assert found.min() / (1 + SEARCH_MARGIN) <= inner.min()
        assert inner.max() <= found.max() * (1 + SEARCH_MARGIN)


def test_robots_within_the_lengths_break_no_certified_law(planar):
    """Motions of random robots stay within what the certificate covers, and runs of the nonlinear arm settle."""
    workspace = Workspace.box([-1.0] * 3, [1.0] * 3, speed=1.0, acceleration=4.0)
    law = TDC(
        inertia=NominalInertia(planar, 0.8, gravity=True),
        natural_frequency=20.0,
        period=1e-3,
        synchronised=True,
        estimator=Algebraic(window=0.006),
    )
    share, random = 0.02, np.random.default_rng(2)
    certificate = certify_known_inertia(law, robots_with_lengths([planar], share, workspace, 0), workspace, samples=60)
    assert certificate.certified
    worded = with_lengths(certificate, planar, share)
    assert worded.verdict_in_words == (
        "certified on 60 sampled postures and local search; ends of 3 link lengths chosen at 200 sampled motions"
    )
    assert "of their 8 ends those with the extreme inertia" in worded.assumptions[-1]
    assert with_lengths(certificate, ARM, share).basis.endswith("; each link shorter, as it is and longer")
    assert with_lengths(certificate, planar, 0.0) is certificate
    evidence = certificate.evidence
    reference = Sinusoid(amplitude=[0.4, 0.4, 0.4], frequency=[2.5, 2.0, 1.7])
    for _ in range(4):
        inside = planar.with_parameters({"length_factors": random.choice([1 - share, 1 + share], 3)})
        for q in workspace.sample(100, int(random.integers(1000))):
            ratios = np.linalg.eigvals(np.linalg.solve(inside.inertia(q), 0.8 * planar.inertia(q))).real
            assert evidence.min_ratio / (1 + SEARCH_MARGIN) <= ratios.min()
            assert ratios.max() <= evidence.max_ratio * (1 + SEARCH_MARGIN)
        start = 0.05 * random.normal(size=3)
        run = simulate(inside, law, reference, 1.5, initial_position=start, initial_torque="rest", progress=False)
        error = np.abs((run.data["position"] - run.data["reference"]).values)
        assert error[-300:].max() < 0.05 * np.abs(start).max()


def test_lengths_that_are_too_uncertain_are_refused():
    with pytest.raises(InvalidParameter, match=r"length_error: got 0\.1; between its ends .* needs at most 0\.0"):
        robots_with_lengths([UR5E.with_parameters({"payload": 5.0})], 0.1, SPEEDS, 0)
    arm = NLinkArm(lengths=[0.3] * 4, centres=[0.15] * 4, masses=[1.0] * 4, inertias=[0.01] * 4)
    with pytest.raises(InvalidParameter, match="4 links, whose lengths have 81 combinations"):
        robots_with_lengths([arm], 0.02, Workspace.from_joint_limits(arm).with_speed_limits(1.0, 4.0), 0)
