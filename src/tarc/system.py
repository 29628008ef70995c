"""The one abstraction: a discrete-time system, and its tracing into a ``casadi.Function``.

Everything that runs once a period (sensor, estimator, law, the closed loop itself) is a `System`: frozen
parameters, an explicit state, a pure step

    x(k+1), y(k) = step(x(k), u(k)).

State, input and output are arrays or nested NamedTuples of arrays. The step is plain Python on operators that
NumPy arrays and CasADi symbols share (see `tarc.ops`), so that one text is stepped, fused into a simulation,
differentiated and exported.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np


class System(ABC):
    """A discrete-time system with explicit state."""

    @abstractmethod
    def init(self, first: Any, /) -> Any:
        """State before the first step, made from a first input: a NamedTuple of float arrays."""

    @abstractmethod
    def step(self, state: Any, value: Any) -> tuple[Any, Any]:
        """Next state and output; pure, on NumPy arrays and CasADi symbols alike."""


def leaves(tree: Any) -> list[Any]:
    """Arrays of a nested NamedTuple, tuple or dict, in order."""
    if isinstance(tree, dict):
        return [leaf for key in tree for leaf in leaves(tree[key])]
    if isinstance(tree, tuple):
        return [leaf for branch in tree for leaf in leaves(branch)]
    return [tree]


def rebuild(tree: Any, values: Sequence[Any]) -> Any:
    """A tree of the same structure with other leaves, the inverse of `leaves`."""
    supply = iter(values)

    def build(node: Any) -> Any:
        if isinstance(node, dict):
            return {key: build(child) for key, child in node.items()}
        if isinstance(node, tuple):
            children = [build(child) for child in node]
            return type(node)(*children) if hasattr(node, "_fields") else tuple(children)
        return next(supply)

    return build(tree)


def names(tree: Any, prefix: str = "") -> list[str]:
    """Dotted name of each leaf, in the order of `leaves`."""
    if isinstance(tree, dict):
        items = list(tree.items())
    elif isinstance(tree, tuple):
        fields = getattr(tree, "_fields", range(len(tree)))
        items = [(str(field), child) for field, child in zip(fields, tree, strict=True)]
    else:
        return [prefix]
    return [name for key, child in items for name in names(child, f"{prefix}.{key}" if prefix else key)]


def pack(tree: Any) -> np.ndarray:
    """All numbers of a tree as one vector; matrices column by column, as CasADi stores them."""
    parts = [np.ravel(np.asarray(leaf, dtype=float), order="F") for leaf in leaves(tree)]
    return np.concatenate(parts) if parts else np.zeros(0)


def unpack(tree: Any, vector: np.ndarray) -> Any:
    """The tree of the same shapes whose numbers are the vector's, the inverse of `pack`."""
    result, start = [], 0
    for leaf in leaves(tree):
        shape = np.shape(leaf)
        size = int(np.prod(shape))
        result.append(np.reshape(vector[start : start + size], shape, order="F"))
        start += size
    return rebuild(tree, result)


def _symbols(tree: Any, kind: type) -> tuple[Any, Any]:
    """One symbol vector for the whole tree, and the tree of its pieces."""
    shapes = [(*np.shape(leaf), 1, 1)[:2] if np.ndim(leaf) else (1, 1) for leaf in leaves(tree)]
    sizes = [rows * columns for rows, columns in shapes]
    vector = kind.sym("x", sum(sizes))  # type: ignore[attr-defined]
    ends = np.cumsum([0, *sizes])
    pieces = [
        ca.reshape(vector[int(start) : int(end)], *shape) if shape[1] > 1 else vector[int(start) : int(end)]
        for start, end, shape in zip(ends, ends[1:], shapes, strict=False)
    ]
    return vector, rebuild(tree, pieces)


def trace(
    step: Callable[[Any, Any], tuple[Any, Any]],
    state: Any,
    value: Any,
    *,
    symbol: type = ca.MX,
    name: str = "step",
) -> tuple[ca.Function, Any]:
    """Trace a step into a CasADi function of packed vectors.

    Parameters
    ----------
    step
        Pure function (state, value) -> (state, output).
    state, value
        Trees of arrays with the shapes to trace for; one NumPy step from them tells the output's shapes.
    symbol
        ``casadi.MX`` (matrix graph: least time per call for wide windows) or ``casadi.SX`` (scalar graph:
        fuses into larger functions).

    Returns
    -------
    function
        ``[state, value] -> [next state, output]``, each one column, ordered as `pack` orders them.
    output
        A tree of zeros with the output's structure and shapes, for `unpack`.
    """
    state_symbol, state_tree = _symbols(state, symbol)
    value_symbol, value_tree = _symbols(value, symbol)
    next_state, output = step(state_tree, value_tree)
    for old, new, label in zip(leaves(state_tree), leaves(next_state), names(state), strict=True):
        if old.shape != symbol(new).shape:
            raise ValueError(f"{name}: state {label} has shape {old.shape} before the step and {new.shape} after")

    def column(tree: Any) -> Any:
        parts = [ca.vec(symbol(leaf)) for leaf in leaves(tree)]
        return ca.vertcat(*parts) if parts else symbol(0, 1)

    function = ca.Function(
        name, [state_symbol, value_symbol], [column(next_state), column(output)], ["x", "u"], ["x_next", "y"]
    )
    _, example = step(state, value)
    return function, rebuild(example, [np.zeros(np.shape(leaf)) for leaf in leaves(example)])


class Buffered:
    """A traced step over fixed memory: no allocation a call, a microsecond or so each.

    Two call buffers alternate, since a function must not write the state that it is reading.

    Attributes
    ----------
    value, output
        Input and output vectors, ordered as `pack` orders them. Write the one, `step()`, read the other.
    """

    def __init__(self, function: ca.Function):
        self.value = np.zeros(function.nnz_in(1))
        self.output = np.zeros(function.nnz_out(1))
        self._states = [np.zeros(function.nnz_in(0)), np.zeros(function.nnz_in(0))]
        self._calls: list[Any] = []
        self._keep: list[Any] = [function]
        for now in (0, 1):
            buffer: Any
            buffer, call = function.buffer()
            buffer.set_arg(0, self._states[now].data)
            buffer.set_arg(1, self.value.data)
            buffer.set_res(0, self._states[1 - now].data)
            buffer.set_res(1, self.output.data)
            self._calls.append(call)
            self._keep.append(buffer)
        self._now = 0

    @property
    def state(self) -> np.ndarray:
        """The present state vector."""
        return self._states[self._now]

    def reset(self, state: np.ndarray) -> None:
        """Set the state vector."""
        self._states[self._now][:] = state

    def step(self) -> None:
        """One step from `value` to `output`."""
        self._calls[self._now]()
        self._now = 1 - self._now
