"""Studies of many runs: laws side by side on equal terms, and the search for their gains."""

from typing import TYPE_CHECKING

from tarc.core.lazy import lazy_attributes
from tarc.core.optional import require

require("cli", "tarc.study")

from tarc.study.budget import TorqueVariationBudget, torque_variation_budget
from tarc.study.comparison import Comparison, compare, tuned_laws
from tarc.study.front import FrontPoint, TuningFront
from tarc.study.gains_file import load_gains
from tarc.study.rare_events import RareProbability, SplittingLevel, rare_probability
from tarc.study.report import write_report
from tarc.study.report_searches import rare_event_section, worst_case_section
from tarc.study.search_space import SearchSpace, user_search_space
from tarc.study.sensitivity import Sensitivity, SobolIndices, estimate_sensitivity, sobol_indices
from tarc.study.statistics import (
    Interval,
    PairedComparison,
    compare_laws,
    holm,
    mean_interval,
    median_interval,
    quantile_interval,
    success_rate,
)
from tarc.study.summary import StudySummary, summarise
from tarc.study.tuning import default_search_spaces, tune, tune_all, tune_front, tune_fronts
from tarc.study.tuning_options import TuningOptions
from tarc.study.worst_case import WorstPoint, search_worst_point

if TYPE_CHECKING:
    from tarc.study.exploration import WorstCase, failure_probability, find_worst_case, study_sobol_indices
    from tarc.study.specification import Study
    from tarc.study.study_result import StudyResult

__getattr__, _, _ = lazy_attributes(  # they need Zarr, which comes with an extra of its own
    __name__,
    {
        "Study": "tarc.study.specification",
        "StudyResult": "tarc.study.study_result",
        "WorstCase": "tarc.study.exploration",
        "failure_probability": "tarc.study.exploration",
        "find_worst_case": "tarc.study.exploration",
        "study_sobol_indices": "tarc.study.exploration",
    },
)

__all__ = [
    "Comparison",
    "FrontPoint",
    "Interval",
    "PairedComparison",
    "RareProbability",
    "SearchSpace",
    "Sensitivity",
    "SobolIndices",
    "SplittingLevel",
    "Study",
    "StudyResult",
    "StudySummary",
    "TorqueVariationBudget",
    "TuningFront",
    "TuningOptions",
    "WorstCase",
    "WorstPoint",
    "compare",
    "compare_laws",
    "default_search_spaces",
    "estimate_sensitivity",
    "failure_probability",
    "find_worst_case",
    "holm",
    "load_gains",
    "mean_interval",
    "median_interval",
    "quantile_interval",
    "rare_event_section",
    "rare_probability",
    "search_worst_point",
    "sobol_indices",
    "study_sobol_indices",
    "success_rate",
    "summarise",
    "torque_variation_budget",
    "tune",
    "tune_all",
    "tune_front",
    "tune_fronts",
    "tuned_laws",
    "user_search_space",
    "worst_case_section",
    "write_report",
]
