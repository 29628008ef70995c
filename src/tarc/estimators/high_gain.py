"""High-gain observer."""

from dataclasses import dataclass

import numpy as np

from tarc.core import validation as check
from tarc.estimators.observer import Observer


@dataclass(frozen=True, kw_only=True, eq=False)
class HighGain(Observer):
    """High-gain observer: all three poles of the estimation error at −1/ε, sampled exactly as z = exp(−T/ε).

    In continuous time x̂1' = x̂2 + 3 (q − x̂1)/ε, x̂2' = x̂3 + 3 (q − x̂1)/ε², x̂3' = (q − x̂1)/ε³. The gain is chosen
    such that the sampled observer has those poles. A smaller ε is faster and noisier, and peaks more at the start.

    Parameters
    ----------
    time_constant
        ε [s].

    References
    ----------
    H. K. Khalil, Nonlinear Systems, 3rd ed., Prentice Hall, 2002, Section 14.5.
    """

    time_constant: float

    def __post_init__(self) -> None:
        super().__post_init__()
        check.number("time_constant", self.time_constant, 0, strict=True)

    @property
    def gain(self) -> np.ndarray:
        """Return L, shape (3,): the fading-memory polynomial filter of degree 2 with p = exp(−T/ε)."""
        p = np.exp(-self.sampling_period / self.time_constant)
        return np.array([1 - p**3, 1.5 * (1 - p) ** 2 * (1 + p), (1 - p) ** 3]) / self.sampling_period ** np.arange(3)
