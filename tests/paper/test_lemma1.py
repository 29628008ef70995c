"""Lemma 1 and (c2) against sweeps, direct norms and random matrices, with what they leave out shown."""

from dataclasses import replace

import flint
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from law_catalogue import make_law, make_tdc
from tarc import laws
from tarc.analysis.workspace import Workspace
from tarc.certificates import certify_constant_ratio
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.numerics.ball_arithmetic import balls, is_positive_definite
from tarc.paper.lemma1 import check_condition_c2, check_lemma1, lemma1_form
from tarc.plants import MassSpringDamper, MujocoPlant, NLinkArm, TwoLinkArm
from tarc.stored_certificates import certificate_from_json

ARM = TwoLinkArm()
ALL = Workspace.from_joint_limits(ARM)


def largest_norm(plant, nominal):
    """Largest norm of a two-link arm over its second joint, the only one that counts."""
    angles = np.linspace(-np.pi, np.pi, 2001)
    norms = [np.linalg.norm(np.linalg.inv(plant.inertia([0, q])) @ nominal - np.eye(2), 2) for q in angles]
    return float(max(norms))


@pytest.mark.parametrize("scale", [0.05, 0.5, 1.0, 1.5])
def test_norm_is_the_peak_of_a_dense_sweep(scale):
    nominal = scale * np.diag([1.0, 0.5])
    certificate = check_lemma1(make_tdc(inertia=nominal), ARM, ALL)
    known = largest_norm(ARM, nominal)
    assert certificate.evidence.norm == pytest.approx(known, rel=1e-5)
    assert certificate.margin == pytest.approx(1 - known, abs=1e-5 * known)
    assert certificate.certified == (known < 1)
    assert certificate.proof_grade == (certificate.verdict == "refuted")
    assert certificate.verify()


@given(seed=st.integers(0, 10_000), size=st.integers(1, 6))
def test_form_and_norm_are_the_same_condition(seed, size):
    rng = np.random.default_rng(seed)
    M, nominal = (root @ root.T + 0.1 * np.eye(size) for root in rng.normal(size=(2, size, size)))
    nominal *= rng.uniform(0.1, 2.0)
    norm = np.linalg.norm(np.linalg.solve(M, nominal) - np.eye(size), 2)
    if abs(norm - 1) > 1e-6:
        with flint.ctx.workprec(160):
            assert is_positive_definite(lemma1_form(balls(M), balls(nominal))) == (norm < 1)


def test_refuted_with_a_posture_that_shows_it():
    certificate = check_lemma1(make_tdc(inertia=np.diag([3.0, 1.0])), ARM, ALL)
    assert certificate.verdict == "refuted"
    assert certificate.proof_grade
    assert certificate.witness is not None
    M = ARM.inertia(certificate.witness.posture)
    norm = np.linalg.norm(np.linalg.solve(M, np.diag([3.0, 1.0])) - np.eye(2), 2)
    assert certificate.witness.norm == pytest.approx(norm, rel=1e-12)
    assert norm > 1
    assert "Shown by: posture (" in certificate.explain()


def test_at_the_edge_the_verdict_is_open():
    """One joint with M̂ = 2 M: the norm is one, and the form zero."""
    mass = MassSpringDamper(masses=[1.5], springs=[0.0], dampers=[0.0])
    place = Workspace.box([0.0], [1.0])
    verdicts = [check_lemma1(make_tdc(inertia=m), mass, place).verdict for m in (3.0 - 1e-12, 3.0, 3.0 + 1e-12)]
    assert verdicts == ["certified", "inconclusive", "refuted"]


def test_payloads_between_two_that_pass_pass():
    """The condition is affine in M, which is affine in the payload."""
    law = make_tdc(inertia=0.3 * np.eye(2))
    both = check_lemma1(law, [ARM, TwoLinkArm(payload=3.0)], ALL)
    assert both.certified
    for payload in (0.5, 1.0, 2.0):
        assert check_lemma1(law, TwoLinkArm(payload=payload), ALL).certified


def test_norm_in_coordinates_without_units():
    """The lemma's norm depends on the coordinates: here it exceeds one with all ratios inside (0, 2)."""
    certificate = check_lemma1(make_tdc(inertia=[0.5, 0.2]), ARM, ALL)
    assert certificate.evidence.scaled_norm < 1 < certificate.evidence.norm
    ends = certificate.evidence.min_ratio, certificate.evidence.max_ratio
    assert certificate.evidence.scaled_norm == max(abs(1 - end) for end in ends)


def test_a_certified_lemma_does_not_certify_the_loop():
    """M̂ = M satisfies the lemma with norm zero, and with a window of ten periods the loop is unstable."""
    mass = MassSpringDamper(masses=[1.5], springs=[0.0], dampers=[0.0])
    law = make_tdc(inertia=1.5)
    certificate = check_lemma1(law, mass, Workspace.box([0.0], [1.0]))
    assert certificate.margin == pytest.approx(1.0)
    assert certify_constant_ratio(law, 1.0).verdict == "refuted"
    assert any("left out" in assumption and "loop" in assumption for assumption in certificate.assumptions)


