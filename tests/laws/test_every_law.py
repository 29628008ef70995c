"""What holds for every law there is, with every estimator."""

import pickle
from dataclasses import replace
from functools import lru_cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from law_catalogue import ESTIMATORS, concrete_laws, make_law
from tarc import Controller, plants, signals, simulate
from tarc.core.errors import InvalidParameter
from tarc.core.tracing import trace
from tarc.core.trees import leaves, pack, unpack
from tarc.estimators import Algebraic, RobustDifferentiator, TrueDerivatives
from tarc.laws import TDC, TDE, LawInput, PolePlacement
from tarc.scenario.schema import parameters

LAWS = concrete_laws()


def parametrize_kinds(kinds):
    return pytest.mark.parametrize("kind", kinds, ids=lambda kind: kind.__name__)


every_law = parametrize_kinds(LAWS)
every_law_with_poles = parametrize_kinds([kind for kind in LAWS if issubclass(kind, PolePlacement)])
every_law_on_tde = parametrize_kinds([kind for kind in LAWS if issubclass(kind, TDE)])
every_way = pytest.mark.parametrize(
    ("kind", "options"),
    [
        pytest.param(kind, {name: True} if name else {}, id=f"{kind.__name__} {name or ''}".strip())
        for kind in LAWS
        for name in (None, "synchronised", "time_delay")
        if name is None or name in parameters(kind)
    ],
)
ESTIMATORS_AND_SYMBOLS = [
    pytest.param(name, symbol, id=f"{name}-{symbol.__name__}", marks=marks)
    for name in ESTIMATORS
    for symbol, marks in ((ca.SX, ()), (ca.MX, () if name in ("algebraic", "truth") else pytest.mark.slow))
]
"""Graphs of matrices are slow to trace, and two estimators show that the laws have them."""


def random_state(law, rng):
    """Return a state with plausible numbers in every place: positions near one, counters and latches off."""
    state, _ = law.example()
    vector = pack(state)
    numbers = unpack(state, rng.normal(size=vector.shape))
    zero = np.zeros(())
    return numbers._replace(missing=zero, fault=zero)


@lru_cache(maxsize=1)
def traced_law(kind, options, estimator, symbol):
    """Return a law with its traced step and the example of its output; options as pairs."""
    law = make_law(kind, 3, estimator, **dict(options))
    return law, *trace(law.step, *law.example(), symbol=symbol)


@every_way
@pytest.mark.parametrize(("estimator", "symbol"), ESTIMATORS_AND_SYMBOLS)
@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1), lost=st.sampled_from([None, np.nan, np.inf]))
def test_traced_equals_numpy(kind, options, estimator, symbol, seed, lost):
    if options.get("synchronised") and isinstance(ESTIMATORS[estimator], RobustDifferentiator | TrueDerivatives):
        with pytest.raises(InvalidParameter, match="use synchronised=False"):
            make_law(kind, 3, estimator, **options).example()
        return
    law, function, example = traced_law(kind, tuple(options.items()), estimator, symbol)
    rng = np.random.default_rng(seed)
    state, value = random_state(law, rng), LawInput(*rng.normal(size=(4, 3)))
    if lost is not None:
        value.position[rng.integers(3)] = lost
    next_state, output = law.step(state, value)
    traced_state, traced_output = (np.array(part).ravel() for part in function(pack(state), pack(value)))
    # acceleration weights are of order 1/T² = 1e6, so rounding is 1e6 times that of numbers near one
    np.testing.assert_allclose(traced_state, pack(next_state), rtol=1e-9, atol=1e-8)
    np.testing.assert_allclose(traced_output, pack(output), rtol=1e-9, atol=1e-8)
    assert [np.shape(leaf) for leaf in leaves(output)] == [np.shape(leaf) for leaf in leaves(example)]


@every_way
@settings(max_examples=30)
@given(data=st.data())
def test_never_emits_nan(kind, options, data):
    """Whatever comes in, NaN and infinities and numbers near overflow included, finite torque comes out."""
    law = make_law(kind, 2, max_missing=3, **options)
    state, _ = law.example()
    anything = st.lists(st.floats(width=64), min_size=8, max_size=8)
    for _ in range(8):
        value = LawInput(*np.array(data.draw(anything)).reshape(4, 2))
        with np.errstate(over="ignore", invalid="ignore"):
            state, output = law.step(state, value)
        assert all(np.all(np.isfinite(leaf)) for leaf in leaves(state)), "state"
        assert all(np.all(np.isfinite(leaf)) for leaf in leaves(output)), "output"


