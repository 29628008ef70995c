"""Estimators: exactness on polynomials, kernels, known special cases, noise, delay, missing samples."""

from math import factorial
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.signal import freqz, lfilter, savgol_coeffs

from tarc.core.errors import InvalidParameter
from tarc.core.tracing import trace
from tarc.core.trees import pack, unpack
from tarc.estimators import Algebraic, BackwardDifference, Estimate, Estimator, FilteredDifference
from tarc.estimators.base import TorqueAverage, WindowedEstimator, synchronous_weights

T = 1e-3
sampled = settings(max_examples=50)
EVERY: dict[str, Estimator] = {
    "degree 2": Algebraic(window=0.01, period=T),
    "degree 3": Algebraic(window=0.016, degree=3, period=T),
    "differences": BackwardDifference(period=T),
    "filtered differences": FilteredDifference(cutoff=300.0, period=T),
}
every_estimator = pytest.mark.parametrize("estimator", EVERY.values(), ids=EVERY.keys())


@st.composite
def algebraic_estimators(draw: st.DrawFn, least: int = 1) -> Algebraic:
    """Any degree, window length and period."""
    degree = draw(st.integers(least, 5))
    intervals = draw(st.integers(degree, 40))
    period = 10 ** draw(st.floats(-5, 0))
    return Algebraic(window=intervals * period, degree=degree, period=period)


def estimates_along(estimator: Estimator, positions: np.ndarray) -> list[Estimate]:
    """Estimates after each column of positions (n, k)."""
    state, estimates = estimator.init(positions[:, 0]), []
    for sample in positions.T:
        state, estimate = estimator.step(state, sample)
        estimates.append(estimate)
    return estimates


def polynomial_samples(estimator: Algebraic, coefficients: np.ndarray, count: int) -> np.ndarray:
    """Polynomial Σ c_k (t/ς)^k up to t = 0, one joint, shape (1, count)."""
    times = np.arange(1 - count, 1) / (estimator.samples - 1)
    return np.polynomial.polynomial.polyval(times, coefficients)[None, :]


def rounding_bound(weights: np.ndarray, positions: np.ndarray) -> float:
    """Bound on rounding errors in weights · positions: the fit's condition number is below 1e5 for degree ≤ 5."""
    return 1e-10 * np.sum(np.abs(weights)) * np.max(np.abs(positions)) + 1e-300


@sampled
@given(estimator=algebraic_estimators(), data=st.data())
def test_least_squares_are_exact_on_polynomials_up_to_their_degree(estimator: Algebraic, data: st.DataObject) -> None:
    c = data.draw(arrays(float, estimator.degree + 1, elements=st.floats(-10, 10, allow_subnormal=False)))
    positions = polynomial_samples(estimator, c, estimator.samples)
    estimate = estimates_along(estimator, positions)[-1]
    velocity, acceleration = c[1] / estimator.window, (2 * c[2] if estimator.degree > 1 else 0) / estimator.window**2
    assert estimate.position == positions[:, -1]
    assert estimate.velocity == pytest.approx(velocity, abs=rounding_bound(estimator.weights(1), positions))
    if estimator.degree == 1:
        assert estimator.max_derivative == 1
        assert estimate.acceleration == 0
    else:
        assert estimate.acceleration == pytest.approx(acceleration, abs=rounding_bound(estimator.weights(2), positions))


@sampled
@given(estimator=algebraic_estimators(), data=st.data())
def test_weights_of_every_derivative_are_exact_on_polynomials(estimator: Algebraic, data: st.DataObject) -> None:
    c = data.draw(arrays(float, estimator.degree + 1, elements=st.floats(-10, 10, allow_subnormal=False)))
    newest_first = polynomial_samples(estimator, c, estimator.samples)[0, ::-1]
    for j in range(estimator.degree + 1):
        weights = estimator.weights(j)
        truth = factorial(j) * c[j] / estimator.window**j
        assert weights @ newest_first == pytest.approx(truth, abs=rounding_bound(weights, newest_first))


@sampled
@given(estimator=algebraic_estimators(), data=st.data())
def test_prediction_is_exact_on_polynomials(estimator: Algebraic, data: st.DataObject) -> None:
    c = data.draw(arrays(float, estimator.degree + 1, elements=st.floats(-10, 10, allow_subnormal=False)))
    positions = polynomial_samples(estimator, c, estimator.samples + 1)[0]
    past = positions[:-1][::-1]
    predicted = estimator.prediction @ past
    assert predicted == pytest.approx(positions[-1], abs=rounding_bound(estimator.prediction, positions))


