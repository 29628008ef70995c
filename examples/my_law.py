"""Write a law of your own.

The file holds a law, and as a program it runs the law beside TDC.
`tarc run two_link_payload --law my_law.py:BoundedPush` needs the law alone, and so do the other commands.
"""

from dataclasses import dataclass

import tarc
from tarc.core import array_ops as ops


@dataclass(frozen=True, kw_only=True, eq=False)
class BoundedPush(tarc.laws.TDE):
    """Time-delayed control with a bounded push against the error of each joint: Δu = −c tanh(e1/w).

    Parameters
    ----------
    max_push
        c [rad/s² or m/s²], the largest push.
    width
        w [rad or m], the error at which the push is 0.76 of the largest.
    """

    max_push: float = 1.0
    width: float = 0.01

    @property
    def robust_slope_bound(self):
        """Return the largest slope of the push over the error [1/s²]."""
        return self.max_push / self.width

    def robust_init(self):
        """Return the state before the first step: this term has none."""
        return ()

    def robust(self, state, tracking):
        """Return the next state, Δu [rad/s²], and signals to record."""
        push = -self.max_push * ops.tanh(tracking.error / self.width)
        return state, push, {"push": push}


if __name__ == "__main__":
    settings = ["duration=4.0", "metrics_start=1.0"]
    own = tarc.Scenario.load("two_link_payload", settings, law=f"{__file__}:BoundedPush")
    plain = tarc.Scenario.load("two_link_payload", settings, law="TDC")
    runs = {**own.run(), **plain.run()}
    for name, run in runs.items():
        print(name, run.metrics(start_time=1.0)["rms_error"], run.status)
    print(own.certify(samples=200)["BoundedPush"].verdict.explain())
    runs["BoundedPush"].plot(others={"TDC": runs["TDC"]}).savefig("my_law.png", dpi=110)
