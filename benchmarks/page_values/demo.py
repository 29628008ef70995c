"""Values of the demo, its scenario ``ur5e`` and its variants."""

import json

from benchmarks.page_values.registry import Value, command, flat, metrics, source, table, text_block

VARIANTS = {
    "synchronised": ("law.synchronised=true", "law.inertia.fraction=0.5"),
    "small_inertia": ("law.inertia.fraction=0.02",),
    "fast_tdc": ("law.1.natural_frequency=30",),
    "stiff_tdc": ("law.1.natural_frequency=null", "law.1.position_gain=827", "law.1.velocity_gain=40"),
    "fast": ("law.natural_frequency=30",),
    "large_limit": ("law.0.max_gain=12",),
    "no_limit": ("law.0.max_gain=null",),
    "certified": ("estimator.window=0.005", "law.synchronised=true", "law.inertia.fraction=0.6"),
}


@source
def demo() -> dict[str, Value]:
    """Metrics of ``ur5e``, tables of the demo, and JSON in short."""
    runs = json.loads(command("tarc demo --no-figures --json"))["runs"]
    results = [run["metrics"] for run in runs.values()]
    rows = [
        ("RMS error", *(f"{1e3 * result['rms_error']:.2f} mrad" for result in results)),
        ("torque variation", *(f"{result['torque_variation']:.1f} N m/s" for result in results)),
        ("on the robot, with the load and without", *(run["verdict"] for run in runs.values())),
    ]
    return flat(metrics("ur5e")) | {
        "summary": table(["", *runs], rows),
        "table": text_block(command("tarc demo --no-figures")),
        "json": short_json(command("tarc run ur5e --set duration=2 --no-figures --json")),
    }


def short_json(text: str) -> str:
    """Return the JSON of a run with three metrics of the first law, rounded."""
    results = json.loads(text)
    laws = results["runs"]
    first, second = laws
    measured = {name: float(f"{value:.6g}") for name, value in list(laws[first]["metrics"].items())[:3]}
    laws[first]["metrics"] = measured | {"...": "..."}
    laws[second] = "{...}"
    results["files"] = [file.replace(file.split("runs/")[0], "") for file in results["files"]]
    short = json.dumps(results, indent=2, ensure_ascii=False)
    short = short.replace('"...": "..."', "...").replace('"{...}"', "{...}")
    return text_block(short)


@source
def demo_variants() -> dict[str, Value]:
    """Metrics of the demo with other gains."""
    found = {name: metrics("ur5e", *settings) for name, settings in VARIANTS.items()}
    values: dict[str, Value] = {}
    for name, measured in found.items():
        values |= flat(measured, f"{name}.")
    shown = {
        "TARC, 20 rad/s": metrics("ur5e")["TARC"],
        "TDC, 20 rad/s": metrics("ur5e")["TDC"],
        "TDC, 30 rad/s": found["fast_tdc"]["TDC"],
        "TDC, K1 = 827, K2 = 40": found["stiff_tdc"]["TDC"],
        "TARC, 30 rad/s": found["fast"]["TARC"],
    }
    heads = ["law", "RMS error [mrad]", "peak error [mrad]", "torque variation [N m/s]"]
    keys = ("rms_error", "peak_error", "torque_variation")
    rows = [
        (label, *(f"{scale * law[key]:.4g}" for key, scale in zip(keys, (1e3, 1e3, 1.0), strict=True)))
        for label, law in shown.items()
    ]
    return values | {"natural_frequencies": table(heads, rows), "max_gains": _max_gains(found)}


def _max_gains(found: dict[str, dict[str, dict[str, float]]]) -> str:
    """Return the errors over the largest gain; without one the run is chaotic, so that one digit is given."""
    tdc = f"{1e3 * metrics('ur5e')['TDC']['rms_error']:.4g}"
    unbounded = 1e3 * found["no_limit"]["TARC"]["rms_error"]
    rows = [
        ("6.4, `ur5e`", f"{1e3 * metrics('ur5e')['TARC']['rms_error']:.4g}", tdc),
        ("12", f"{1e3 * found['large_limit']['TARC']['rms_error']:.4g}", tdc),
        ("none", f"≈ {float(f'{unbounded:.1g}'):g}", tdc),
    ]
    return table(["largest gain [rad/s²]", "TARC, RMS error [mrad]", "TDC, RMS error [mrad]"], rows)