@every_way
def test_controller_equals_simulation(kind, options):
    """The real-time face, fed with the measurements of a run, gives the torques of that run."""
    options = {**options, **({"inertia": [0.15, 0.05]} if issubclass(kind, PolePlacement) else {})}
    law = make_law(kind, torque_limit=60.0, **options)
    reference = signals.Sinusoid(amplitude=[0.3, 0.4], frequency=[2.0, 3.0])
    sensor = signals.Encoder(bits=14, dropout=0.02)
    run = simulate(plants.TwoLinkArm(), law, reference, 0.5, sensor=sensor, initial_torque="rest", seed=3)
    assert run.status.completed
    data = run.data
    assert np.isnan(data["measured_position"].values).any(), "the sensor loses samples here"
    controller = Controller(law)
    controller.reset(data["reference"].values[0], plants.TwoLinkArm().gravity_torque(data["reference"].values[0]))
    columns = [
        data[name].values for name in ("measured_position", "reference", "velocity_reference", "acceleration_reference")
    ]
    torques = np.array([controller.step(*row).copy() for row in zip(*columns, strict=True)])
    # the two engines evaluate in another order; a closed loop does not amplify that here
    np.testing.assert_allclose(torques, data["torque"].values, rtol=1e-7, atol=1e-7)


@every_law
def test_torque_stays_within_limits(kind):
    law = make_law(kind, torque_limit=[5.0, 2.0])
    state, value = law.example()
    state, output = law.step(state, value._replace(reference=np.array([3.0, -3.0])))
    np.testing.assert_array_equal(output.torque, [5.0, -2.0])
    np.testing.assert_array_equal(state.torque[:, 0], output.torque)


@every_law
def test_missing_sample_is_bridged_then_safe(kind):
    missing = np.full(2, np.nan)
    law = make_law(kind, max_missing=2, safe_torque="hold")
    state, value = law.example()
    state, _ = law.step(state, value._replace(position=np.full(2, 0.01)))
    for count in (1, 2):
        state, output = law.step(state, value._replace(position=missing))
        assert (output.signals["missing"], output.signals["fault"]) == (count, 0)
    last_torque = state.torque[:, 0]
    for _ in range(3):
        state, output = law.step(state, value._replace(position=missing))
        assert output.signals["fault"] == 1
        np.testing.assert_array_equal(output.torque, last_torque)
    state, output = law.step(state, value)
    assert output.signals["missing"] == 0
    assert output.signals["fault"] == 1, "the fault stays until reset"


@every_law
@pytest.mark.parametrize(
    ("safe", "expected"), [("zero", [0.0, 0.0]), (lambda q: 2.0 * q + 1.0, [1.5, 0.5])], ids=["zero", "gravity"]
)
def test_safe_torque(kind, safe, expected):
    law = make_law(kind, max_missing=0, safe_torque=safe)
    state = law.init(np.array([0.25, -0.25]))
    _, value = law.example()
    _, output = law.step(state, value._replace(position=np.full(2, np.inf)))
    np.testing.assert_allclose(output.torque, expected, atol=1e-12)


@every_law
def test_lost_reference_is_held(kind):
    """A reference that is not a number is the last one held, at rest: no step, no NaN."""
    law = make_law(kind)
    _, value = law.example()
    at_rest = value._replace(position=np.full(2, 0.5), reference=np.full(2, 0.5))
    state, output = law.step(law.init(np.full(2, 0.5)), at_rest)
    state, output = law.step(state, at_rest._replace(reference=np.full(2, np.nan)))
    np.testing.assert_allclose(output.torque, 0.0, atol=1e-6)


@every_law_on_tde
def test_is_at_rest_on_target(kind):
    """On the reference at rest every law keeps the torque that was applied."""
    law = make_law(kind)
    state, value = law.init(np.full(2, 0.5), [3.0, -1.0]), law.example()[1]
    for _ in range(20):
        state, output = law.step(state, value._replace(position=np.full(2, 0.5), reference=np.full(2, 0.5)))
        np.testing.assert_allclose(output.torque, [3.0, -1.0], rtol=1e-9)


@every_law
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"period": 0.0}, "period: got 0; needs a finite number above 0"),
        ({"estimator": "Algebraic"}, "estimator: got 'Algebraic'; needs one of tarc.estimators"),
        ({"torque_limit": [1.0, 2.0, 3.0]}, r"torque_limit: got shape \(3,\)"),
        ({"torque_limit": -1.0}, "torque_limit"),
        ({"period": "0.001"}, "period: got '0.001'; needs one number"),
        ({"max_missing": 2.5}, "max_missing: got 2.5; needs a whole number"),
        ({"safe_torque": "brake"}, "safe_torque: got 'brake'; known are zero, hold"),
    ],
)
def test_bad_parameters_are_refused(kind, options, message):
    with pytest.raises(InvalidParameter, match=message):
        make_law(kind, **options)


