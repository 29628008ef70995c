"""Trace a step into a ``casadi.Function``, and call it over fixed memory."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import casadi as ca
import numpy as np

from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.core.trees import leaves, names, rebuild
from tarc.core.types import Array, Tree, Vector

Step = Callable[[Tree, Tree], tuple[Tree, Tree]]
"""Pure function (state, value) -> (next state, output)."""

TRACE_ERRORS = (RuntimeError, ValueError, TypeError, AttributeError, NotImplementedError, LookupError, UnsupportedLaw)
"""What a part raises that decides by the value of a symbol."""
BUFFER_PERIODS = 32
"""Periods between two copies of the recorded outputs; few, so that the arrays of a buffer stay in the fast cache."""


def _symbols(tree: Tree, kind: type) -> tuple[Vector, Tree]:
    """Return one symbol vector for the whole tree, and the tree of its pieces."""
    shapes = [(*np.shape(leaf), 1, 1)[:2] if np.ndim(leaf) else (1, 1) for leaf in leaves(tree)]
    sizes = [rows * columns for rows, columns in shapes]
    vector = kind.sym("x", sum(sizes))
    ends = np.cumsum([0, *sizes])
    pieces = [
        ca.reshape(vector[int(start) : int(end)], *shape) if shape[1] > 1 else vector[int(start) : int(end)]
        for start, end, shape in zip(ends, ends[1:], shapes, strict=False)
    ]
    return vector, rebuild(tree, pieces)


@contextmanager
def numpy_on_symbols() -> Iterator[None]:
    """Let functions of NumPy take symbols, without CasADi's warning that a later version may do so otherwise."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        yield


def expressions(
    step: Step,
    state: Tree,
    value: Tree,
    *,
    symbol: type = ca.SX,
    name: str = "step",
) -> tuple[list[Vector], list[Vector]]:
    """Return the packed symbols ``[state, value]`` of a step and its expressions ``[next state, output]``.

    The parameters are those of `trace`.
    """
    state_symbol, state_tree = _symbols(state, symbol)
    value_symbol, value_tree = _symbols(value, symbol)
    with numpy_on_symbols():
        next_state, output = step(state_tree, value_tree)
    for old, new, label in zip(leaves(state_tree), leaves(next_state), names(state), strict=True):
        new = new if isinstance(new, symbol) else symbol(new)
        if old.shape != new.shape:
            raise InvalidParameter(f"{name}: state {label} has shape {old.shape} before the step and {new.shape} after")

    def column(tree: Tree) -> Vector:
        parts = [ca.vec(leaf if isinstance(leaf, symbol) else symbol(leaf)) for leaf in leaves(tree)]
        return ca.vertcat(*parts) if parts else symbol(0, 1)

    return [state_symbol, value_symbol], [column(next_state), column(output)]


def trace(
    step: Step,
    state: Tree,
    value: Tree,
    *,
    symbol: type = ca.SX,
    name: str = "step",
) -> tuple[ca.Function, Tree]:
    """Trace a step into a CasADi function of packed vectors.

    Parameters
    ----------
    step
        Pure function (state, value) -> (state, output).
    state, value
        Trees of arrays with the shapes to trace for; one NumPy step from them gives the shapes of the output.
    symbol
        ``casadi.SX`` (scalar graph: about 1 ns per operation) or ``casadi.MX`` (matrix graph: about 12 ns).

    Returns
    -------
    function
        ``[state, value] -> [next state, output]``, each one column, ordered as `pack` orders them.
    output
        A tree of zeros with the output's structure and shapes, for `unpack`.

    Raises
    ------
    InvalidParameter
        For a step that changes the shape of its state.
    """
    inputs, results = expressions(step, state, value, symbol=symbol, name=name)
    function = ca.Function(name, inputs, results, ["x", "u"], ["x_next", "y"], {"cse": True})
    _, example = step(state, value)
    return function, rebuild(example, [np.zeros(np.shape(leaf)) for leaf in leaves(example)])


def n_instructions(function: ca.Function) -> int:
    """Return the number of scalar instructions of a call, those of called functions included."""
    callees = function.find_functions(0)
    if not callees:
        return function.n_instructions()
    longest = max(n_instructions(callee) for callee in callees)
    n_calls = sum(function.instruction_id(k) == ca.OP_CALL for k in range(function.n_instructions()))
    return function.n_instructions() + n_calls * longest


