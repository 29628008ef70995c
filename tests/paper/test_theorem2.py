"""Theorem 2 is met by nothing: its witness, on the form written out as printed, for numbers of all kinds."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from law_catalogue import make_tdc
from tampering import reread, rewritten
from tarc import estimators
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.numerics.ball_arithmetic import FLOATS
from tarc.paper import theorem2
from tarc.paper.theorem2 import (
    Theorem2Condition,
    Theorem2Evidence,
    Theorem2Part,
    check_theorem2,
    printed_theta,
    theta,
)

CONDITION = Theorem2Condition(delay=0.01, window=0.1, degree=2, beta=1.0, xi=3.0)


def printed_form(part, condition, sign=1.0):
    """Θ as the paper prints it, (8n, 8n), each block by its own formula; sign −1 for the (1,2) block of the proof."""
    K1, K2, P, D, L = part.K1, part.K2, part.P, part.D, part.L
    n, h, beta, xi = len(K1), condition.delay, condition.beta, condition.xi
    none, eye = np.zeros((n, n)), np.eye(n)
    A1, B1 = np.block([[none, eye], [none, none]]), np.block([[none, none], [-K1, -K2]])
    B = np.concatenate([none, eye])
    bar, breve = B @ np.concatenate([K2, none], axis=1), B @ np.concatenate([none, K2], axis=1)
    A, Di = A1 + B1, np.linalg.inv(D)
    Q = -(A.T @ P + P @ A)
    estimator = estimators.Algebraic(window=condition.window, degree=condition.degree)
    energy = quad(lambda psi: float(estimator.kernel(psi)) ** 2, -condition.window, 0, epsabs=0)[0]
    E = beta * P @ B1 @ (A1 @ Di @ A1.T + B1 @ Di @ B1.T + Di + bar @ Di @ bar.T) @ B1.T @ P
    F = (h**2 / beta * D + L) * condition.window * energy
    J = np.concatenate([np.zeros((2 * n, 2 * n)), np.eye(2 * n)], axis=1)
    wide = np.zeros((2 * n, 4 * n))
    return np.block(
        [
            [Q - E - (1 + xi) * h**2 / beta * D, sign * P @ breve, P @ bar @ J],
            [sign * breve.T @ P, (xi - 1) * h**2 / beta * D - F, wide],
            [J.T @ bar.T @ P, wide.T, J.T @ L @ J],
        ]
    )


def random_part(seed, n, spread=1.0):
    """Any real gains, and weights whose eigenvalues span decades."""
    rng = np.random.default_rng(seed)
    weights = []
    for _ in range(3):
        basis = np.linalg.qr(rng.normal(size=(2 * n, 2 * n)))[0]
        weight = basis @ np.diag(10 ** rng.uniform(-spread, spread, 2 * n)) @ basis.T
        weights.append((weight + weight.T) / 2)
    K1, K2 = (rng.normal(size=(n, n)) * 10 ** rng.uniform(-1, 2) for _ in range(2))
    P, D, L = weights
    return Theorem2Part(K1=K1, K2=K2, P=P, D=D, L=L)


@settings(max_examples=40)
@given(
    seed=st.integers(0, 10_000),
    n=st.integers(1, 3),
    logs=st.tuples(*[st.floats(-3, 0.5)] * 4),
    degree=st.integers(1, 5),
)
def test_refuted_whatever_the_numbers(seed, n, logs, degree):
    part = random_part(seed, n, spread=1.5)
    h, window, beta, above = (10**value for value in logs)
    condition = Theorem2Condition(delay=h, window=window, degree=degree, beta=beta, xi=1 + above)
    evidence = Theorem2Evidence(condition=condition, part=part, last_block_size=4 * n, last_block_rank=2 * n)
    verdict, margin, witness = evidence.judge()
    assert verdict == "refuted"
    assert margin < 0
    assert witness is not None
    e = witness.e
    for sign in (1.0, -1.0):
        vector = np.concatenate([e, -sign * e, np.zeros(4 * n)])
        assert vector @ printed_form(part, condition, sign) @ vector < 0


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("n", [1, 2])
def test_theta_is_the_printed_one_and_singular(n, degree):
    part, condition = random_part(n, n), replace(CONDITION, degree=degree)
    reduced = theta(part, condition, FLOATS)
    expected = printed_form(part, condition)
    np.testing.assert_allclose(printed_theta(reduced), expected, rtol=1e-7, atol=1e-9 * np.max(np.abs(expected)))
    assert reduced.shape == (6 * n, 6 * n)
    assert np.linalg.matrix_rank(expected) <= 6 * n
    assert np.linalg.matrix_rank(expected[4 * n :, 4 * n :]) == 2 * n


def test_trace_argument():
    """tr(P⁻¹S) = 2 tr A_b = 0 for any P and K1: no S is negative definite."""
    for seed in range(20):
        part = random_part(seed, 2)
        K1, P = part.K1, part.P
        A_b = np.block([[np.zeros((2, 2)), np.eye(2)], [-K1, np.zeros((2, 2))]])
        S = P @ A_b + A_b.T @ P
        assert abs(np.trace(np.linalg.solve(P, S))) < 1e-9 * np.linalg.norm(S) * np.linalg.norm(np.linalg.inv(P))
        assert np.linalg.eigvalsh(S)[-1] > 0


@pytest.mark.parametrize("weights", [{}, {"lyapunov_weight": 1.0}, {"D": 3.0, "L": [0.1, 2.0], "beta": 0.5, "xi": 2.0}])
@pytest.mark.parametrize("natural_frequency", [1.0, 10.0, 100.0])
def test_refuted_for_a_law(natural_frequency, weights):
    certificate = check_theorem2(make_tdc(natural_frequency=natural_frequency), **weights)
    assert certificate.verdict == "refuted"
    assert certificate.proof_grade
    assert certificate.verify()
    assert "Shown by: e (" in certificate.explain()
    assert "tr(P⁻¹S) = 2 tr A_b = 0" in certificate.explain()
    assert ("given weights" in certificate.claim) == bool(weights)


def test_the_program_finds_a_better_least_eigenvalue_than_plain_weights():
    def worst(certificate):
        evidence = certificate.evidence
        return np.linalg.eigvalsh(theta(evidence.part, evidence.condition, FLOATS) / np.trace(evidence.part.P))[0]

    law = make_tdc(natural_frequency=1.0)
    best, plain = worst(check_theorem2(law, window=1.0)), worst(check_theorem2(law, window=1.0, D=1.0))
    assert plain < best < 0


def test_a_coupled_law_and_many_joints():
    law = make_tdc(
        natural_frequency=None, inertia=np.eye(2), position_gain=[[9.0, 5.0], [-1.0, 4.0]], velocity_gain=[6.0, 4.0]
    )
    certificate = check_theorem2(law)
    assert certificate.verdict == "refuted"
    assert certificate.evidence.part.P.shape == (4, 4)
    many = check_theorem2(make_tdc(natural_frequency=10.0, inertia=0.1 * np.eye(30)))
    assert many.evidence.part.P.shape == (2, 2)
    assert many.evidence.last_block_size == 120
    assert many.evidence.last_block_rank == 60


def test_a_solver_that_fails_changes_nothing(monkeypatch):
    monkeypatch.setattr(theorem2, "solve_lmi", lambda *_: None)
    assert check_theorem2(make_tdc()).verdict == "refuted"


def test_json_round_trip_verifies_and_tampering_shows():
    certificate = check_theorem2(make_tdc())
    assert "NaN" not in certificate.to_json()
    assert reread(certificate).verify()
    for path, value in [
        ("verdict", "certified"),
        ("evidence.part.P", [[-1.0, 0.0], [0.0, 1.0]]),
        ("evidence.part.D", [[1.0]]),
        ("evidence.condition.xi", 0.5),
        ("evidence.condition.degree", 40),
    ]:
        assert not rewritten(certificate, path, value).verify()


@pytest.mark.parametrize(
    ("call", "message", "error"),
    [
        (lambda: check_theorem2("TDC"), "law: got str", UnsupportedLaw),  # type: ignore[arg-type]
        (
            lambda: check_theorem2(replace(make_tdc(), estimator=estimators.BackwardDifference())),
            "its estimator is BackwardDifference; this certificate is about the kernel of tarc.estimators.Algebraic",
            UnsupportedLaw,
        ),
        (lambda: check_theorem2(make_tdc(), window=0.0), "window: got 0", InvalidParameter),
        (lambda: check_theorem2(make_tdc(), L=-1.0), "L: its smallest eigenvalue is -1", InvalidParameter),
        (lambda: check_theorem2(make_tdc(), D=np.inf), "D: got inf", InvalidParameter),
        (lambda: check_theorem2(make_tdc(), xi=0.9), "xi: got 0.9", InvalidParameter),
        (lambda: check_theorem2(make_tdc(), beta=-1.0), "beta: got -1", InvalidParameter),
    ],
)
def test_bad_input(call, message, error):
    with pytest.raises(error, match=message):
        call()
