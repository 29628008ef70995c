"""Values of the pages for a start and of the how-to pages on robots, signals and scenarios."""

import re
import shutil
import sysconfig
import tempfile
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import tarc
from benchmarks.page_values.registry import (
    ROOT,
    Value,
    command,
    flat,
    long_source,
    run_page,
    source,
    table,
    text_block,
    type_page,
    yaml_block,
)

SIGNIFICANT_LINES = re.compile(r"^│ (RMS error|peak error|torque variation) .*$", re.MULTILINE)
TUNED_ERROR = re.compile(r"^│ (tdc|LeakyIntegral)[ *]*│ +([\d.]+) ", re.MULTILINE)
Z1_JOINTS = [f"joint{number}" for number in range(1, 7)]
Z1_CHANGES: dict[str, tuple[str, dict[str, Any]]] = {
    "base": ("as above", {}),
    "noise": ("`--noise-budget 0.03`: three per cent of the torque limit by noise", {"noise_budget": 0.03}),
    "encoder": ("`--encoder-bits 19`", {"sensor": tarc.signals.Encoder(bits=19)}),
    "payload": ("`--payload 0 0.5`", {"payload": (0.0, 0.5)}),
    "speed": ("`--speed 0.5`", {"speed": 0.5}),
    "rate": ("`--control-rate 2000`", {"period": 1 / 2000}),
    "rated": ("no `--speed`", {"speed": None}),
}


@source
def first_run() -> dict[str, Value]:
    """Errors that the first run prints, and the table of the arm from a URDF."""
    page = run_page("start/first-run.md")
    run, plain = page.names["run"], page.names["plain"]
    with tempfile.TemporaryDirectory() as folder:
        scenario = Path(folder) / "arm.yaml"
        scenario.write_text(yaml_block("start/first-run.md", "arm.urdf"), encoding="utf-8")
        shutil.copy(page.folder / "arm.urdf", folder)
        printed = command("tarc run arm.yaml --no-figures", Path(folder))
    lines = [match[0] for match in SIGNIFICANT_LINES.finditer(printed)]
    return {
        "rms_error": run.metrics()["rms_error"],
        "tarc_error": 1e3 * run.metrics(start_time=2.0)["rms_error"],
        "tdc_error": 1e3 * plain.metrics(start_time=2.0)["rms_error"],
        "arm": text_block("\n".join(lines)),
    }


@source
def idea_to_firmware() -> dict[str, Value]:
    """Run the page from a law of one's own to firmware, and draw its figure."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        printed = type_page("start/idea-to-firmware.md", folder)
        measured = [
            tarc.Run.load(folder / "runs" / place).metrics(start_time=2.0)
            for place in ("arm/LeakyIntegral.nc", "plain/TDC.nc")
        ]
        shutil.copy(folder / "runs" / "arm-compared" / "side.png", ROOT / "docs" / "images" / "idea-to-firmware.png")
    _, _, certify, strong, _, compare, _, verify, firmware = printed.values()
    rows = [
        (
            name,
            *(f"{factor * part[key]:.4g}" for key, factor in (("rms_error", 1e3), ("peak_error", 1e3))),
            f"{part['torque_variation']:.4g}",
        )
        for name, part in zip(("LeakyIntegral", "TDC"), measured, strict=True)
    ]
    tuned = {law: float(error) for law, error in TUNED_ERROR.findall(compare)}
    verified = re.sub(r", \d+ ns per step( *)", lambda match: " " * len(match[0]), verify)
    return {
        "ratio": measured[0]["rms_error"] / measured[1]["rms_error"],
        "runs": table(["law", "RMS error [mrad]", "peak error [mrad]", "torque variation [N m/s]"], rows),
        "verdict": text_block(_first_rows(certify)),
        "strong": text_block(_first_rows(strong)),
        "compared": text_block(compare),
        "tuned_ratio": tuned["LeakyIntegral"] / tuned["tdc"],
        "verified": text_block(verified),
        "firmware": text_block(firmware),
    }


def _first_rows(printed: str) -> str:
    """Return a table up to its first rule between rows."""
    table, _, _ = printed.partition("├")
    return table.rstrip()


def z1_file() -> Path:
    """Return the URDF of the Unitree Z1."""
    data = Path(sysconfig.get_path("purelib"), "cmeel.prefix", "share")
    return data / "example-robot-data/robots/z1_description/urdf/z1.urdf"


@long_source
def your_robot() -> dict[str, Value]:
    """Designs for the Unitree Z1, each simulated, and the error of the command where none can be certified."""
    arm = tarc.plants.load_robot(z1_file(), joints=Z1_JOINTS, armature=0.1)
    values: dict[str, Value] = {}
    rows = []
    for name, (label, changes) in Z1_CHANGES.items():
        common: dict[str, Any] = {"payload": (0.0, 2.0), "sensor": tarc.signals.Encoder(bits=17), "speed": 1.0}
        design = tarc.design.design_controller(arm, **common | changes)
        measured = next(iter(design.scenario().run(progress=False).values())).metrics(start_time=1.0)
        law: Any = design.law
        frequency = float(np.max(law.natural_frequency))
        error, variation = 1e3 * measured["rms_error"], measured["torque_variation"]
        values |= {f"{name}.natural_frequency": frequency, f"{name}.window": 1e3 * law.estimator.window}
        values |= {f"{name}.rms_error": error, f"{name}.torque_variation": variation}
        rows.append((label, f"{frequency:.3g}", f"{error:.2g}", f"{float(f'{variation:.4g}'):g}"))
    heads = ["change", "natural frequency [rad/s]", "RMS error [mrad]", "torque variation [N m/s]"]
    return values | {"changes": table(heads, rows[:-1]), "refused": refused_design()}


def refused_design() -> str:
    """Return the error of a design for 100 rad/s, which cannot be certified, in lines of 100 characters."""
    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(z1_file(), folder)
        error = command(
            f"tarc design z1.urdf --joints {','.join(Z1_JOINTS)} --armature 0.1 --payload 0 2 --speed 1 "
            "--natural-frequency 100",
            Path(folder),
            fails=True,
        )
    return text_block(textwrap.fill(error, 92))


@source
def real_task() -> dict[str, Value]:
    """Verdict and run of a pick-and-place with TIAGo's arm; its figure is written too."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        designed = _design_real_task(folder)
        ran = command("tarc run design.yaml", folder)
        (figure,) = folder.glob("runs/*/tracking.png")
        shutil.copy(figure, ROOT / "docs" / "images" / "real-task.png")
    verdict = designed[designed.index("certified: ") :]
    return {"design": text_block(verdict), "run": text_block(ran)}


