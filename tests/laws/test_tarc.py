"""TARC against a second writing of its equations, and its own parameters."""

import numpy as np
import pytest
from scipy.integrate import quad_vec

from law_catalogue import make_law
from tarc import estimators, laws, plants, signals, simulate
from tarc.core.errors import InvalidParameter
from tarc.laws import LawInput


def torques_written_again(law, positions, reference, rates, accelerations):
    """Return the torques of TARC written again, with lists and loops, from the paper's equations alone."""
    n, T, m = law.n_joints, law.period, law.delay_periods
    count = law.estimator.samples
    age = -np.arange(count) * T
    fit = np.linalg.lstsq(np.vander(age, law.estimator.degree + 1, increasing=True), np.eye(count), rcond=None)[0]
    P2 = law.P[n:, :n]
    window = [positions[0]] * count
    torques, past_accelerations, past_norms = [np.zeros(n)] * m, [np.zeros(n)] * m, [0.0] * m
    gain, result, gains = law.start_gain, [], []
    for q, qd, dqd, ddqd in zip(positions, reference, rates, accelerations, strict=True):
        window = [q, *window[:-1]]
        velocity = sum(fit[1, i] * window[i] for i in range(count))
        acceleration = sum(2 * fit[2, i] * window[i] for i in range(count))
        e, de = q - qd, velocity - dqd
        s = P2 @ e
        size = np.sqrt(s @ s)
        switching = -law.gain_factor * gain * (s / size if size >= law.boundary_layer else s / law.boundary_layer)
        u = ddqd - law.K2 @ de - law.K1 @ e + switching
        torque = law.M @ u + (torques[m - 1] - law.M @ past_accelerations[m - 1])
        gains.append(gain)
        growth = size - past_norms[m - 1] if law.growth == "difference" else s @ P2 @ de
        if gain <= law.min_gain or growth > 0:
            gain = gain + T * law.rise_rate * size
        else:
            gain = max(gain - T * law.fall_rate * size, law.min_gain)
        torques, past_accelerations = [torque, *torques[:-1]], [acceleration, *past_accelerations[:-1]]
        past_norms = [size, *past_norms[:-1]]
        result.append(torque)
    return np.array(result), np.array(gains)


@pytest.mark.parametrize(("delay", "growth"), [(None, "difference"), (0.003, "difference"), (None, "window")])
def test_equals_second_writing(delay, growth):
    inertia = 0.05 * np.array([[3.0, 1.0], [1.0, 1.0]])
    law = make_law(
        laws.TARC,
        inertia=inertia,
        delay=delay,
        growth=growth,
        boundary_layer=0.002,
        rise_rate=4000.0,
        fall_rate=3000.0,
        gain_factor=1.5,
    )
    reference = signals.Sinusoid(amplitude=[0.4, 0.5], frequency=[2.0, 3.0])
    run = simulate(plants.TwoLinkArm(coulomb=0.5), law, reference, 1.0, sensor=signals.Encoder(bits=15))
    data = run.data
    columns = [
        data[name].values for name in ("measured_position", "reference", "velocity_reference", "acceleration_reference")
    ]
    torques, gains = torques_written_again(law, *columns)
    assert run.status.completed
    assert 0 < data["rising"].values.mean() < 1, "both branches run"
    assert (data["sliding"].values > law.boundary_layer).any(), "both sides of the boundary run"
    assert (data["sliding"].values < law.boundary_layer).any()
    np.testing.assert_allclose(data["torque"].values, torques, rtol=1e-7, atol=1e-6)
    np.testing.assert_allclose(data["gain"].values, gains, rtol=1e-9)


def test_differs_from_tdc_by_the_switching_term_alone():
    tdc, tarc = make_law(laws.TDC), make_law(laws.TARC, boundary_layer=0.02, initial_gain=3.0)
    value = LawInput(np.array([0.1, -0.2]), np.zeros(2), np.ones(2), np.ones(2))
    plain, robust = (law.step(law.init(np.zeros(2)), value)[1].torque for law in (tdc, tarc))
    s = tarc.P2 @ value.position
    np.testing.assert_allclose(robust - plain, -tarc.M @ (3.0 * s / np.linalg.norm(s)), rtol=1e-9, atol=1e-9)


def test_default_weight_makes_s_the_error():
    """P2 = I and P3 = 1/(ζ ωn) for K = scalar·I; with Q = I, P2 = 1/(2 ωn²)."""
    law = make_law(laws.TARC, natural_frequency=12.0, damping_ratio=0.8)
    np.testing.assert_allclose(law.P2, np.eye(2), atol=1e-9)
    np.testing.assert_allclose(law.P3, np.eye(2) / (0.8 * 12.0), atol=1e-9)
    identity = make_law(laws.TARC, lyapunov_weight=1.0)
    np.testing.assert_allclose(identity.P2, np.eye(2) / (2 * 12.0**2), atol=1e-12)


