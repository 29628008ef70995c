"""Studies of many runs: laws side by side on equal terms, and the search for their gains."""

from tarc.core.optional import require

require("cli", "tarc.study")


from tarc.study.budget import TorqueVariationBudget, torque_variation_budget
from tarc.study.comparison import Comparison, compare, tuned_laws
from tarc.study.gains_file import load_gains
from tarc.study.search_space import SearchSpace, user_search_space
from tarc.study.tuning import default_search_spaces, tune, tune_all

__all__ = [
    "Comparison",
    "SearchSpace",
    "TorqueVariationBudget",
    "compare",
    "default_search_spaces",
    "load_gains",
    "torque_variation_budget",
    "tune",
    "tune_all",
    "tuned_laws",
    "user_search_space",
]
