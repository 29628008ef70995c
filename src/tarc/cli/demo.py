"""`tarc demo`: the shipped UR5e scenario."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from tarc.cli.options import Figures, Json
from tarc.cli.run import run_scenario
from tarc.core.files import make_folder
from tarc.core.optional import EXTRAS, is_installed

WithModel = Annotated[
    bool, typer.Option("--model", help="Run one law without a model and one with M̂(q) of the robot file.")
]
DemoFolder = Annotated[Path, typer.Option("--out", "-o", help="Folder for the results.")]


def demo(
    out: DemoFolder = Path("runs/demo"), model: WithModel = False, as_json: Json = False, figures: Figures = True
) -> None:
    """Simulate a UR5e that follows a trajectory with encoders alone and picks up 5 kg half-way, under TARC and TDC.

    It writes figures, and with the extra view an animation in 3D.
    With --model the laws are one without a model and one with M̂(q).

    Example: tarc demo -o runs/demo
    """
    from tarc.scenario.model import Scenario

    animation = None
    if figures and all(is_installed(module) for module in EXTRAS["view"]):
        animation = make_folder("--out", out) / "animation.html"
    elif figures:
        print("no animation: it needs the extra view; pip install 'tarc-control[view]'", file=sys.stderr)
    run_scenario(Scenario.load("ur5e_model" if model else "ur5e"), out, as_json, figures, animation)
