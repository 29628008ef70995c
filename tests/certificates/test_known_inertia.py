"""The certificate of M̂(q), against what is known and against motions of the robot."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

import check_certificate as tool
from law_catalogue import make_tdc
from tarc import NominalInertia
from tarc.analysis import Workspace
from tarc.analysis.known_inertia import KnownInertia
from tarc.analysis.linearise import decoupled_channels
from tarc.analysis.operating_points import OperatingPoint
from tarc.analysis.uncertain_loop import UncertainLoop
from tarc.certificates import certify_known_inertia, certify_varying_ratio
from tarc.certificates.affine import find_proof
from tarc.certificates.affine_form import RatioSet
from tarc.certificates.known_points import WorstKnownPoints
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.plants import MassSpringDamper, NLinkArm, TwoLinkArm
from tarc.scenario.certified_laws import CertifiedLaws
from tarc.stored_certificates import certificate_from_json

T = 1e-3
ARM = TwoLinkArm(viscous=0.2)
LOADED = TwoLinkArm(viscous=0.2, payload=0.5)
WORKSPACE = Workspace.box([-1.0, 0.5], [1.0, 2.0], speed=1.0)


def known_law(
    fraction: float = 0.8,
    window: int = 6,
    natural_frequency: Any = 20.0,
    synchronised: bool = True,
    model: Any = ARM,
    **terms: Any,
) -> Any:
    inertia = NominalInertia(model, fraction, **terms)
    return make_tdc(window, synchronised, natural_frequency, inertia)


@pytest.fixture(scope="module")
def certificate():
    law = known_law(gravity=True, coriolis=True)
    return law, certify_known_inertia(law, [ARM, LOADED], WORKSPACE, samples=60)


def test_certified_and_verified_again(certificate):
    _, certified = certificate
    assert certified.certified
    assert certified.verify()
    again = certificate_from_json(certified.to_json())
    assert again.verify()
    assert again.explain() == certified.explain()
    assert certified.evidence.max_ratio == pytest.approx(0.8, rel=1e-9), "the exact model has the ratio ρ"


def test_worst_points_serve_every_fraction(certificate):
    law, searched = certificate
    start = replace(law.inertia, fraction=1.0)
    worst = WorstKnownPoints.search(start, [ARM, LOADED], WORKSPACE, 60, 0)
    reused = certify_known_inertia(law, [ARM, LOADED], WORKSPACE, samples=60, worst=worst)
    assert reused.verdict == searched.verdict
    assert reused.margin == pytest.approx(searched.margin, rel=1e-6)
    for name in ("min_ratio", "max_ratio", "rate", "radius"):
        assert getattr(reused.evidence, name) == pytest.approx(getattr(searched.evidence, name), rel=1e-6), name


def test_loop_along_motions_decays(certificate):
    """Products of the loop's matrices along fast motions, built from the robot's own derivatives, go to zero."""
    law, _ = certificate
    A, B, C = decoupled_channels(law)[0].closed_loop(0.0)[:3]
    known = KnownInertia(law.inertia)
    identity = np.eye(2)
    inputs, outputs = np.kron(B, identity), np.kron(C, identity)
    base = np.kron(A, identity)
    rng = np.random.default_rng(0)
    size, rate, steps = np.array([1.0, 0.75]), np.array([1.0, 1.33]), 2000
    for plant in (ARM, LOADED):
        angles = rng.uniform(0, 6.28, 2) + rate * T * np.arange(steps)[:, None]
        motions = [0.0, 1.25] + size * np.sin(angles), size * rate * np.cos(angles), -size * rate**2 * np.sin(angles)
        points = [OperatingPoint(plant, *motion) for motion in zip(*motions, strict=True)]
        x = rng.normal(size=len(base))
        first = np.linalg.norm(x)
        for nominal, M, D, G in zip(known.inertias(points), *known.linearised(points), strict=True):
            force = nominal @ (outputs @ x) - G @ x[:2] - D @ x[2:4] / T
            x = base @ x + inputs @ np.linalg.solve(M, force)
        assert np.linalg.norm(x) < 1e-6 * first


@pytest.mark.slow
def test_affine_covers_more_than_the_ball():
    """A literal law is left undecided by the ball; the Lyapunov function affine in M̂ and M covers it."""
    law = known_law(0.15, 6, 60.0, synchronised=False, gravity=True)
    heavy = ARM.with_parameters({"payload": 2.0})
    slow = Workspace.box([-1.0, 0.8], [1.0, 2.0], speed=0.5)
    undecided = certify_known_inertia(law, [ARM, heavy], slow, samples=40, quick=True)
    assert undecided.verdict == "inconclusive"
    proven = certify_known_inertia(law, [ARM, heavy], slow, samples=40)
    assert proven.certified
    assert proven.margin > 0.05
    again = certificate_from_json(proven.to_json())
    assert again.verify()
    proof = proven.evidence.affine
    assert proof is not None
    assert proof.ratios.nominal_rate > proven.evidence.rate
    for change in ({"nominal_rate": 0.0}, {"relative_rate": 0.0}, {"max_ratio": 0.1}):
        ratios = replace(proof.ratios, **change)
        forged = replace(proven.evidence, affine=replace(proof, ratios=ratios))
        assert not replace(proven, evidence=forged).verify()


@pytest.mark.slow
def test_affine_with_a_computation_delay(tmp_path):
    """The late torque has M̂ and the model's stiffness of its own sample; both count, in the package and in the tool."""
    law = known_law(0.15, 6, 60.0, synchronised=False, gravity=True)
    heavy = ARM.with_parameters({"payload": 2.0})
    slow = Workspace.box([-1.0, 0.8], [1.0, 2.0], speed=0.5)
    laws = CertifiedLaws(None, [ARM, heavy], slow, 40)  # pyright: ignore[reportArgumentType]
    laws.laws_with_model["delayed"] = law
    laws.known_inertia["delayed"] = certify_known_inertia(
        law, [ARM, heavy], slow, samples=40, computation_delay=1, quick=True
    )
    laws.strengthen(progress=False)
    proven = laws.known_inertia["delayed"]
    evidence = proven.evidence
    assert proven.certified
    assert evidence.affine is not None
    assert len(evidence.affine.loop.full.scales) == 4, "the lag of the position is an output"
    (tmp_path / "delayed.json").write_text(proven.to_json(), encoding="utf-8")
    assert certificate_from_json(proven.to_json()).verify()
    assert tool.main([str(tmp_path / "delayed.json")]) == 0
    stiffer = tuple(replace(point, model_stiffness=100 * point.model_stiffness) for point in evidence.points)
    ratios = replace(evidence.affine.ratios, lag_weights=np.zeros(len(evidence.affine.ratios.powers)))
    without_lag = replace(evidence.affine, ratios=ratios)
    for change in ({"computation_delay": 0}, {"computation_delay": 2}, {"points": stiffer}, {"affine": without_lag}):
        forged = replace(proven, evidence=replace(evidence, **change))
        assert not forged.verify()
        (tmp_path / "forged.json").write_text(forged.to_json(), encoding="utf-8")
        assert tool.main([str(tmp_path / "forged.json")]) == 1
    for plant in (ARM, heavy):
        assert late_loop_decays(law, plant, 1)
    assert not late_loop_decays(law, ARM, 2)
    refuted = certify_known_inertia(law, [ARM, heavy], slow, samples=40, computation_delay=2)
    assert refuted.verdict == "refuted"


