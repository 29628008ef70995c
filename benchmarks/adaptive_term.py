"""What TARC's adaptive term adds once M̂(q) is known: ``python -m benchmarks.adaptive_term``.

The demo's UR5e, 17 bits, with friction and loads other than those of the design. All laws have M̂(q) of the robot file
and 70 % of its dry friction. The largest gain follows from a slope that is certified for the moving robot. Another one,
for comparison, is what the circle criterion admits at every constant inertia ratio. Parameters are those with the least
error as designed that keep to the torque variation of TDC at 40 rad/s. Each result is compared with TDC at the same
torque variation, between its natural frequencies.
"""

import argparse
import json
import math
from collections.abc import Iterable
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from benchmarks.pages import round_ticks
from tarc import NominalInertia, Run, Scenario
from tarc.analysis import Workspace
from tarc.certificates import certify_known_inertia, certify_sector
from tarc.estimators import Algebraic
from tarc.laws import TARC, TDC
from tarc.plants import load_robot
from tarc.plotting.style import COLOURS, StyledFigure

FRACTION = 0.08
WINDOW = 0.014
PERIOD = 1e-3
LEAST_RATIO = 0.35
"""Least inertia ratio over ρ, with 5 kg that the model lacks."""
RATIOS = FRACTION * np.linspace(LEAST_RATIO, 1.0, 14)
CERTIFIED_SLOPES = {25.0: 400.0, 30.0: 300.0, 35.0: 250.0, 40.0: 200.0}
"""Slopes [1/s²] by natural frequency, whose `verdicts` are those of the robot without load and with the design's."""
FREQUENCIES_OF_TDC = (25.0, 27.5, 30.0, 32.5, 35.0, 37.5, 40.0, 42.5, 45.0, 50.0)
LAYERS = (0.0005, 0.002)
"""Boundary layers [rad]."""
REFERENCE = 40.0
"""Natural frequency [rad/s] of the TDC whose torque variation none may exceed."""
TOLERANCE = 1.02
CHANGE = 4.0
"""Time [s] of the change; errors are measured from then on."""
DURATION = 10.0
DESIGN = "as designed: 5 kg"

SCHEDULE = "ParameterSchedule"
CASES: dict[str, list[dict[str, Any]]] = {
    DESIGN: [{"kind": "Payload", "mass": 5.0, "start_time": CHANGE}],
    "no load": [],
    "10 kg, twice the design's load": [{"kind": "Payload", "mass": 10.0, "start_time": CHANGE}],
    "dry friction 2 to 4 N m": [{"kind": SCHEDULE, "parameter": "coulomb", "times": [CHANGE], "values": [4.0]}],
    "dry friction 2 to 1 N m": [{"kind": SCHEDULE, "parameter": "coulomb", "times": [CHANGE], "values": [1.0]}],
    "viscous friction 1 to 5 N m s/rad": [
        {"kind": SCHEDULE, "parameter": "viscous", "times": [CHANGE], "values": [5.0]}
    ],
    "wear: dry friction from 2 to 6 N m": [
        {
            "kind": SCHEDULE,
            "parameter": "coulomb",
            "times": [0.0, DURATION],
            "values": [2.0, 6.0],
            "interpolate": True,
        }
    ],
}
"""Changes of the robot that no law knows of."""

KINDS = ("TDC", "TARC, difference", "TARC, window", "constant gain", "TARC, window, uncertified slope")


class Result(NamedTuple):
    """RMS error [rad] and torque variation [N m/s] after the change, and the mean gain [rad/s²]."""

    error: float
    variation: float
    gain: float


def known_laws() -> dict[float, TARC]:
    """Return TARC with M̂(q) and the certified slope, by natural frequency."""
    model = load_robot("ur5e", armature=0.1)
    layer = LAYERS[0]
    return {
        frequency: TARC(
            inertia=NominalInertia(model, FRACTION),
            natural_frequency=frequency,
            period=PERIOD,
            estimator=Algebraic(window=WINDOW),
            boundary_layer=layer,
            max_gain=slope * layer,
            min_gain=slope * layer / 100,
            fall_rate=slope * frequency,
            rise_rate=3 * slope * frequency,
        )
        for frequency, slope in CERTIFIED_SLOPES.items()
    }


