"""`tarc study`: many runs of a scenario with drawn values."""

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tarc.cli.options import Json
from tarc.core.allocator import keep_freed_memory

if TYPE_CHECKING:
    from tarc.study.specification import Study
    from tarc.study.study_result import StudyResult

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
Limits = Annotated[
    list[str] | None,
    typer.Option(
        "--limit",
        metavar="MEASURE=VALUE",
        help="Largest allowed value of a measure in SI units, such as rms_error=0.001: a run that exceeds it is no "
        "success in the report. May be given several times.",
    ),
]
Reference = Annotated[
    str, typer.Option(metavar="LAW", help="Law with which the report compares the others. Default: the first.")
]
WorstCase = Annotated[
    str,
    typer.Option(
        "--worst-case",
        metavar="LAW",
        help="Search the draws for the worst run of a law, with hundreds of further runs; for the report, and as "
        "worst.yaml, a study that replays it.",
    ),
]
Example = Annotated[bool, typer.Option("--example", help="Print a study to start from, and do nothing else.")]


def study(
    file: StudyFile = "",
    out: StudyOut = None,
    runs: Runs = None,
    engine: EngineName = "auto",
    jobs: StudyJobs = None,
    scheduler: Scheduler = "",
    limit: Limits = None,
    reference: Reference = "",
    worst_case: WorstCase = "",
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

    Example: tarc study study.yaml --limit rms_error=0.001 --worst-case TDC
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
    limits = read_limits(limit or [])
    loaded = Study.load(file)
    if runs is not None:
        loaded = loaded.with_runs(runs)
    folder = out or Path("runs") / f"{loaded.name}.study"
    try:
        keep_freed_memory()
        result = loaded.run(folder, engine=engine, jobs=jobs, scheduler=scheduler)
    except KeyboardInterrupt:
        print(tables.interruption(folder), file=sys.stderr)
        raise typer.Exit(130) from None
    sections = [worst_case_section(loaded, result, worst_case, engine)] if worst_case else []
    report = result.report(reference=reference or None, limits=limits, more=sections)
    if as_json:
        print(json.dumps(tables.study_summary(result, report), indent=2, allow_nan=False))
    else:
        tables.print_study(result, report)


def read_limits(settings: list[str]) -> dict[str, float]:
    """Return limits by measure from texts such as ``rms_error=0.001``.

    Raises
    ------
    InvalidParameter
        For a text without ``=``, an unknown measure, and a value that is no number.
    """
    from tarc.core import validation as check
    from tarc.simulation.quantities import MEASURES

    limits = {}
    for setting in settings:
        name, equals, value = setting.partition("=")
        check.one_of("--limit", name, MEASURES)
        try:
            limits[name] = float(value) if equals else float("nan")
        except ValueError:
            limits[name] = float("nan")
        check.number(f"--limit {name}", limits[name], 0)
    return limits


def worst_case_section(study: "Study", result: "StudyResult", law: str, engine: str) -> str:
    """Search the worst case of a law, save it in the folder of the results, and return its section of the report."""
    from tarc.study.exploration import find_worst_case

    worst = find_worst_case(study, result, law=law, engine=engine)
    worst.save(result.folder / "worst.yaml")
    return worst.section()


def example_text() -> str:
    """Return the text of a study to start from."""
    from importlib.resources import files

    return files("tarc.study").joinpath("example.yaml").read_text(encoding="utf-8")