def late_loop_decays(law, plant, delay, parts=4, steps=1500):
    """Whether the robot linearised about a motion, in parts of a period, with a torque of a past sample, decays."""
    A, _, C, *_ = decoupled_channels(law, delay)[0].closed_loop(0.0)
    known, identity = KnownInertia(law.inertia), np.eye(2)
    base, outputs = np.kron(A, identity), np.kron(C, identity)
    times = T / parts * np.arange(steps * parts)[:, None]
    rate = np.array([0.5, 0.8])
    motions = (
        [0.0, 1.4] + 0.6 * np.sin(rate * times),
        0.6 * rate * np.cos(rate * times),
        -0.6 * rate**2 * np.sin(rate * times),
    )
    points = [OperatingPoint(plant, *motion) for motion in zip(*motions, strict=True)]
    nominal = known.inertias(points)
    M, D, G, own = known.linearised_apart(points)
    x = np.random.default_rng(3).normal(size=len(base))
    x[2:4] *= T
    past, first = [x[:2]] * (delay + 1), np.linalg.norm(x)
    for k in range(delay, steps):
        past = [x[:2], *past[:-1]]
        sample = parts * (k - delay)
        held = nominal[sample] @ (outputs @ x) + own[sample] @ past[-1]
        q, velocity, step = x[:2], x[2:4] / T, T / parts
        for i in range(parts * k, parts * (k + 1)):
            acceleration = np.linalg.solve(M[i], held - G[i] @ q - D[i] @ velocity)
            q, velocity = q + velocity * step + acceleration * step**2 / 2, velocity + acceleration * step
        x = base @ x
        x[:2], x[2:4] = q, velocity * T
    return np.linalg.norm(x) < 0.1 * first