def verdicts() -> dict[float, str]:
    """Return the verdict on each certified slope, along the reference at its speeds."""
    demo = Scenario.load("ur5e_model")
    reference = demo.build_reference(demo.build_plant())
    _, velocities, _ = reference.sample(np.arange(0.0, demo.duration, 0.001))
    workspace = Workspace.from_reference(reference, demo.duration, speed=np.abs(velocities).max(axis=1))
    robots = [load_robot("ur5e", armature=0.1, payload=mass) for mass in (0.0, 5.0)]
    return {
        frequency: str(certify_known_inertia(law, robots, workspace, samples=200).verdict)
        for frequency, law in known_laws().items()
    }


def slope_bound(natural_frequency: float) -> float:
    """Return the largest slope [1/s²] that the circle criterion admits at every inertia ratio of the robot."""
    loop = TDC(
        inertia=1.0,
        natural_frequency=natural_frequency,
        period=PERIOD,
        estimator=Algebraic(window=WINDOW),
    )
    return min(certify_sector(loop, float(ratio)).evidence.circle_limit for ratio in RATIOS)


def laws() -> dict[str, dict[str, Any]]:
    """Return all laws as a scenario writes them, by a label that begins with their kind."""
    known = {
        "estimator": {"kind": "Algebraic", "window": WINDOW},
        "inertia": {
            "model": {"coulomb": 1.4, "payload": 0.0},
            "fraction": FRACTION,
            "friction": True,
            "friction_width": 0.05,
        },
    }
    found = {
        f"TDC; {frequency:g} rad/s": {"kind": "TDC", "natural_frequency": frequency, **known}
        for frequency in FREQUENCIES_OF_TDC
    }
    for frequency, certified in CERTIFIED_SLOPES.items():
        common = {"natural_frequency": frequency, **known}
        slopes = {"": certified, ", uncertified slope": slope_bound(frequency)}
        for (suffix, slope), layer in product(slopes.items(), LAYERS):
            highest = float(f"{0.999 * slope * layer:.4g}")
            gain = {"boundary_layer": layer, "max_gain": highest, "min_gain": highest / 100}
            rates = {"fall_rate": slope * frequency, "rise_rate": 3 * slope * frequency}
            place = f"{frequency:g} rad/s, ε = {1e3 * layer:g} mrad"
            for growth in ("difference", "window"):
                label = f"TARC, {growth}{suffix}"
                if label in KINDS:
                    found[f"{label}; {place}"] = {"kind": "TARC", **common, **gain, **rates, "growth": growth}
            if not suffix:
                still = {"min_gain": 0.99 * highest, "initial_gain": highest, "rise_rate": 1e-6, "fall_rate": 1e-6}
                found[f"constant gain; {place}"] = {"kind": "TARC", **common, **gain, **still}
    return found


def measured(run: Run) -> Result | None:
    """Return the result of a run; None where it did not complete, or where the loop is unstable at rest."""
    if not run.status.completed or run.instability:
        return None
    measures = run.metrics(start_time=CHANGE)
    return Result(measures["rms_error"], measures["torque_variation"], measures.get("mean_gain", math.nan))


def run_all(names: Iterable[str] = CASES) -> dict[str, dict[str, Result]]:
    """Return the results by case and law."""
    content = Scenario.load("ur5e_model").model_dump()
    parts = [{"label": label, **law} for label, law in laws().items()]
    results = {}
    for name in names:
        changes = {"law": parts, "disturbance": CASES[name], "duration": DURATION}
        runs = Scenario.parse({**content, **changes}).run(progress=False)
        found = {label: measured(run) for label, run in runs.items()}
        results[name] = {label: result for label, result in found.items() if result}
    return results


def best(results: dict[str, Result], kind: str, limit: float) -> str:
    """Return the label of the law of a kind with the least error whose torque variation keeps to a limit."""
    fitting = {
        label: result for label, result in results.items() if label.startswith(f"{kind};") and result.variation <= limit
    }
    return min(fitting, key=lambda label: fitting[label].error)


def limit(results: dict[str, Result]) -> float:
    """Return the torque variation that laws may have [N m/s]: that of the reference TDC and a tolerance."""
    return TOLERANCE * results[f"TDC; {REFERENCE:g} rad/s"].variation


def chosen(results: dict[str, dict[str, Result]]) -> dict[str, str]:
    """Return the law of each kind that is best as designed."""
    designed = results[DESIGN]
    return {kind: best(designed, kind, limit(designed)) for kind in KINDS}


