"""The paper, checked: Lemma 1, condition (c2), Theorems 1 and 2, bounds on the gain, the procedure of selection."""

from tarc.core.optional import require

require("certify", "tarc.paper")

from tarc.paper.gain_bounds import GainBounds, evaluate_gain_bounds
from tarc.paper.lemma1 import check_condition_c2, check_lemma1
from tarc.paper.nominal_loop import check_nominal_loop, nominal_max_delay, nominal_max_window
from tarc.paper.procedure import Procedure, ProcedureStep, run_procedure
from tarc.paper.tde_error import TDEErrorBound, bound_tde_error
from tarc.paper.theorem1 import check_theorem1, theorem1_max_delay
from tarc.paper.theorem2 import check_theorem2
from tarc.paper.ultimate_bound import UltimateBound, ultimate_bound

__all__ = [
    "GainBounds",
    "Procedure",
    "ProcedureStep",
    "TDEErrorBound",
    "UltimateBound",
    "bound_tde_error",
    "check_condition_c2",
    "check_lemma1",
    "check_nominal_loop",
    "check_theorem1",
    "check_theorem2",
    "evaluate_gain_bounds",
    "nominal_max_delay",
    "nominal_max_window",
    "run_procedure",
    "theorem1_max_delay",
    "ultimate_bound",
]
