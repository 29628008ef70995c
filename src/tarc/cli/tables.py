"""What the command line prints."""

import inspect
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

import tarc.laws
from tarc.certificates.base import Certificate
from tarc.certification import LawCertification
from tarc.core import validation as check
from tarc.core.errors import TarcError
from tarc.core.formatting import format_vector
from tarc.plants.mujoco import MujocoPlant
from tarc.plants.robot_file import shipped_robots
from tarc.scenario.loader import find_scenario, shipped_scenarios
from tarc.scenario.model import Scenario
from tarc.scenario.schema import SECTIONS, catalogue, parameters
from tarc.simulation.quantities import MEASURES
from tarc.simulation.run import Run
from tarc.study.comparison import Comparison

if TYPE_CHECKING:
    from tarc.design.result import Design
    from tarc.design.stress import StressLimit


def measures(scenario: Scenario, run: Run) -> dict[str, float]:
    """The run's metrics, or none where it ended before they begin."""
    if run.data.sizes["time"] < 2 or float(run.data["time"].values[-2]) < scenario.metrics_start:
        return {}
    return run.metrics(start_time=scenario.metrics_start)


def summary(scenario: Scenario, runs: dict[str, Run], files: list[Path]) -> dict[str, Any]:
    """Results as plain data, ready for JSON."""
    results = {}
    for name, run in runs.items():
        status = run.status
        results[name] = {
            "status": "completed" if status.completed else "diverged",
            "divergence_time": status.divergence_time,
            "fault_time": status.fault_time,
            "saturated": status.saturated,
            "metrics": {key: value if math.isfinite(value) else None for key, value in measures(scenario, run).items()},
        }
    return {"name": scenario.name, "runs": results, "files": [str(file) for file in files]}


def print_runs(scenario: Scenario, runs: dict[str, Run], files: list[Path]) -> None:
    """A table of metrics, a column a run, and where the files are."""
    console = Console()
    since = f", measured after {scenario.metrics_start:g} s" if scenario.metrics_start else ""
    table = Table(title=f"{scenario.name}, {scenario.duration:g} s{since}", title_justify="left")
    table.add_column("measure")
    for name in runs:
        table.add_column(name, justify="right")
    table.add_column("unit")
    results = {name: measures(scenario, run) for name, run in runs.items()}
    slides = {str(run.data["position"].attrs["units"]) for run in runs.values()} == {"m"}
    for key, (label, _, scale, unit) in MEASURES.items():
        if any(key in result for result in results.values()):
            cells = [f"{scale * result[key]:.4g}" if key in result else "–" for result in results.values()]
            table.add_row(label, *cells, unit.replace("rad", "m").replace("N m", "N") if slides else unit)
    table.add_section()
    statuses = [str(run.status) for run in runs.values()]
    table.add_row("status", *[s if s.startswith("completed") else f"[bold red]{s}[/bold red]" for s in statuses], "")
    console.print(table)
    if not any(results.values()):
        console.print(f"no measures: no run lasts beyond metrics_start, {scenario.metrics_start:g} s")
    console.print("written: " + ", ".join(escape(str(file)) for file in files), soft_wrap=True)


WIDE = 110
"""Columns of a terminal from which tables show all that they have; the rest is in the files."""
FEW = ("rms_error", "peak_error", "torque_variation")
"""What a comparison shows in a narrow one."""
CERTIFICATES = {
    "robot": "this robot, however it moves in the workspace",
    "constant_ratio": "each constant inertia ratio that occurs",
    "sector": "constant ratio, any switching of the robust term",
    "varying_ratio": "any varying ratio, in the widest range",
    "lemma1": "paper, Lemma 1: ‖M(q)⁻¹M̂ − I‖ < 1",
    "c2": "paper, condition (c2): P3 P2ᵀ > 0",
    "theorem1": "paper, Theorem 1: Ψ > 0, nominal",
    "theorem2": "paper, Theorem 2 as printed: Θ > 0",
    "nominal": "Theorem 2 repaired, nominal",
}
"""What each kind of certificate is about, in the order of the table."""


def _findings(certificate: Certificate) -> dict[str, Any]:
    """Return the plain numbers of the evidence, None for a number that is not finite."""
    evidence = certificate.to_dict()["evidence"]
    flat = {
        key: value
        for content in (evidence, evidence.get("findings") or {}, evidence.get("ball") or {})
        for key, value in content.items()
        if not isinstance(value, dict | list)
    }
    for name in ("rate", "ratio_spread"):
        if hasattr(certificate.evidence, name):
            flat[name] = getattr(certificate.evidence, name)
    return {key: None if value in ("inf", "-inf", "nan") else value for key, value in flat.items()}