@every_law_with_poles
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"inertia": [[1.0, 0.5], [0.4, 1.0]]}, "inertia: .* not symmetric"),
        ({"inertia": [[1.0, 2.0], [2.0, 1.0]]}, "inertia: its smallest eigenvalue is -1"),
        ({"inertia": [[1.0, 2.0, 3.0], [2.0, 1.0, 3.0]]}, r"inertia: got shape \(2, 3\)"),
        ({"inertia": [np.nan, 1.0]}, "inertia: .*finite numbers"),
        ({"natural_frequency": None}, "natural_frequency: missing"),
        ({"natural_frequency": -3.0}, "natural_frequency: .*above 0"),
        ({"velocity_gain": [-1.0, 10.0]}, "A = .* is not Hurwitz, an eigenvalue has real part"),
        ({"position_gain": 100.0}, "natural_frequency, position_gain: both are given"),
    ],
)
def test_bad_poles_are_refused(kind, options, message):
    with pytest.raises(InvalidParameter, match=message):
        make_law(kind, **options)


@every_law_on_tde
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"delay": 0.0015}, "delay: got 0.0015 s, which is no whole multiple of the period 0.001 s"),
        ({"delay": 0.002, "synchronised": True}, "delay: got 0.002 s with synchronised=True"),
    ],
)
def test_bad_delays_are_refused(kind, options, message):
    with pytest.raises(InvalidParameter, match=message):
        make_law(kind, **options)


@every_law
def test_unknown_and_missing_parameters(kind):
    with pytest.raises(InvalidParameter, match=r"unknown parameter 'perod'.*Did you mean 'period'\?"):
        make_law(kind, perod=3.0)
    with pytest.raises(InvalidParameter, match="parameter 'period' is missing"):
        kind()


@every_law
def test_survives_pickling_and_replacement(kind):
    law = make_law(kind)
    twin = pickle.loads(pickle.dumps(law))
    state, value = law.example()
    torques = [copy.step(state, value._replace(reference=np.ones(2)))[1].torque for copy in (law, twin)]
    np.testing.assert_array_equal(*torques)
    if isinstance(law, PolePlacement):
        assert replace(law, natural_frequency=7.0).K1[0, 0] == pytest.approx(49.0)


@every_law_on_tde
def test_estimator_without_acceleration_is_refused(kind):
    with pytest.raises(InvalidParameter, match="gives no acceleration"):
        make_law(kind, estimator=Algebraic(window=0.008, degree=1))


@every_law
def test_safe_torque_is_of_the_last_position_seen(kind):
    """However long nothing is heard: the window's own prediction runs away, the last position does not."""
    law = make_law(kind, max_missing=3, safe_torque=lambda q: 10.0 * q)
    controller, still = Controller(law), np.zeros(2)
    controller.reset(still)
    rng = np.random.default_rng(0)
    seen, torque = still, still
    for _ in range(20):
        seen = np.array([0.3, -0.2]) + 1e-4 * rng.normal(size=2)
        controller.step(seen, still, still, still)
    for _ in range(3000):
        torque = controller.step(np.full(2, np.nan), still, still, still)
    np.testing.assert_allclose(torque, 10.0 * seen, rtol=1e-12)


@every_law
def test_a_safe_torque_that_is_no_number_is_zero(kind):
    law = make_law(kind, max_missing=0, safe_torque=lambda q: q / (q - 1.2), torque_limit=50.0)
    controller = Controller(law)
    controller.reset([1.2, 0.5])
    torque = controller.step([np.nan, np.nan], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0])
    np.testing.assert_array_equal(torque, 0.0)


def test_a_safe_torque_that_fails_is_refused_with_its_own_error():
    def fail(position):
        raise KeyError

    with pytest.raises(InvalidParameter, match="safe_torque: it fails with KeyError") as caught:
        make_law(TDC, safe_torque=fail)
    assert isinstance(caught.value.__cause__, KeyError)


@every_law
@pytest.mark.parametrize("wrong", [lambda q: q[:1], lambda q: None, lambda q: [float(x) for x in q]])
def test_a_safe_torque_that_cannot_be_is_refused(kind, wrong):
    with pytest.raises(InvalidParameter, match="safe_torque: it .*needs a function of a position"):
        make_law(kind, safe_torque=wrong)


@every_law_with_poles
def test_keeps_its_own_copy_of_arrays(kind):
    inertia = np.diag([0.1, 0.1])
    law = make_law(kind, inertia=inertia)
    inertia *= 100
    assert law.M[0, 0] == 0.1
    assert replace(law, natural_frequency=5.0).M[0, 0] == 0.1


@every_law_with_poles
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"inertia": "abc"}, "inertia: got 'abc'; needs numbers"),
        ({"inertia": [[1.0, 2.0], [3.0]]}, "inertia: .*needs numbers"),
        ({"inertia": []}, "inertia"),
        ({"inertia": None}, "inertia"),
        (
            {"natural_frequency": None, "position_gain": 100.0, "velocity_gain": 20.0, "damping_ratio": 0.7},
            "damping_ratio, velocity_gain: both",
        ),
        ({"natural_frequency": 10**400}, "natural_frequency: .*needs numbers"),
    ],
)
def test_odd_values_are_refused(kind, options, message):
    with pytest.raises(InvalidParameter, match=message):
        make_law(kind, **options)
