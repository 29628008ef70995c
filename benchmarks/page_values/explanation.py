"""Values of the pages on laws and estimators."""

import re
import shutil

import numpy as np

from benchmarks.page_values.registry import NO_VALUE, ROOT, Value, run_page, source, table

CHAOTIC = 0.1
"""RMS error [rad] from which a run of the page on laws is chaotic, so that one digit is given."""


@source
def laws() -> dict[str, Value]:
    """Tables of the page on laws, from its own code."""
    page = run_page("explanation/laws.md")
    law, interval = page.names["law"], page.names["interval"]
    stable, slow = interval(law(10, False, 20.0)), interval(law(10, False, 10.0))
    return {
        "intervals": _intervals(law, interval),
        "ranges": _ranges(page.columns(r"^(along the path|with 5 kg|in any posture) +(\S+) to (\S+)$"), stable),
        "robust_term": _robust_term(page.printed),
        "slopes": _slopes(page.columns(r"^(\S+) (\S+) frozen (\S+), circle (\S+)$")),
        "low_20": stable[0],
        "high_20": stable[1],
        "low_10": slow[0],
        "high_10": slow[1],
    }


def _intervals(law, interval) -> str:
    loops = [(False, 2), (False, 10), (False, 20), *((True, periods) for periods in (10, 20, 50, 100, 200))]
    rows = []
    for synchronised, periods in loops:
        low, high = interval(law(periods, synchronised))
        kind = "synchronised" if synchronised else "literal"
        rows.append((kind, f"{periods}", f"{low:.3g} – {high:.3g}"))
    return table(["time-delay estimation", "N", "stable ratio"], rows)


def _ranges(found: list[tuple[str, ...]], stable: tuple[float, float]) -> str:
    labels = {
        "along the path": "along the path",
        "with 5 kg": "along the path, 5 kg at the tool",
        "in any posture": "in any posture",
    }
    rows = [(labels[name], f"{low} – {high}") for name, low, high in found]
    rows.append(("stable at the demo's 20 rad/s", f"{stable[0]:.4f} – {stable[1]:.4f}"))
    return table(["", "ratio"], rows)


def _robust_term(printed: str) -> str:
    line = re.compile(r"^(TDC|\S+=.*?\S) {2,}(\S+) +(\S+) +(\S+) (completed|diverged at \S+ s)", re.MULTILINE)
    rows = []
    for label, *numbers, status in line.findall(printed):
        chaotic = float(numbers[0]) > CHAOTIC
        scaled = [1e3 * float(numbers[0]), float(numbers[1]), float(numbers[2])]
        cells = [_cell(value, chaotic) for value in scaled]
        shown = re.sub(r"\d+\.\d+", lambda time: f"{float(time[0]):.1f}", status)
        rows.append((label.replace("=", " "), *cells, shown))
    return table(["law", "RMS error", "peak gain", "torque variation", "status"], rows)


def _cell(value: float, chaotic: bool) -> str:
    if np.isnan(value):
        return NO_VALUE
    if chaotic:
        return f"≈ {grouped(float(f'{value:.1g}'))}"
    return f"{value:.4g}"


def _slopes(found: list[tuple[str, ...]]) -> str:
    ratios = list(dict.fromkeys(ratio for _, ratio, *_ in found))
    rows = []
    for frequency in dict.fromkeys(row[0] for row in found):
        for name, place in (("frozen", 2), ("circle criterion", 3)):
            cells = [grouped(float(row[place]), 5) for row in found if row[0] == frequency]
            rows.append((f"{frequency}, {name}", *cells))
    return table(["natural frequency", f"ratio {ratios[0]}", *ratios[1:]], rows)


@source
def estimators() -> dict[str, Value]:
    """Tables of the page on estimators, from its own code."""
    page = run_page("explanation/estimators.md")
    rows = []
    for name, estimator in page.names["estimators"].items():
        timed = estimator.with_period(1e-3)
        cells = []
        for order in (1, 2):
            if order > timed.max_derivative:
                cells += [NO_VALUE, NO_VALUE]
                continue
            delay, noise = 1e3 * abs(timed.group_delay(order)), timed.noise_gain(order)
            cells += [f"{round(delay, 2):g} ms", grouped(noise)]
        rows.append((name, *cells))
    heads = ["estimator", "delay of velocity", "noise gain [1/s]", "delay of acceleration", "noise gain [1/s²]"]
    values: dict[str, Value] = {"delays": table(heads, rows)}
    for periods, difference in page.columns(r"^(10|50|200) (0\.\d+)$"):
        values[f"kernel_{periods}"] = float(difference)
    noise_lines = page.columns(r"^(?:Algebraic|BackwardDifference).* \S+e-05 (\S+e-05) (\S+)$")
    for name, (noise, acceleration) in zip(("window", "difference"), noise_lines, strict=True):
        values[f"noise_{name}"], values[f"acceleration_{name}"] = 1e6 * float(noise), float(acceleration)
    for name, (error,) in zip(
        ("window", "truth", "truth_exact"), page.columns(r"^(?:Algebraic|TrueDerivatives) \S+ (\S+)$"), strict=True
    ):
        values[f"tde_error_{name}"] = float(error)
    return values


def grouped(value: float, digits: int = 4) -> str:
    """Return a number with significant digits, in groups of three from 10 000 on."""
    rounded = float(f"{value:.{digits}g}")
    return f"{rounded:,.0f}".replace(",", "\N{NO-BREAK SPACE}") if rounded >= 1e4 else f"{rounded:g}"


@source
def optimum_design() -> dict[str, Value]:
    """Distance of the design on the page about the optimum; its figure is kept."""
    page = run_page("explanation/optimum.md")
    shutil.copy(page.folder / "optimum-design.png", ROOT / "docs" / "images" / "optimum-design.png")
    rows = [
        (f"{distance.inertia_ratio:.3g}", f"{distance.ratio:.3g}", f"{distance.change_ratio:.2g}")
        for distance in page.names["design"].optimum_distances
    ]
    heads = ["inertia ratio", "error over the least", "torque variation over the least"]
    return {"distances": table(heads, rows)}
