"""Super-twisting on a mass: the known time of reaching, and a disturbance of known rate."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

from law_catalogue import make_law
from tarc import estimators, laws, plants, signals, simulate
from tarc.core.errors import InvalidParameter

MASS = plants.MassSpringDamper(masses=(1.0,), springs=0.0, dampers=0.0)
TARGET = signals.Sinusoid(amplitude=0.0, frequency=1.0)


def fast_sampled_law(**options):
    """Return a law that runs so fast that the continuous results hold."""
    given = {"inertia": 1.0, "natural_frequency": 5.0, "period": 1e-4, "estimator": estimators.BackwardDifference()}
    return laws.SuperTwisting(**{**given, "boundary_layer": 1e-4, **options})


def sliding_variable(run, law):
    """Return the true s."""
    data = run.data
    return data["velocity"].values[:, 0] + law.slope[0, 0] * data["position"].values[:, 0]


def reaching_time(law, s, z):
    """Bound on the time until s = 0 for good, from s and what z lacks, by V = ζᵀPζ with ζ = (|s|^½ sgn s, z).

    ζ' = |s|^−½ A ζ, so V' ≤ −|s|^−½ μ V with μ = λmin(P⁻¹Q), and |s|^½ ≤ ((P⁻¹)₁₁ V)^½: V^½ falls at a rate that is
    known. The quadratic V is J. A. Moreno and M. Osorio's, 47th IEEE CDC, 2008; the best Q is searched for.
    """
    A = np.array([[-law.k1 / 2, 0.5], [-law.k2, 0.0]])
    zeta = np.array([np.sign(s) * abs(s) ** 0.5, z])
    bounds = []
    for weight in np.geomspace(1e-5, 1.0, 30):
        Q = np.diag([1.0, weight])
        P = solve_continuous_lyapunov(A.T, -Q)
        rate = np.min(np.linalg.eigvals(np.linalg.solve(P, Q)).real)
        bounds.append(2 * np.sqrt(zeta @ P @ zeta * np.linalg.inv(P)[0, 0]) / rate)
    return min(bounds)


def test_reaches_the_surface_within_the_known_time():
    law = fast_sampled_law(disturbance_rate=40.0)
    run = simulate(MASS, law, TARGET, 4.0, initial_velocity=1.0, disturbance=signals.StepDisturbance(amplitude=3.0))
    s = sliding_variable(run, law)
    bound = reaching_time(law, 1.0, 3.0)
    is_after_bound = run.data["time"].values > bound
    assert 0.1 < bound < 3.0
    assert is_after_bound.sum() > 1000
    assert np.abs(s[is_after_bound]).max() < 1e-3
    assert np.abs(s[: len(s) // 50]).max() > 0.5


def test_holds_the_surface_against_a_disturbance_of_bounded_rate():
    """|d'| up to L, and gains that Levant's condition has as sufficient: b > 1 and a² ≥ 4 (b + 1)/(b − 1)."""
    a, b = 3.5, 2.0
    assert a**2 >= 4 * (b + 1) / (b - 1)
    wave = signals.SineDisturbance(amplitude=8.0, frequency=5.0)
    worst = []
    for L in (40.0, 10.0):
        law = fast_sampled_law(
            disturbance_rate=L, root_gain=a if L == 40.0 else 0.5, switch_gain=b if L == 40.0 else 0.5
        )
        run = simulate(MASS, law, TARGET, 3.0, disturbance=wave)
        worst.append(np.abs(sliding_variable(run, law)[10000:]).max())
    assert worst[0] < 1e-3
    assert worst[1] > 0.1, "gains far below the condition let go of the surface"


def test_gains():
    law = make_law(laws.SuperTwisting, disturbance_rate=25.0)
    assert (law.k1, law.k2) == pytest.approx((7.5, 27.5))


def test_integral_does_not_wind_up():
    law = make_law(laws.SuperTwisting, joints=1, inertia=0.1, torque_limit=2.0)
    state, value = law.init([0.0]), law.example()[1]
    integrals = []
    for _ in range(4000):
        state, output = law.step(state, value._replace(reference=np.array([1.0])))
        integrals.append(output.signals["integral"].item())
    # ż = 0 where k2 sgn s = Λ (what is allowed − what is asked for)
    size = law.slope[0, 0]
    expected = 2.0 / 0.1 - law.k1 * size**0.5 + law.k2 / size
    np.testing.assert_allclose(integrals[-1], expected, rtol=1e-6)


@pytest.mark.parametrize("name", ["disturbance_rate", "root_gain", "switch_gain", "boundary_layer"])
def test_bad_parameters(name):
    with pytest.raises(InvalidParameter, match=f"{name}: got 0; needs a finite number above 0"):
        replace(make_law(laws.SuperTwisting), **{name: 0.0})
