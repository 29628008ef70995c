"""Every certificate names a rate at which errors decay; no certified loop decays more slowly."""

from dataclasses import replace

import numpy as np
import pytest

from law_catalogue import make_law, make_tdc
from tampering import replaced, reread, scaled
from tarc import NominalInertia, laws
from tarc.analysis import Workspace
from tarc.analysis.known_inertia import KnownInertia
from tarc.analysis.linearise import decoupled_channels
from tarc.analysis.operating_points import OperatingPoint, UncertaintySamples, linearise_points, uncertainty_samples
from tarc.certificates import (
    certify_affine,
    certify_constant_ratio,
    certify_known_inertia,
    certify_robot,
    certify_sector,
    certify_varying_ratio,
)
from tarc.plants import TwoLinkArm

T = 1e-3
ARM = TwoLinkArm()
LOADED = ARM.with_parameters({"payload": 1.0})
BOX = Workspace.box([-1.0, 0.6], [1.0, 2.0], speed=1.0)


def matrices(law):
    """Return A, B, C of the loop of one joint, opened at its inertia ratio."""
    return decoupled_channels(law)[0].closed_loop(0.0)[:3]


def rate_of_frozen(law, ratio):
    A, B, C = matrices(law)
    return -np.log(np.abs(np.linalg.eigvals(A + ratio * B @ C)).max()) / T


def rate_of_product(steps, n_states, seed=0):
    """Return at which rate [1/s] the product of matrices shrinks, by the second half of its steps."""
    x = np.random.default_rng(seed).normal(size=(n_states, 4))
    sizes, start = [], 0.0
    for step in steps:
        x = step @ x
        size = np.linalg.norm(x)
        start, x = start + np.log(size), x / size
        sizes.append(start)
    half = len(sizes) // 2
    return -(sizes[-1] - sizes[half]) / (len(sizes) - 1 - half) / T


def mismatches(low, high, rng, n_steps):
    """Yield symmetric E of two joints with both ratios, turned now and then."""
    E = np.diag([low, high])
    for step in range(n_steps):
        if step % 300 == 0:
            angle = rng.uniform(0, np.pi)
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            E = turn @ np.diag(rng.choice([low, high], 2)) @ turn.T
        yield E


LITERAL = make_tdc()


@pytest.mark.parametrize("ratios", [0.08, (0.006, 0.2)])
def test_constant_ratio(ratios):
    verdict = certify_constant_ratio(LITERAL, ratios)
    low, high = np.broadcast_to(ratios, 2)
    slowest = min(rate_of_frozen(LITERAL, ratio) for ratio in np.geomspace(low, high, 40))
    assert 0.93 * slowest < verdict.evidence.decay_rate <= slowest
    assert f"e^(−{verdict.evidence.decay_rate:.3g} t)" in verdict.explain()
    assert reread(verdict).verify()
    assert not replaced(verdict, "decay_rate", 1.05 * slowest).verify()
    assert not replaced(verdict, "decay_rate", -1.0).verify()


def test_sector_against_slopes_that_switch():
    law = make_law(laws.TARC, 1, max_gain=6.0)
    verdict = certify_sector(law, 0.08, max_gain=0.5)
    evidence = verdict.evidence
    (loop,) = evidence.loops
    assert evidence.decay_rate > 1.0
    rng = np.random.default_rng(1)
    for interval in (1, 30, 4000):
        slopes = np.repeat(rng.choice([0.0, evidence.max_slope], 4000), interval)[:4000]
        steps = (loop.A - slope * loop.B @ loop.C for slope in slopes)
        assert rate_of_product(steps, len(loop.A)) >= evidence.decay_rate
    assert not replaced(verdict, "decay_rate", 2 * rate_of_frozen(law, 0.08)).verify()


@pytest.mark.parametrize("options", [{}, {"slope": 50.0}, {"rate": 20.0}, {"ratio_range": (0.03, 0.12)}])
def test_balls(options):
    verdict = certify_varying_ratio(LITERAL, **options)
    evidence, ball = verdict.evidence, verdict.evidence.ball
    low, high = ball.centre - ball.decay_radius, ball.centre + ball.decay_radius
    assert 0 < evidence.decay_rate < rate_of_frozen(LITERAL, low)
    if "ratio_range" in options:
        assert (low, high) == pytest.approx((0.03, 0.12), rel=0.5)
        assert evidence.decay_rate > 1.0
    A, B, C = (np.kron(part, np.eye(2)) for part in matrices(LITERAL))
    rng = np.random.default_rng(2)
    if "rate" not in options:
        steps = (A + B @ E @ C for E in mismatches(low, high, rng, 6000))
        assert rate_of_product(steps, len(A)) >= evidence.decay_rate
    assert reread(verdict).verify()
    assert not replaced(verdict, "ball.growth", float(np.exp(1.1 * T * rate_of_frozen(LITERAL, low)))).verify()
    assert not replaced(verdict, "ball.growth", 0.999).verify()
    assert not replaced(verdict, "ball.decay_radius", 1.1 * ball.radius).verify()