@sampled
@given(estimator=algebraic_estimators())
def test_weights_are_savitzky_and_golay_s_at_the_end_of_the_window(estimator: Algebraic) -> None:
    n = estimator.samples
    for j in range(estimator.degree + 1):
        coefficients = savgol_coeffs(
            n, estimator.degree, deriv=j, delta=estimator.sampling_period, pos=n - 1, use="dot"
        )
        weights = estimator.weights(j)
        # SciPy fits powers of the sample number, up to 40⁵, and loses that many digits
        assert np.allclose(weights, coefficients[::-1], rtol=0, atol=1e-6 * np.max(np.abs(weights)))


def test_two_samples_of_degree_one_are_backward_euler() -> None:
    assert np.allclose(Algebraic(window=T, degree=1, period=T).weights(1) * T, [1, -1])


def test_three_samples_of_degree_two_are_bdf2_and_the_second_difference() -> None:
    estimator = Algebraic(window=2 * T, period=T)
    assert np.allclose(estimator.weights(1) * T, [1.5, -2, 0.5])
    assert np.allclose(estimator.weights(2) * T**2, [1, -2, 1])


@pytest.mark.parametrize(("degree", "integrals"), [(1, [4, 12]), (2, [9, 192, 720]), (3, [16, 1200, 25920, 100800])])
def test_kernel_energies(degree: int, integrals: list[int]) -> None:
    window = 0.3
    psi, weight = gauss_points(window)
    estimator = Algebraic(window=window, degree=degree)
    energies = [weight @ estimator.kernel(psi, j) ** 2 * window ** (2 * j + 1) for j in range(degree + 1)]
    assert np.allclose(energies, integrals, rtol=1e-10)