@long_source
def real_task_laws() -> dict[str, Value]:
    """Gains of five laws for the pick-and-place, and their errors; the figure of both is written too."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _design_real_task(folder)
        laws = "pid,pd-gravity,computed-torque-integral,tdc,tarc"
        tuned = command(f"tarc tune design.yaml --laws {laws} --trials 1000", folder)
        compared = command("tarc compare design.yaml --gains gains.yaml --out compared", folder)
        shutil.copy(folder / "compared" / "plane.png", ROOT / "docs" / "images" / "real-task-laws.png")
    return {"tune": text_block(tuned), "compare": text_block(compared)}


def _design_real_task(folder: Path) -> str:
    """Write the pick-and-place of the page into a folder, and return what the design prints."""
    page = "start/real-task.md"
    arm = [f"arm_{number}_joint" for number in range(1, 8)]
    data = Path(sysconfig.get_path("purelib"), "cmeel.prefix", "share", "example-robot-data")
    shutil.copy(data / "robots/tiago_description/robots/tiago.urdf", folder)
    (folder / "pick.yaml").write_text(yaml_block(page, "joint_names"), encoding="utf-8")
    designed = command(
        "tarc design tiago.urdf --trajectory pick.yaml --payload 0 1 --armature 0.03 "
        f"--joints {','.join(arm)} -o design.yaml --no-figures",
        folder,
    )
    scenario = folder / "design.yaml"
    kept, _, _ = scenario.read_text(encoding="utf-8").partition("disturbance:")
    end = "initial_torque: rest\nmetrics_start: 1.0\n"
    scenario.write_text(kept + yaml_block(page, "disturbance:") + end, encoding="utf-8")
    return designed


@source
def design() -> dict[str, Value]:
    """Largest certified payload of the arm on the page on design, and a larger one that it tracks in simulation."""
    limit = run_page("how-to/design.md").names["limits"]["payload"]
    tracked = [outcome.value for outcome in limit.beyond_runs if outcome.stable]
    return {"payload": limit.value, "beyond": max(tracked)}


@source
def signals() -> dict[str, Value]:
    """Errors of an arm seen through four encoders."""
    page = run_page("how-to/signals.md")
    labels = ("perfect", "12 bits", "17 bits, one sample in twenty lost", "17 bits, two periods late")
    measured = page.columns(r"^Encoder\(.*\) (\S+) (\S+) completed")
    rows = [
        (label, f"{1e3 * float(error):.4g}", f"{float(variation):.4g}")
        for label, (error, variation) in zip(labels, measured, strict=True)
    ]
    return {"encoders": table(["encoder", "RMS error [mrad]", "torque variation [N m/s]"], rows)}


@source
def diagnose() -> dict[str, Value]:
    """Run the page's example of a limit cycle; its figure is written too."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        limits = "law.torque_limit=[100,50]"
        command(f"tarc run two_link_payload --set law.inertia.fraction=0.3 --set {limits} --no-figures", folder)
        found = "tarc diagnose runs/two_link_payload/TDC.nc --start-time 1 --figure log.png"
        printed = command(found, folder, status=1)
        _palette(folder / "log.png", ROOT / "docs" / "images" / "diagnose.png")
    return {"bad": text_block(printed)}


