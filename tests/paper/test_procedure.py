"""The paper's procedure against numbers known independently, and where it must not end."""

import numpy as np
import pytest

from tarc.core.errors import InvalidParameter
from tarc.paper.procedure import exact_delay, run_procedure


def steps_by_symbol(procedure):
    return {step.name.split()[0].rstrip(","): step for step in procedure.steps}


def test_known_delays_at_one_radian_per_second():
    found = steps_by_symbol(run_procedure(1.0))["h"].values
    assert found["largest by Theorem 1 [s]"] == pytest.approx(0.2454, abs=5e-5)
    assert found["stability limit of the equation [s]"] == pytest.approx(0.6474, abs=5e-5)


@pytest.mark.parametrize(("natural_frequency", "scaled"), [(0.1, 0.0587), (10.0, 0.2705), (100.0, 0.2708)])
def test_delay_times_natural_frequency(natural_frequency, scaled):
    """As printed the condition does not scale with the natural frequency; the equation does."""
    found = steps_by_symbol(run_procedure(natural_frequency, delay=1e-3 / natural_frequency))["h"].values
    assert natural_frequency * found["largest by Theorem 1 [s]"] == pytest.approx(scaled, abs=6e-5)
    assert natural_frequency * found["stability limit of the equation [s]"] == pytest.approx(0.6474, abs=5e-5)


def test_exact_delay_is_where_a_root_reaches_the_axis():
    law = run_procedure(7.0, damping_ratio=0.6).law
    h, k1, k2 = exact_delay(law), 49.0, 8.4
    w = np.linspace(0.1, 60, 600001)
    distance = np.abs(-(w**2) + (1j * k2 * w + k1) * np.exp(-1j * w * h))
    assert distance.min() < 1e-2
    assert np.abs(-(w**2) + (1j * k2 * w + k1) * np.exp(-1j * w * 0.9 * h)).min() > 1.0


def test_usual_choice():
    procedure = run_procedure(10.0)
    found = steps_by_symbol(procedure)
    np.testing.assert_allclose(found["K1"].values["K1 [1/s²]"], 100.0)
    np.testing.assert_allclose(found["K1"].values["K2 [1/s]"], 20.0)
    verdicts = [(certificate.kind, certificate.verdict) for certificate in procedure.certificates]
    assert verdicts == [
        ("theorem1", "certified"),
        ("c2", "certified"),
        ("theorem2", "refuted"),
        ("nominal", "certified"),
        ("constant_ratio", "refuted"),
        ("constant_ratio", "certified"),
    ]
    assert found["M̂"].values["spectral radius"] == pytest.approx(1.152, abs=5e-4)
    ends = [float(found["M̂"].values[name]) for name in ("least stable ρ", "greatest stable ρ")]
    np.testing.assert_allclose(ends, [0.00486, 0.2616], rtol=2e-3)
    ends = [float(found["M̂"].values[f"{name} with averaged torque"]) for name in ("least", "greatest")]
    np.testing.assert_allclose(ends, [0.0255, 2.815], rtol=2e-3)
    assert found["ς"].values["largest ς [s]"] == pytest.approx(0.1240, abs=5e-5)


def test_values_found_meet_psi():
    """Ψ rebuilt here from the equation, at the values of the step."""
    procedure = run_procedure(3.0, damping_ratio=0.8, delay=0.01)
    values, K1, K2, h = steps_by_symbol(procedure)["P"].values, 9.0, 4.8, 0.01
    beta, xi = values["β"], values["ξ"]
    part = procedure.theorem1.evidence.parts[0]
    P, D = part.P, part.D
    A1, B1 = np.array([[0.0, 1], [0, 0]]), np.array([[0.0, 0], [-K1, -K2]])
    Q, inverse = -((A1 + B1).T @ P + P @ (A1 + B1)), np.linalg.inv(D)
    E = beta * P @ B1 @ (A1 @ inverse @ A1.T + B1 @ inverse @ B1.T + inverse) @ B1.T @ P
    assert np.linalg.eigvalsh(Q - E - (1 + xi) * h**2 / beta * D)[0] > 0
    assert xi > 1
    assert np.linalg.eigvalsh(D)[0] > 0


