"""Trees and vectors, tracing, and the step over fixed memory."""

import tracemalloc
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from tarc.core.errors import InvalidParameter
from tarc.core.tracing import CompiledStep, trace
from tarc.core.trees import leaves, names, pack, rebuild, unpack

sampled = settings(max_examples=50)


class Pair(NamedTuple):
    left: Any
    right: Any


class Motion(NamedTuple):
    position: Any
    velocity: Any


numbers = st.floats(-1e6, 1e6)
leaf = arrays(float, array_shapes(min_dims=0, max_dims=2, max_side=4), elements=numbers)
trees = st.recursive(
    leaf,
    lambda child: st.one_of(
        st.builds(Pair, child, child),
        st.builds(Motion, child, child),
        st.tuples(child, child, child),
        st.just(()),
        st.dictionaries(st.text("abcdef", min_size=1, max_size=3), child, max_size=3),
    ),
    max_leaves=12,
)


def is_identical(first: Any, second: Any) -> bool:
    """Equal in structure, kinds, shapes and numbers."""
    if isinstance(first, dict):
        return (
            type(second) is dict
            and list(first) == list(second)
            and all(is_identical(first[key], second[key]) for key in first)
        )
    if isinstance(first, tuple):
        return type(first) is type(second) and len(first) == len(second) and all(map(is_identical, first, second))
    return np.shape(first) == np.shape(second) and np.array_equal(first, second)


@sampled
@given(tree=trees)
def test_rebuild_undoes_leaves(tree: Any) -> None:
    assert is_identical(rebuild(tree, leaves(tree)), tree)


@sampled
@given(tree=trees)
def test_unpack_undoes_pack(tree: Any) -> None:
    vector = pack(tree)
    assert vector.ndim == 1
    assert is_identical(unpack(tree, vector), tree)


@sampled
@given(tree=trees)
def test_pack_undoes_unpack(tree: Any) -> None:
    vector = np.arange(1.0, 1 + sum(np.size(x) for x in leaves(tree)))
    assert np.array_equal(pack(unpack(tree, vector)), vector)


@sampled
@given(tree=trees)
def test_every_leaf_has_a_name_of_its_own_that_leads_to_it(tree: Any) -> None:
    labels = names(tree)
    assert len(labels) == len(set(labels)) == len(leaves(tree))
    for label, expected in zip(labels, leaves(tree), strict=True):
        node = tree
        for part in label.split(".") if label else []:
            if isinstance(node, dict):
                node = node[part]
            else:
                node = getattr(node, part) if hasattr(node, "_fields") else node[int(part)]
        assert node is expected


def test_names_and_order_of_a_known_tree() -> None:
    tree = Pair(Motion(np.array([1.0, 2.0]), np.array(3.0)), {"gain": np.array([[4.0, 6.0], [5.0, 7.0]]), "none": ()})
    assert names(tree) == ["left.position", "left.velocity", "right.gain"]
    assert pack(tree).tolist() == [1, 2, 3, 4, 5, 6, 7]  # matrices column by column


A = np.array([[0.9, 0.2], [-0.1, 0.8]])
B = np.array([[0.0, 1.0, 2.0], [1.0, 0.5, 0.0]])


def linear(state: Motion, value: dict[str, Any]) -> tuple[Motion, dict[str, Any]]:
    """Return a small system with vector, matrix and scalar leaves."""
    x = A @ state.position + B @ value["force"]
    history = state.velocity @ np.array([[0.0, 1.0], [0.0, 0.0]]) + value["scale"]
    return Motion(x, history), {"sum": x[0] + x[1], "twice": 2 * x, "history": state.velocity}


STATE = Motion(np.array([1.0, -2.0]), np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]))
VALUE = {"force": np.array([0.5, 1.5, -1.0]), "scale": np.array(0.25)}


