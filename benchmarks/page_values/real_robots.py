"""Values of the page on real robots."""

from benchmarks import real_robots as records
from benchmarks.page_values.registry import Value, source


@source
def real_robots() -> dict[str, Value]:
    """Return the tables of two records; `DataMissingError` where they are not there."""
    return records.values()
