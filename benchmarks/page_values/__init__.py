"""Where the numbers of the pages come from: one function per source, in `SOURCES` by name."""

from benchmarks.page_values import (
    certificates,
    demo,
    explanation,
    how_sure,
    intervals,
    known_model,
    lemma1,
    long_runs,
    real_robots,
    region,
    start,
    study_agreement,
)
from benchmarks.page_values.registry import SOURCES, Value

__all__ = [
    "SOURCES",
    "Value",
    "certificates",
    "demo",
    "explanation",
    "how_sure",
    "intervals",
    "known_model",
    "lemma1",
    "long_runs",
    "real_robots",
    "region",
    "start",
    "study_agreement",
]