def test_affine():
    verdict = certify_affine(make_tdc(window=5), (0.02, 0.3), 10.0)
    slowest = min(rate_of_frozen(make_tdc(window=5), ratio) for ratio in np.geomspace(0.02, 0.3, 40))
    assert 0 < verdict.evidence.decay_rate <= slowest


def motion(plant, seed, n_steps=3000):
    """Return operating points along a motion within the box and its speeds."""
    rng = np.random.default_rng(seed)
    size, rate = np.array([0.9, 0.65]), np.array([1.0, 1.4])
    angles = rng.uniform(0, 6.28, 2) + rate * T * np.arange(n_steps)[:, None]
    path = [0.0, 1.3] + size * np.sin(angles), size * rate * np.cos(angles), -size * rate**2 * np.sin(angles)
    return [OperatingPoint(plant, *values) for values in zip(*path, strict=True)]


def steps_along(law, inertias, M, D, G):
    """Yield the matrices of the loop of all joints along a motion."""
    A, B, C = (np.kron(part, np.eye(2)) for part in matrices(law))
    position, speed = np.eye(2, len(A)), np.eye(2, len(A), 2) / T
    for nominal, inertia, damping, stiffness in zip(inertias, M, D, G, strict=True):
        yield A + B @ np.linalg.solve(inertia, nominal @ C - stiffness @ position - damping @ speed)


@pytest.mark.parametrize("plant", [ARM, LOADED], ids=["empty", "loaded"])
def test_robot(plant):
    law = make_tdc(5, True, 10.0, 0.2 * ARM.inertia([0.0, 1.5]))
    verdict = certify_robot(law, [ARM, LOADED], BOX, samples=20)
    rate = verdict.evidence.decay_rate
    assert rate is not None
    assert rate > 1.0
    assert reread(verdict).verify()
    points = motion(plant, 3)
    M, D, G = linearise_points(points)
    steps = steps_along(law, [law.M] * len(points), M, D, G)
    assert rate_of_product(steps, 2 * len(matrices(law)[0])) >= rate


def test_known_inertia():
    inertia = NominalInertia(ARM, 0.8, gravity=True, coriolis=True)
    law = make_tdc(6, True, 20.0, inertia)
    verdict = certify_known_inertia(law, [ARM, LOADED], BOX, samples=20, quick=True)
    evidence = verdict.evidence
    assert evidence.decay_rate > 1.0
    assert reread(verdict).verify()
    faster = replace(evidence, decay_growth=evidence.decay_growth**3)
    assert faster.judge().verdict == "inconclusive"
    known = KnownInertia(inertia)
    for plant in (ARM, LOADED):
        points = motion(plant, 4)
        steps = steps_along(law, known.inertias(points), *known.linearised(points))
        assert rate_of_product(steps, 2 * len(matrices(law)[0])) >= evidence.decay_rate


def test_viscous_friction_that_changes_at_any_time():
    """Any share of the robot's viscous friction is covered, and the loop decays with it as it says."""
    arms = [TwoLinkArm(viscous=[1.0, 0.6], payload=mass) for mass in (0.0, 1.0)]
    law = make_tdc(5, True, 10.0, 0.2 * ARM.inertia([0.0, 1.5]))
    verdict = certify_robot(law, arms, BOX, samples=20)
    evidence, ball = verdict.evidence, verdict.evidence.ball
    assert verdict.certified
    assert ball is not None
    assert reread(verdict).verify()
    assert not scaled(verdict, "points.largest_norm.damping", 1e3).verify()
    assert not scaled(verdict, "points.stiffest_moving.friction", 1e3).verify()
    points = motion(arms[1], 5, 2000)
    samples = uncertainty_samples(law.M, points)
    friction, lead_time = samples.friction, ball.loop.lead_periods.item() * law.period
    assert friction is not None
    assert np.linalg.norm(friction[0], 2) > 0.5
    M, D, G = linearise_points(points)
    rng = np.random.default_rng(6)
    for interval in (1, 100):
        shares = np.repeat(rng.choice([0.0, 0.5, 1.0], 2000), interval)[:2000, None, None]
        rubbed = UncertaintySamples(samples.inertia, samples.stiffness, samples.damping + shares * friction)
        assert rubbed.joint_norms(ball.centre, ball.position_weight, lead_time).max() < ball.decay_radius
        steps = steps_along(law, [law.M] * len(points), M, D + shares * np.diag([1.0, 0.6]), G)
        assert rate_of_product(steps, 2 * len(matrices(law)[0])) >= evidence.decay_rate