@pytest.mark.parametrize("symbol", [ca.SX, ca.MX])
def test_a_traced_step_is_the_numpy_step(symbol: type) -> None:
    function, example = trace(linear, STATE, VALUE, symbol=symbol, name="interpolate")
    assert function.name() == "interpolate"
    state, packed = STATE, pack(STATE)
    for k in range(5):
        value = {"force": VALUE["force"] * k, "scale": VALUE["scale"] - k}
        packed, output = function(packed, pack(value))
        state, expected = linear(state, value)
        traced = unpack(example, np.array(output).ravel())
        assert list(traced) == list(expected)
        for name in expected:
            assert np.shape(traced[name]) == np.shape(expected[name])
            assert np.allclose(traced[name], expected[name], rtol=1e-14)
        assert np.allclose(np.array(packed).ravel(), pack(state), rtol=1e-14)


def test_the_example_of_a_trace_is_zero_in_the_output_s_shapes() -> None:
    _, example = trace(linear, STATE, VALUE)
    assert {name: np.shape(values) for name, values in example.items()} == {"sum": (), "twice": (2,), "history": (3, 2)}
    assert not pack(example).any()


def test_a_step_without_state_or_output_traces() -> None:
    function, example = trace(lambda state, value: (state, 3 * value), (), np.zeros(2))
    assert np.array_equal(np.array(function(np.zeros(0), [1.0, 2.0])[1]).ravel(), [3, 6])
    assert example.shape == (2,)
    function, example = trace(lambda state, value: (state + value, ()), np.zeros(2), np.zeros(2))
    assert np.array_equal(np.array(function([1.0, 2.0], [1.0, 2.0])[0]).ravel(), [2, 4])
    assert example == ()


def test_a_state_that_changes_its_shape_is_named() -> None:
    def grow(state: Motion, value: Any) -> tuple[Motion, Any]:
        return Motion(state.position, ca.vertcat(state.velocity, value)), value

    with pytest.raises(
        InvalidParameter, match=r"growing: state velocity has shape \(2, 1\) before the step and \(3, 1\)"
    ):
        trace(grow, Motion(np.zeros(2), np.zeros(2)), np.zeros(1), name="growing")


def test_a_state_that_gains_a_leaf_is_refused() -> None:
    with pytest.raises(ValueError, match="argument"):
        trace(lambda state, value: (Pair(state, state), value), np.zeros(2), np.zeros(1))


def test_buffered_steps_equal_repeated_calls() -> None:
    function, _ = trace(linear, STATE, VALUE)
    buffered, packed = CompiledStep(function), pack(STATE)
    buffered.reset(packed)
    for k in range(7):  # odd, so that both of the alternating buffers have had the last word
        value = pack(VALUE) * (k - 3)
        buffered.value[:] = value
        buffered.step()
        packed, output = function(packed, value)
        assert np.array_equal(buffered.output, np.array(output).ravel())
        assert np.array_equal(buffered.state, np.array(packed).ravel())


def test_buffered_starts_at_zero_and_again_wherever_it_is_reset() -> None:
    function, _ = trace(linear, STATE, VALUE)
    buffered, outputs = CompiledStep(function), []
    assert not buffered.state.any()
    for _ in range(3):
        buffered.reset(pack(STATE))
        assert np.array_equal(buffered.state, pack(STATE))
        buffered.step()
        outputs.append(buffered.output.copy())
    assert np.array_equal(outputs[0], outputs[1])
    assert np.array_equal(outputs[0], outputs[2])


def test_two_buffered_of_one_function_do_not_share_memory() -> None:
    function, _ = trace(linear, STATE, VALUE)
    first, second = CompiledStep(function), CompiledStep(function)
    first.reset(pack(STATE))
    first.step()
    assert first.output.any()
    assert not second.output.any()
    assert not second.state.any()


def test_buffered_steps_allocate_nothing() -> None:
    wide = np.zeros(1000)  # so that one array more, even for a moment, is 8000 bytes
    buffered = CompiledStep(trace(lambda state, value: (state + value, 2 * state), wide, wide)[0])
    value, output, states = buffered.value, buffered.output, []
    for _ in range(4):
        states.append(buffered.state)
        buffered.step()
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(100):
            buffered.step()
        after, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert max(peak, after) - before < 2000  # the loop's own counter and the call's frame
    assert buffered.value is value
    assert buffered.output is output
    assert states[0] is states[2] is buffered.state
    assert states[1] is states[3]
