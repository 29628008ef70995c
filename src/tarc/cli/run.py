"""`tarc run`: simulate a scenario."""

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tarc.cli.options import Figures, Json, Out, Set, file_stem
from tarc.core.files import make_folder

if TYPE_CHECKING:
    from tarc.scenario.model import Scenario
    from tarc.simulation.run import Run


def run(
    scenario: Annotated[str, typer.Argument(help="A YAML file, or the name of a shipped scenario.")],
    set_: Set = None,
    out: Out = None,
    native: Annotated[bool, typer.Option("--native", help="Compile the loop first; needs a C compiler.")] = False,
    as_json: Json = False,
    figures: Figures = True,
) -> None:
    """Simulate a scenario: metrics, trajectories as netCDF, figures.

    Example: tarc run ur5e --set law.natural_frequency=15 --set duration=5
    """
    from tarc.scenario.model import Scenario

    run_scenario(Scenario.load(scenario, [*(set_ or []), *(["native=true"] if native else [])]), out, as_json, figures)


def run_scenario(scenario: "Scenario", out: Path | None, as_json: bool, figures: bool) -> None:
    """Run a scenario, write its results and print them."""
    from tarc.cli import tables

    folder = make_folder("--out", out or Path("runs") / file_stem(scenario.name))
    try:
        runs = scenario.run()
    except KeyboardInterrupt:
        print("interrupted; nothing was written", file=sys.stderr)
        raise typer.Exit(130) from None
    files = save_all(scenario, runs, folder, figures)
    if as_json:
        print(json.dumps(tables.summary(scenario, runs, files), indent=2, allow_nan=False))
    else:
        tables.print_runs(scenario, runs, files)


def save_all(scenario: "Scenario", runs: dict[str, "Run"], folder: Path, figures: bool) -> list[Path]:
    """Write scenario, trajectories and figures into a folder; the files written."""
    files = [scenario.save(folder / "scenario.yaml")]
    for number, (name, run) in enumerate(runs.items()):
        stem = file_stem(name)
        path = folder / f"{stem}.nc"
        files.append(run.save(folder / f"{stem}-{number + 1}.nc" if path in files else path))
    if figures:
        from rich.console import Console

        from tarc.plotting.runs import run_figure

        with Console(stderr=True).status("drawing figures"):
            for kind, name in (("screen", "tracking.png"), ("column", "column.pdf")):
                run_figure(runs, kind).savefig(folder / name, dpi=110)
                files.append(folder / name)
    return files
