"""The one abstraction: a discrete-time system, and its tracing into a ``casadi.Function``.

Everything that runs once a period (sensor, estimator, law, the closed loop itself) is a `System`: frozen
parameters, an explicit state, a pure step

    x(k+1), y(k) = step(x(k), u(k)).

State, input and output are arrays or nested NamedTuples of arrays. The step is plain Python on operators that NumPy
arrays and CasADi symbols share (see `tarc.core.array_ops`). The same function is stepped, fused into a simulation,
differentiated and compiled.
"""

from abc import ABC, abstractmethod

from tarc.core.types import Tree, Vector


class System(ABC):
    """A discrete-time system with explicit state."""

    @abstractmethod
    def init(self, first: Vector, /) -> Tree:
        """Return the state before the first step, from a first input: a NamedTuple of float arrays."""

    @abstractmethod
    def step(self, state: Tree, value: Tree) -> tuple[Tree, Tree]:
        """Return the next state and the output; pure, on NumPy arrays and CasADi symbols alike."""
