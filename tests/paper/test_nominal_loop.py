"""The repaired Theorem 2 against the roots and the frequency response of the delay equation that it is about."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from law_catalogue import make_tdc
from tampering import rewritten
from tarc import estimators, laws
from tarc.certificates import certify_constant_ratio
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.paper import nominal_loop
from tarc.paper.nominal_loop import NominalLoop, _Program, check_nominal_loop, nominal_max_delay, nominal_max_window
from tarc.stored_certificates import certificate_from_json

NODES, WEIGHTS = np.polynomial.legendre.leggauss(20)


def tdc(natural_frequency: Any = 1.0, degree=2, joints=1, **options) -> laws.TDC:
    """With h = 0.01 and ς = 0.1 over a natural frequency of one."""
    estimator = estimators.Algebraic(window=0.1, degree=degree)
    gains = {"natural_frequency": natural_frequency} if natural_frequency else {}
    return laws.TDC(inertia=0.1 * np.eye(joints), period=0.01, estimator=estimator, **gains, **options)


def max_window(K1, K2, delay, degree):
    """Return the largest window of the whole program, without a split into parts."""
    return _Program(K1, K2, degree).max_value(
        lambda window: NominalLoop(delay=delay, window=window, degree=degree, decay_rate=0.0)
    )


def kernel_points(window, degree):
    """ψ and Ω_1(ψ) dψ, exact for polynomials."""
    psi = window / 2 * (NODES - 1)
    kernel = estimators.Algebraic(window=window, degree=degree).kernel(psi)
    return psi, kernel * WEIGHTS * window / 2


def rightmost_root(K1, K2, h, window, degree, points=24):
    """Largest real part of the roots of ë1 = −K1 e1(t−h) − K2 ∫Ω_1(ψ) e1(t−h+ψ)dψ: the generator collocated at
    Chebyshev nodes in [−h−ς, 0], the integral taken of the interpolating polynomial.
    """
    n, span = len(K1), h + window
    node = np.cos(np.pi * np.arange(points + 1) / points)
    end = np.where(np.arange(points + 1) % points == 0, 2.0, 1.0) * (-1.0) ** np.arange(points + 1)
    D = np.outer(end, 1 / end) / (node[:, None] - node + np.eye(points + 1))
    D -= np.diag(D.sum(axis=1))

    def at(theta):
        distance = 2 * theta / span + 1 - node
        if np.any(np.abs(distance) < 1e-14):
            return (np.abs(distance) < 1e-14).astype(float)
        row = 1 / end / distance
        return row / row.sum()

    psi, kernel = kernel_points(window, degree)
    held = at(-h)
    slope = sum(weight * at(p - h) for p, weight in zip(psi, kernel, strict=True))
    generator = np.kron(2 / span * D, np.eye(2 * n))
    generator[: 2 * n] = 0
    generator[:n, n : 2 * n] = np.eye(n)
    position = np.concatenate([np.eye(n), np.zeros((n, n))], axis=1)
    generator[n : 2 * n] = -np.kron(held, K1 @ position) - np.kron(slope, K2 @ position)
    return float(np.max(np.linalg.eigvals(generator).real))


def peak_gain(K1, K2, h, window, degree):
    """Largest gain from σ′ to e1 over a frequency sweep."""
    psi, kernel = kernel_points(window, degree)
    s = 1j * np.geomspace(1e-2, 10, 2000) * np.sqrt(np.linalg.norm(K1, 2))
    slope = np.exp(np.outer(s, psi)) @ kernel
    eye = np.eye(len(K1))
    loops = s[:, None, None] ** 2 * eye + np.exp(-s * h)[:, None, None] * (K1 + K2 * slope[:, None, None])
    return float(np.max(np.linalg.norm(np.linalg.inv(loops), 2, axis=(1, 2))))


def test_oracle_on_what_is_known_by_hand():
    """Without delay and window the roots are −1, −1; with s² + (2s + 1)e^(−0.6474 s), nearly, imaginary."""
    one, two = np.eye(1), 2 * np.eye(1)
    assert rightmost_root(one, two, 1e-4, 1e-4, 2) == pytest.approx(-1, abs=0.03)
    assert abs(rightmost_root(one, two, 0.6474, 1e-3, 2)) < 3e-3
    assert peak_gain(one, two, 1e-4, 1e-4, 2) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(("degree", "window"), [(1, 0.980), (2, 1.240), (3, 1.263)])
def test_known_windows(degree, window):
    """No law has degree 1, which gives no acceleration; the condition is about the velocity alone."""
    found = max_window(np.eye(1), 2 * np.eye(1), 0.01, degree)
    assert found == pytest.approx(window, abs=5e-4)
    if degree > 1:
        assert nominal_max_window(tdc(degree=degree)) == pytest.approx(found, rel=1e-5)


def test_window_and_delay_scale_with_the_natural_frequency():
    assert 10 * nominal_max_window(tdc(10.0), delay=0.001) == pytest.approx(nominal_max_window(tdc()), rel=1e-5)
    assert 10 * nominal_max_delay(tdc(10.0), window=0.01) == pytest.approx(nominal_max_delay(tdc()), rel=1e-5)


@settings(max_examples=15)
@given(
    natural_frequency=st.floats(0.5, 50.0),
    damping_ratio=st.floats(0.3, 2.0),
    degree=st.integers(2, 4),
    delay=st.floats(1e-3, 0.3),
    window=st.floats(0.01, 1.2),
    decay=st.sampled_from([0.0, 0.05, 0.2, 0.4]),
)
def test_certified_is_stable_as_fast_and_as_quiet_as_claimed(
    natural_frequency, damping_ratio, degree, delay, window, decay
):
    law = tdc(natural_frequency, degree, damping_ratio=damping_ratio)
    h, length, rate = delay / natural_frequency, window / natural_frequency, decay * natural_frequency
    certificate = check_nominal_loop(law, delay=h, window=length, decay_rate=rate)
    assert certificate.verify()
    assert certificate_from_json(certificate.to_json()).verify()
    assert certificate.proof_grade == certificate.certified
    if not certificate.certified:
        assert certificate.verdict == "inconclusive"
        return
    assert rightmost_root(law.K1, law.K2, h, length, degree) < -rate
    gain = certificate.evidence.peak_gain if decay else certificate.evidence.mean_square_gain
    assert gain is not None
    assert gain >= peak_gain(law.K1, law.K2, h, length, degree)


def test_gain_is_close_to_the_true_one_for_a_small_delay_and_window():
    certificate = check_nominal_loop(tdc(), delay=0.001, window=0.01)
    truth = peak_gain(tdc().K1, tdc().K2, 0.001, 0.01, 2)
    gain = certificate.evidence.mean_square_gain
    assert gain is not None
    assert truth <= gain < 1.01 * truth


@pytest.mark.parametrize("decay", [0.0, 0.3])
def test_the_longest_window_certifies_and_a_longer_one_does_not(decay):
    law = tdc()
    window = nominal_max_window(law, decay_rate=decay)
    assert check_nominal_loop(law, window=window, decay_rate=decay).certified
    assert check_nominal_loop(law, window=1.001 * window, decay_rate=decay).verdict == "inconclusive"
    assert rightmost_root(law.K1, law.K2, 0.01, window, 2) < -decay
    delay = nominal_max_delay(law, decay_rate=decay)
    assert check_nominal_loop(law, delay=delay, decay_rate=decay).certified
    assert check_nominal_loop(law, delay=1.001 * delay, decay_rate=decay).verdict == "inconclusive"
    assert rightmost_root(law.K1, law.K2, delay, 0.1, 2) < -decay


def test_no_window_for_a_decay_that_is_too_fast():
    assert nominal_max_window(tdc(), decay_rate=1.5) == 0.0
    assert nominal_max_delay(tdc(), decay_rate=1.5) == 0.0


@pytest.mark.parametrize("decay", [0.0, 1.0])
def test_coupled_gains(decay):
    K1, K2 = np.array([[100.0, 20.0], [-20.0, 80.0]]), np.array([[20.0, 1.0], [3.0, 25.0]])
    law = tdc(None, joints=2, position_gain=K1, velocity_gain=K2)
    certificate = check_nominal_loop(law, delay=0.005, window=0.03, decay_rate=decay)
    assert certificate.certified
    assert certificate.evidence.parts[0].P.shape == (4, 4)
    assert rightmost_root(K1, K2, 0.005, 0.03, 2) < -decay
    gain = certificate.evidence.peak_gain if decay else certificate.evidence.mean_square_gain
    assert gain is not None
    assert gain >= peak_gain(K1, K2, 0.005, 0.03, 2)


def test_decoupled_equals_the_full_program():
    K1, K2 = np.diag([100.0, 144.0]), np.diag([20.0, 24.0])
    full = max_window(K1, K2, 0.005, 2)
    law = tdc(None, joints=2, position_gain=K1, velocity_gain=K2)
    assert nominal_max_window(law, delay=0.005) == pytest.approx(full, rel=1e-4)
    one, many = check_nominal_loop(tdc()), check_nominal_loop(tdc(joints=30))
    assert (one.evidence.loop, one.evidence.gamma) == (many.evidence.loop, many.evidence.gamma)
    assert many.evidence.parts[0].P.shape == (2, 2)


def test_it_is_not_stability_of_the_loop_that_runs():
    """Feasible by far, while the literal loop at the very same numbers diverges; and the verdict says so."""
    law = make_tdc()
    certificate = check_nominal_loop(law)
    assert certificate.certified
    assert certificate.evidence.loop.window < 0.1 * nominal_max_window(law)
    running = certify_constant_ratio(law, 1.0)
    assert running.verdict == "refuted"
    assert running.evidence.findings.spectral_radius == pytest.approx(1.152, abs=5e-4)
    assert "not stability of the loop that runs" in certificate.claim
    assert "M⁻¹M̂(q̈_h − q̈̂_h)" in certificate.explain()


def test_a_solver_that_fails_certifies_nothing(monkeypatch):
    monkeypatch.setattr(nominal_loop, "solve_lmi", lambda *_: None)
    certificate = check_nominal_loop(tdc())
    assert certificate.verdict == "inconclusive"
    assert certificate.verify()
    assert "NaN" not in certificate.to_json()
    assert nominal_max_window(tdc()) == 0.0


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("evidence.loop.window", 2.0),
        ("evidence.loop.delay", 1.0),
        ("evidence.gamma", 0.5),
        ("evidence.loop.decay_rate", -1.0),
        ("evidence.loop.degree", 7),
        ("evidence.parts.0.P", [[1.0, 0.0], [0.0, -1.0]]),
        ("evidence.parts.0.R1", [[-1.0]]),
        ("evidence.parts.0.R2", [[0.0]]),
        ("evidence.parts.0.K2", [[0.1]]),
        ("verdict", "refuted"),
    ],
)
def test_tampering_shows(path, value):
    assert not rewritten(check_nominal_loop(tdc()), path, value).verify()


@pytest.mark.parametrize(
    ("call", "message", "error"),
    [
        (lambda: check_nominal_loop("TDC"), "law: got str", UnsupportedLaw),  # type: ignore[arg-type]
        (
            lambda: check_nominal_loop(replace(make_tdc(), estimator=estimators.BackwardDifference())),
            "its estimator is BackwardDifference",
            UnsupportedLaw,
        ),
        (lambda: check_nominal_loop(tdc(), window=-1.0), "window: got -1", InvalidParameter),
        (lambda: check_nominal_loop(tdc(), delay=np.nan), "delay: got nan", InvalidParameter),
        (lambda: check_nominal_loop(tdc(), decay_rate=-1.0), "decay_rate: got -1", InvalidParameter),
        (lambda: nominal_max_window(tdc(), delay=0.0), "delay: got 0", InvalidParameter),
        (lambda: nominal_max_delay(tdc(), window=0.0), "window: got 0", InvalidParameter),
    ],
)
def test_bad_input(call, message, error):
    with pytest.raises(error, match=message):
        call()
