"""The usual bound on the error of time-delay estimation presupposes the bounded acceleration that it is to prove."""

import numpy as np
import pytest

import tarc

RATIO, PERIOD = 0.1, 1e-3


def simulated(natural_frequency, duration=0.4):
    """Return the TDE error and the auxiliary input of TDC with true derivatives on a mass, M̂ a tenth of it."""
    mass = tarc.plants.MassSpringDamper(masses=1.0, springs=0.0, dampers=0.0)
    law = tarc.laws.TDC(
        inertia=[RATIO],
        natural_frequency=natural_frequency,
        period=PERIOD,
        estimator=tarc.estimators.TrueDerivatives(),
    )
    data = tarc.simulate(mass, law, tarc.signals.Sinusoid(amplitude=[0.1], frequency=[2.0]), duration).data
    return data["tde_error"].values[:, 0], data["auxiliary"].values[:, 0]


def loop_matrix(natural_frequency):
    """Return the sampled loop in error, its rate, ε and u of the period before, from the equations alone."""
    gains = np.array([natural_frequency**2, 2 * natural_frequency])
    hold = np.array([PERIOD**2 / 2, PERIOD])
    new_error = (1 - RATIO) * np.concatenate([gains, [1.0, 1.0]])
    nominal = np.array([[1.0, PERIOD], [0.0, 1.0]]) - np.outer(hold, gains)
    loop = np.zeros((4, 4))
    loop[:2, :2] = nominal
    loop[:2] += np.outer(hold, new_error)
    loop[2] = new_error
    loop[3, :2] = -gains
    return loop


@pytest.mark.parametrize("natural_frequency", [100.0, 250.0])
def test_the_bound_is_true_on_every_stretch_of_a_stable_and_of_an_unstable_loop(natural_frequency):
    """ε_k = (1 − ρ)(ε_{k−1} − Δu_k), so that sup|ε| ≤ |ε(0)| + (1 − ρ)/ρ sup|Δu|, whatever the loop does."""
    error, u = simulated(natural_frequency)
    change = np.diff(u)
    np.testing.assert_allclose(error[1:], (1 - RATIO) * (error[:-1] - change), atol=1e-9)
    for periods in (100, 200, 400):
        bound = abs(error[0]) + (1 - RATIO) / RATIO * np.abs(change[: periods - 1]).max()
        assert np.abs(error[:periods]).max() <= bound


def test_its_constant_grows_with_the_run_where_the_loop_is_unstable():
    constants = {}
    for natural_frequency in (100.0, 250.0):
        _, u = simulated(natural_frequency)
        constants[natural_frequency] = [np.abs(np.diff(u)[:periods]).max() for periods in (100, 200, 300, 400)]
    assert np.ptp(constants[100.0]) == 0
    assert np.all(np.diff(np.log(constants[250.0])) > 0.5)


def test_simulation_grows_at_the_rate_of_the_loop():
    """The eigenvalue of the equations is the growth of the simulated error, by another route."""
    eigenvalues = np.linalg.eigvals(loop_matrix(250.0))
    largest = eigenvalues[np.argmax(np.abs(eigenvalues))]
    error, _ = simulated(250.0)
    # two samples later: x_{k+2} = 2 Re(λ) x_{k+1} − |λ|² x_k, for the mode that is left
    tail = error[-60:]
    coefficients = np.linalg.lstsq(np.column_stack([tail[1:-1], tail[:-2]]), tail[2:], rcond=None)[0]
    assert -coefficients[1] == pytest.approx(abs(largest) ** 2, rel=1e-2)
    assert abs(largest) > 1.005
    assert np.abs(np.linalg.eigvals(loop_matrix(100.0))).max() < 1
