"""Emitted C against CasADi's virtual machine: the same numbers to the last bit, and no warnings."""

import subprocess
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from law_catalogue import ESTIMATORS, concrete_laws, make_law
from tarc import estimators, laws
from tarc.core.c_constants import ARITHMETIC, COMPARISONS, LOGICAL, Constants
from tarc.core.c_emitter import emit
from tarc.core.codegen import CompiledLoop, compiled, compiler
from tarc.core.errors import InvalidParameter
from tarc.core.tracing import trace

NUMBERS = [0.0, -0.0, 1.0, -1.0, 0.3, -2.7, 1e-320, 1e200, -1e200, np.inf, -np.inf, np.nan]
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-Wno-unused-function"]


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


def assert_equal_to_the_bit(actual, expected):
    np.testing.assert_array_equal(actual, expected)
    finite = ~np.isnan(expected)
    np.testing.assert_array_equal(np.signbit(actual)[finite], np.signbit(expected)[finite])


def every_operation() -> ca.Function:
    """Return a function of two numbers that has each operation of the emitter at least once."""
    x = ca.SX.sym("x")
    y = ca.SX.sym("y")
    unary = [-x, x * x, 2 * x, 1 / x, ca.sqrt(x), ca.exp(x), ca.log(x), ca.sin(x), ca.cos(x), ca.tan(x)]
    unary += [ca.asin(x), ca.acos(x), ca.atan(x), ca.sinh(x), ca.cosh(x), ca.tanh(x), ca.fabs(x)]
    unary += [ca.floor(x), ca.ceil(x), ca.sign(x)]
    binary = [x + y, x - y, x * y, x / y, x**y, x**0.3, ca.atan2(x, y), ca.fmod(x, y), ca.copysign(x, y)]
    binary += [ca.fmin(x, y), ca.fmax(x, y), ca.hypot(x, y)]
    comparisons = [x < y, x <= y, x == y, x != y]
    logical = [ca.logic_not(x), ca.logic_and(x < y, x), ca.logic_or(x, y < 0)]
    chosen = [ca.if_else(x < y, x, y), ca.if_else(x, y, 0), 3 * (x < y)]
    return ca.Function("f", [x, y], [ca.vertcat(*unary, *binary, *comparisons, *logical, *chosen)])


def test_every_operation_gives_the_same_bits():
    function = every_operation()
    used = {function.instruction_id(k) for k in range(function.n_instructions())}
    assert {*ARITHMETIC, *COMPARISONS, *LOGICAL} - used <= {ca.OP_ASSIGN}
    machine = compiled(function)
    for x in NUMBERS:
        for y in NUMBERS:
            assert_equal_to_the_bit(np.array(machine(x, y)), np.array(function(x, y)))


@pytest.mark.parametrize("window", [0.008, 0.05])
@pytest.mark.parametrize("kind", concrete_laws(), ids=lambda kind: kind.__name__)
def test_every_law_gives_the_same_bits(kind, window):
    law = make_law(kind)
    law = replace(law, estimator=estimators.Algebraic(window=window, degree=2))
    check_law(law)


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("kind", concrete_laws(), ids=lambda kind: kind.__name__)
def test_every_law_gives_the_same_bits_with_every_estimator(kind, estimator):
    check_law(make_law(kind, 2, estimator))


def check_law(law):
    function, _ = trace(law.step, *law.example())
    random = np.random.default_rng(1)
    state = random.normal(size=function.nnz_in(0))
    inputs = random.normal(size=(12, function.nnz_in(1)))
    inputs[3, 0] = np.nan
    inputs[7] = 0.0
    expected = []
    interpreted = state.copy()
    for row in inputs:
        interpreted, output = (np.array(result)[:, 0] for result in function(interpreted, row))
        expected.append(output)
    assert_equal_to_the_bit(CompiledLoop(function).run(state, inputs), np.array(expected))
    assert_equal_to_the_bit(state, interpreted)


def test_functions_within_functions_are_called():
    x = ca.SX.sym("x", 2)
    inner = ca.Function("inner", [x], [ca.sin(x), x[0]], {"never_inline": True})
    y, z = inner(3 * x)
    outer = ca.Function("outer", [x], [y * z + inner(x)[0]], {"never_inline": True})
    whole = ca.Function("whole", [x], [outer(outer(x))])
    assert emit(whole, "f").count("static void inner(") == 1
    assert_equal_to_the_bit(np.array(compiled(whole)([0.3, -0.4])), np.array(whole([0.3, -0.4])))


@pytest.mark.parametrize("joints", [4, 9, 10])
def test_windows_as_long_as_there_are_joints(joints):
    check_law(make_law(laws.TARC, joints))


def test_called_matrix_functions_are_products():
    x = ca.MX.sym("x", 2)
    inner = ca.Function("inner", [x], [ca.sin(x)], {"never_inline": True})
    y = ca.SX.sym("y", 2)
    with pytest.raises(InvalidParameter, match="inner: it is called, and is no product with a constant matrix"):
        emit(ca.Function("outer", [y], [inner(y)]), "f")


def test_inputs_and_outputs_that_casadi_leaves_out():
    x = ca.SX.sym("x", 2)
    y = ca.SX.sym("y")
    machine = compiled(ca.Function("f", [x, y], [x + y, x * y], ["x", "y"], ["sum", "product"]))
    np.testing.assert_array_equal(np.array(machine(x=[1.0, 2.0])["sum"])[:, 0], [1.0, 2.0])


@pytest.mark.parametrize("in_array", [False, True], ids=["literals", "array"])
@pytest.mark.parametrize("kind", concrete_laws(), ids=lambda kind: kind.__name__)
def test_no_warnings(kind, in_array, tmp_path):
    law = replace(make_law(kind), estimator=estimators.Algebraic(window=0.05, degree=2))
    function, _ = trace(law.step, *law.example())
    source = tmp_path / "law.c"
    source.write_text(emit(function, "law_step", Constants(in_array)))
    command = [*compiler(), *STRICT, "-fsyntax-only", str(source)]
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr


def test_operation_without_counterpart():
    x = ca.SX.sym("x")
    with pytest.raises(InvalidParameter, match="operation .*, which has no counterpart in C"):
        emit(ca.Function("f", [x], [ca.erf(x)]), "f")


def test_wrong_shapes():
    x = ca.SX.sym("x", 2)
    u = ca.SX.sym("u")
    loop = CompiledLoop(ca.Function("f", [x, u], [x + u, x]))
    with pytest.raises(InvalidParameter, match=r"got shapes \(2,\) and \(3, 2\); needs \(2,\) and \(k, 1\)"):
        loop.run(np.zeros(2), np.zeros((3, 2)))
