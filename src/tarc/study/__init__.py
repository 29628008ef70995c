"""Studies of many runs: laws side by side on equal terms, and the search for their gains."""

from tarc.core.optional import require

require("cli", "tarc.study")


from tarc.study.budget import TorqueVariationBudget, torque_variation_budget
from tarc.study.comparison import Comparison, compare, tuned_laws
from tarc.study.search_space import SearchSpace
from tarc.study.tuning import default_search_spaces, tune, tune_all

__all__ = [
    "Comparison",
    "SearchSpace",
    "TorqueVariationBudget",
    "compare",
    "default_search_spaces",
    "torque_variation_budget",
    "tune",
    "tune_all",
    "tuned_laws",
]
