"""A traced function in single precision, instruction by instruction: what exported C in ``float`` computes."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from tarc.core import array_ops as ops
from tarc.core.c_constants import SINGLE_HUGE
from tarc.core.c_emitter import called_names
from tarc.core.errors import UnsupportedLaw
from tarc.core.types import Array

Single = np.float32

OPERATIONS: dict[int, Callable[..., Any]] = {
    ca.OP_ASSIGN: lambda x: x,
    ca.OP_NEG: lambda x: -x,
    ca.OP_SQ: lambda x: x * x,
    ca.OP_TWICE: lambda x: Single(2) * x,
    ca.OP_INV: lambda x: Single(1) / x,
    ca.OP_SQRT: np.sqrt,
    ca.OP_EXP: np.exp,
    ca.OP_LOG: np.log,
    ca.OP_SIN: np.sin,
    ca.OP_COS: np.cos,
    ca.OP_TAN: np.tan,
    ca.OP_ASIN: np.arcsin,
    ca.OP_ACOS: np.arccos,
    ca.OP_ATAN: np.arctan,
    ca.OP_SINH: np.sinh,
    ca.OP_COSH: np.cosh,
    ca.OP_TANH: np.tanh,
    ca.OP_FABS: np.abs,
    ca.OP_FLOOR: np.floor,
    ca.OP_CEIL: np.ceil,
    ca.OP_SIGN: lambda x: Single(-1) if x < 0 else Single(1) if x > 0 else x,
    ca.OP_ADD: lambda x, y: x + y,
    ca.OP_SUB: lambda x, y: x - y,
    ca.OP_MUL: lambda x, y: x * y,
    ca.OP_DIV: lambda x, y: x / y,
    ca.OP_POW: lambda x, y: np.power(x, y),
    ca.OP_CONSTPOW: lambda x, y: np.power(x, y),
    ca.OP_ATAN2: np.arctan2,
    ca.OP_FMOD: np.fmod,
    ca.OP_COPYSIGN: np.copysign,
    ca.OP_FMIN: lambda x, y: x if x <= y or y != y else y,
    ca.OP_FMAX: lambda x, y: x if x >= y or y != y else y,
    ca.OP_HYPOT: np.hypot,
    ca.OP_LT: lambda x, y: Single(x < y),
    ca.OP_LE: lambda x, y: Single(x <= y),
    ca.OP_EQ: lambda x, y: Single(x == y),
    ca.OP_NE: lambda x, y: Single(x != y),
    ca.OP_NOT: lambda x: Single(x == 0),
    ca.OP_AND: lambda x, y: Single(x != 0 and y != 0),
    ca.OP_OR: lambda x, y: Single(x != 0 or y != 0),
    ca.OP_IF_ELSE_ZERO: lambda x, y: y if x != 0 else Single(0),
}
"""What each instruction gives, as the C of `tarc.core.c_constants` writes it."""


class SinglePrecision:
    """A traced function in single precision.

    Parameters
    ----------
    function
        As for `tarc.core.c_emitter.emit`.
    """

    def __init__(self, function: ca.Function):
        self._sizes = [function.nnz_out(i) for i in range(function.n_out())]
        self._program: list[tuple[int, Any, list[int], list[int]]] = []
        callees = {callee.name(): callee for callee in _all_callees(function)}
        called = called_names(function)
        for k in range(function.n_instructions()):
            operation = function.instruction_id(k)
            detail: Any = None
            if operation == ca.OP_CONST:
                detail = _single(function.instruction_constant(k))
            elif operation == ca.OP_CALL:
                callee = callees[next(called)]
                detail = (
                    SinglePrecision(callee) if callee.is_a("SXFunction") else _Product(callee),
                    [callee.nnz_in(i) for i in range(callee.n_in())],
                )
            elif operation not in OPERATIONS and operation not in (ca.OP_INPUT, ca.OP_OUTPUT):
                raise UnsupportedLaw(f"export: CasADi's operation {operation} has no counterpart in C")
            program = function.instruction_input(k), function.instruction_output(k)
            self._program.append((operation, detail, *program))
        self._n_registers = function.sz_w()

    def __call__(self, *values: Sequence[Any] | Array) -> list[Array]:
        """Return the outputs for vectors of single precision."""
        registers: list[Any] = [Single(0)] * self._n_registers
        outputs = [np.zeros(size, dtype=Single) for size in self._sizes]
        with np.errstate(all="ignore"):
            for operation, detail, inputs, results in self._program:
                if operation == ca.OP_INPUT:
                    registers[results[0]] = values[inputs[0]][inputs[1]]
                elif operation == ca.OP_OUTPUT:
                    outputs[results[0]][results[1]] = registers[inputs[0]]
                elif operation == ca.OP_CONST:
                    registers[results[0]] = detail
                elif operation == ca.OP_CALL:
                    callee, sizes = detail
                    ends = np.cumsum([0, *sizes])
                    arguments = [registers[i] for i in inputs]
                    parts = [arguments[start:end] for start, end in pairwise(ends)]
                    for place, value in zip(results, np.concatenate(callee(*parts)), strict=True):
                        registers[place] = value
                else:
                    registers[results[0]] = OPERATIONS[operation](*(registers[i] for i in inputs))
        return outputs


class _Product:
    """A product of the one input (n, m) with a constant matrix (m, p), summed as the C does."""

    def __init__(self, function: ca.Function):
        height, inner = function.size_in(0)
        weights = np.array([np.array(function(_unit_row(height, inner, k)))[0] for k in range(inner)])
        self._height, self._weights = height, weights.astype(Single)

    def __call__(self, value: Sequence[Any]) -> list[Array]:
        matrix = np.reshape(np.array(value, dtype=Single), (self._height, -1), order="F")
        total = np.zeros((self._height, self._weights.shape[1]), dtype=Single)
        for k, row in enumerate(self._weights):
            total = total + matrix[:, k : k + 1] * row
        return [total.ravel(order="F")]


def _unit_row(height: int, inner: int, column: int) -> ca.DM:
    matrix = ca.DM.zeros(height, inner)
    matrix[0, column] = 1.0
    return matrix


def _single(value: float) -> Any:
    if abs(value) >= ops.HUGE and np.isfinite(value):
        return Single(SINGLE_HUGE if value > 0 else -SINGLE_HUGE)
    return Single(value)


def _all_callees(function: ca.Function) -> list[ca.Function]:
    return [inner for callee in function.find_functions(0) for inner in (callee, *_all_callees(callee))]
