"""`tarc compare`: run several laws in one scenario."""

import json
from pathlib import Path
from typing import Annotated

import typer

from tarc.cli.options import Figures, Jobs, Json, Out, ScenarioName, Set, file_stem, names_of
from tarc.core.files import make_folder

Laws = Annotated[
    str,
    typer.Option(
        metavar="A,B", help="Names of tuned laws with commas between, or all. Default: the laws of the scenario."
    ),
]


def compare(
    scenario: ScenarioName,
    laws: Laws = "",
    set_: Set = None,
    out: Out = None,
    jobs: Jobs = None,
    as_json: Json = False,
    figures: Figures = True,
) -> None:
    """Run several laws in one scenario with the same seed; write a table, trajectories, CSV, LaTeX and figures.

    The gains of the tuned laws come from one search with one budget, on other
    scenarios. An unknown name lists them.

    Example: tarc compare ur5e --laws tarc,tdc,tdc-sync
    """
    from tarc.cli.tables import compare as tables
    from tarc.scenario.model import Scenario
    from tarc.study import compare, tuned_laws

    loaded = Scenario.load(scenario, set_ or [])
    folder = make_folder("--out", out or Path("runs") / f"{file_stem(loaded.name)}-compared")
    names = list(tuned_laws()) if laws.strip() == "all" else names_of(laws)
    comparison = compare(loaded, names or None, jobs=jobs)
    files = comparison.save(folder, figures)
    if as_json:
        print(json.dumps(tables.comparison_summary(comparison, files), indent=2, allow_nan=False))
    else:
        tables.print_comparison(comparison, files)
