"""Draw the figures of the documentation again."""

import os
import re
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

from PIL import Image

from tarc import Scenario
from tarc.design import design
from tarc.plants import MujocoPlant
from tarc.plotting.certificates import design_figure
from tarc.plotting.runs import run_figure
from tarc.signals import Encoder

HERE = Path(__file__).resolve().parent


def run_page(name: str, figures: list[str]) -> None:
    """Execute a page's Python blocks and keep the figures that they save."""
    text = (HERE.parent / name).read_text(encoding="utf-8")
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            space: dict[str, object] = {}
            for block in re.findall(
                r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE
            ):
                exec(block, space)
            for figure in figures:
                shrink(Path(figure), HERE / figure)
        finally:
            os.chdir(before)


def shrink(source: Path, target: Path) -> None:
    """Write a drawing with a palette, in less than half of the space."""
    image = Image.open(source).convert("RGB")
    image.quantize(
        colors=256, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE
    ).save(target, optimize=True)


def law_pages() -> None:
    """Compare all laws; write figures and numbers into the laws' pages."""
    for module in ("benchmarks.comparison", "benchmarks.pages"):
        root = HERE.parents[1]
        subprocess.run([sys.executable, "-m", module], cwd=root, check=True)


def first_robot() -> None:
    """The design of the tutorial's robot, and its run."""
    data = Path(sysconfig.get_path("purelib"), "cmeel.prefix", "share")
    arm = MujocoPlant.from_file(
        data / "example-robot-data/robots/z1_description/urdf/z1.urdf",
        joints=[f"joint{i}" for i in range(1, 7)],
        armature=0.1,
    )
    made = design(arm, payload=(0.0, 2.0), sensor=Encoder(bits=17), speed=1.0)
    figures = {"z1-front.png": made.plot("front")}
    figures["z1-tracking.png"] = run_figure(made.scenario().run())
    with tempfile.TemporaryDirectory() as folder:
        for name, figure in figures.items():
            figure.savefig(Path(folder) / name, dpi=110)
            shrink(Path(folder) / name, HERE / name)


if __name__ == "__main__":
    law_pages()
    first_robot()
    run_page("how-to/design.md", ["adaptation.png"])
    run_page("explanation/estimators.md", ["estimators.png"])
    run_page("start/first-run.md", ["tracking.png"])
    run_page("explanation/claims.md", ["gain_moves.png"])
    with tempfile.TemporaryDirectory() as folder:
        demo = Path(folder) / "demo.png"
        run_figure(Scenario.load("ur5e").run()).savefig(demo, dpi=110)
        shrink(demo, HERE / "demo.png")
    scenario = Scenario.load("ur5e")
    plant, reference = scenario.build_plant(), scenario.build_reference()
    law = scenario.build_laws(plant, reference)["TARC"]
    with tempfile.TemporaryDirectory() as folder:
        picture = Path(folder) / "design.png"
        design_figure(law, scenario.certify()["TARC"]).savefig(picture, dpi=110)
        shrink(picture, HERE / "design.png")