def n_distinct_instructions(function: ca.Function) -> int:
    """Return the number of instructions of a function and of those that it calls, each counted once."""
    return function.n_instructions() + sum(map(n_distinct_instructions, function.find_functions(0)))


class FixedCall:
    """A function of one output over fixed memory, a microsecond or so each call.

    Attributes
    ----------
    inputs
        Arrays to write the inputs into, by number, each the column of its elements.
    """

    def __init__(self, function: ca.Function):
        self._shape = function.size_out(0)
        self.inputs = [np.zeros(function.nnz_in(i)) for i in range(function.n_in())]
        self._output = np.zeros(function.nnz_out(0))
        buffer: Any
        buffer, self._call = function.buffer()
        for i, array in enumerate(self.inputs):
            buffer.set_arg(i, array.data)
        buffer.set_res(0, self._output.data)
        self._keep = function, buffer

    def __call__(self) -> Array:
        """Return the output as a new array."""
        self._call()
        return self._output.reshape(self._shape, order="F").copy()


class PeriodBuffer:
    """A traced function over fixed memory, several periods in a row: one call each, no copies between them.

    The function's first input and output are its state. Every other input and output has one row per period, or the
    array of its name in ``fixed`` in every period.

    Attributes
    ----------
    calls
        One call per period, to be made in order, over and over.
    rows
        Array of each input and output by its name, shape (periods, size).
    states
        The two state vectors that take turns; the first call reads the first. They may be those of another buffer,
        in place of copies of the state.
    """

    def __init__(
        self,
        function: ca.Function,
        state: np.ndarray,
        periods: int,
        fixed: dict[str, np.ndarray] | None = None,
        states: list[np.ndarray] | None = None,
    ):
        if periods % 2:
            raise InvalidParameter(f"periods: got {periods}; needs an even number, since two states take turns")
        fixed = fixed or {}
        sizes = {function.name_in(i): function.nnz_in(i) for i in range(1, function.n_in())}
        sizes |= {function.name_out(i): function.nnz_out(i) for i in range(1, function.n_out())}
        self.rows = {name: np.zeros((periods, size)) for name, size in sizes.items() if name not in fixed}
        self.calls: list[Callable[[], None]] = []
        self.states = states = [np.array(state), np.array(state)] if states is None else states
        self._keep: list[object] = [function, fixed]
        for k in range(periods):
            places = fixed | {name: rows[k] for name, rows in self.rows.items()}
            buffer: Any
            buffer, call = function.buffer()
            buffer.set_arg(0, states[k % 2].data)
            buffer.set_res(0, states[1 - k % 2].data)
            for i in range(1, function.n_in()):
                buffer.set_arg(i, places[function.name_in(i)].data)
            for i in range(1, function.n_out()):
                buffer.set_res(i, places[function.name_out(i)].data)
            self.calls.append(call)
            self._keep.append(buffer)


class CompiledStep:
    """A traced step over fixed memory: calls of about a microsecond, without allocation.

    Attributes
    ----------
    value, output
        Input and output vectors, ordered as `pack` orders them. Write the input, call `step()`, read the output.
    """

    def __init__(self, function: ca.Function):
        self.value = np.zeros(function.nnz_in(1))
        self.output = np.zeros(function.nnz_out(1))
        fixed = {function.name_in(1): self.value, function.name_out(1): self.output}
        self._ring = PeriodBuffer(function, np.zeros(function.nnz_in(0)), 2, fixed)
        self._calls, self._now = self._ring.calls, 0

    @property
    def state(self) -> np.ndarray:
        """Return the present state vector."""
        return self._ring.states[self._now]

    def reset(self, state: np.ndarray) -> None:
        """Set the state vector."""
        self.state[:] = state

    def prepare(self, function: ca.Function) -> PeriodBuffer:
        """Return another function with inputs and outputs of the same sizes over the same memory, state included."""
        names = {function.name_in(1): self.value, function.name_out(1): self.output}
        return PeriodBuffer(function, self.state, 2, names, self._ring.states)

    def exchange(self, prepared: PeriodBuffer) -> None:
        """Step what `prepare` returned from now on; the state stays, and nothing is copied or allocated."""
        self._ring, self._calls = prepared, prepared.calls

    def step(self) -> None:
        """Step once, from `value` to `output`."""
        self._calls[self._now]()
        self._now = 1 - self._now
