"""What holds for every estimator there is."""

import inspect

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from law_catalogue import ESTIMATORS, PERIOD
from tarc import estimators
from tarc.core.tracing import CompiledStep, trace
from tarc.core.trees import pack, unpack

BOUND = {name: estimator.with_period(PERIOD) for name, estimator in ESTIMATORS.items()}
every_estimator = pytest.mark.parametrize("name", BOUND)
NO_FILTERS = estimators.RobustDifferentiator, estimators.TrueDerivatives
LINEAR = [name for name, one in BOUND.items() if not isinstance(one, NO_FILTERS)]
every_linear_estimator = pytest.mark.parametrize("name", LINEAR)


def test_none_is_left_out():
    kinds = [getattr(estimators, name) for name in estimators.__all__]
    concrete = {
        k for k in kinds if inspect.isclass(k) and issubclass(k, estimators.Estimator) and not inspect.isabstract(k)
    }
    assert concrete == {type(estimator) for estimator in ESTIMATORS.values()}


@every_estimator
@pytest.mark.parametrize("joints", [1, 3])
@pytest.mark.parametrize("symbol", [ca.SX, ca.MX], ids=["SX", "MX"])
@settings(max_examples=15)
@given(seed=st.integers(0, 2**32 - 1), lost=st.sampled_from([None, np.nan, np.inf, -np.inf]))
def test_traced_equals_numpy(name, joints, symbol, seed, lost):
    estimator = BOUND[name]
    rng = np.random.default_rng(seed)
    blank = estimator.init(np.zeros(joints))
    state = unpack(blank, rng.normal(size=pack(blank).shape))
    position = rng.normal(size=joints)
    if lost is not None:
        position[rng.integers(joints)] = lost
    function, _ = trace(estimator.step, blank, np.zeros(joints), symbol=symbol)
    traced = [np.array(part).ravel() for part in function(pack(state), position)]
    # weights are of order 1/T² = 1e6, so rounding is 1e6 times that of numbers near one
    for traced_part, expected in zip(traced, estimator.step(state, position), strict=True):
        np.testing.assert_allclose(traced_part, pack(expected), rtol=1e-9, atol=1e-8)


@every_linear_estimator
def test_transfer_function_is_that_of_the_step(name):
    """The impulse response of the running estimator is that of `transfer`."""
    from scipy.signal import lfilter

    estimator = BOUND[name]
    state = estimator.init(np.zeros(1))
    impulse = np.zeros(60)
    impulse[0] = 1.0
    response = []
    for sample in impulse:
        state, estimate = estimator.step(state, np.array([sample]))
        response.append([estimate.position[0], estimate.velocity[0], estimate.acceleration[0]])
    for derivative, column in enumerate(np.transpose(response)):
        if derivative == 0:
            np.testing.assert_array_equal(column, impulse)  # a measured position is passed as it is
            continue
        expected = lfilter(*estimator.transfer_function(derivative), impulse)
        np.testing.assert_allclose(column, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@every_estimator
def test_buffered_equals_numpy_over_time(name):
    estimator = BOUND[name]
    rng = np.random.default_rng(1)
    samples = np.cumsum(rng.normal(size=(50, 2)), axis=0)
    state = estimator.init(samples[0])
    function, _ = trace(estimator.step, state, samples[0])
    buffered = CompiledStep(function)
    buffered.reset(pack(state))
    for sample in samples:
        state, estimate = estimator.step(state, sample)
        buffered.value[:] = sample
        buffered.step()
        np.testing.assert_allclose(buffered.output, pack(estimate), rtol=1e-9, atol=1e-6)