def test_lyapunov_equation_by_quadrature():
    """P = ∫ e^{Aᵀt} Q e^{At} dt, an independent route to AᵀP + PA = −Q."""
    from scipy.linalg import expm

    law = make_law(laws.TARC, lyapunov_weight=[1.0, 2.0, 3.0, 4.0], natural_frequency=[3.0, 5.0])
    P, _ = quad_vec(lambda t: expm(law.A.T * t) @ law.Q @ expm(law.A * t), 0, 12)
    np.testing.assert_allclose(law.P, P, atol=1e-6)


def test_gain_stays_above_floor_and_below_cap():
    law = make_law(laws.TARC, inertia=[0.1, 0.05], rise_rate=2e5, fall_rate=3e5, min_gain=0.5, max_gain=4.0)
    reference = signals.Sinusoid(amplitude=[0.4, 0.5], frequency=[2.0, 3.0])
    gain = simulate(plants.TwoLinkArm(coulomb=1.0), law, reference, 2.0).data["gain"].values
    assert gain.min() == 0.5
    assert gain.max() == 4.0


def test_rises_at_rate_and_falls_at_rate():
    law = make_law(laws.TARC, rise_rate=100.0, fall_rate=40.0, initial_gain=5.0)
    state = law.init(np.zeros(2))
    value = LawInput(np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2))
    gains, sizes = [], [0.3, 0.4, 0.2, 0.1, 0.1, 0.5]
    for size in sizes:
        state, output = law.step(state, value._replace(position=np.array([size, 0.0])))
        gains.append(float(output.signals["gain"]))
    signs = [1, 1, -1, -1, -1]  # f = ‖s‖ − ‖s_h‖: grows, grows, shrinks, shrinks, equal counts as not growing
    expected = [1e-3 * (100.0 if sign > 0 else -40.0) * size for sign, size in zip(signs, sizes, strict=False)]
    np.testing.assert_allclose(np.diff(gains), expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"initial_gain": 0.5, "min_gain": 0.5}, "initial_gain: got 0.5, which is not above min_gain 0.5"),
        ({"gain_factor": 0.9}, "gain_factor: got 0.9; needs a finite number of at least 1"),
        ({"rise_rate": 0.0}, "rise_rate"),
        ({"fall_rate": -1.0}, "fall_rate"),
        ({"boundary_layer": 0.0}, "boundary_layer: got 0; needs a finite number above 0"),
        ({"max_gain": 0.001}, "max_gain: got 0.001; needs at least the initial gain"),
        ({"lyapunov_weight": [1.0, 1.0, -1.0, 1.0]}, "lyapunov_weight: .*positive definite"),
    ],
)
def test_bad_parameters(options, message):
    with pytest.raises(InvalidParameter, match=message):
        make_law(laws.TARC, **options)


def test_condition_c2_is_checked():
    """A weight with a strong coupling of the blocks makes P3 P2ᵀ lose definiteness, and is refused."""
    rng = np.random.default_rng(5)
    K1, K2 = np.diag([100.0, 4.0]), np.diag([20.0, 4.0])
    refused = 0
    for _ in range(200):
        root = rng.normal(size=(4, 4))
        lyapunov_weight = root @ root.T + 1e-3 * np.eye(4)
        A = np.block([[np.zeros((2, 2)), np.eye(2)], [-K1, -K2]])
        from scipy.linalg import solve_continuous_lyapunov

        P = solve_continuous_lyapunov(A.T, -lyapunov_weight)
        product = P[2:, 2:] @ P[2:, :2].T
        fails = np.linalg.eigvalsh(product + product.T)[0] <= 0
        options = {
            "natural_frequency": None,
            "position_gain": K1,
            "velocity_gain": K2,
            "lyapunov_weight": lyapunov_weight,
        }
        if fails:
            refused += 1
            with pytest.raises(InvalidParameter, match=r"condition \(c2\) fails"):
                make_law(laws.TARC, **options)
        else:
            make_law(laws.TARC, **options)
    assert 0 < refused < 200


def test_payload_is_survived_on_position_alone():
    """The claim in one run: unknown payload, encoder alone, and the error stays in the millirads."""
    law = laws.TARC(
        inertia=0.05 * np.array([[3.0, 1.0], [1.0, 1.0]]),
        natural_frequency=10.0,
        period=1e-3,
        estimator=estimators.Algebraic(window=0.010, degree=2),
        rise_rate=2000.0,
        fall_rate=1000.0,
    )
    reference = signals.Sinusoid(amplitude=0.6, frequency=[2.0, 2.5], phase=np.pi / 2)
    run = simulate(
        plants.TwoLinkArm(),
        law,
        reference,
        6.0,
        sensor=signals.Encoder(bits=16),
        disturbance=[signals.Payload(mass=0.5, start_time=3.0)],
        initial_torque="rest",
    )
    assert run.status.completed
    assert run.metrics(start_time=1.0)["rms_error"] < 5e-3
