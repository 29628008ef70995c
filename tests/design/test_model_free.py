"""Gains from a measured inertia alone."""

import numpy as np
import pytest

import tarc
from tarc import TarcError
from tarc.core.errors import InfeasibleDesign
from tarc.design import design_without_model, identify

ARM = tarc.plants.TwoLinkArm(viscous=[1.0, 1.0], coulomb=[1.0, 0.5])


def test_from_positions_and_torques_to_tracking():
    """The robot's model is used by the simulation alone."""
    measured = identify(ARM, sensor=tarc.signals.Encoder(bits=17), duration=10.0, diagonal=False).inertia
    made = design_without_model(measured, 12.0, 8.0, expected_step=10.0)
    assert made.certificate.certified
    assert made.certificate.verify()
    sines = tarc.signals.Sinusoid(amplitude=0.4, frequency=[1.5, 2.1], phase=np.pi / 2, offset=[0.0, 1.2])
    run = tarc.simulate(ARM, made.law, sines, 4.0, sensor=tarc.signals.Encoder(bits=17), initial_torque="rest")
    assert run.status.completed
    assert run.metrics(start_time=1.0)["rms_error"] < 0.01


@pytest.mark.parametrize("expected", [None, 5.0])
def test_what_is_certified_is_what_was_asked_for(expected):
    """The ball holds every M whose eigenvalues against the one measured are within √spread, either way."""
    M = np.array([[3.0, 1.0], [1.0, 1.0]])
    made = design_without_model(M, 16.0, 5.0, expected_step=expected)
    low, high = made.certificate.evidence.min_ratio, made.certificate.evidence.max_ratio
    for factor in (0.25, 1.0, 4.0):
        ratios = np.linalg.eigvals(np.linalg.solve(factor * M, made.law.M)).real
        assert np.all((ratios >= low) & (ratios <= high))
    assert made.certificate.evidence.slope == pytest.approx(0.0 if expected is None else 25.0, rel=1e-3)
    assert made.torque_noise.shape == (2,)


def test_a_spread_that_no_loop_tolerates_is_said():
    with pytest.raises(InfeasibleDesign, match="spread: required 1000; .* tolerate at most ") as error:
        design_without_model([1.0], 1000.0, 20.0)
    (relaxation,) = error.value.relaxations
    bearable = float(str(relaxation.value))
    assert design_without_model([1.0], 0.99 * bearable, 20.0).certificate.certified


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((-1.0, 4.0, 5.0), "inertia"),
        (([1.0], 0.5, 5.0), "spread: got 0.5"),
        (([1.0], 4.0, 0.0), "natural_frequency: got 0"),
        (([1.0], 4.0, np.nan), "natural_frequency"),
    ],
)
def test_bad_input(arguments, message):
    with pytest.raises(TarcError, match=message):
        design_without_model(*arguments)
