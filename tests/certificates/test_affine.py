"""The affine certificate: the theory's spreads, V along attacks of the full loop, and forces within a period."""

from dataclasses import replace

import numpy as np
import pytest

from reference.law_parameters import PERIOD, LawParameters, draw_parameters
from reference.soundness_checks import check_affine
from reference.soundness_tally import Tally
from slow_cases import slow
from tampering import replaced, reread, scaled, without
from tarc.analysis.linearise import decoupled_channels
from tarc.analysis.uncertain_loop import UncertainLoop
from tarc.certificates import certify_affine
from tarc.certificates.affine import AffineProof, find_proof
from tarc.certificates.affine_form import RatioSet, decrease
from tarc.certificates.reduced_loop import CentredLoop, reduce_loop
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.laws import TDC
from tarc.numerics.matrix_polynomial import evaluate
from tarc.stored_certificates import certificate_from_dict

SYNCHRONISED, LITERAL = LawParameters(window=5, synchronised=True), LawParameters(window=5)

# spread certified at a rate [1/s], E constant within a period; and a range that has it
KNOWN = [
    slow(SYNCHRONISED, 1.0, 189, (0.01454, 2.75)),
    slow(SYNCHRONISED, 10.0, 185, (0.0148, 2.75)),
    (SYNCHRONISED, 100.0, 159.9, (0.0175, 2.8)),
    (SYNCHRONISED, 1000.0, 35.7, (0.07, 2.5)),
    slow(LITERAL, 1.0, 90, (0.005, 0.45)),
    slow(LITERAL, 100.0, 84, (0.0051, 0.43)),
    (LITERAL, 1000.0, 44.9, (0.008, 0.36)),
    slow(LawParameters(window=10, synchronised=True), 10.0, 101, (0.027, 2.75)),
]


@pytest.mark.parametrize(("design", "rate", "spread", "ratio_range"), KNOWN)
def test_known_spreads(design, rate, spread, ratio_range):
    certificate = certify_affine(design.law, ratio_range, rate, intersample=False)
    assert certificate.certified
    assert certificate.proof_grade
    assert certificate.evidence.ratio_spread >= spread
    assert certificate.margin == certificate.evidence.decay_rate


def ratio_set(**changes) -> RatioSet:
    none = np.zeros(0)
    plain = RatioSet(
        min_ratio=0.1,
        max_ratio=1.6,
        rate=20.0,
        relative_rate=20.0,
        period=PERIOD,
        intersample=True,
        powers=none,
        lead_times=none,
        stiffness=none,
        shares=none,
    )
    return replace(plain, **changes)


FORCES = {
    "powers": np.array([0.0, 0.5, 1.0]),
    "lead_times": np.array([0.02, 0.02, 0.02]),
    "stiffness": np.array([8.0, 8.0, 8.0]),
    "shares": np.array([0.01, 0.01, 0.01]),
}


@pytest.fixture(scope="module")
def proof() -> AffineProof:
    """Prove a law with a slope and one period of computation, with stiffness and damping."""
    (channel,) = decoupled_channels(SYNCHRONISED.law, 1)
    found = find_proof(UncertainLoop.from_channel(channel, 5.0, intersample=True), ratio_set(**FORCES))
    assert found is not None
    return found


def test_the_condition_on_a_dense_grid_without_balls(proof):
    ratios = proof.ratios
    forms = decrease(proof.loop, ratios, proof.matrices, proof.multipliers, proof.growth)
    P0, P1, Q1, S, R, _ = proof.matrices
    for form in (S - P1, S + P1, R - Q1, R + Q1):
        assert np.linalg.eigvalsh(form)[0] > 0
    for ratio in np.geomspace(ratios.min_ratio, ratios.max_ratio, 500):
        assert np.linalg.eigvalsh(P0 + (P1 + Q1) / ratio)[0] > 0
        assert np.linalg.eigvalsh(evaluate(forms, ratio))[0] > 0


def step(proof: AffineProof, x: np.ndarray, z: np.ndarray, E: list[np.ndarray], k: np.ndarray, slope: float):
    """One period of the full and the reduced loop in two joints; E and k in halves of the period."""
    loop, full, T = proof.loop.full.loop, proof.loop.full, PERIOD
    half = loop.half_slope.item()
    w = (half - slope) * x[0]
    v = (loop.C @ x)[0] + loop.D_robust.item() * (w - half * x[0])
    accelerations = [part @ (v + force) for part, force in zip(E, k, strict=True)]
    mean = sum(accelerations) / 2
    moment = 12**0.5 / 4 * (accelerations[0] - accelerations[1]) / 2
    inputs = [mean - full.centre * v, moment, full.centre * w]
    into = loop.B_robust @ (w - half * x[0])[None]
    next_x = loop.A @ x + into
    velocity = x[1] / T
    position = x[0]
    for acceleration in accelerations:  # exactly, half a period each
        position = position + velocity * T / 2 + acceleration * T**2 / 8
        velocity = velocity + acceleration * T / 2
    next_x[0], next_x[1] = position, velocity * T
    return next_x, proof.loop.A @ z + proof.loop.B @ np.array(inputs)