def over_tdc(results: dict[str, Result], label: str) -> float:
    """Return the error of a law over that of TDC at the same torque variation; NaN beyond all of TDC's.

    Between the natural frequencies the logarithm of TDC's least error is linear in that of the torque variation.
    """
    points = sorted((one.variation, one.error) for name, one in results.items() if name.startswith("TDC;"))
    variations = [variation for variation, _ in points]
    errors = np.minimum.accumulate([error for _, error in points])
    own = results[label]
    if not variations[0] <= own.variation <= variations[-1]:
        return math.nan
    return own.error / float(np.exp(np.interp(math.log(own.variation), np.log(variations), np.log(errors))))


def hindsight(results: dict[str, Result], kind: str) -> float:
    """Return the least error of a kind over that of TDC at the same torque variation, gains chosen for this case."""
    most = limit(results)
    ratios = [
        over_tdc(results, label)
        for label, one in results.items()
        if label.startswith(f"{kind};") and one.variation <= most
    ]
    return float(np.nanmin(ratios))


def rows(results: dict[str, dict[str, Result]]) -> list[list[str]]:
    """Return a row per case: error [mrad], torque variation [N m/s] and the ratio to TDC, for the gains of the design.

    The last cell has the ratios for gains that were chosen for the case.
    """
    names = chosen(results)
    lines = []
    for case, found in results.items():
        cells = []
        for kind, label in names.items():
            ratio = over_tdc(found, label)
            compared = "" if kind == "TDC" else f", {NO_VALUE if math.isnan(ratio) else f'{ratio:.2f}'}"
            cells.append(f"{1e3 * found[label].error:.3f}, {found[label].variation:.0f}{compared}")
        lines.append([case, *cells, ", ".join(f"{hindsight(found, kind):.2f}" for kind in KINDS[1:])])
    return lines


NO_VALUE = "–"
HEADS = ["robot", *(f"{kind}: mrad, N m/s{'' if kind == 'TDC' else ', over TDC'}" for kind in KINDS), "in hindsight"]


def figure(results: dict[str, dict[str, Result]]) -> Figure:
    """Draw error against torque variation of every law in four cases."""
    shown = [case for case in results if not case.startswith(("no load", "dry friction 2 to 1", "viscous"))]
    canvas = StyledFigure(figsize=(7.6, 6.4), layout="constrained")
    names = chosen(results)
    for axes, case in zip(canvas.subplots(2, 2).flat, shown, strict=True):
        for kind, colour in zip(KINDS, COLOURS, strict=False):
            points = [
                (result.variation, 1e3 * result.error, label == names[kind])
                for label, result in results[case].items()
                if label.startswith(f"{kind};")
            ]
            variation, error, is_chosen = zip(*points, strict=True)
            sizes = [70.0 if choice else 16.0 for choice in is_chosen]
            axes.scatter(variation, error, s=sizes, color=colour, label=kind, alpha=0.85, linewidths=0)
        axes.axvline(limit(results[case]), color="0.5", lw=0.8, ls=":")
        axes.set_title(case, fontsize="small")
        axes.set(xscale="log", yscale="log")
        axes.set_xlabel("torque variation [N m/s]", fontsize="small")
        axes.set_ylabel("RMS error [mrad]", fontsize="small")
        axes.tick_params(which="both", labelsize="x-small")
        round_ticks(axes.xaxis)
        round_ticks(axes.yaxis)
        axes.grid(alpha=0.3)
    handles, labels = canvas.axes[0].get_legend_handles_labels()
    canvas.legend(handles, labels, loc="outside upper center", ncols=3, fontsize="small", frameon=False)
    return canvas


def save(results: dict[str, dict[str, Result]], folder: Path) -> None:
    """Write the results as JSON into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "results.json").write_text(json.dumps(results), encoding="utf-8")


def main() -> None:
    """Run, print and write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("runs/adaptive_term"))
    options = parser.parse_args()
    results = run_all()
    save(results, options.out)
    for kind, label in chosen(results).items():
        print(f"{kind}: {label}")
    for row in rows(results):
        print(" | ".join(row))
    figure(results).savefig(options.out / "fronts.png", dpi=110)


if __name__ == "__main__":
    main()
