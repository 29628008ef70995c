"""Studies of many runs: laws side by side on equal terms, and the search for their gains."""

from tarc.core.optional import require

require("cli", "tarc.study")


from tarc.study.comparison import Comparison, compare, tuned_laws
from tarc.study.search_spaces import SearchSpace
from tarc.study.tuning import search_spaces, tune, tune_all, variation_limit

__all__ = ["Comparison", "SearchSpace", "compare", "search_spaces", "tune", "tune_all", "tuned_laws", "variation_limit"]
