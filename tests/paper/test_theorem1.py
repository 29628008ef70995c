"""Theorem 1 against the exact margin of its equation, simulations, and its own other forms."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from law_catalogue import make_tdc
from tampering import rewritten
from tarc import laws
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.numerics.ball_arithmetic import FLOATS
from tarc.numerics.lmi import solve_lmi
from tarc.paper import theorem1
from tarc.paper.law_parts import independent_parts
from tarc.paper.theorem1 import Theorem1Condition, Theorem1Part, _Program, check_theorem1, psi, theorem1_max_delay
from tarc.paper.ultimate_bound import ultimate_bound
from tarc.stored_certificates import certificate_from_json


def tdc(natural_frequency: Any = 1.0, joints=1, **options):
    return make_tdc(natural_frequency=natural_frequency, inertia=0.1 * np.eye(joints), **options)


def coupled_tdc(K1, K2) -> laws.TDC:
    return make_tdc(natural_frequency=None, inertia=0.1 * np.eye(len(K1)), position_gain=K1, velocity_gain=K2)


def rightmost_root(K1, K2, h, points=20):
    """Largest real part of the roots of ė = A1 e + B1 e_h: the generator of the delay equation collocated at Chebyshev
    nodes in [−h, 0].
    """
    n = len(K1)
    node = np.cos(np.pi * np.arange(points + 1) / points)
    end = np.where(np.arange(points + 1) % points == 0, 2.0, 1.0) * (-1.0) ** np.arange(points + 1)
    D = np.outer(end, 1 / end) / (node[:, None] - node + np.eye(points + 1))
    D -= np.diag(D.sum(axis=1))
    generator = np.kron(2 / h * D, np.eye(2 * n))
    generator[: 2 * n] = 0
    generator[:n, n : 2 * n] = np.eye(n)
    generator[n : 2 * n, -2 * n :] = -np.concatenate([K1, K2], axis=1)
    return float(np.max(np.linalg.eigvals(generator).real))


def exact_delay_margin(natural_frequency, damping_ratio):
    """Return the delay where s² + (k2 s + k1) e^(−sh) first has roots ± jω: ω⁴ = k1² + k2²ω², ωh = arctan(k2ω/k1)."""
    k1, k2 = natural_frequency**2, 2 * damping_ratio * natural_frequency
    omega = np.sqrt((k2**2 + np.sqrt(k2**4 + 4 * k1**2)) / 2)
    return np.arctan2(k2 * omega, k1) / omega


def simulate_delay_equation(h, start, drive, duration, steps=20):
    """ė = A1 e + B1 e_h + B σ1 for ωn = ζ = 1 by the method of steps; σ1 = drive(i, e)."""
    dt, count = h / steps, round(duration / h * steps)
    e = np.zeros((count + 1, 2))
    e[0] = start

    def slope(now, past, push):
        return np.array([now[1], push - past[0] - 2 * past[1]])

    for i in range(count):
        past = [e[i + j - steps] if i + j >= steps else np.zeros(2) for j in (0, 1)]
        push = drive(i, e[i])
        a = slope(e[i], past[0], push)
        b = slope(e[i] + dt / 2 * a, (past[0] + past[1]) / 2, push)
        c = slope(e[i] + dt / 2 * b, (past[0] + past[1]) / 2, push)
        d = slope(e[i] + dt * c, past[1], push)
        e[i + 1] = e[i] + dt / 6 * (a + 2 * b + 2 * c + d)
    return e


def test_oracles_agree_on_the_exact_margin():
    assert exact_delay_margin(1.0, 1.0) == pytest.approx(0.6474, abs=5e-5)
    K1, K2 = np.eye(1), 2 * np.eye(1)
    assert abs(rightmost_root(K1, K2, exact_delay_margin(1.0, 1.0))) < 1e-9
    assert rightmost_root(K1, K2, 0.64) < 0 < rightmost_root(K1, K2, 0.65)


def test_known_delays():
    assert theorem1_max_delay(tdc()) == pytest.approx(0.24543, abs=1e-5)
    assert theorem1_max_delay(tdc(), disturbance_term=False) == pytest.approx(0.27081, abs=1e-5)


def test_without_the_disturbance_term_the_delay_scales_with_the_natural_frequency_and_as_printed_it_does_not():
    """As printed, D⁻¹ adds a term with another unit of time."""
    free = [theorem1_max_delay(tdc(w), disturbance_term=False) * w for w in (0.1, 1.0, 30.0)]
    np.testing.assert_allclose(free, free[1], rtol=1e-6)
    printed = [theorem1_max_delay(tdc(w)) * w for w in (0.1, 1.0, 30.0)]
    assert printed[0] < 0.06
    assert 0.9 * free[1] < printed[1] < printed[2] < free[1]


@settings(max_examples=10)
@given(st.floats(0.5, 100.0), st.floats(0.1, 3.0), st.booleans())
def test_certified_is_stable(natural_frequency, damping_ratio, term):
    """The longest certified delay is below the exact margin, and certifies; a little more does not."""
    law = tdc(natural_frequency, damping_ratio=damping_ratio)
    h = theorem1_max_delay(law, disturbance_term=term)
    assert 0 < h < exact_delay_margin(natural_frequency, damping_ratio)
    assert rightmost_root(law.K1, law.K2, h) < 0
    certificate = check_theorem1(law, delay=h, disturbance_term=term)
    assert certificate.certified
    assert certificate.proof_grade
    assert certificate.verify()
    beyond = check_theorem1(law, delay=1.001 * h, disturbance_term=term)
    assert beyond.verdict == "inconclusive"
    assert beyond.verify()
    assert beyond.evidence.parts == ()


def test_decoupled_equals_the_full_program():
    position_gain = np.diag([100.0, 100.0, 225.0])
    law = coupled_tdc(position_gain, 2 * np.sqrt(position_gain))
    assert len(independent_parts(law)) == 2
    full = _Program(law.K1, law.K2, None, True).max_delay()
    assert theorem1_max_delay(law) == pytest.approx(full, rel=1e-5)


def test_rotated_gains_give_what_they_give_unrotated():
    """Without the disturbance term the condition does not see an orthogonal change of joints."""
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    omega = np.diag([8.0, 10.0, 15.0])
    law = coupled_tdc(turn @ omega**2 @ turn.T, 2 * turn @ omega @ turn.T)
    assert len(independent_parts(law)) == 1
    assert theorem1_max_delay(law) == pytest.approx(theorem1_max_delay(tdc(15.0)), rel=1e-3)
    certificate = check_theorem1(law)
    assert certificate.certified
    assert certificate_from_json(certificate.to_json()).verify()


def test_many_joints_cost_and_give_what_one_does(monkeypatch):
    programs: list[list[int]] = []

    def counted(sizes, conditions):
        programs.append(sizes)
        return solve_lmi(sizes, conditions)

    monkeypatch.setattr(theorem1, "solve_lmi", counted)
    single = check_theorem1(tdc(10.0))
    of_one = programs.copy()
    programs.clear()
    certificate = check_theorem1(tdc(10.0, joints=30))
    assert programs == of_one
    assert certificate.evidence.parts[0].P.shape == (2, 2)
    assert certificate.margin == single.margin


def test_psi_is_the_printed_one():
    """Against the formula written out, for full matrices."""
    rng = np.random.default_rng(3)
    n, h, beta, xi = 2, 0.03, 0.7, 1.2
    K1, K2 = (np.diag([9.0, 4.0]) + 0.3 * rng.normal(size=(n, n)) for _ in range(2))
    R, S = rng.normal(size=(2, 4, 4))
    P, D = R @ R.T + np.eye(4), S @ S.T + np.eye(4)
    A1, B1 = np.zeros((4, 4)), np.zeros((4, 4))
    A1[:2, 2:], B1[2:, :2], B1[2:, 2:] = np.eye(2), -K1, -K2
    Di, A = np.linalg.inv(D), A1 + B1
    E = beta * P @ B1 @ (A1 @ Di @ A1.T + B1 @ Di @ B1.T + Di) @ B1.T @ P
    condition = Theorem1Condition(delay=h, beta=beta, xi=xi, disturbance_term=True)
    first, second = psi(Theorem1Part(K1=K1, K2=K2, P=P, D=D), condition, FLOATS)
    np.testing.assert_allclose(first, -(A.T @ P + P @ A) - E - (1 + xi) * h**2 / beta * D)
    np.testing.assert_allclose(second, (xi - 1) * h**2 / beta * D)


def test_given_numbers_are_certified_or_refuted_with_a_vector():
    good = check_theorem1(tdc(), delay=0.01, lyapunov_weight=1.0, D=100.0)
    assert good.certified
    assert good.verify()
    bad = check_theorem1(tdc(), delay=0.26, lyapunov_weight=1.0, D=1.0, xi=1.1, beta=2.0)
    assert bad.verdict == "refuted"
    assert bad.proof_grade
    assert "the given Q and D" in bad.claim
    assert bad.witness is not None
    e, part = bad.witness.e, bad.evidence.parts[0]
    assert e @ psi(part, bad.evidence.condition, FLOATS)[0] @ e < 0
    assert certificate_from_json(bad.to_json()).verify()
    # P is that of the given Q
    A = tdc().A
    np.testing.assert_allclose(A.T @ part.P + part.P @ A, -np.eye(2), atol=1e-12)


def test_given_weight_alone_leaves_D_to_be_found():
    certificate = check_theorem1(tdc(), delay=0.05, lyapunov_weight=[1.0, 2.0])
    assert certificate.certified
    P, A = certificate.evidence.parts[0].P, tdc().A
    np.testing.assert_allclose(A.T @ P + P @ A, -np.diag([1.0, 2.0]), atol=1e-12)
    assert check_theorem1(tdc(), delay=0.24, lyapunov_weight=1.0).verdict == "inconclusive"


@pytest.mark.parametrize("term", [True, False])
def test_ultimate_bound_holds_against_the_worst_disturbance(term):
    """Bang-bang after the impulse response reaches the largest error that any |σ1| ≤ c can; so does not feedback."""
    h, c, steps, duration = 0.1, 0.5, 20, 20.0
    certificate = check_theorem1(tdc(), delay=h, disturbance_term=term)
    bound = ultimate_bound(certificate, c)
    impulse = simulate_delay_equation(h, [0.0, 1.0], lambda i, e: 0.0, duration)
    signs = np.sign(impulse[::-1])
    P = certificate.evidence.parts[0].P
    runs = [
        simulate_delay_equation(h, [0.0, 0.0], lambda i, e, k=k: c * signs[i, k], duration, steps) for k in (0, 1)
    ] + [simulate_delay_equation(h, [0.0, 0.0], lambda i, e: c * np.sign(P[1] @ e) if i else c, duration, steps)]
    worst_position = c * np.sum(np.abs(impulse[:, 0])) * h / steps
    assert runs[0][-1, 0] == pytest.approx(worst_position, rel=1e-2)
    assert worst_position < bound.position < 10 * worst_position
    assert max(np.max(np.linalg.norm(run, axis=1)) for run in runs) < bound.error
    assert bound.decay_rate > 0
    assert ultimate_bound(certificate, 2 * c).position == pytest.approx(2 * bound.position)
    part = certificate.evidence.parts[0]
    if term:
        narrow = min(np.linalg.eigvalsh(form)[0] for form in psi(part, certificate.evidence.condition, FLOATS))
        r, iota, Gamma = bound.printed_radius, np.linalg.norm(P[1]), h**2 * c**2 * part.D[1, 1]
        assert narrow * r**2 == pytest.approx(Gamma + 2 * iota * c * r)


def test_ultimate_bound_of_identical_joints_is_that_of_one():
    one, many = (ultimate_bound(check_theorem1(tdc(10.0, joints=n)), 1.0) for n in (1, 5))
    assert one == many
    mixed = ultimate_bound(check_theorem1(tdc([10.0, 20.0], joints=2)), 1.0)
    assert mixed.position >= 0.8 * one.position


def test_says_that_it_is_conditional():
    text = check_theorem1(tdc()).explain()
    for part in ("‖σ1‖ ≤ c for all time", "neither the sampled loop", "sufficient only", "decided in ball arithmetic"):
        assert part in text


def test_a_solver_that_fails_certifies_nothing(monkeypatch):
    monkeypatch.setattr(theorem1, "solve_lmi", lambda *_: None)
    certificate = check_theorem1(tdc())
    assert certificate.verdict == "inconclusive"
    assert certificate.verify()
    assert "NaN" not in certificate.to_json()
    assert theorem1_max_delay(tdc()) == 0.0


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("evidence.condition.delay", 0.4),
        ("evidence.condition.xi", 5.0),
        ("evidence.condition.xi", 1.0),
        ("evidence.parts.0.P", [[1.0, 0.0], [0.0, 1.0]]),
        ("evidence.parts.0.P", [[1.0, 0.2], [0.1, 1.0]]),
        ("evidence.parts.0.D", [[-1.0, 0.0], [0.0, 1.0]]),
        ("evidence.parts.0.D", [[0.0, 0.0], [0.0, 0.0]]),
        ("evidence.parts.0.K1", [[9.0]]),
        ("evidence.parts.0.K1", [[1.0, 0.0], [0.0, 1.0]]),
        ("evidence.parts.0.P", [[1e400, 0.0], [0.0, 1.0]]),
        ("verdict", "refuted"),
    ],
)
def test_tampering_shows(path, value):
    assert not rewritten(check_theorem1(tdc(), delay=0.2), path, value).verify()


@pytest.mark.parametrize(
    ("call", "message", "error"),
    [
        (lambda: check_theorem1("TDC"), "law: got str; needs a law on time-delay estimation", UnsupportedLaw),  # type: ignore[arg-type]
        (lambda: theorem1_max_delay(3), "law: got int", UnsupportedLaw),  # type: ignore[arg-type]
        (lambda: check_theorem1(tdc(), delay=0.0), "delay: got 0", InvalidParameter),
        (
            lambda: check_theorem1(tdc(), lyapunov_weight=[[1.0, 2.0], [2.0, 1.0]]),
            "lyapunov_weight: its smallest eigenvalue is -1",
            InvalidParameter,
        ),
        (lambda: check_theorem1(tdc(), lyapunov_weight=1.0, D=[1.0, np.nan]), "D: got nan", InvalidParameter),
        (
            lambda: check_theorem1(tdc(), lyapunov_weight=1.0, D=-1.0),
            "D: its smallest eigenvalue is -1",
            InvalidParameter,
        ),
        (
            lambda: check_theorem1(tdc(), lyapunov_weight=1.0, D=1.0, xi=1.0),
            "xi: got 1; needs a finite number above 1",
            InvalidParameter,
        ),
        (lambda: check_theorem1(tdc(), lyapunov_weight=1.0, D=1.0, beta=0.0), "beta: got 0", InvalidParameter),
        (lambda: check_theorem1(tdc(), D=1.0), "lyapunov_weight: missing", InvalidParameter),
        (lambda: check_theorem1(tdc(), xi=1.5), "beta, xi: given without D", InvalidParameter),
        (
            lambda: ultimate_bound(check_theorem1(tdc(), delay=0.5), 1.0),
            "certificate: got one of theorem1 that is inconclusive",
            InvalidParameter,
        ),
        (lambda: ultimate_bound(check_theorem1(tdc(), delay=0.1), -1.0), "disturbance_bound: got -1", InvalidParameter),
    ],
)
def test_bad_input(call, message, error):
    with pytest.raises(error, match=message):
        call()


def test_constants_of_the_ultimate_bound_are_the_papers():
    """ι = ‖BᵀP‖ and Γ1 = h²c²‖BᵀDB‖/β from the stored matrices; with them the printed radius."""
    certificate = check_theorem1(make_tdc(natural_frequency=5.0), delay=0.02)
    found = ultimate_bound(certificate, 2.0)
    P, D = certificate.evidence.parts[0].P, certificate.evidence.parts[0].D
    assert found.iota == pytest.approx(np.linalg.norm(P[1:]), rel=1e-12)
    assert found.gamma == pytest.approx(0.02**2 * 4.0 * D[1, 1] / certificate.evidence.condition.beta, rel=1e-12)
    assert 0 < found.psi_share < 1
    r = found.printed_radius
    least = (found.gamma + 2 * found.iota * 2.0 * r) / r**2
    blocks = psi(certificate.evidence.parts[0], certificate.evidence.condition, FLOATS)
    assert least == pytest.approx(min(np.linalg.eigvalsh(block)[0] for block in blocks), rel=1e-9)
