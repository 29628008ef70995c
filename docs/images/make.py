"""Draw the figures of the documentation: ``docs/images/make.py [NAME …]``.

Without names it draws all but those that take minutes; ``--all`` draws all.
"""

import argparse
import os
import re
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable
from pathlib import Path

from cycler import cycler
from matplotlib import rc_context
from matplotlib.figure import Figure
from PIL import Image

from tarc import Scenario
from tarc.design import design_controller
from tarc.plants import load_robot
from tarc.plotting.animation import animate
from tarc.plotting.certificates import design_figure
from tarc.plotting.runs import run_figure
from tarc.plotting.style import COLOURS, STYLE
from tarc.plotting.tuning import front_figure
from tarc.signals import Encoder
from tarc.study import TuningOptions, torque_variation_budget, tune_fronts

IMAGES = Path(__file__).resolve().parent
DOCS = IMAGES.parent
ROOT = DOCS.parent
CODE = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def shrink(source: Path, target: Path) -> None:
    """Write a drawing with a palette, in less than half of the space."""
    image = Image.open(source).convert("RGB")
    method = Image.Quantize.MAXCOVERAGE
    palette = image.quantize(256, method=method, dither=Image.Dither.NONE)
    target.parent.mkdir(exist_ok=True)
    palette.save(target, optimize=True)


def draw(figure: Figure, name: str) -> None:
    """Save a figure among the images of the pages."""
    with tempfile.TemporaryDirectory() as folder:
        picture = Path(folder) / name
        figure.savefig(picture, dpi=110)
        shrink(picture, IMAGES / name)


def run_page(page: str, *figures: str) -> None:
    """Execute a page's Python blocks and keep the figures that they save."""
    blocks = CODE.findall((DOCS / page).read_text(encoding="utf-8"))
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            namespace: dict[str, object] = {}
            with rc_context(STYLE | {"axes.prop_cycle": cycler(color=COLOURS)}):
                for block in blocks:
                    exec(block, namespace)
            for figure in figures:
                shrink(Path(figure), IMAGES / figure)
        finally:
            os.chdir(before)


def run_example(example: Path) -> None:
    """Run an example and keep the figure that has its name."""
    program = [sys.executable, str(example)]
    figure = f"{example.stem}.png"
    if example.suffix == ".yaml":
        program = [sys.executable, "-m", "tarc", "run", str(example)]
        program += ["--out", "."]
        figure = "tracking.png"
    with tempfile.TemporaryDirectory() as folder:
        settings = [f"{key}: {value}" for key, value in STYLE.items()]
        colours = ", ".join(repr(colour.lstrip("#")) for colour in COLOURS)
        settings.append(f'axes.prop_cycle: cycler("color", [{colours}])')
        (Path(folder) / "matplotlibrc").write_text("\n".join(settings))
        subprocess.run(program, cwd=folder, check=True)
        target = IMAGES / "examples" / f"{example.stem}.png"
        shrink(Path(folder) / figure, target)


def examples() -> None:
    """Run all examples."""
    folder = ROOT / "examples"
    for example in sorted([*folder.glob("*.py"), *folder.glob("*.yaml")]):
        run_example(example)


def demo() -> None:
    """Run the demo."""
    draw(run_figure(Scenario.load("ur5e_model").run()), "demo.png")


def animation() -> None:
    """Take a picture of the demo's animation in Chromium."""
    runs = Scenario.load("ur5e_model").run()
    with tempfile.TemporaryDirectory() as folder:
        page, picture = Path(folder, "run.html"), Path(folder, "animation.png")
        animate(runs, None, page)
        options = [
            "--headless=new",
            "--no-sandbox",
            "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader",
            "--virtual-time-budget=14000",
            "--window-size=1100,860",
            f"--screenshot={picture}",
        ]
        subprocess.run(["chromium", *options, page.as_uri()], check=True)
        box = (
            0,
            172,
            1100,
            812,
        )  # without a note on drawing without a graphics card
        Image.open(picture).crop(box).save(picture)
        shrink(picture, IMAGES / "animation.png")


def certified_demo() -> None:
    """Certify the demo's TARC."""
    draw(design_figure(Scenario.load("ur5e").certify()["TARC"]), "design.png")


def first_robot() -> None:
    """Design for the tutorial's robot, and run the design."""
    data = Path(sysconfig.get_path("purelib"), "cmeel.prefix", "share")
    arm = load_robot(
        data / "example-robot-data/robots/z1_description/urdf/z1.urdf",
        joints=[f"joint{i}" for i in range(1, 7)],
        armature=0.1,
    )
    made = design_controller(
        arm, payload=(0.0, 2.0), sensor=Encoder(bits=17), speed=1.0
    )
    draw(made.plot("front"), "z1-front.png")
    draw(run_figure(made.scenario().run()), "z1-tracking.png")


def tightness() -> None:
    """Measure how much of the stable ranges the certificates cover."""
    module = "benchmarks.tightness"
    with tempfile.TemporaryDirectory() as folder:
        picture = Path(folder) / "tightness.png"
        program = [sys.executable, "-m", module, "--figure", str(picture)]
        subprocess.run(program, cwd=ROOT, check=True)
        shrink(picture, IMAGES / picture.name)


def tuning() -> None:
    """Search the fronts of two laws."""
    scenario = Scenario.load("train_two_link")
    limit = torque_variation_budget(scenario).total
    fronts = tune_fronts(
        ["tdc", "tarc"], [scenario], [limit], TuningOptions(trials=400)
    )
    draw(
        front_figure(fronts, scenario.name, ("rad", "N m/s")),
        "tuning_front.png",
    )


def law_pages() -> None:
    """Compare all laws; write figures and numbers into the laws' pages."""
    for module in ("benchmarks.comparison", "benchmarks.pages"):
        subprocess.run([sys.executable, "-m", module], cwd=ROOT, check=True)


def run_script(name: str) -> None:
    """Run a script beside this one."""
    subprocess.run([sys.executable, str(IMAGES / name)], check=True)


FIGURES: dict[str, Callable[[], None]] = {
    "demo": demo,
    "animation": animation,
    "certified-demo": certified_demo,
    "examples": examples,
    "first-robot": first_robot,
    "design": lambda: run_page("how-to/design.md", "adaptation.png"),
    "estimators": lambda: run_page(
        "explanation/estimators.md", "estimators.png"
    ),
    "first-run": lambda: run_page("start/first-run.md", "tracking.png"),
    "claims": lambda: run_page("explanation/claims.md", "gain_moves.png"),
    "studio": lambda: run_script("studio.py"),
    "tightness": tightness,
    "laws": law_pages,
    "tuning": tuning,
}
LONG = {"laws", "animation", "studio"}


def main() -> None:
    """Draw the figures that were named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", choices=[*FIGURES, []])
    parser.add_argument("--all", action="store_true")
    options = parser.parse_args()
    default = [name for name in FIGURES if options.all or name not in LONG]
    for name in options.names or default:
        print(name, flush=True)
        FIGURES[name]()


if __name__ == "__main__":
    main()