COMMISSIONING = {
    "first": "M̂ × 0.2, 8 rad/s",
    "second": "M̂ × 0.4, 8 rad/s",
    "third": "M̂ × 0.7, 8 rad/s",
    "fourth": "M̂, 8 rad/s",
    "fifth": "M̂, 12 rad/s",
    "design": "the design: M̂, 20 rad/s",
    "load": "5 kg from 2.5 s on",
    "far": "M̂ × 2.5, 20 rad/s",
}
"""Runs of the page on commissioning, and what each is."""


def _palette(source_file: Path, target: Path) -> None:
    """Copy a drawing with a palette, in less than half of the space."""
    image = Image.open(source_file).convert("RGB")
    image.quantize(256, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(target, optimize=True)


@source
def commissioning() -> dict[str, Value]:
    """Type the page's commands and measure its runs; its figures are written too."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        type_page("how-to/commissioning.md", folder)
        images = ROOT / "docs" / "images"
        for place in ("sag", "first", "fourth", "design", "load"):
            _palette(folder / "runs" / place / "tracking.png", images / f"commissioning-{place}.png")
        _palette(folder / "far.png", images / "commissioning-far.png")
        values: dict[str, Value] = {}
        for place in ("hold", "sag"):
            measured = tarc.Run.load(folder / "runs" / place / "TDC.nc").metrics()
            values[f"{place}.peak_error"] = 1e3 * measured["peak_error"]
        rows = []
        for place, label in COMMISSIONING.items():
            file = folder / "runs" / place / "TDC.nc"
            measured = tarc.Run.load(file).metrics(start_time=1.0)
            found = tarc.diagnose(file, start_time=1.0).findings
            kinds = dict.fromkeys(finding.kind.replace("_", " ") for finding in found)
            values[f"{place}.rms_error"] = 1e3 * measured["rms_error"]
            errors = (f"{1e3 * measured[key]:.3g}" for key in ("rms_error", "peak_error"))
            rate = float(f"{measured['torque_variation']:.3g}")
            rows.append((label, *errors, f"{rate:g}", ", ".join(kinds) or "none"))
    heads = ["step", "RMS error [mrad]", "peak error [mrad]", "torque variation [N m/s]", "findings"]
    return values | {"steps": table(heads, rows)}


@source
def own_reference() -> dict[str, Value]:
    """Deviation of the velocity of a recorded trajectory, in 10⁻⁸ rad/s."""
    deviation = run_page("how-to/own-reference.md").names["deviation"]
    return {"recorded_velocity": float(1e8 * np.max(np.abs(deviation)))}


@source
def own_law() -> dict[str, Value]:
    """Errors of time-delayed control and of the law that extends it."""
    runs = run_page("how-to/own-law.md").names["runs"]
    return flat({name: run.metrics(start_time=1.0) for name, run in runs.items()})


@source
def robots() -> dict[str, Value]:
    """Errors of the polar arm."""
    boom, slide = run_page("how-to/own-plant.md").names["run"].joint_errors().values()
    return {"boom": 1e3 * boom, "slide": 1e3 * slide}


@source
def real_time() -> dict[str, Value]:
    """Errors of the arm in a loop of one's own."""
    errors = run_page("how-to/real-time.md").names["errors"]
    shoulder, elbow = 1e3 * np.sqrt(np.mean(errors[1000:] ** 2, axis=0))
    return {"shoulder": float(shoulder), "elbow": float(elbow)}


@source
def scenarios() -> dict[str, Value]:
    """Upper limits of the inertia ratio with a computation delay of two periods."""

    def limit(synchronised: bool, known: int) -> float:
        law = tarc.laws.TDC(
            inertia=0.1,
            natural_frequency=10.0,
            period=1e-3,
            estimator=tarc.estimators.Algebraic(window=0.010, degree=2),
            synchronised=synchronised,
            actuation_delay=known,
        )
        return tarc.analysis.stable_interval(law, computation_delay=2)[1]

    rows = [
        (f"{kind}, 2 periods", f"{limit(synchronised, 0):.4g}", f"{limit(synchronised, 2):.4g}")
        for kind, synchronised in (("literal", False), ("synchronised", True))
    ]
    return {"delays": table(["loop", "delay unknown to the law", "known"], rows)}
