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
        metavar="A,B",
        help="Names of tuned laws with commas between, or all. Default: the laws of the gains file, else those of the "
        "scenario.",
    ),
]
OwnLaw = Annotated[
    str,
    typer.Option(
        "--law",
        metavar="FILE.py:CLASS",
        help="A law from your own file, or one of tarc.laws, beside the others. It takes the parameters of the "
        "scenario's first law that it has too; give others by --set law.KEY=VALUE.",
    ),
]
Gains = Annotated[
    Path | None,
    typer.Option(help="A file that tarc tune wrote. Its laws run, or with --laws those of them that are named."),
]


def compare(
    scenario: ScenarioName,
    laws: Laws = "",
    gains: Gains = None,
    law: OwnLaw = "",
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

    Example: tarc compare my_robot.yaml --gains my_gains.yaml
    """
    from tarc.cli.tables import compare as tables
    from tarc.scenario.model import Scenario
    from tarc.study import compare, load_gains
    from tarc.study.comparison import choose_laws

    settings = set_ or []
    loaded = Scenario.load(scenario, settings)
    folder = make_folder("--out", out or Path("runs") / f"{file_stem(loaded.name)}-compared")
    names = None if laws.strip() == "all" else names_of(laws)
    tuned = {} if gains is None else load_gains(gains)
    own = Scenario.load(scenario, settings, law=law).laws if law else {}
    chosen = choose_laws(loaded, names, tuned)
    comparison = compare(loaded, {**chosen, **own}, jobs=jobs)
    files = comparison.save(folder, figures)
    if as_json:
        print(json.dumps(tables.comparison_summary(comparison, files), indent=2, allow_nan=False))
    else:
        tables.print_comparison(comparison, files)
