"""The intelligent PID: its F̂ against the integrals, and its relation to time-delay estimation."""

import numpy as np
import pytest
from scipy.integrate import quad

from law_catalogue import PERIOD, make_law
from tarc import analysis, certificates, estimators, laws, plants, signals, simulate
from tarc.core.errors import InvalidParameter
from tarc.laws import LawInput


def last_signals(law, positions, torques):
    """Signals after positions (k, 1), with these torques (k,) applied in between whatever the law says."""
    state, zero = law.init(positions[0], torques[:1]), np.zeros(1)
    output = None
    for position, torque in zip(positions, torques, strict=True):
        state = state._replace(torque=np.full_like(state.torque, torque))
        state, output = law.step(state, LawInput(position, zero, zero, zero))
    assert output is not None
    return output.signals


def test_constant_force_is_found_exactly():
    """A mass under F = −9.81 and any sequence of held torques."""
    inertia, count = 0.7, 40
    v = np.random.default_rng(0).normal(size=count)
    q, dq, F = 0.2, -0.3, -9.81
    positions = [q]
    for k in range(1, count):
        a = F + v[k] / inertia
        q, dq = q + PERIOD * dq + PERIOD**2 / 2 * a, dq + PERIOD * a
        positions.append(q)
    law = make_law(laws.IntelligentPID, joints=1, inertia=inertia, window=0.012)
    signals_ = last_signals(law, np.array(positions)[:, None], v)
    np.testing.assert_allclose(signals_["disturbance_estimate"], F, rtol=1e-7)


def test_tends_to_the_integrals():
    """F̂ as the paper has it, by quadrature, for a motion and a torque that have nothing to do with each other."""
    L, T, alpha = 0.2, 1e-3, 1 / 0.7

    def q(t):
        return np.sin(9 * t) + t**3

    def torque(t):
        return np.cos(5 * t)

    first = quad(lambda x: (L**2 - 6 * L * x + 6 * x**2) * q(1 - x), 0, L)[0]
    second = quad(lambda x: x**2 * (L - x) ** 2 * alpha * torque(1 - x), 0, L)[0]
    law = make_law(laws.IntelligentPID, joints=1, inertia=0.7, window=L, period=T)
    times = 1 - T * np.arange(400)[::-1]
    estimate = last_signals(law, q(times)[:, None], torque(times - T / 2))["disturbance_estimate"]
    np.testing.assert_allclose(estimate, 60 / L**5 * first - 30 / L**5 * second, rtol=0.01)


def test_is_synchronised_tdc():
    """Term by term, with the window of the estimator and no integral."""
    common = {"estimator": estimators.Algebraic(window=0.010), "inertia": [0.8, 0.3]}
    reference = signals.Sinusoid(amplitude=[0.4, 0.5], frequency=[2.0, 3.0])
    torques = [
        simulate(plants.TwoLinkArm(), law, reference, 1.0, sensor=signals.Encoder(bits=15)).data["torque"].values
        for law in (
            make_law(laws.IntelligentPID, window=0.010, **common),
            make_law(laws.IntelligentPID, **common),
            make_law(laws.TDC, synchronised=True, **common),
        )
    ]
    for torque in torques[:2]:
        np.testing.assert_allclose(torque, torques[2], rtol=1e-6, atol=1e-6)


def test_certificate():
    law, twin = make_law(laws.IntelligentPID, window=0.008), make_law(laws.TDC, synchronised=True)
    assert certificates.certify_constant_ratio(law, 1.0).verdict == "certified"
    intervals = [analysis.stable_interval(kind) for kind in (law, twin)]
    np.testing.assert_allclose(*intervals, rtol=1e-6)
    assert (
        certificates.certify_constant_ratio(make_law(laws.IntelligentPID, integral_gain=3.0), 1.0).verdict
        == "certified"
    )


def test_window_is_its_own():
    """F̂ from a long window and the velocity from a short one."""
    law = make_law(laws.IntelligentPID, window=0.030, inertia=[1.0, 0.4], integral_gain=2.0)
    reference = signals.Sinusoid(amplitude=[0.4, 0.5], frequency=[2.0, 3.0])
    run = simulate(plants.TwoLinkArm(), law, reference, 3.0, sensor=signals.Encoder(bits=16), initial_torque="rest")
    assert run.status.completed
    assert run.metrics(start_time=1.0)["rms_error"] < 5e-3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"window": 0.001}, "window: .* holds 2 samples"),
        ({"window": 0.0025}, "window: .*no whole multiple of the period"),
        ({"integral_gain": -1.0}, "integral_gain"),
    ],
)
def test_bad_parameters(options, message):
    with pytest.raises(InvalidParameter, match=message):
        make_law(laws.IntelligentPID, **options)
