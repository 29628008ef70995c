"""Values of the page on laws with a model and without one, on the demo's robot and motion."""

from typing import Any

from benchmarks.page_values.registry import Value, metrics, source, table
from tarc import NominalInertia, Scenario
from tarc.analysis import Workspace
from tarc.certificates import certify_known_inertia
from tarc.estimators import Algebraic
from tarc.laws import TDC
from tarc.plants import load_robot

ROBOT = {"payload": 0.0, "coulomb": 0.0, "viscous": 0.0}
"""What the models leave out."""


def law(
    window: int, natural_frequency: float, fraction: float, *, model: dict[str, float] | None = None, **more: Any
) -> dict[str, Any]:
    """Return TDC in a scenario's terms, with a constant M̂ or with M̂(q) of a model."""
    inertia: dict[str, Any] = {"fraction": fraction}
    if model is not None:
        inertia["model"] = {**ROBOT, **model}
    if model:
        inertia |= {"friction": True, "friction_width": 0.05}
    estimator = {"kind": "Algebraic", "window": window * 1e-3}
    return {
        "kind": "TDC",
        "natural_frequency": natural_frequency,
        "inertia": inertia,
        "estimator": estimator,
        **more,
    }


def measured(laws: dict[str, dict[str, Any]], **changes: Any) -> dict[str, dict[str, float]]:
    """Return the metrics of laws in the demo, by label."""
    demo = Scenario.load("ur5e").model_dump()
    content = {**demo, "law": [{"label": label, **part} for label, part in laws.items()], **changes}
    scenario = Scenario.parse(content)
    runs = scenario.run(progress=False)
    return {label: run.metrics(start_time=scenario.metrics_start) for label, run in runs.items()}


def rows(results: dict[str, dict[str, float]]) -> list[tuple[str, str, str]]:
    """Return label, RMS error [mrad] and torque variation [N m/s]."""
    return [
        (label, f"{1e3 * part['rms_error']:.3g}", f"{part['torque_variation']:.0f}") for label, part in results.items()
    ]


def certified_frequency() -> float:
    """Return the largest natural frequency [rad/s] certified of a UR5e in any posture at 1 rad/s, up to 100."""
    model = load_robot("ur5e", armature=0.1)
    robots = [load_robot("ur5e", armature=armature, payload=mass) for armature in (0.08, 0.12) for mass in (0.0, 5.0)]
    workspace = Workspace.from_joint_limits(model).with_speed_limits(1.0)
    for frequency in (100.0, 80.0, 60.0, 40.0):
        synchronised = TDC(
            inertia=NominalInertia(model, 0.8),
            natural_frequency=frequency,
            period=1e-3,
            synchronised=True,
            estimator=Algebraic(window=0.006),
        )
        if certify_known_inertia(synchronised, robots, workspace, samples=500).certified:
            return frequency
    return 0.0


@source
def known_model() -> dict[str, Value]:
    """Errors and torque variation with more and more knowledge of the robot."""
    heads = ["law", "RMS error [mrad]", "torque variation [N m/s]"]
    forward = {"model": {**ROBOT, "coulomb": 1.4, "viscous": 1.0}, "friction_width": 0.05}
    laws = {
        "constant M̂, 20 rad/s": law(10, 20.0, 0.08),
        "constant M̂, 30 rad/s": law(10, 30.0, 0.08),
        "M̂(q), 40 rad/s": law(14, 40.0, 0.08, model={}),
        "M̂(q), 60 rad/s": law(10, 60.0, 0.08, model={}),
        "constant M̂, 20 rad/s, feed-forward": law(10, 20.0, 0.08, feedforward=forward),
        "M̂(q), 40 rad/s, 1.4 N m of dry friction known": law(14, 40.0, 0.08, model={"coulomb": 1.4}),
        "M̂(q), 40 rad/s, 2.0 N m of dry friction known": law(14, 40.0, 0.08, model={"coulomb": 2.0}),
    }
    results = measured(laws)
    loops = {
        "constant M̂, 20 rad/s": law(10, 20.0, 0.08),
        "M̂(q), 40 rad/s": law(14, 40.0, 0.08, model={}),
        "M̂(q), 30 rad/s, window of 24 ms": law(24, 30.0, 0.04, model={}),
    }
    exact = {"model": True, "friction_width": 0.01}
    windows = []
    for label, part in loops.items():
        variants = {
            "none": part,
            "true": {**part, "feedforward": {**exact, "same_window": False}},
            "same": {**part, "feedforward": exact},
        }
        found = measured(variants, disturbance=[], duration=10.0)
        windows.append((label, *(f"{1e3 * found[name]['rms_error']:.3g}" for name in variants)))
    constant, known = (results[label] for label in ("constant M̂, 20 rad/s", "M̂(q), 40 rad/s"))
    return {
        "laws": table(heads, rows(results)),
        "same_window": table(
            ["law", "no feed-forward", "with the true derivatives of the reference", "with those of the window"],
            windows,
        ),
        "ratio": constant["rms_error"] / known["rms_error"],
        "certified_frequency": certified_frequency(),
        "demo_error": 1e3 * metrics("ur5e_model")["with a model"]["rms_error"],
        "demo_variation": metrics("ur5e_model")["with a model"]["torque_variation"],
    }
