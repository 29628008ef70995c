"""`tarc demo`: the shipped UR5e scenario."""

from pathlib import Path
from typing import Annotated

import typer

from tarc.cli.options import Figures, Json
from tarc.cli.run import run_scenario

DemoFolder = Annotated[Path, typer.Option("--out", "-o", help="Folder for the results.")]


def demo(out: DemoFolder = Path("runs/demo"), as_json: Json = False, figures: Figures = True) -> None:
    """Simulate a UR5e that follows a trajectory with encoders alone and picks up 5 kg half-way, under TARC and TDC.

    Example: tarc demo -o runs/demo
    """
    from tarc.scenario.model import Scenario

    run_scenario(Scenario.load("ur5e"), out, as_json, figures)