def gauss_points(window: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights over [−window, 0], exact on polynomials up to degree 39."""
    x, weight = np.polynomial.legendre.leggauss(20)
    return (x - 1) * window / 2, weight * window / 2


@sampled
@given(degree=st.integers(1, 6), window=st.floats(0.01, 10), data=st.data())
def test_kernel_is_exact_on_polynomials_up_to_its_degree(degree: int, window: float, data: st.DataObject) -> None:
    c = data.draw(arrays(float, degree + 1, elements=st.floats(-10, 10, allow_subnormal=False)))
    psi, weight = gauss_points(window)
    estimator = Algebraic(window=window, degree=degree)
    for j in range(degree + 1):
        terms = weight * estimator.kernel(psi, j)
        value = terms @ np.polynomial.polynomial.polyval(psi / window, c)
        assert value == pytest.approx(factorial(j) * c[j] / window**j, abs=1e-12 * np.sum(np.abs(terms)) * 100)


def test_kernel_vanishes_outside_the_window() -> None:
    assert np.array_equal(Algebraic(window=0.1).kernel([-0.11, 0.01]), [0, 0])


def printed_kernel(psi: np.ndarray, window: float, degree: int, j: int) -> np.ndarray:
    """Ω_j as equation (omega) of the paper prints it, with (−1)^k."""
    scale = factorial(degree + 1 + j) / (window ** (j + 1) * factorial(j) * factorial(degree - j))
    total = np.zeros_like(psi)
    for k in range(degree + 1):
        factor = (-1) ** k * factorial(degree + 1 + k) / ((j + k + 1) * factorial(degree - k) * factorial(k) ** 2)
        total += factor * (psi / window) ** k
    return scale * total


@pytest.mark.parametrize("window", [0.01, 0.5])
def test_kernel_as_printed_gives_a_constant_a_velocity(window: float) -> None:
    psi, weight = gauss_points(window)
    assert weight @ printed_kernel(psi, window, 1, 1) == pytest.approx(12 / window)
    assert weight @ Algebraic(window=window, degree=1).kernel(psi, 1) == pytest.approx(0, abs=1e-9 / window)


@pytest.mark.parametrize(("degree", "j"), [(1, 0), (1, 1), (2, 1), (2, 2), (3, 2)])
def test_kernel_as_printed_is_right_for_the_integral_over_q_of_t_minus_psi(degree: int, j: int) -> None:
    psi = np.linspace(0, 0.3, 7)
    kernel = Algebraic(window=0.3, degree=degree).kernel(-psi, j)
    assert np.allclose(printed_kernel(psi, 0.3, degree, j), kernel, rtol=1e-12)


@pytest.mark.parametrize(("degree", "j"), [(1, 1), (2, 1), (2, 2), (3, 1), (3, 2)])
def test_weights_tend_to_the_kernel_with_first_order_in_the_period(degree: int, j: int) -> None:
    def distance(intervals: int) -> float:
        estimator = Algebraic(window=1.0, degree=degree, period=1 / intervals)
        ages = -np.arange(intervals + 1) / intervals
        # a smooth motion that no polynomial is: what the sum and the integral make of it
        psi, weight = gauss_points(1.0)
        integral = weight @ (estimator.kernel(psi, j) * np.exp(3 * psi))
        return float(abs(estimator.weights(j) @ np.exp(3 * ages) - integral))

    assert np.log2(distance(400) / distance(800)) == pytest.approx(1, abs=0.05)
    inside = np.arange(1, 800)
    estimator = Algebraic(window=1.0, degree=degree, period=1 / 800)
    kernel = estimator.kernel(-inside / 800, j)
    assert np.allclose(estimator.weights(j)[1:-1] * 800, kernel, rtol=0, atol=0.05 * np.max(np.abs(kernel)))


@pytest.mark.parametrize("degree", [2, 3, 4, 5])
@pytest.mark.parametrize("intervals", [5, 6, 10, 20, 50])
def test_synchronous_weights_sum_to_one(degree: int, intervals: int) -> None:
    weights = Algebraic(window=intervals * T, degree=degree, period=T).matched_torque_filter().weights
    assert len(weights) == intervals
    assert weights.sum() == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize("intervals", range(2, 51))
def test_synchronous_weights_of_degree_two_are_positive(intervals: int) -> None:
    assert np.all(Algebraic(window=intervals * T, period=T).matched_torque_filter().weights > 0)


def test_synchronous_weights_of_the_second_difference_are_halves() -> None:
    assert np.allclose(synchronous_weights(BackwardDifference(period=T).weights(2), T), [0.5, 0.5])


@every_estimator
@settings(max_examples=20)
@given(pulses=arrays(float, (2, 60), elements=st.floats(-5, 5, allow_subnormal=False)))
def test_torque_average_is_in_step_with_the_acceleration_estimate(estimator: Estimator, pulses: np.ndarray) -> None:
    position, velocity = np.zeros(2), np.zeros(2)
    average = estimator.matched_torque_filter()
    state, memory = estimator.init(position), average.init(np.zeros(2))
    for pulse in pulses.T:  # the acceleration held over each period: a unit mass under zero-order hold
        position, velocity = position + T * velocity + T**2 / 2 * pulse, velocity + T * pulse
        state, estimate = estimator.step(state, position)
        memory, expected = average.step(memory, pulse)
        # positions up to 1e-2 of rounding 1e-18 under weights of up to 4e6/s²
        assert np.allclose(estimate.acceleration, expected, rtol=0, atol=1e-9)


def test_a_torque_average_starts_as_if_its_torque_had_always_been_applied() -> None:
    average = TorqueAverage([0.5, 0.3, 0.2], pole=0.4)
    state = average.init([3.0, -1.0])
    for _ in range(3):
        state, output = average.step(state, np.array([3.0, -1.0]))
        assert np.allclose(output, [3.0, -1.0])


@every_estimator
def test_transfer_function_filters_like_the_estimator(estimator: Estimator) -> None:
    positions = 1.0 + np.random.default_rng(1).standard_normal((1, 80)).cumsum(axis=1) * 1e-3
    estimates = estimates_along(estimator, positions)
    assert np.array_equal([estimate.position for estimate in estimates], positions.T)
    moved = positions[0] - positions[0, 0]  # from rest at the first sample, which no derivative sees
    for j, name in ((1, "velocity"), (2, "acceleration")):
        b, a = estimator.transfer_function(j)
        filtered = [getattr(estimate, name)[0] for estimate in estimates]
        assert np.allclose(filtered, lfilter(b, a, moved), rtol=0, atol=1e-12 * np.sum(np.abs(b)))


@every_estimator
@pytest.mark.parametrize("derivative", [0, 1, 2])
def test_frequency_response_is_the_transfer_function_s(estimator: Estimator, derivative: int) -> None:
    frequency = np.linspace(1, np.pi / T, 50)
    b, a = estimator.transfer_function(derivative)
    expected = freqz(b, a, frequency * T)[1]  # pyright: ignore[reportArgumentType] - inferred from the default
    response = estimator.frequency_response(frequency, derivative)
    assert np.allclose(response, expected, rtol=1e-9, atol=1e-12 * np.sum(np.abs(b)))


@every_estimator
@pytest.mark.parametrize("derivative", [1, 2])
def test_a_slow_sine_is_differentiated(estimator: Estimator, derivative: int) -> None:
    frequency = 5.0
    ideal = (1j * frequency) ** derivative
    error = abs(estimator.frequency_response(frequency, derivative) / ideal - 1)
    assert error == pytest.approx(abs(frequency * estimator.group_delay(derivative)), abs=3e-3)  # (ω ς)²/2


@every_estimator
@pytest.mark.parametrize("derivative", [1, 2])
def test_group_delay_is_the_slope_of_the_phase(estimator: Estimator, derivative: int) -> None:
    # far below 1/ς so that the phase is straight, far above what rounding of Σ w_i = 0 hides
    frequency = 2.0
    response = estimator.frequency_response(frequency, derivative) / (1j * frequency) ** derivative
    assert estimator.group_delay(derivative) == pytest.approx(-np.angle(response) / frequency, abs=2e-3 * 0.016)


@pytest.mark.parametrize("intervals", [2, 5, 10, 40])
def test_group_delay_of_degree_two_is_none_in_velocity_and_half_the_window_in_acceleration(intervals: int) -> None:
    estimator = Algebraic(window=intervals * T, period=T)
    assert estimator.group_delay(0) == pytest.approx(0, abs=1e-12)
    assert estimator.group_delay(1) == pytest.approx(0, abs=1e-12)
    assert estimator.group_delay(2) == pytest.approx(intervals * T / 2)


def test_group_delay_of_differences_is_half_a_period_and_a_period_and_the_filter_adds_its_own() -> None:
    plain, filtered = BackwardDifference(period=T), FilteredDifference(cutoff=300.0, period=T)
    p = np.exp(-0.3)
    assert [plain.group_delay(j) for j in (1, 2)] == pytest.approx([T / 2, T])
    assert [filtered.group_delay(j) for j in (1, 2)] == pytest.approx([T / 2 + T * p / (1 - p), T + T * p / (1 - p)])


@every_estimator
def test_noise_gain_is_the_standard_deviation_that_white_noise_comes_out_with(estimator: Estimator) -> None:
    noise = np.random.default_rng(2).standard_normal((4000, 60))  # many joints; the filter forgets e^(-18) by the end
    last = estimates_along(estimator, noise)[-1]
    assert last.velocity.std() == pytest.approx(estimator.noise_gain(1), rel=0.03)
    assert last.acceleration.std() == pytest.approx(estimator.noise_gain(2), rel=0.03)


@pytest.mark.parametrize("name", ["degree 2", "degree 3", "differences"])
@pytest.mark.parametrize("derivative", [1, 2])
def test_noise_gain_of_a_window_is_the_norm_of_its_weights(name: str, derivative: int) -> None:
    estimator = EVERY[name]
    assert isinstance(estimator, WindowedEstimator)
    norm = np.linalg.norm(estimator.weights(derivative))
    assert estimator.noise_gain(derivative) == pytest.approx(norm, rel=1e-12)


@pytest.mark.parametrize("name", EVERY)
def test_the_position_is_passed_on_as_measured(name: str) -> None:
    assert EVERY[name].noise_gain(0) == pytest.approx(1.0, rel=1e-12)
    assert EVERY[name].group_delay(0) == 0.0


def test_a_degree_given_as_a_float_counts_if_it_is_whole() -> None:
    def algebraic(degree: Any) -> Algebraic:
        return Algebraic(window=0.01, degree=degree, period=1e-3)

    assert np.array_equal(algebraic(2.0).weights(2), algebraic(2).weights(2))
    for degree in (2.5, "x", None, np.nan, True):
        with pytest.raises(InvalidParameter, match="degree: got .*; needs a whole number from 1 to 6"):
            algebraic(degree)


def test_noise_gain_of_filtered_differences_is_the_geometric_sum() -> None:
    p = np.exp(-0.3)
    velocity = (1 - p) / T * np.sqrt(2 / (1 + p))
    assert EVERY["filtered differences"].noise_gain(1) == pytest.approx(velocity)


@pytest.mark.parametrize("lost", [np.nan, np.inf, -np.inf])
@settings(max_examples=20)
@given(estimator=algebraic_estimators(), data=st.data())
def test_missing_samples_leave_polynomials_exact_and_are_flagged_by_joint(
    lost: float, estimator: Algebraic, data: st.DataObject
) -> None:
    count = estimator.samples
    shape = (2, estimator.degree + 1)
    c = data.draw(arrays(float, shape, elements=st.floats(-10, 10, allow_subnormal=False)))
    is_missing = data.draw(arrays(bool, (2, 3)))
    truth = np.concatenate([polynomial_samples(estimator, row, count + 3) for row in c])
    received = truth.copy()
    received[:, count:][is_missing] = lost
    estimates = estimates_along(estimator, received)[count:]
    for estimate, expected, missing in zip(estimates, truth[:, count:].T, is_missing.T, strict=True):
        assert np.array_equal(estimate.valid, ~missing)
        # each prediction in a row multiplies the rounding of the one before
        size = np.sum(np.abs(estimator.prediction)) ** 3
        assert np.allclose(estimate.position, expected, rtol=0, atol=rounding_bound(np.array([size]), truth))
    velocity = c[:, 1] / estimator.window
    bound = rounding_bound(estimator.weights(1), truth) * np.sum(np.abs(estimator.prediction)) ** 3
    assert np.allclose(estimates[-1].velocity, velocity, rtol=0, atol=bound)


@pytest.mark.parametrize("name", ["differences", "filtered differences"])
def test_differences_extrapolate_a_missing_sample_linearly(name: str) -> None:
    estimates = estimates_along(EVERY[name], np.array([[0.0, 0.1, 0.2, np.nan, 0.4], [1.0, 1.0, 1.0, 1.0, np.inf]]))
    assert np.allclose([e.position for e in estimates], [[0, 1], [0.1, 1], [0.2, 1], [0.3, 1], [0.4, 1]])
    assert [e.valid.tolist() for e in estimates[3:]] == [[False, True], [True, False]]


@every_estimator
def test_the_traced_step_is_the_numpy_step_missing_samples_included(estimator: Estimator) -> None:
    positions = np.random.default_rng(3).standard_normal((2, 30)).cumsum(axis=1) * 1e-3
    positions[0, 12] = positions[1, 13:15] = np.nan
    first = estimator.init(positions[:, 0])
    for symbol in (ca.SX, ca.MX):
        function, example = trace(estimator.step, first, positions[:, 0], symbol=symbol)
        state = pack(first)
        for sample, expected in zip(positions.T, estimates_along(estimator, positions), strict=True):
            state, output = function(state, sample)
            traced: Any = unpack(example, np.array(output).ravel())
            for a, b, size in zip(traced, expected, (1, 1 / T, 1 / T**2, 1), strict=True):
                assert np.allclose(a, b, rtol=0, atol=1e-13 * size)


def test_an_estimator_at_rest_sees_no_motion() -> None:
    for estimator in EVERY.values():
        estimate = estimates_along(estimator, np.full((2, 5), 0.7))[-1]
        assert np.allclose(estimate.velocity, 0, atol=1e-12 / T)
        assert np.allclose(estimate.acceleration, 0, atol=1e-12 / T**2)


@pytest.mark.parametrize(
    ("attempt", "message"),
    [
        (lambda: Algebraic(window=0.0105, period=T), "window: got 0.0105 s, .* no whole multiple .* nearest is 0.01 s"),
        (
            lambda: Algebraic(window=T, degree=2).with_period(T),
            "window: 0.001 s holds 2 samples .* needs 3. Use window=0.002",
        ),
        (lambda: Algebraic(window=0.0), "window: got 0; needs a finite number above 0"),
        (lambda: Algebraic(window=0.01, degree=0), "degree: got 0; needs a whole number from 1 to 6"),
        (lambda: Algebraic(window=0.01, degree=7), "degree: got 7"),
        (lambda: Algebraic(window=0.01).weights(1), r"Algebraic: it has no period yet; use \.with_period\(1e-3\)"),
        (lambda: FilteredDifference(cutoff=10.0).pole, "FilteredDifference: it has no period yet"),
        (lambda: BackwardDifference(period=T).with_period(2 * T), "period of 0.001 s, the law runs at 0.002 s"),
        (lambda: BackwardDifference().with_period(0.0), "period: got 0"),
        (lambda: FilteredDifference(cutoff=-1.0), "cutoff: got -1"),
        (lambda: Algebraic(window=0.01).kernel(0.0, 3), "derivative: got 3; a kernel of degree 2 has 0 to 2"),
        (lambda: EVERY["degree 2"].noise_gain(3), "derivative: got 3; Algebraic estimates orders 0 to 2"),
        (lambda: EVERY["differences"].group_delay(-1), "derivative: got -1; BackwardDifference"),
        (lambda: EVERY["degree 2"].init([np.nan, 0.0]), "position: .* not NaN"),
    ],
)
def test_bad_input_is_refused_with_the_remedy(attempt: Any, message: str) -> None:
    with pytest.raises(InvalidParameter, match=message):
        attempt()
