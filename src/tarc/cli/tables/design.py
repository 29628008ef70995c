"""What `tarc design` prints."""

import math
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tarc.cli.tables.console import VERDICT_COLOURS, print_written
from tarc.core.units import unit_for_joints
from tarc.design.result import Design
from tarc.design.stress import StressLimit
from tarc.design.stress_case import StressRun
from tarc.design.writer import plant_name

MAX_EXCESS = 2.0
"""Simulated error or torque noise over the predicted one from which a design is not as predicted."""


def design_summary(
    design: Design, trial: StressRun, predicted: float, files: list[Path], limits: dict[str, StressLimit]
) -> dict[str, Any]:
    """Return a design as plain data, ready for JSON; its certificates are in the files."""
    verdict, content = design.certificates["robot"], design.scenario().model_dump(mode="json")
    return {
        "name": content["name"],
        "verdict": verdict.verdict,
        "margin": verdict.margin,
        "margin_meaning": verdict.margin_meaning,
        "spread": design.spread,
        "choices": {choice.label: {"value": choice.value, "reason": choice.reason} for choice in design.choices},
        "law": content["law"],
        "estimator": content["estimator"],
        "torque_noise": {name: {"rms": rms, "share": share} for name, rms, share in _noise(design)},
        "error_over_optimum": [_finite_or_none(distance.ratio) for distance in design.optimum_distances],
        "predicted_rms_error": _finite_or_none(predicted),
        "trial": {
            "status": trial.status,
            "rms_error": _finite_or_none(trial.rms_error),
            "torque_noise": [_finite_or_none(noise) for noise in trial.torque_noise],
            "saturation_share": trial.saturation_share,
            "torque_rate": [_finite_or_none(rate) for rate in trial.torque_rate],
        },
        "stress_limits": {
            name: {"value": limit.value, "unit": limit.unit, "explanation": limit.explain()}
            for name, limit in limits.items()
        },
        "files": [str(file) for file in files],
    }


def _noise(design: Design) -> list[tuple[str, float, float | None]]:
    """Return each joint, its predicted RMS torque noise, and that over its limit, None where it has none."""
    torque_limits = np.inf if design.law.torque_limit is None else np.asarray(design.law.torque_limit, dtype=float)
    shares = [float(share) or None for share in design.torque_noise / torque_limits]
    return list(zip(design.plants[0].joint_names, design.torque_noise.tolist(), shares, strict=True))


def _finite_or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def print_design(design: Design, trial: StressRun, predicted: float, files: list[Path]) -> None:
    """Print each choice with its reason, the verdict, what is predicted and simulated, and the files."""
    console = Console()
    title = f"{type(design.law).__name__} for {plant_name(design.plants[0])}, {1 / design.law.period:g} Hz"
    table = Table(title=title, title_justify="left", show_lines=True)
    table.add_column("choice", width=17)
    table.add_column("value", max_width=22)
    table.add_column("reason")
    for choice in design.choices:
        style = "yellow" if choice.reason.startswith("WARNING") else None
        table.add_row(*(escape(text) for text in (choice.label, choice.value, choice.reason)), style=style)
    console.print(table)
    verdict = design.certificates["robot"]
    console.print(f"[{VERDICT_COLOURS[verdict.verdict]}]{verdict.verdict}[/]: {escape(verdict.claim)}", highlight=False)
    console.print(f"margin {verdict.margin:.3g}, {escape(verdict.margin_meaning)}", highlight=False)
    plant = design.plants[0]
    steps = np.broadcast_to(design.sensor.step_size, (plant.n_joints,))
    texts = [f"{1e3 * step:.3g} m{unit}" for step, unit in zip(steps, plant.units, strict=True)]
    by_joint = ", ".join(f"{escape(name)} {text}" for name, text in zip(plant.joint_names, texts, strict=True))
    text = f"{texts[0]} on every joint" if len(set(texts)) == 1 else by_joint
    console.print(f"step of the encoders: {text}", highlight=False)
    noise = [
        f"{escape(name)} {rms:.3g} {unit}" + ("" if share is None else f" ({100 * share:.2g} %)")
        for (name, rms, share), unit in zip(_noise(design), design.plants[0].torque_units, strict=True)
    ]
    console.print(f"predicted torque noise, RMS (of the limit): {', '.join(noise)}", highlight=False)
    changes = design.torque_change / design.law.torque_limits
    loudest = float(np.max(changes, initial=0.0))
    if loudest > 0:
        name = escape(plant.joint_names[int(np.argmax(changes))])
        console.print(f"its change per period: {100 * loudest:.2g} % of the limit, RMS, at {name}", highlight=False)
    _print_distance(console, design)
    _print_trial(console, design, trial, predicted)
    quietest = 0.0 if design.law.has_model else design.front[0].change  # with a model only what is chosen is proven
    least = loudest * quietest / design.candidate.change
    if design.noise_budget is not None and loudest > 1.0001 * design.noise_budget >= 1.0001 * least:
        console.print(
            f"[yellow]noise changes the torque by more than {100 * design.noise_budget:.3g} % per period: the error "
            f"falls faster than the square of that; --noise-budget {design.noise_budget:g} keeps to it[/]",
            highlight=False,
        )
    elif design.noise_budget is not None and loudest > 1.0001 * design.noise_budget:
        console.print(
            f"[yellow]noise changes the torque by more than {100 * design.noise_budget:.3g} % per period: no certified "
            f"loop has less. An encoder with {math.ceil(math.log2(loudest / design.noise_budget))} more bits keeps to "
            "it; more rotor inertia, less payload or a smaller joint range lower the noise[/]",
            highlight=False,
        )
    print_written(console, files)


