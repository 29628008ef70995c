from collections.abc import Sequence
from typing import Any

from numpy.typing import NDArray

class ZeroConeT:
    def __init__(self, dim: int) -> None: ...

class PSDTriangleConeT:
    def __init__(self, dim: int) -> None: ...

class DefaultSettings:
    verbose: bool

class SolverStatus:
    Solved: SolverStatus
    AlmostSolved: SolverStatus

class DefaultSolution:
    status: SolverStatus
    x: list[float]

class DefaultSolver:
    def __init__(
        self,
        P: Any,
        q: NDArray[Any],
        A: Any,
        b: NDArray[Any],
        cones: Sequence[ZeroConeT | PSDTriangleConeT],
        settings: DefaultSettings,
    ) -> None: ...
    def solve(self) -> DefaultSolution: ...