def test_v_falls_while_both_inertias_turn():
    """M̂ = L Lᵀ and M = L J Lᵀ with L turned and stretched at the rates of the proof, halves of a period apart."""
    (channel,) = decoupled_channels(make_tdc(3, True, 40.0, 1.0))
    loop = UncertainLoop.from_channel(channel, 0.0, intersample=True)
    none = np.zeros(0)
    ratios = RatioSet(
        min_ratio=0.3,
        max_ratio=1.2,
        rate=24.0,
        relative_rate=7.0,
        period=T,
        intersample=True,
        powers=none,
        lead_times=none,
        stiffness=none,
        shares=none,
        nominal_rate=5.0,
    )
    proof = find_proof(loop, ratios)
    assert proof is not None
    P0, P1, Q1 = proof.matrices[:3]
    J = np.diag([1 / 1.15, 1 / 0.32])
    rng = np.random.default_rng(2)
    L = rng.normal(size=(2, 2))
    x = rng.normal(size=(len(loop.A), 2))
    z = proof.loop.projection @ x
    before, turns = None, []
    for k in range(300):
        if k % 20 == 0:
            N = rng.normal(size=(2, 2))
            root = np.sqrt(np.diag(J))
            relative = (N * root / root[:, None]) + (N * root / root[:, None]).T
            sizes = [np.linalg.norm(N + N.T, 2) / 5.0, np.linalg.norm(relative, 2) / 7.0]
            N *= 0.98 / max(*sizes, np.linalg.norm(N @ J + J @ N.T, 2) / 24.0)
            turns = [expm(N * T * share) for share in (0.25, 0.75, 1.0)]
        halves = [L @ turns[0], L @ turns[1]]
        nominal = L @ L.T
        E = [np.linalg.solve(half @ J @ half.T, nominal) for half in halves]
        mean = (E[0] + E[1]) / 2
        xi = np.concatenate([x, z - proof.loop.projection @ x])
        V = np.trace(z.T @ P0 @ z @ nominal) + np.trace(z.T @ (P1 + Q1) @ z @ nominal @ np.linalg.inv(mean))
        V += proof.multipliers.error * np.trace(xi.T @ proof.loop.storage @ xi @ nominal)
        if before is not None:
            assert before * proof.growth**-2 > V
        before = V
        v = (loop.C @ x)[0]
        accelerations = [part @ v for part in E]
        average, moment = sum(accelerations) / 2, 12**0.5 / 4 * (accelerations[0] - accelerations[1]) / 2
        z = proof.loop.A @ z + proof.loop.B @ np.array([average - proof.loop.full.centre * v, moment])
        position, velocity = x[0], x[1] / T
        x = loop.A @ x
        for acceleration in accelerations:
            position = position + velocity * T / 2 + acceleration * T**2 / 8
            velocity = velocity + acceleration * T / 2
        x[0], x[1] = position, velocity * T
        L = L @ turns[2]


