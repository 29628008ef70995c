"""Linear programs that grow by cuts, solved again from where the last one ended."""

import numpy as np

from tarc.core.types import Array


class CuttingPlanes:
    """Maximise the last of n unknowns z ≥ 0, itself at most one, subject to A z ≤ b, whose rows are added in rounds.

    The dual simplex method of HiGHS goes on from the last basis, so that a round costs little.

    Parameters
    ----------
    n_unknowns
        n.
    """

    def __init__(self, n_unknowns: int):
        import highspy

        self._optimal = highspy.HighsModelStatus.kOptimal
        self._highs = highspy.Highs()
        self._highs.silent()
        self._highs.setOptionValue("presolve", "off")
        self._highs.setOptionValue("threads", 1)
        upper = np.full(n_unknowns, np.inf)
        upper[-1] = 1.0
        self._highs.addVars(n_unknowns, np.zeros(n_unknowns), upper)
        self._highs.changeColCost(n_unknowns - 1, -1.0)

    def add(self, A: Array, b: Array) -> None:
        """Add the rows A z ≤ b, of shapes (k, n) and (k,)."""
        count, n = A.shape
        starts = np.arange(0, A.size, n, dtype=np.int32)
        columns = np.tile(np.arange(n, dtype=np.int32), count)
        self._highs.addRows(count, np.full(count, -np.inf), b, A.size, starts, columns, A.ravel())

    def solve(self) -> Array | None:
        """Return the solution z, shape (n,); None where the solver fails."""
        self._highs.run()
        if self._highs.getModelStatus() != self._optimal:
            return None
        return np.array(self._highs.getSolution().col_value)
