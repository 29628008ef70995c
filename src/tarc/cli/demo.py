"""`tarc demo`: the shipped UR5e scenario."""

from pathlib import Path

from tarc.cli.options import Figures, Json, Out
from tarc.cli.run import run_scenario


def demo(out: Out = None, as_json: Json = False, figures: Figures = True) -> None:
    """Simulate a UR5e that follows a trajectory with encoders alone and picks up 5 kg half-way, under TARC and TDC.

    Example: tarc demo -o runs/demo
    """
    from tarc.scenario.model import Scenario

    run_scenario(Scenario.load("ur5e"), out or Path("runs/demo"), as_json, figures)