def test_linearised_is_the_derivative_of_the_torque():
    """G less the model's stiffness is the derivative of M q̈ + N − M̂ a − ĥ, at the a of the motion."""
    model = TwoLinkArm(payload=0.3)
    inertia = NominalInertia(model, 0.3, gravity=True, coriolis=True)
    q, v, a = np.array([0.3, 0.9]), np.array([0.8, -0.5]), np.array([1.5, 2.0])
    known = KnownInertia(inertia)
    _, _, G = known.linearised([OperatingPoint(LOADED, q, v, a)])
    torque = LOADED.inertia(q) @ a + LOADED.bias(q, v)
    held = np.linalg.solve(inertia.at(q), torque - inertia.forces(q, v))

    def rest(q):
        return LOADED.inertia(q) @ a + LOADED.bias(q, v) - inertia.at(q) @ held - inertia.forces(q, v)

    differences = [(rest(q + d) - rest(q - d)) / 2e-6 for d in 1e-6 * np.eye(2)]
    np.testing.assert_allclose(rest(q), 0, atol=1e-9)
    np.testing.assert_allclose(G[0], np.column_stack(differences), atol=1e-6)


def test_masses_have_the_ball_of_a_constant_inertia():
    """For masses without springs M̂(q) is constant, and the radius is that of any varying ratio."""
    masses = MassSpringDamper(masses=(1.0, 2.0), springs=(0.0, 0.0), dampers=(0.0, 0.0))
    heavier = masses.with_parameters({"payload": 1.0})
    workspace = Workspace.box([-0.1, -0.1], [0.1, 0.1], speed=1.0)
    found = certify_known_inertia(known_law(model=masses), [masses, heavier], workspace, samples=5).evidence
    assert found.rate == 0
    assert (found.min_ratio, found.max_ratio) == pytest.approx((0.8 * 2 / 3, 0.8))
    varying = certify_varying_ratio(make_tdc(6, True, 20.0, 0.8), found.centre).evidence
    assert found.radius == pytest.approx(varying.radius, rel=3e-3)


def test_refuted_with_a_mode():
    refuted = certify_known_inertia(known_law(0.8, 10, synchronised=False), ARM, WORKSPACE, samples=20)
    assert refuted.verdict == "refuted"
    assert refuted.witness.growth_rate > 0
    assert certificate_from_json(refuted.to_json()).verify()


def test_faster_motion_is_not_covered(certificate):
    law, certified = certificate
    fast = Workspace.box([-1.0, 0.5], [1.0, 2.0], speed=30.0)
    assert not certify_known_inertia(law, [ARM, LOADED], fast, samples=30, quick=True).certified
    assert certified.evidence.rate < 5


def test_bad_input():
    with pytest.raises(UnsupportedLaw, match="has a constant M̂"):
        certify_known_inertia(make_tdc(inertia=[0.1, 0.1]), ARM, WORKSPACE)
    with pytest.raises(UnsupportedLaw, match="differ between the joints"):
        certify_known_inertia(known_law(natural_frequency=[10.0, 20.0]), ARM, WORKSPACE)
    with pytest.raises(UnsupportedLaw, match="workspace has no speeds"):
        certify_known_inertia(known_law(), ARM, Workspace.from_joint_limits(ARM))
    with pytest.raises(InvalidParameter, match="it has 3 joints, the law 2"):
        certify_known_inertia(known_law(), NLinkArm(), Workspace.box([0.0] * 3, [1.0] * 3, speed=1.0))