def _print_distance(console: Console, design: Design) -> None:
    """Print how far the loop is from the best linear controller."""

    def span(values: list[float]) -> str:
        return f"{min(values):.3g} to {max(values):.3g}" if min(values) < max(values) else f"{min(values):.3g}"

    distances = design.optimum_distances
    console.print(
        f"over the best linear controller for one inertia: {span([distance.ratio for distance in distances])} of its "
        f"error at the same torque variation, or {span([distance.change_ratio for distance in distances])} of its "
        "torque "
        "variation at the same error; with a random walk of torque that adds as much error as the encoders",
        highlight=False,
    )


def _print_trial(console: Console, design: Design, trial: StressRun, predicted: float) -> None:
    """Print what the simulation of the design's own scenario shows, and where it is not as predicted."""
    plant = design.plants[0]
    unit = unit_for_joints("mrad", plant.units)
    console.print(f"predicted RMS error for the motion of the file: {1e3 * predicted:.3g} {unit}", highlight=False)
    if not np.isfinite(trial.rms_error):
        console.print(f"[red]tried in simulation: {escape(trial.status)}[/], which is not as predicted")
        return
    joint = int(np.argmax(trial.torque_noise / design.torque_noise))
    excess = trial.torque_noise[joint] / design.torque_noise[joint]
    console.print(
        f"tried in simulation: {escape(trial.status)}, RMS error {1e3 * trial.rms_error:.3g} {unit}, torque noise at "
        f"most {excess:.2g} of the predicted one",
        highlight=False,
    )
    fastest = int(np.argmax(trial.torque_rate))
    console.print(
        f"torque rate reached: {trial.torque_rate[fastest]:.4g} {plant.torque_units[fastest]}/s, at "
        f"{escape(plant.joint_names[fastest])}",
        highlight=False,
    )
    if not trial.rms_error <= MAX_EXCESS * predicted:
        console.print("[yellow]the error is above twice the predicted one[/]", highlight=False)
    if trial.saturation_share > 0:
        console.print(
            f"[yellow]this motion needs more than the torque limits in {trial.saturation_share:.2%} of the samples, "
            "which the certificate does not cover: drive it slower, with less payload, or about another posture[/]",
            highlight=False,
        )
    if excess > MAX_EXCESS:
        console.print(
            f"[yellow]the torque noise of {escape(plant.joint_names[joint])} is above twice the predicted one[/]",
            highlight=False,
        )


def print_comparison(designs: dict[str, tuple[Design, StressRun, float] | str]) -> None:
    """Print what a model buys: designs by what the law knows, each with its trial and predicted error, or the reason.

    Each design is on the motion of its own file.
    """
    console = Console()
    table = Table(title="What the model buys", title_justify="left")
    heads = "certified natural frequency [rad/s]", "predicted RMS error [mrad]", "simulated", "torque variation [N m/s]"
    for head in ("model", *heads):
        table.add_column(head, justify="left" if head == "model" else "right")
    for name, result in designs.items():
        if isinstance(result, str):
            table.add_row(name, "none", "–", "–", "–")
            continue
        design, trial, predicted = result
        frequency = f"{design.candidate.natural_frequency:.3g}"
        table.add_row(name, frequency, *(f"{value:.3g}" for value in _comparable(trial, predicted)))
    console.print(table)
    for name, result in designs.items():
        if isinstance(result, str):
            console.print(f"{name}: {escape(result)}", highlight=False)


def _comparable(trial: StressRun, predicted: float) -> tuple[float, float, float]:
    """Return predicted and simulated RMS error [mrad] and the torque variation [N m/s]."""
    return 1e3 * predicted, 1e3 * trial.rms_error, trial.torque_variation


def comparison_summary(designs: dict[str, tuple[Design, StressRun, float] | str]) -> dict[str, Any]:
    """Return what a model buys as plain data, ready for JSON."""
    return {
        name: {"reason": result}
        if isinstance(result, str)
        else {
            "natural_frequency": result[0].candidate.natural_frequency,
            "predicted_rms_error": _finite_or_none(result[2]),
            "rms_error": _finite_or_none(result[1].rms_error),
            "torque_variation": _finite_or_none(result[1].torque_variation),
        }
        for name, result in designs.items()
    }


def print_limits(limits: dict[str, StressLimit]) -> None:
    """Print the limits of a design, one line per quantity."""
    console = Console()
    console.print("\nlimits of each quantity by itself, with the gains unchanged:")
    for limit in limits.values():
        console.print(escape(limit.explain()), highlight=False)