def certificate_summary(scenario: Scenario, found: dict[str, LawCertification], files: list[Path]) -> dict[str, Any]:
    """Certificates as plain data, ready for JSON; their matrices are in the files."""
    laws = {
        name: {
            kind: {
                "claim": one.claim,
                "verdict": one.verdict,
                "margin": one.margin if math.isfinite(one.margin) else None,
                "margin_meaning": one.margin_meaning,
                "proof_grade": one.proof_grade,
                "findings": _findings(one),
                "witness": one.to_dict()["witness"],
                "assumptions": list(one.assumptions),
            }
            for kind, one in certification.certificates.items()
        }
        for name, certification in found.items()
    }
    return {"name": scenario.name, "certificates": laws, "files": [str(file) for file in files]}


def print_certificates(scenario: Scenario, found: dict[str, LawCertification], files: list[Path]) -> None:
    """A table a law, with the worst configuration and, where a design is refuted, what to do."""
    console = Console()
    colours = {"certified": "green", "refuted": "red", "inconclusive": "yellow"}
    for name, certification in found.items():
        table = Table(title=f"{scenario.name}: {name}", title_justify="left")
        wide = console.width >= WIDE
        for column in ("certificate", "verdict", "margin", *(["which is"] if wide else []), "decided in"):
            table.add_column(column, justify="right" if column == "margin" else "left")
        for kind, one in certification.certificates.items():
            if kind == "lemma1":
                table.add_section()
            table.add_row(
                CERTIFICATES[kind],
                f"[{colours[one.verdict]}]{one.verdict_in_words}[/]",
                f"{one.margin:.3g}",
                *([one.margin_meaning] if wide else []),
                "ball arithmetic" if one.proof_grade else "floating point",
            )
        console.print(table)
        verdict = certification.verdict
        evidence = verdict.evidence
        for word, ratio, point in (
            ("least", evidence.min_ratio, evidence.points.min_ratio),
            ("greatest", evidence.max_ratio, evidence.points.max_ratio),
        ):
            posture = format_vector(point.position)
            console.print(f"{word} ratio {ratio:.4g} at q = ({posture})", highlight=False)
        ball = evidence.ball
        contained = ""
        if ball is not None and ball.radius:
            contained = f"; the ball that fits best contains {ball.min_ratio:.4g} to {ball.max_ratio:.4g}"
        spread = f"spread {evidence.ratio_spread:.3g}, from {evidence.samples} postures and local search{contained}"
        console.print(spread, highlight=False)
        if evidence.rate is not None and evidence.max_rate_point is not None:
            speeds = format_vector(evidence.max_rate_point.velocity_limits)
            console.print(f"no joint faster than ({speeds}), M changes by at most {evidence.rate:.3g} M̂ per second")
        text = certification.suggestion
        if text:
            console.print(f"[{colours[verdict.verdict]}]{escape(text)}[/]", highlight=False)
        console.print()
    console.print("written: " + ", ".join(escape(str(file)) for file in files), soft_wrap=True)


def comparison_summary(comparison: Comparison, files: list[Path]) -> dict[str, Any]:
    """A comparison as plain data, ready for JSON."""
    laws = {
        name: {
            "status": str(comparison.runs[name].status),
            "measures": {key: value if math.isfinite(value) else None for key, value in found.items()},
        }
        for name, found in comparison.measures.items()
    }
    return {
        "name": comparison.scenario.name,
        "laws": laws,
        "failures": comparison.failures,
        "front": comparison.front,
        "files": [str(file) for file in files],
    }


def print_comparison(comparison: Comparison, files: list[Path]) -> None:
    """A row a law, best error first; the laws that no other beats in both error and variation are marked."""
    console = Console()
    scenario = comparison.scenario
    table = Table(
        title=f"{scenario.name}, {scenario.duration:g} s, after {scenario.metrics_start:g} s", title_justify="left"
    )
    table.add_column("law")
    shown = {key: one for key, one in comparison.columns.items() if console.width >= WIDE or key in FEW}
    for label, _, unit in shown.values():
        table.add_column(f"{label} [{unit}]", justify="right")
    table.add_column("status")
    front = comparison.front
    measures = comparison.measures
    for name in sorted(measures, key=lambda name: measures[name].get("rms_error", math.inf)):
        found = measures[name]
        cells = [f"{scale * found[key]:.4g}" if key in found else "–" for key, (_, scale, _) in shown.items()]
        status = comparison.runs[name].status
        ended = str(status) if status.completed else f"[red]{status}[/red]"
        table.add_row(f"{name} *" if name in front else name, *cells, ended)
    console.print(table)
    console.print("* no other law has both a smaller RMS error and a smaller torque variation")
    for name, reason in comparison.failures.items():
        console.print(f"{name} did not run: {escape(reason)}")
    console.print("written: " + ", ".join(escape(str(file)) for file in files), soft_wrap=True)


