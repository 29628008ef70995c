"""`tarc compare`: run several laws in one scenario."""

import json
from pathlib import Path
from typing import Annotated

import typer

from tarc.cli.options import Figures, Json, Out, Set, file_stem
from tarc.core.files import make_folder


def compare(
    scenario: Annotated[str, typer.Argument(help="A YAML file, or the name of a shipped scenario.")],
    laws: Annotated[
        str, typer.Option(help="Names with commas between, or 'all'; default: the laws of the scenario.")
    ] = "",
    set_: Set = None,
    out: Out = None,
    jobs: Annotated[int | None, typer.Option(help="Processes; default: one a core.")] = None,
    as_json: Json = False,
    figures: Figures = True,
) -> None:
    """Run several laws in one scenario, on the same seed: table, trajectories, CSV, LaTeX, figures.

    The names stand for laws whose gains were found by one search with one budget; tarc show --json lists them.

    Example: tarc compare ur5e --laws tarc,tdc,tdc-sync
    """
    from tarc.cli import tables
    from tarc.scenario.model import Scenario
    from tarc.study import compare, tuned_laws

    described = Scenario.load(scenario, set_ or [])
    folder = make_folder("--out", out or Path("runs") / f"{file_stem(described.name)}-compared")
    names = list(tuned_laws()) if laws.strip() == "all" else [name.strip() for name in laws.split(",") if name.strip()]
    found = compare(described, names or None, jobs=jobs)
    files = found.save(folder, figures)
    if as_json:
        print(json.dumps(tables.comparison_summary(found, files), indent=2, allow_nan=False))
    else:
        tables.print_comparison(found, files)