@pytest.mark.parametrize("delay", [1e-3, 0.01, 0.05])
@pytest.mark.parametrize(("natural_frequency", "damping_ratio"), [(1.0, 1.0), (20.0, 0.5), (5.0, 3.0)])
def test_theorem_2_is_refuted_always_and_all_certificates_verify(natural_frequency, damping_ratio, delay):
    procedure = run_procedure(natural_frequency, damping_ratio=damping_ratio, delay=delay)
    assert procedure.theorem2.verdict == "refuted"
    assert procedure.theorem2.witness
    assert steps_by_symbol(procedure)["L"].values["Θ at (e, −e, 0)"] < 0
    assert not procedure.is_complete
    assert all(one.verify() for one in procedure.certificates)


def test_too_large_a_delay_is_said_with_the_largest():
    procedure = run_procedure(1.0, delay=0.3)
    step = steps_by_symbol(procedure)["h"]
    assert step.outcome == "too large"
    assert "h is too large: Theorem 1 certifies up to 0.2454 s" in procedure.explain()
    assert "still stable" in step.meaning
    assert procedure.theorem1.verdict == "inconclusive"
    share = step.values["share of ωn that Theorem 1 certifies"]
    assert run_procedure(share, delay=0.3).theorem1.certified
    assert not run_procedure(share + 0.005, delay=0.3).theorem1.certified


def test_beyond_the_equations_own_margin():
    procedure = run_procedure(1.0, delay=0.7)
    assert "unstable as well" in steps_by_symbol(procedure)["h"].meaning
    assert "no lower natural frequency" in steps_by_symbol(procedure)["h"].meaning
    assert "No M̂ makes it stable" in steps_by_symbol(procedure)["M̂"].meaning
    assert procedure.running_loop_in_range is None


def test_too_long_a_window_is_said_with_the_longest():
    step = steps_by_symbol(run_procedure(1.0, delay=0.1, window=2.0))["ς"]
    assert step.outcome == "inconclusive"
    assert f"The window is too long: {step.values['largest ς [s]']:.4g} s is the longest" in step.meaning
    assert steps_by_symbol(run_procedure(1.0, delay=0.1, window=1.0))["ς"].outcome == "certified"


def test_joints_with_gains_of_their_own():
    procedure = run_procedure([5.0, 10.0], n_joints=2)
    slower = run_procedure(10.0)
    assert len(procedure.theorem1.evidence.parts) == 2
    for name in ("largest by Theorem 1 [s]", "stability limit of the equation [s]"):
        assert steps_by_symbol(procedure)["h"].values[name] == pytest.approx(
            steps_by_symbol(slower)["h"].values[name], rel=1e-4
        )
    assert "(5, 10)" in procedure.explain()


def test_explain_has_every_step_and_how_it_ends():
    procedure = run_procedure(10.0)
    text = procedure.explain()
    for number, step in enumerate(procedure.steps, 1):
        assert f"{number}. {step.name}: {step.outcome}" in text
        assert step.meaning in text
    assert text.endswith("The procedure does not end; the last two steps replace it.")


@pytest.mark.parametrize(
    ("options", "message", "error"),
    [
        ({"natural_frequency": -1.0}, "natural_frequency: got", InvalidParameter),
        ({"natural_frequency": 1.0, "damping_ratio": 0.0}, "damping_ratio: got", InvalidParameter),
        ({"natural_frequency": 1.0, "delay": 0.0}, "delay: got", InvalidParameter),
        ({"natural_frequency": 1.0, "degree": 1}, "degree: got", InvalidParameter),
        ({"natural_frequency": 1.0, "window": 0.0015}, "no whole multiple", InvalidParameter),
        ({"natural_frequency": 1.0, "n_joints": 0}, "n_joints: got", InvalidParameter),
        ({"natural_frequency": [1.0, 2.0], "n_joints": 3}, "one per joint", InvalidParameter),
        ({"natural_frequency": 1.0, "ratio": 0.0}, "ratio: got", InvalidParameter),
    ],
)
def test_bad_numbers(options, message, error):
    with pytest.raises(error, match=message):
        run_procedure(**options)
