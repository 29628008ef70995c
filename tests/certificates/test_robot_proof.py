"""Proofs of a robot's certificate for every posture: complete ones, and bounds that do not hold."""

from dataclasses import replace

import numpy as np
import pytest

from law_catalogue import make_tdc
from tampering import reread, scaled
from tarc.analysis import Workspace, stored_proof
from tarc.analysis.motion_forces import MotionCorners
from tarc.certificates import bound_prover, prove_robot
from tarc.certification import certify_law
from tarc.plants import NLinkArm
from tarc.signals import Sinusoid
from two_link_certificate import ARM, INERTIA, LOADED, WORKSPACE, strengthened


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(stored_proof, "proofs_folder", lambda: tmp_path / "proofs")


@pytest.fixture(scope="module")
def affine():
    return strengthened(40.0)


def test_an_affine_certificate_holds_for_every_posture(affine):
    certificate, law = affine
    proven = prove_robot(certificate, law, [ARM, LOADED], WORKSPACE, progress=False)
    assert proven.complete
    assert [part.name for part in proven.parts][:3] == [
        "inertia ratios",
        "rate of the inertia",
        "relative rate of the inertia",
    ]
    assert len(proven.parts) < 3 + len(certificate.evidence.affine.proof.ratios.stiffness)
    assert proven.certificate.verdict_in_words == "certified for every posture"
    assert reread(proven.certificate).verify()
    assert not any("samples" in line for line in proven.certificate.assumptions)
    assert any("no joint is faster" in line for line in proven.certificate.assumptions)


@pytest.mark.parametrize(
    ("name", "factor"),
    [("min_ratio", 1.07), ("max_ratio", 0.93), ("rate", 0.93), ("relative_rate", 0.93), ("stiffness", 0.93)],
)
def test_a_bound_that_does_not_hold_is_not_proven(affine, name, factor):
    """The certificate leaves 5 %: with 7 % less a posture breaks it, and the verdict takes it in."""
    certificate, law = affine
    wrong = scaled(certificate, f"affine.proof.ratios.{name}", factor)
    proven = prove_robot(wrong, law, [ARM, LOADED], WORKSPACE, progress=False)
    assert not proven.complete
    assert proven.certificate.verdict == "inconclusive"
    assert "the proof met a posture" in proven.certificate.assumptions[-1]
    assert proven.certificate.verify()


def test_a_payload_that_was_left_out_is_met(affine):
    certificate, law = affine
    heavier = ARM.with_parameters({"payload": 2.4})
    proven = prove_robot(certificate, law, [ARM, heavier], WORKSPACE, progress=False)
    assert proven.certificate.verdict == "inconclusive"


def test_a_ball_is_proven_about_a_reference_as_well():
    reference = Sinusoid(amplitude=[0.3, 0.3], frequency=1.0)
    space = Workspace.from_reference(reference, 1.0, tube=0.02).with_reference_speeds()
    law = make_tdc(window=6, natural_frequency=10.0, synchronised=True, inertia=0.4 * INERTIA)
    certification = certify_law(law, [ARM, LOADED], space, samples=60, prove=True)
    assert certification.verdict.evidence.method == "ball with a rate"
    assert certification.proof is not None
    assert certification.proof.complete
    assert certification.verdict.verdict_in_words == "certified for every posture"


def test_time_that_ends_leaves_the_samples_and_a_share(affine):
    certificate, law = affine
    proven = prove_robot(certificate, law, [ARM, LOADED], WORKSPACE, time_limit=1e-6, progress=False)
    assert not proven.complete
    assert proven.share < 1
    assert proven.certificate.certified
    assert proven.certificate.verdict_in_words.startswith("certified on 30 sampled postures and local search")
    assert sum(line.startswith("rests on samples") for line in proven.certificate.assumptions) == len(proven.parts)
    assert "the time ended" in str(proven.parts[0])


def test_what_is_not_certified_is_not_proven(affine):
    certificate, law = affine
    open_one = replace(certificate, verdict="inconclusive")
    assert prove_robot(open_one, law, [ARM, LOADED], WORKSPACE).parts == ()


@pytest.mark.parametrize("n_tangents", [3, 5])
@pytest.mark.parametrize("arm", [LOADED, NLinkArm(payload=1.0)], ids=["two", "three"])
def test_corners_of_the_motions_contain_all_motions(arm, n_tangents):
    """The parts add up to G and D of any motion, and no motion has a larger norm than the corners of its posture."""
    n, rng = arm.n_joints, np.random.default_rng(1)
    corners = MotionCorners((2.0,) * n, (8.0,) * n, n_tangents)
    motions = corners.corners()
    assert len(motions) == corners.count()
    q = rng.uniform(-np.pi, np.pi, (3, n))
    parts = np.array([part(q) for part in corners.parts(arm)])
    largest = np.max(
        [np.linalg.norm(np.tensordot(corners.weights(*motion), parts, axes=1), 2, axis=(1, 2)) for motion in motions],
        axis=0,
    )
    for _ in range(60):
        v, a = rng.uniform(-1, 1, (2, n))
        if rng.random() < 0.5:
            v, a = np.sign(v), np.sign(a)
        total = np.tensordot(corners.weights(v, v**2, a), parts, axes=1)
        for i, posture in enumerate(q):
            _, D, G = arm.linearised(posture, 2.0 * v, 8.0 * a)
            D = D - arm.linearised(posture, 0 * v, 0 * a)[1]
            assert total[i] == pytest.approx(np.hstack([G, D]), abs=1e-5 * np.abs(G).max())
            assert np.linalg.norm(total[i], 2) <= largest[i] * (1 + 1e-9)


def test_six_joints_have_too_many_corners():
    corners = MotionCorners((1.0,) * 6, (4.0,) * 6)
    assert corners.count() == 2 * 4**5 * 2**6 > bound_prover.MAX_CORNERS
    counts = [len(corners.group_weights(group)) for group in corners.groups()]
    assert counts == [2**6, 32 * 33 // 2, 2**5]


@pytest.mark.slow
def test_three_links_in_a_box():
    plants = [NLinkArm(), NLinkArm(payload=1.0)]
    space = Workspace.box([-0.4, 0.2, 0.2], [0.4, 0.9, 0.9], speed=0.5)
    shape = plants[1].inertia([0.0, 0.5, 0.5])
    law = make_tdc(window=6, natural_frequency=20.0, synchronised=True, inertia=0.3 * shape)
    certification = certify_law(law, plants, space, samples=60, prove=True)
    assert certification.verdict.verdict_in_words == "certified for every posture"
