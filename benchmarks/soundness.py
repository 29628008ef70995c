"""Whether the certificates tell the truth: ``python -m benchmarks.soundness`` simulates random designs against them.

The loops and the adversaries are those of ``tests/reference``.
"""

import argparse

from rich.console import Console
from rich.table import Table

from reference.soundness_checks import tally_certificates


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soundness", description=__doc__)
    parser.add_argument("--designs", type=int, default=10_000, help="random designs (default 10000)")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    tallies = tally_certificates(options.designs, options.seed, None)
    table = Table(
        "certificate", "designs", "certified", "refuted", "inconclusive", "undecided", "violations", "time [s]"
    )
    for name, tally in tallies.items():
        numbers = (tally.designs, tally.certified, tally.refuted, tally.inconclusive, tally.undecided)
        table.add_row(name, *map(str, numbers), str(len(tally.violations)), f"{tally.seconds:.0f}")
    table.caption = "Undecided: too near the edge for a simulation to tell; counted among the verdicts too."
    console = Console(width=None if Console().is_terminal else 120)
    console.print(table)
    for tally in tallies.values():
        for violation in tally.violations[:20]:
            console.print(violation, style="red", highlight=False)


if __name__ == "__main__":
    main()