def value(proof: AffineProof, x: np.ndarray, z: np.ndarray, E: np.ndarray) -> float:
    P0, P1, Q1 = proof.matrices[:3]
    xi = np.concatenate([x, z - proof.loop.projection @ x])
    plain = np.sum(z * (P0 @ z)) + np.sum(z * ((P1 + Q1) @ z @ np.linalg.inv(E)))
    return float(plain + proof.multipliers.error * np.sum(xi * (proof.loop.storage @ xi)))


@pytest.mark.parametrize("seed", range(3))
def test_v_falls_along_attacks_of_the_full_loop(proof, seed):
    """A rotating E, halves of a period apart, forces at their limit and a switching slope, in two joints."""
    rng, ratios = np.random.default_rng(seed), proof.ratios
    low, high = ratios.min_ratio, ratios.max_ratio
    x = rng.normal(size=(len(proof.loop.full.loop.A), 2))
    z = proof.loop.projection @ x
    # the fastest rotation: ‖dJ/dt‖ = ω (1/low − 1/high) and, relative to J, ω (high − low)/√(low high)
    spread = 1 / low - 1 / high
    speed = min(ratios.rate / spread, ratios.relative_rate * (low * high) ** 0.5 / (high - low)) * rng.uniform(0.5, 1)
    angle = rng.uniform(0, np.pi)

    def mismatch(turn: float) -> np.ndarray:
        c, s = np.cos(turn), np.sin(turn)
        return np.array([[c, -s], [s, c]]) @ np.diag([low, high]) @ np.array([[c, s], [-s, c]])

    before = None
    for _ in range(300):
        halves = [mismatch(angle + speed * PERIOD * share) for share in (0.25, 0.75)]
        mean = (halves[0] + halves[1]) / 2
        size = min(ratios.stiffness) * np.hypot(np.linalg.norm(x[0]), 0.02 * np.linalg.norm(x[1] / PERIOD))
        push = np.array([rng.normal(size=2) for _ in range(2)])
        k = [0.9 * size * part / np.linalg.norm(part) / max(high, 1.0) for part in push]
        now = value(proof, x, z, mean)
        if before is not None:
            assert now < before * proof.growth**-2
        before = now
        x, z = step(proof, x, z, halves, np.array(k), rng.choice([0.0, 5.0]))
        angle += speed * PERIOD
    assert before is not None


@pytest.mark.parametrize("n_designs", [slow(24)])
def test_no_attack_within_the_rate_breaks_a_certified_design(n_designs):
    rng, tally = np.random.default_rng(7), Tally()
    check_affine([draw_parameters(rng) for _ in range(n_designs)], rng, tally, 1200, lambda: None)
    assert tally.violations == []
    assert tally.certified > n_designs / 8


def test_the_error_of_a_reduced_loop_is_bounded():
    """A window of 12 periods in 9 states: outputs of both loops for random inputs."""
    design = LawParameters(window=12, synchronised=True)
    loop = UncertainLoop.from_channel(decoupled_channels(design.law)[0], 0.0, intersample=True)
    reduced = reduce_loop(CentredLoop(loop=loop, centre=0.8, scales=np.array([1.0])), 9)
    assert reduced is not None
    stored = reduced.with_storage(1.0)
    assert stored is not None
    assert stored.error_is_bounded(1.0)
    assert not replace(stored, error_gain=stored.error_gain / 10).error_is_bounded(1.0)
    assert not stored.error_is_bounded(1.1)
    A, B, C, _ = reduced.full.matrices()
    assert len(reduced.A) < len(A) / 2
    for angle in (0.01, 0.1, 0.5, 2.0):
        z = np.exp(1j * angle)
        full = C @ np.linalg.solve(z * np.eye(len(A)) - A, B)
        other = reduced.C @ np.linalg.solve(z * np.eye(len(reduced.A)) - reduced.A, reduced.B)
        assert np.linalg.norm(full - other, 2) < reduced.error_gain


