"""`tarc run`: simulate a scenario."""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tarc.cli.options import Animate, Figures, Json, LawKind, Out, ScenarioName, Set, View, drawing_figures, file_stem
from tarc.core.files import file_in_folder, make_folder, writing
from tarc.core.optional import require

if TYPE_CHECKING:
    from tarc.scenario.model import Scenario
    from tarc.simulation.run import Run

Native = Annotated[bool, typer.Option("--native", help="Compile the loop to machine code first; needs a C compiler.")]


def run(
    scenario: ScenarioName,
    set_: Set = None,
    law: LawKind = "",
    out: Out = None,
    native: Native = False,
    as_json: Json = False,
    figures: Figures = True,
    animate: Animate = None,
    view: View = False,
) -> None:
    """Simulate a scenario; write its trajectories as netCDF, and figures, and print its measures.

    Example: tarc run ur5e --set law.natural_frequency=15 --set duration=5
    """
    from tarc.scenario.model import Scenario

    settings = [*(set_ or []), *(["native=true"] if native else [])]
    run_scenario(Scenario.load(scenario, settings, law=law), out, as_json, figures, animate, view)


def run_scenario(
    scenario: "Scenario",
    out: Path | None,
    as_json: bool,
    figures: bool,
    animation: Path | None = None,
    view: bool = False,
    verdicts: Mapping[str, str] | None = None,
) -> None:
    """Run a scenario, write its results and print them, with the verdicts of its laws by name."""
    from tarc.cli.tables import run as tables

    if animation is not None:
        require("view", "--animate")
        file_in_folder("--animate", animation)
    if view:
        require_display()

    folder = make_folder("--out", out or Path("runs") / file_stem(scenario.name))
    try:
        runs = scenario.run()
    except KeyboardInterrupt:
        print("interrupted; nothing was written", file=sys.stderr)
        raise typer.Exit(130) from None
    files = save_runs(scenario, runs, folder)
    if figures:
        files += save_figures(runs, folder)
    if animation is not None:
        files.append(save_animation(runs, animation))
    if as_json:
        print(json.dumps(tables.run_summary(scenario, runs, files, verdicts), indent=2, allow_nan=False))
    else:
        tables.print_runs(scenario, runs, files, verdicts)
    for result in runs.values() if view else ():
        result.view()


def require_display() -> None:
    """Refuse to simulate for a viewer that cannot open."""
    from tarc.plotting.viewer import require_window

    require_window()


def save_runs(scenario: "Scenario", runs: dict[str, "Run"], folder: Path) -> list[Path]:
    """Write the scenario and the trajectories into a folder; return the files."""
    files = [scenario.save(folder / "scenario.yaml")]
    for number, (name, result) in enumerate(runs.items()):
        stem = file_stem(name)
        path = folder / f"{stem}.nc"
        files.append(result.save(folder / f"{stem}-{number + 1}.nc" if path in files else path))
    return files


def save_figures(runs: dict[str, "Run"], folder: Path) -> list[Path]:
    """Write the figures of runs into a folder; return the files."""
    from tarc.plotting.runs import run_figure

    files = []
    with drawing_figures(), writing("--out", folder):
        for kind, name in (("screen", "tracking.png"), ("column", "column.pdf")):
            files.append(folder / name)
            run_figure(runs, kind).savefig(files[-1], dpi=110)
    return files


def save_animation(runs: dict[str, "Run"], path: Path) -> Path:
    """Write all runs side by side as an animation; return the file."""
    from tarc.plotting.animation import animate

    with drawing_figures():
        return animate(runs, None, path)
