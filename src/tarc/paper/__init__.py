"""The paper, checked: Lemma 1, condition (c2), Theorems 1 and 2, bounds on the gain, the procedure of selection."""

from tarc.core.optional import require

require("certify", "tarc.paper")

from tarc.paper.bounds_on_gain import GainBounds, gain_bounds
from tarc.paper.lemma1 import condition_c2, lemma1
from tarc.paper.nominal_loop import nominal, nominal_delay, nominal_window
from tarc.paper.procedure import Procedure, Step, paper_procedure
from tarc.paper.theorem1 import UltimateBound, theorem1, theorem1_delay, ultimate_bound
from tarc.paper.theorem2 import theorem2

__all__ = [
    "GainBounds",
    "Procedure",
    "Step",
    "UltimateBound",
    "condition_c2",
    "gain_bounds",
    "lemma1",
    "nominal",
    "nominal_delay",
    "nominal_window",
    "paper_procedure",
    "theorem1",
    "theorem1_delay",
    "theorem2",
    "ultimate_bound",
]