def design_summary(design: "Design", files: list[Path], limits: dict[str, "StressLimit"]) -> dict[str, Any]:
    """A design as plain data, ready for JSON; its certificates are in the files."""
    verdict, content = design.certificates["robot"], design.scenario().model_dump(mode="json")
    return {
        "name": content["name"],
        "verdict": verdict.verdict,
        "margin": verdict.margin,
        "margin_meaning": verdict.margin_meaning,
        "spread": design.spread,
        "choices": {one.label: {"value": one.value, "reason": one.reason} for one in design.choices},
        "law": content["law"],
        "estimator": content["estimator"],
        "torque_noise": {name: {"rms": rms, "share": share} for name, rms, share in _noise(design)},
        "limits": {
            name: {"value": one.value, "unit": one.unit, "explanation": one.explain()} for name, one in limits.items()
        },
        "files": [str(file) for file in files],
    }


def _noise(design: "Design") -> list[tuple[str, float, float | None]]:
    """Joint, predicted RMS of its torque noise and that as a share of its limit, None where it has none."""
    known = np.inf if design.law.torque_limit is None else np.asarray(design.law.torque_limit, dtype=float)
    shares = [float(one) or None for one in design.torque_noise / known]
    return list(zip(design.plants[0].joint_names, design.torque_noise.tolist(), shares, strict=True))


def print_design(design: "Design", files: list[Path]) -> None:
    """What was chosen and why, the verdict, the torque noise to be expected, and where the files are."""
    from tarc.design.writer import plant_name

    console = Console()
    title = f"{type(design.law).__name__} for {plant_name(design.plants[0])}, {1 / design.law.period:g} Hz"
    table = Table(title=title, title_justify="left", show_lines=True)
    table.add_column("choice", width=17)
    table.add_column("value", max_width=22)
    table.add_column("reason")
    for one in design.choices:
        style = "yellow" if one.reason.startswith("WARNING") else None
        table.add_row(*(escape(text) for text in (one.label, one.value, one.reason)), style=style)
    console.print(table)
    verdict = design.certificates["robot"]
    console.print(f"[green]{verdict.verdict}[/]: {escape(verdict.claim)}", highlight=False)
    console.print(f"margin {verdict.margin:.3g}, {escape(verdict.margin_meaning)}", highlight=False)
    units = ["N" if unit == "m" else "N m" for unit in design.plants[0].units]
    noise = [
        f"{escape(name)} {rms:.3g} {unit}" + ("" if share is None else f" ({100 * share:.2g} %)")
        for (name, rms, share), unit in zip(_noise(design), units, strict=True)
    ]
    console.print(f"predicted torque noise, RMS (of the limit): {', '.join(noise)}", highlight=False)
    loudest = max((share for _, _, share in _noise(design) if share is not None), default=0.0)
    least = loudest * design.front[0].noise / design.candidate.noise
    if design.noise_budget is not None and loudest > 1.0001 * design.noise_budget >= 1.0001 * least:
        console.print(
            f"[yellow]torque noise is above {100 * design.noise_budget:.3g} %: the error falls faster than its square; "
            f"--noise {design.noise_budget:g} keeps to it[/]",
            highlight=False,
        )
    elif design.noise_budget is not None and loudest > 1.0001 * design.noise_budget:
        console.print(
            f"[yellow]torque noise is above {100 * design.noise_budget:.3g} %: no certified loop has less. "
            f"An encoder with {math.ceil(math.log2(loudest / design.noise_budget))} more bits keeps to it; more rotor "
            "inertia, less payload or a smaller joint range lower the noise[/]",
            highlight=False,
        )
    console.print("written: " + ", ".join(escape(str(file)) for file in files), soft_wrap=True)


def print_limits(limits: dict[str, "StressLimit"]) -> None:
    """How far a design can be pushed, a line a question."""
    console = Console()
    console.print("\nhow far each may change by itself, the gains unchanged:")
    for one in limits.values():
        console.print(escape(one.explain()), highlight=False)


