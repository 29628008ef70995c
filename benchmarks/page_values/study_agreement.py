"""Values of the page on studies: how far the engines agree on random scenarios."""

from benchmarks.agreement import BITS, QUANTISED_LIMIT, all_differences, summarise
from benchmarks.page_values.registry import Value, long_source

RUNS = 1000


@long_source
def study_agreement() -> dict[str, Value]:
    """Random scenarios of ten seconds in lanes, one by one and in the virtual machine."""
    plain, quantised = (summarise(all_differences(RUNS, bits), QUANTISED_LIMIT) for bits in (None, BITS))
    return {
        "runs": float(RUNS),
        "same": float(min(plain.n_same, quantised.n_same)),
        "torque": plain.median,
        "measures": plain.worst,
        "flipped": float(quantised.n_flipped),
        "within": 100 * quantised.share_within,
        "worst": 100 * quantised.worst,
    }
