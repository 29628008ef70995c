"""Where the numbers of the pages come from: one function a source, in `SOURCES` by name."""

from benchmarks.page_values import demo, explanation, start
from benchmarks.page_values.registry import SOURCES, Value

__all__ = ["SOURCES", "Value", "demo", "explanation", "start"]
