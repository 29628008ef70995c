"""`tarc study`: many runs of a scenario with drawn values."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from tarc.cli.options import Json

StudyFile = Annotated[str, typer.Argument(help="A YAML file of a study.")]
StudyOut = Annotated[
    Path | None,
    typer.Option(
        "--out",
        "-o",
        help="Folder for the results; one with this study in it is continued. Default: runs/NAME.study, after the "
        "study's name.",
    ),
]
Runs = Annotated[int | None, typer.Option(help="Number of runs per law, in place of the study's.")]
EngineName = Annotated[
    str,
    typer.Option(
        "--engine",
        metavar="NAME",
        help="What runs the loops: lanes and compiled in machine code, virtual machine, or MuJoCo. Default: auto, the "
        "fastest that can.",
    ),
]
StudyJobs = Annotated[int | None, typer.Option("--jobs", help="Number of processes. Default: one per core.")]
Scheduler = Annotated[
    str,
    typer.Option(metavar="ADDRESS", help="A Dask scheduler, such as tcp://10.0.0.1:8786. Default: this machine."),
]
Example = Annotated[bool, typer.Option("--example", help="Print a study to start from, and do nothing else.")]


def study(
    file: StudyFile = "",
    out: StudyOut = None,
    runs: Runs = None,
    engine: EngineName = "auto",
    jobs: StudyJobs = None,
    scheduler: Scheduler = "",
    as_json: Json = False,
    example: Example = False,
) -> None:
    """Run a scenario many times with drawn values; store every run's measures in one folder.

    The study names a scenario, the keys that are drawn with their
    distributions, and the number of runs. Any number of laws sees the same
    draws. The folder has results.zarr, which xarray opens, the study itself
    and the trajectories of chosen runs.

    Its file report.html explains the results: rates, quantiles and ratios
    of laws with their intervals, and what matters.

    Results are stored as they come. After Ctrl-C, a kill or a full disk the
    same command goes on where it stopped.

    Example: tarc study --example > study.yaml

    Example: tarc study study.yaml

    Example: tarc study study.yaml --runs 10000 --out runs/loads.study
    """
    from tarc.cli.tables import study as tables
    from tarc.study.execution import check_engine
    from tarc.study.specification import Study

    if example:
        print(example_text(), end="")
        return
    if not file:
        raise typer.BadParameter("needs a YAML file; --example prints one to start from")
    check_engine(engine)
    loaded = Study.load(file)
    if runs is not None:
        loaded = loaded.with_runs(runs)
    folder = out or Path("runs") / f"{loaded.name}.study"
    try:
        result = loaded.run(folder, engine=engine, jobs=jobs, scheduler=scheduler)
    except KeyboardInterrupt:
        print(tables.interruption(folder), file=sys.stderr)
        raise typer.Exit(130) from None
    report = result.report()
    if as_json:
        print(json.dumps(tables.study_summary(result, report), indent=2, allow_nan=False))
    else:
        tables.print_study(result, report)


def example_text() -> str:
    """Return the text of a study to start from."""
    from importlib.resources import files

    return files("tarc.study").joinpath("example.yaml").read_text(encoding="utf-8")
