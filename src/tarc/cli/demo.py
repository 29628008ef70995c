"""`tarc demo`: the shipped UR5e scenario, without a model and with one."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tarc.cli.options import Figures, Json
from tarc.cli.run import run_scenario
from tarc.core.files import make_folder
from tarc.core.optional import EXTRAS, install_command, is_installed

if TYPE_CHECKING:
    from tarc.scenario.model import Scenario

SAMPLES = 300
"""Sampled postures of the verdicts."""

DemoFolder = Annotated[Path, typer.Option("--out", "-o", help="Folder for the results.")]


def demo(out: DemoFolder = Path("runs/demo"), as_json: Json = False, figures: Figures = True) -> None:
    """Simulate a UR5e that follows a trajectory with encoders alone and picks up 5 kg half-way.

    One law is TARC without a model. The other has M̂(q) of the robot file
    and a friction that is 30 % too small. Each has its verdict, for the
    robot without and with the load. It writes figures, and with the extra
    view an animation in 3D. The two laws of `tarc run ur5e` have no model.

    Example: tarc demo -o runs/demo
    """
    from tarc.scenario.model import Scenario

    animation = None
    if figures and all(is_installed(module) for module in EXTRAS["view"]):
        animation = make_folder("--out", out) / "animation.html"
    elif figures:
        print(f"no animation: it needs the extra view; {install_command('view')}", file=sys.stderr)
    scenario = Scenario.load("ur5e_model")
    run_scenario(scenario, out, as_json, figures, animation, verdicts=_verdicts(scenario))


def _verdicts(scenario: "Scenario") -> dict[str, str]:
    """Return the verdict of each law, by name."""
    certifications = scenario.certify(samples=SAMPLES)
    certifications.strengthen()
    verdicts = {name: certification.verdict for name, certification in certifications.items()}
    return {name: str(certificate.verdict) for name, certificate in (verdicts | certifications.known_inertia).items()}
