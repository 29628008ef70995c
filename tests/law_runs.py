"""Motions that the tests of single laws share: an ideal double integrator, and an arm with friction."""

from typing import Any

import numpy as np

from law_catalogue import make_law
from tarc import Run, laws, plants, signals, simulate
from tarc.estimators.base import Estimate
from tarc.laws.base import ControlInput


def tracking_at(error: Any, rate: Any, fault: bool = False) -> ControlInput:
    """Return what a law reads at this error and rate, known exactly, about a reference at rest in the origin."""
    error, rate = np.asarray(error, dtype=float), np.asarray(rate, dtype=float)
    zero = np.zeros(len(error))
    estimate = Estimate(error, rate, zero, np.ones(len(error)))
    return ControlInput(estimate, error, rate, zero, zero, np.array(float(fault)), zero, zero, np.ones(()))


def simulate_double_integrator(
    law: Any, position: Any, velocity: Any, duration: float, disturbance: float = 0.0
) -> tuple[Any, Any, Any]:
    """Return times, positions and velocities of q̈ = u + disturbance, u held for a period, derivatives known exactly."""
    q, v, state, T = np.array(position, dtype=float), np.array(velocity, dtype=float), law.robust_init(), law.period
    path = [(q, v)]
    for _ in range(round(duration / T)):
        tracking = tracking_at(q, v)
        state, correction, _ = law.robust(state, tracking)
        a = law.feedback(tracking) + correction + disturbance
        q, v = q + T * v + T**2 / 2 * a, v + T * a
        path.append((q, v))
    return T * np.arange(len(path)), np.array([q for q, _ in path]), np.array([v for _, v in path])


def simulate_arm(law: laws.Law, coulomb: float = 1.0, duration: float = 4.0, **options: Any) -> Run:
    """Return a sinusoid on the two-link arm with Coulomb friction and a 16-bit encoder."""
    reference = signals.Sinusoid(amplitude=0.5, frequency=[2.0, 3.0], phase=np.pi / 2)
    options = {"sensor": signals.Encoder(bits=16), "initial_torque": "rest", **options}
    return simulate(plants.TwoLinkArm(coulomb=coulomb), law, reference, duration, **options)


def assert_equals_tdc(kind: type[laws.Law], **options: Any) -> None:
    """With these options the law gives the torques of TDC, to rounding."""
    plain, run = (
        simulate_arm(make_law(law_kind, inertia=SMALL_INERTIA, **more), duration=0.5)
        for law_kind, more in ((laws.TDC, {}), (kind, options))
    )
    np.testing.assert_allclose(run.data["torque"], plain.data["torque"], rtol=1e-12, atol=1e-11)


SMALL_INERTIA = 0.05 * np.array([[3.0, 1.0], [1.0, 1.0]])
"""An M̂ for `track` that literal time-delay estimation tolerates."""
