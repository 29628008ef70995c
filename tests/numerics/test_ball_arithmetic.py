"""Ball arithmetic proves what is so and nothing else; the kernel's constants against numbers and quadrature."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tarc.estimators import Algebraic
from tarc.numerics import ball_arithmetic as exact
from tarc.numerics.ball_arithmetic import balls, decide, inverse, is_negative_at, is_positive_definite
from tarc.paper import kernel


def spectrum(values, seed):
    basis = np.linalg.qr(np.random.default_rng(seed).normal(size=(len(values), len(values))))[0]
    form = basis @ np.diag(values) @ basis.T
    return (form + form.T) / 2


@settings(max_examples=40)
@given(st.lists(st.floats(-3, 3), min_size=1, max_size=6), st.integers(0, 1000))
def test_positive_is_proven_where_eigenvalues_are_clearly_positive_and_nowhere_else(values, seed):
    form = spectrum(values, seed)
    least = np.linalg.eigvalsh(form)[0]
    if abs(least) > 1e-9:
        assert decide(lambda: is_positive_definite(balls(form))) == (least > 0)


def test_a_sign_below_floating_point_is_decided_exactly():
    """Determinant 2⁻¹⁰⁴ exactly, which no float computation of it sees."""
    form = np.array([[1 + 2.0**-52, 1.0], [1.0, 1 - 2.0**-52 + 2.0**-103]])
    assert form[1, 1] == 1 - 2.0**-52
    assert not decide(lambda: is_positive_definite(balls(form)))
    form[0, 0] = 1 + 2.0**-51
    assert decide(lambda: is_positive_definite(balls(form)))


def test_a_singular_form_is_not_proven_either_way():
    form = np.array([[1.0, 1.0], [1.0, 1.0]])
    assert not decide(lambda: is_positive_definite(balls(form)))
    assert not decide(lambda: is_negative_at(balls(form), np.array([1.0, -1.0])))
    assert not decide(lambda: is_positive_definite(inverse(balls(form))))


def test_more_bits_are_tried_where_the_first_do_not_suffice():
    """1 + 2⁻⁴⁰⁰ − 1 > 0 needs 400 bits."""
    tiny = exact.ball(2.0**-400)
    assert decide(lambda: bool((exact.ball(1.0) + tiny) - exact.ball(1.0) > 0))


def test_a_third_lies_in_its_ball_and_floats_have_no_width():
    assert exact.ball(Fraction(1, 3)) * 3 - 1 < exact.ball(2.0**-40)
    assert exact.ball(0.1).is_exact()
    assert not exact.ball(Fraction(1, 3)).is_exact()


def test_inverse_encloses():
    form = spectrum([1.0, 2.0, 3.0], 1)
    product = balls(form) @ inverse(balls(form))
    assert all(product[i, j].contains(int(i == j)) for i in range(3) for j in range(3))


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_kernel_is_the_estimators(degree):
    estimator = Algebraic(window=1.0, degree=degree, period=0.1)
    psi = np.linspace(-0.999, 0, 7)
    values = np.polynomial.polynomial.polyval(psi, [float(c) for c in kernel.kernel_coefficients(degree)])
    np.testing.assert_allclose(values, estimator.kernel(psi), rtol=1e-12)


@pytest.mark.parametrize(("degree", "energy"), [(1, 12), (2, 192), (3, 1200)])
def test_kernel_energy(degree, energy):
    assert kernel.kernel_energy(degree) == energy


@pytest.mark.parametrize(("degree", "area"), [(1, 0.5), (2, 32 / 81), (3, 0.38787261633716)])
def test_lag_area_is_the_known_and_the_integrated(degree, area):
    found = kernel.lag_area(degree)
    assert float(found) == pytest.approx(area, rel=1e-12)
    theta = (np.arange(200_000) + 0.5) / 200_000 - 1
    g = np.polynomial.polynomial.polyval(theta, [float(c) for c in kernel.lag_coefficients(degree)])
    assert np.mean(np.abs(g)) == pytest.approx(float(found), rel=1e-8)
    # g rises from 0 to ∫w = 1
    assert kernel._evaluate(kernel.lag_coefficients(degree), exact.ball(-1)) == 0
    assert kernel._evaluate(kernel.lag_coefficients(degree), exact.ball(0)) == 1
