"""The range of M⁻¹M̂ in which the loop is stable, from the very functions that are simulated.

A double integrator under TDC is linear; the eigenvalues of the traced closed loop's Jacobian decide. The limits are
those of the scalar loop with T = h = 1 ms, ωn = 10 rad/s, ζ = 1 and a window of N periods, known independently.
"""

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq

from law_catalogue import KNOWN_RANGES, agrees_to_digits, make_tdc
from slow_cases import slow
from tarc import plants, signals
from tarc.control.digital_controller import DigitalController
from tarc.core.tracing import trace
from tarc.core.trees import pack
from tarc.simulation.closed_loop import ClosedLoop, LoopInput


def spectral_radius(ratio, window, synchronised, delay=0, known=False):
    """Largest eigenvalue magnitude of one period of TDC on q̈ = τ with M̂ = ratio."""
    mass = plants.MassSpringDamper(masses=[1.0], springs=[0.0], dampers=[0.0])
    law = make_tdc(window, synchronised, inertia=ratio, actuation_delay=delay if known else 0)
    loop = ClosedLoop(mass, DigitalController(signals.Encoder(), law, delay), 1)
    state = loop.init(np.zeros(1))
    zero = np.zeros(1)
    value = LoopInput(zero, zero, zero, zero, np.zeros((1, 1)), {})
    step, _ = trace(loop.step, state, value, symbol=ca.SX)
    x, u = ca.SX.sym("x", step.nnz_in(0)), ca.SX.sym("u", step.nnz_in(1))
    jacobian = ca.Function("jacobian", [x, u], [ca.jacobian(step(x, u)[0], x)])
    return np.max(np.abs(np.linalg.eigvals(np.array(jacobian(pack(state), pack(value))))))


@pytest.mark.parametrize(
    ("window", "synchronised", "low", "high"),
    [*KNOWN_RANGES, slow(100, True, 0.128, 1.426), slow(200, True, 0.155, 0.875)],
)
def test_stable_interval(window, synchronised, low, high):
    def beyond(ratio):
        # the zero reference leaves eigenvalues at 0 and inside; the last reference held adds one at 0
        return spectral_radius(ratio, window, synchronised) - 1.0

    middle = np.sqrt(low * high)
    assert beyond(middle) < 0
    ends = brentq(beyond, 0.8 * low, middle, xtol=1e-7), brentq(beyond, middle, 1.2 * high, xtol=1e-6)
    assert agrees_to_digits(ends[0], low)
    assert agrees_to_digits(ends[1], high)


@pytest.mark.parametrize(
    ("window", "synchronised", "delay", "unknown", "known"),
    [(10, False, 1, 0.2129, 0.4662), (10, False, 2, 0.1795, 0.6287), (10, True, 2, 1.678, 2.226)],
)
def test_a_law_that_knows_its_delay_tolerates_more(window, synchronised, delay, unknown, known):
    """Upper limits with a computation delay, the torques fed back being the newest, or those that acted."""
    rounding = 1e-9  # a mode that stays, see below, is on the circle to rounding
    for knows, expected in ((False, unknown), (True, known)):
        radius = [spectral_radius(expected * factor, window, synchronised, delay, knows) for factor in (0.999, 1.001)]
        assert radius[0] < 1 + rounding < radius[1]


@pytest.mark.parametrize("delay", [1, 2, 3])
def test_torques_fed_back_every_second_period_leave_an_alternating_mode(delay):
    """With one period of known delay τ(k) = τ(k−2) + …, and no sampled position shows a torque that alternates.

    An eigenvalue stays at −1; with an odd number of periods between the torques there is none.
    """
    marginal = spectral_radius(0.1, 10, False, delay, True) > 1 - 1e-9
    assert marginal == (delay % 2 == 1)