def _entries() -> dict[str, dict[str, Any]]:
    entries: dict[str, dict[str, Any]] = {section: dict(catalogue(section)) for section in SECTIONS}
    entries["robot"] = {"file": MujocoPlant.from_file, **entries["robot"]}
    return entries


def _first_line(kind: Any) -> str:
    return (inspect.getdoc(kind) or "").split("\n\n")[0].replace("\n", " ")


def print_catalogue(as_json: bool) -> None:
    """All kinds of all sections, each with its parameters."""
    entries = _entries()
    if as_json:
        content = {
            section: {name: {"about": _first_line(kind), "parameters": _defaults(kind)} for name, kind in kinds.items()}
            for section, kinds in entries.items()
        }
        shipped = {"robots": [r.removesuffix(".xml") for r in shipped_robots()], "scenarios": shipped_scenarios()}
        print(json.dumps({**content, "shipped": shipped}, indent=2, default=str))
        return
    console = Console()
    for section, kinds in entries.items():
        table = Table(title=section, title_justify="left", show_header=False, title_style="bold", expand=True)
        table.add_column("kind", no_wrap=True, style="cyan")
        table.add_column("what")
        for name, kind in kinds.items():
            text = "parameters: " + ", ".join(parameters(kind)) if parameters(kind) else ""
            table.add_row(name, f"{escape(_first_line(kind))}\n[dim]{escape(text)}[/dim]")
        console.print(table)
    robots = ", ".join(name.removesuffix(".xml") for name in shipped_robots())
    console.print(f"shipped robots: {robots}; shipped scenarios: {', '.join(shipped_scenarios())}")
    console.print("Details of one: tarc show TARC")


def _defaults(kind: Any) -> dict[str, Any]:
    return {
        name: {"allowed": parameter.words, "default": "required" if parameter.needed else parameter.default}
        for name, parameter in parameters(kind).items()
    }


def print_kind(name: str, as_json: bool) -> None:
    """One kind: its documentation, and its parameters with defaults."""
    found = {key: kind for kinds in _entries().values() for key, kind in kinds.items()}
    # their parameters are those of every law on them
    found |= {name: getattr(tarc.laws, name) for name in ("TDE", "PolePlacement", "Law")}
    names = {key.lower(): key for key in found}
    if name.lower().removesuffix(".xml") in (file.removesuffix(".xml") for file in shipped_robots()):
        print_robot(name.lower(), as_json)
        return
    if name.lower() in shipped_scenarios():
        print(find_scenario(name).read_text(encoding="utf-8"), end="")
        return
    name = names.get(name.lower(), name)
    if name not in found:
        raise TarcError(
            f"show: nothing is called {name!r}; there are {', '.join(found)}.{check.did_you_mean(name, found)}"
        )
    kind = found[name]
    if as_json:
        print(
            json.dumps({"name": name, "about": _first_line(kind), "parameters": _defaults(kind)}, indent=2, default=str)
        )
        return
    console = Console()
    console.print(f"[bold]{name}[/bold]\n")
    console.print(escape(inspect.getdoc(kind) or ""), highlight=False)
    table = Table(title="parameters in a scenario", title_justify="left")
    for column in ("name", "default", "allowed"):
        table.add_column(column)
    for parameter in parameters(kind).values():
        table.add_row(parameter.name, "required" if parameter.needed else str(parameter.default), parameter.words)
    console.print(table)


def print_robot(name: str, as_json: bool) -> None:
    """Print the joints of a shipped robot: names, units and limits."""
    plant = MujocoPlant.from_file(name)
    rows = [
        {"joint": joint, "unit": unit, "torque_limit": float(torque), "velocity_limit": float(velocity)}
        for joint, unit, torque, velocity in zip(
            plant.joint_names, plant.units, plant.torque_limits, plant.velocity_limits, strict=True
        )
    ]
    if as_json:
        print(json.dumps({"name": name, "joints": rows}, indent=2))
        return
    table = Table(title=f"robot {name}", title_justify="left")
    for column in ("joint", "unit", "torque limit [N m or N]", "velocity limit [1/s]"):
        table.add_column(column)
    for row in rows:
        table.add_row(row["joint"], row["unit"], f"{row['torque_limit']:g}", f"{row['velocity_limit']:g}")
    console = Console()
    console.print(table)
    console.print(f"In a scenario: robot: {{file: {name}}}; tarc show file lists its options", highlight=False)