def test_force_bounds_against_a_finely_cut_period():
    """The mean square of (q, θ q̇) over a period, of motions with accelerations that the bound allows."""
    rng, n = np.random.default_rng(5), 400
    t = (np.arange(n) + 0.5) / n * PERIOD
    for _ in range(50):
        ratios = ratio_set(
            **FORCES | {"lead_times": rng.uniform(0, 0.1, 3), "stiffness": rng.uniform(1, 300, 3)},
            lag_weights=rng.uniform(0, 3, 3),
            max_ratio=1.0,
        )
        q, velocity, v = rng.normal(), rng.normal() * 30, rng.normal() * 3000
        past = q + rng.normal()
        e = 1 + rng.uniform(-1, 1) * ratios.swing * np.sign(t - rng.uniform(0, PERIOD))
        for power, lead, kappa, lag, (size, squared_lead, within, squared_lag) in zip(
            ratios.powers,
            ratios.lead_times,
            ratios.stiffness,
            ratios.lags(),
            ratios.force_bounds(),
            strict=True,
        ):
            position, rate, force = np.empty(n), np.empty(n), np.empty(n)
            state, sign = np.array([q, velocity]), rng.choice([-1.0, 1.0])
            for i in range(n):
                position[i], rate[i] = state
                force[i] = sign * kappa * np.linalg.norm([state[0], lead * state[1], lag * (state[0] - past)])
                acceleration = e[i] * (v + force[i])
                state = state + np.array([state[1] + acceleration * PERIOD / n / 2, acceleration]) * PERIOD / n
            mean_e = e.mean()
            mean = np.mean(e * (v + force))
            steady = q + velocity * t + mean * t**2 / 2, velocity + mean * t
            squares = np.mean(steady[0] ** 2 + squared_lead * PERIOD**2 * steady[1] ** 2)
            squares += squared_lag * np.mean((steady[0] - past) ** 2)
            k = e * force / mean_e
            assert mean_e ** (2 - 2 * power) * np.mean(k**2) <= (size * squares + within * mean_e * v**2) * (1 + 1e-2)


def test_json_round_trip_verifies_and_tampering_shows():
    certificate = certify_affine(SYNCHRONISED.law, (0.05, 2.0), 10.0, slope=5.0)
    assert certificate.certified
    assert reread(certificate).verify()
    assert reread(certificate).to_dict() == certificate.to_dict()
    for name, factor in {
        "max_ratio": 1.01,
        "rate": 1.01,
        "slope": 1.01,
        "proof.ratios.max_ratio": 2.0,
        "proof.ratios.min_ratio": 0.2,
        "proof.ratios.period": 1.1,
        "proof.ratios.rate": np.nan,
        "proof.ratios.relative_rate": 0.5,
        "proof.matrices.P0": -1.0,
        "proof.matrices.S": 1e-3,
        "proof.multipliers.error": 1e6,
        "proof.growth": 1.1,
        "proof.loop.A": 1.1,
        "proof.loop.error_gain": 1e-3,
        "proof.loop.storage": -1.0,
        "proof.loop.full.loop.B_mismatch": 0.5,
        "proof.loop.full.loop.C": 3.0,
        "proof.loop.full.loop.half_slope": 5.0,
    }.items():
        assert not scaled(certificate, name, factor).verify(), name
    assert not replaced(certificate, "proof", None).verify()
    with pytest.raises(InvalidParameter, match="cannot read it"):
        certificate_from_dict(without(certificate, "proof.matrices"))


def test_what_is_unstable_or_too_fast_is_inconclusive():
    for ratio_range, rate in (((0.014, 2.0), 1.0), ((0.05, 2.0), 1e6), ((0.02, 2.8), 2000.0)):
        certificate = certify_affine(SYNCHRONISED.law, ratio_range, rate)
        assert certificate.verdict == "inconclusive"
        assert certificate.evidence.proof is None
        assert certificate.verify()


def test_bad_input():
    for ratio_range, rate in (((0.0, 1.0), 1.0), ((2.0, 1.0), 1.0), ((0.1, 1.0), -1.0), ((0.1, 1.0), np.nan)):
        with pytest.raises(InvalidParameter):
            certify_affine(SYNCHRONISED.law, ratio_range, rate)
    uneven = TDC(
        inertia=[0.1, 0.1],
        natural_frequency=[10.0, 12.0],
        period=PERIOD,
        estimator=SYNCHRONISED.law.estimator,
    )
    with pytest.raises(UnsupportedLaw, match="joints' gains differ"):
        certify_affine(uneven, (0.1, 1.0), 1.0)


def test_the_first_proof_takes_fewer_programs_and_may_decay_slower():
    wanted = certify_affine(SYNCHRONISED.law, (0.05, 2.5), 100.0, slope=5.0).evidence.proof
    assert wanted is not None
    programs: list[int] = []
    found = find_proof(wanted.loop.full.loop, wanted.ratios, lambda: programs.append(1), first=True)
    assert len(programs) == 1
    assert found is not None
    assert found.is_proven()
    assert 1 < found.growth < wanted.growth
