"""`tarc run`: simulate a scenario."""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tarc.cli.options import Animate, Figures, Json, LawKind, ScenarioName, Set, View, drawing_figures, file_stem
from tarc.core.files import file_in_folder, make_folder, writing
from tarc.core.optional import require

if TYPE_CHECKING:
    from tarc.scenario.model import Scenario
    from tarc.simulation.run import Run

ReferenceFile = Annotated[
    Path | None,
    typer.Option(
        "--reference",
        metavar="FILE",
        help="Follow a file in place of the scenario's reference, for as long as it lasts: a ROS 2 bag (.mcap), a "
        "trajectory (.yaml) or a record (.csv).",
    ),
]
RunOut = Annotated[
    Path | None,
    typer.Option(
        "--out",
        "-o",
        help="Folder for the results, or a file .mcap for the trajectories alone, as a ROS 2 bag. Default: a folder in "
        "runs/ that is named after the scenario.",
    ),
]
Native = Annotated[bool, typer.Option("--native", help="Compile the loop to machine code first; needs a C compiler.")]


def run(
    scenario: ScenarioName,
    set_: Set = None,
    law: LawKind = "",
    reference: ReferenceFile = None,
    out: RunOut = None,
    native: Native = False,
    as_json: Json = False,
    figures: Figures = True,
    animate: Animate = None,
    view: View = False,
) -> None:
    """Simulate a scenario; write its trajectories as netCDF, and figures, and print its measures.

    Example: tarc run ur5e --set law.natural_frequency=15 --set duration=5

    Example: tarc run ur5e --reference task.mcap -o run.mcap
    """
    from tarc.scenario.model import Scenario

    settings = [*(set_ or []), *(["native=true"] if native else [])]
    loaded = Scenario.load(scenario, settings, law=law, reference=reference or "")
    run_scenario(loaded, out, as_json, figures, animate, view)


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

    bag = out if out is not None and out.suffix.lower() == ".mcap" else None
    if bag is not None:
        require("logs", "--out", "mcap", "mcap_ros2")
        out = file_in_folder("--out", bag).parent
    folder = make_folder("--out", out or Path("runs") / file_stem(scenario.name))
    try:
        runs = scenario.run()
    except KeyboardInterrupt:
        print("interrupted; nothing was written", file=sys.stderr)
        raise typer.Exit(130) from None
    files = save_runs(scenario, runs, folder) if bag is None else save_bags(runs, bag)
    if figures and bag is None:
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


def save_bags(runs: dict[str, "Run"], path: Path) -> list[Path]:
    """Write the trajectories of runs as ROS 2 bags, with several laws one per law; return the files."""
    paths = [path if len(runs) == 1 else path.with_stem(f"{path.stem}-{file_stem(name)}") for name in runs]
    return [result.save(file) for result, file in zip(runs.values(), paths, strict=True)]


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