def test_a_real_robot():
    robot = MujocoPlant.from_file("ur5e", armature=0.1)
    certificate = check_lemma1(make_tdc(inertia=np.full(6, 0.1)), robot, Workspace.from_joint_limits(robot))
    assert certificate.certified
    assert certificate_from_json(certificate.to_json()).verify()


def test_tampering_shows():
    certificate = check_lemma1(make_tdc(inertia=[0.2, 0.2]), ARM, ALL)
    assert certificate.certified
    evidence = replace(certificate.evidence, nominal_inertia=np.diag([50.0, 0.2]))
    assert not replace(certificate, evidence=evidence).verify()


@pytest.mark.parametrize("joints", [1, 3, 7])
@pytest.mark.parametrize("lyapunov_weight", [None, 1.0])
def test_c2_for_scalar_gains_in_closed_form(joints, lyapunov_weight):
    """P2 = q1/(2ωn²), P3 = (q3 + q1/ωn²)/(4ζωn), for ωn = 12, ζ = 1; Δsᵀs at a unit e1 is −P2 P3."""
    certificate = check_condition_c2(make_law(laws.TARC, joints, lyapunov_weight=lyapunov_weight))
    q1, q3 = (2 * 144.0, 2.0) if lyapunov_weight is None else (1.0, 1.0)
    P2, P3 = q1 / 288, (q3 + q1 / 144) / 48
    assert certificate.certified
    assert certificate.proof_grade
    assert certificate.margin == pytest.approx(1.0)
    assert certificate.evidence.shrinking.value == pytest.approx(-P2 * P3, rel=1e-9)
    assert certificate.evidence.growing is None
    assert certificate.evidence.residual < 1e-12
    assert certificate.verify()


def test_c2_gives_no_sign_even_where_the_error_grows():
    """With gains that couple, or a general Q, ‖s‖ may grow while Δsᵀs is negative."""
    rng = np.random.default_rng(0)
    root = rng.normal(size=(4, 4))
    law = make_law(laws.TARC, 2, lyapunov_weight=np.diag([288.0, 288.0, 2.0, 2.0]) + root @ root.T)
    certificate = check_condition_c2(law)
    assert certificate.certified
    growing, e1 = certificate.evidence.growing, certificate.evidence.shrinking.error
    assert growing is not None
    f1, df1 = growing.error, growing.error_rate
    assert (law.P2 @ f1) @ (law.P2 @ df1) > 0
    assert (law.P3 @ df1) @ (law.P2 @ f1) == pytest.approx(growing.value)
    assert growing.value < 0
    assert (law.P3 @ -e1) @ (law.P2 @ e1) == pytest.approx(certificate.evidence.shrinking.value)
    assert certificate.evidence.shrinking.value < 0


def test_c2_refuted_and_open_from_stored_matrices():
    """The law itself refuses such a P, so the evidence is changed by hand."""
    certificate = check_condition_c2(make_law(laws.TARC, 2))
    P = certificate.evidence.P.copy()
    P[2:, :2] *= -1
    changed = replace(certificate.evidence, P=P)
    assert not replace(certificate, evidence=changed).verify()
    verdict, margin, witness = changed.judge()
    assert verdict == "refuted"
    assert margin < 0
    assert witness is not None
    P[2:, :2] = 0.0
    assert replace(certificate.evidence, P=P).judge().verdict == "inconclusive"


def test_figures_of_the_forms(tmp_path):
    for certificate in (
        check_lemma1(make_tdc(inertia=[0.2, 0.2]), ARM, ALL),
        check_condition_c2(make_law(laws.TARC, 2)),
    ):
        for form in certificate.evidence.forms().values():
            assert np.linalg.eigvalsh(form)[0] > 0
        certificate.plot().savefig(tmp_path / "forms.png")


@pytest.mark.parametrize(
    ("call", "message", "error"),
    [
        (lambda: check_lemma1("TDC", ARM, ALL), "law: got str", UnsupportedLaw),  # type: ignore[arg-type]
        (
            lambda: check_lemma1(make_tdc(), NLinkArm(), ALL),
            "law: it drives 1 joints and the robot has 3",
            InvalidParameter,
        ),
        (lambda: check_lemma1(make_tdc(inertia=[1, 1]), "arm", ALL), "plant: got str", InvalidParameter),  # type: ignore[arg-type]
        (
            lambda: check_lemma1(make_tdc(inertia=[1, 1]), ARM, Workspace.box([0], [1])),
            "it has 1 joints and the robot 2",
            InvalidParameter,
        ),
        (lambda: check_condition_c2(make_tdc()), "law: got TDC; condition", UnsupportedLaw),
    ],
)
def test_bad_input(call, message, error):
    with pytest.raises(error, match=message):
        call()
