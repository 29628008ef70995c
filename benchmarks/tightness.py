"""How much of what is stable the certificates certify: ``python -m benchmarks.tightness [--markdown] [--figure PATH]``.

A sufficient condition that is sound can still be useless. Two are compared with what is exact. The varying-ratio
certificate is compared with the range of constant ratios. The conditions on the nominal loop, the
paper's first theorem and its second one repaired, are compared with the roots of the delay equations.

The share of the ball shows the cost of a varying mismatch more than the conservatism of the test. With two joints or
more, a rotating mismatch destabilises just outside the ball.
"""

import argparse
import time
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from tarc import estimators, laws
from tarc.analysis import stable_interval
from tarc.certificates import certify_varying_ratio
from tarc.core.errors import NoStableRatio
from tarc.core.progress import Progress
from tarc.paper import nominal_max_window, theorem1_max_delay

PERIOD = 1e-3
WINDOWS = (2, 5, 10, 20, 50)
BANDWIDTHS = (5.0, 10.0, 20.0, 40.0)
DEGREES = (2, 3)
DELAYS = (0.01, 0.05, 0.1, 0.2)
"""Over the natural frequency."""


class Balls(NamedTuple):
    """Of one design: its stable range, its widest ball, and the share of the one that the other is."""

    stable: tuple[float, float]
    ball: tuple[float, float]

    @property
    def share(self) -> float:
        """In logarithms, as a ratio of inertias is what a robot spreads over."""
        return float(np.log(self.ball[1] / self.ball[0]) / np.log(self.stable[1] / self.stable[0]))


def law(
    window: float, degree: int = 2, natural_frequency: float = 10.0, period: float = PERIOD, **options: Any
) -> laws.TDC:
    """TDC of one joint with a window [s]."""
    estimator = estimators.Algebraic(window=window, degree=degree)
    return laws.TDC(inertia=0.1, natural_frequency=natural_frequency, period=period, estimator=estimator, **options)


def balls(synchronised: bool, window: int, natural_frequency: float) -> Balls | None:
    """Return the widest ball of a design whose mismatch changes at any time; None where no ratio is stable."""
    design = law(window * PERIOD, natural_frequency=natural_frequency, synchronised=synchronised)
    try:
        stable, found = stable_interval(design), certify_varying_ratio(design)
    except NoStableRatio:
        return None
    return Balls(stable, (found.evidence.min_ratio, found.evidence.max_ratio)) if found.certified else None


def exact_window(delay: float, degree: int) -> float:
    """Return the shortest window ς at which s² + e^{−sh}(1 + 2 ∫Ω_1(ψ)e^{sψ}dψ) has a root on the imaginary axis.

    At damping and natural frequency one. Crossings are followed from a scan of the frequencies in which the loop
    gain is one.
    """
    from scipy.optimize import brentq

    nodes, weights = np.polynomial.legendre.leggauss(40)
    power = np.arange(degree + 1)
    # the kernel of that degree on [−1, 0] that takes 1, ψ, ψ² to 0, 1, 0
    moments = (-1.0) ** (power[:, None] + power) / (power[:, None] + power + 1)
    kernel = np.linalg.solve(moments, np.eye(degree + 1)[1])

    def slope(frequency: float, window: float) -> complex:
        psi = (nodes - 1) / 2
        samples = np.polynomial.polynomial.polyval(psi, kernel) * np.exp(1j * frequency * window * psi)
        return complex(samples @ weights / 2 / window)

    def loop(frequency: float, window: float) -> complex:
        """−1 at a root."""
        return (1 + 2 * slope(frequency, window)) * np.exp(-1j * frequency * delay) / (1j * frequency) ** 2

    def room(window: float) -> float:
        """Return the least angle [rad] left before −1 where the loop gain is one; positive where it is stable."""
        frequencies = np.geomspace(0.05, 60.0, 3000)
        size = np.log(np.abs([loop(one, window) for one in frequencies]))
        least = np.inf
        for k in np.flatnonzero(size[:-1] * size[1:] < 0):
            at: Any = brentq(lambda one: np.log(abs(loop(one, window))), frequencies[k], frequencies[k + 1])
            least = min(least, float(np.angle(-loop(float(at), window))))
        return least

    windows = np.geomspace(0.1, 10.0, 40).tolist()
    for one, two in pairwise(windows):
        if room(two) < 0:
            found: Any = brentq(room, one, two, xtol=1e-6)
            return float(found)
    return np.inf


def exact_delay() -> float:
    """Return the delay at which s² + (2s + 1) e^{−sh} has a root on the imaginary axis: 0.6474."""
    frequency = np.sqrt(2 + np.sqrt(5))
    return float(np.arctan(2 * frequency) / frequency)


class Share(NamedTuple):
    """What is certified of what is exact, at a natural frequency of one."""

    certified: float
    exact: float

    @property
    def share(self) -> float:
        return self.certified / self.exact


class Measured(NamedTuple):
    """Everything, by what it was measured for."""

    balls: dict[tuple[bool, int, float], Balls | None]
    windows: dict[tuple[int, float], Share]
    delays: dict[str, Share]


def measure(show: bool | None = None) -> Measured:
    """All of it, in under a minute."""
    wide, windows = {}, {}
    with Progress("tightness", 2 * len(WINDOWS) * len(BANDWIDTHS) + len(DEGREES) * len(DELAYS), show) as progress:
        for synchronised in (False, True):
            for window in WINDOWS:
                for natural_frequency in BANDWIDTHS:
                    wide[synchronised, window, natural_frequency] = balls(synchronised, window, natural_frequency)
                    progress.advance()
        for degree in DEGREES:
            for delay in DELAYS:
                design = law(0.1, degree, 1.0, 0.01)
                windows[degree, delay] = Share(nominal_max_window(design, delay=delay), exact_window(delay, degree))
                progress.advance()
    design = law(0.1, natural_frequency=1.0, period=0.01)
    delays = {
        "Theorem 1": Share(theorem1_max_delay(design), exact_delay()),
        "Theorem 1 without its D⁻¹ term": Share(theorem1_max_delay(design, disturbance_term=False), exact_delay()),
    }
    return Measured(wide, windows, delays)


def tables(found: Measured) -> list[tuple[str, list[str], list[list[str]]]]:
    """Title, heads and rows of each table."""
    kinds = {False: "literal", True: "synchronised"}
    rows = []
    for synchronised, kind in kinds.items():
        for window in WINDOWS:
            cells = [found.balls[synchronised, window, natural_frequency] for natural_frequency in BANDWIDTHS]
            rows.append([kind, f"{window}", *(_cell(one) for one in cells)])
    heads = ["loop", "window [periods]", *(f"ωn = {natural_frequency:g} rad/s" for natural_frequency in BANDWIDTHS)]
    title = "Widest ball over stable range, in logarithms; in brackets greatest over least ratio of the two"
    first = (title, heads, rows)
    rows = [
        [f"{degree}", f"{delay:g}", f"{one.certified:.3f}", f"{one.exact:.3f}", f"{one.share:.0%}"]
        for (degree, delay), one in found.windows.items()
    ]
    second = (
        "Longest window of the nominal loop, over the bandwidth",
        ["Λ", "ωn h", "certified ωn ς", "exact ωn ς", "share"],
        rows,
    )
    rows = [
        [name, f"{one.certified:.4f}", f"{one.exact:.4f}", f"{one.share:.0%}"] for name, one in found.delays.items()
    ]
    third = ("Longest delay without a window", ["condition", "certified ωn h", "exact ωn h", "share"], rows)
    return [first, second, third]


def _cell(one: Balls | None) -> str:
    if one is None:
        return "no ratio is stable"
    return f"{one.share:.0%} ({one.ball[1] / one.ball[0]:.3g} of {one.stable[1] / one.stable[0]:.3g})"


def figure(found: Measured, path: Path) -> None:
    """Shares over the window and over the delay."""

    from tarc.plotting.style import COLOURS, StyledFigure

    drawing = StyledFigure(figsize=(10, 4.2), layout="constrained")
    left, right = drawing.subplots(1, 2, sharey=True)
    for colour, natural_frequency in zip(COLOURS, BANDWIDTHS, strict=False):
        for synchronised, style in ((False, "o-"), (True, "s--")):
            known = [(window, found.balls[synchronised, window, natural_frequency]) for window in WINDOWS]
            points = [(window, one.share) for window, one in known if one is not None]
            label = f"$\\omega_n$ = {natural_frequency:g} rad/s" if not synchronised else None
            left.semilogx(*zip(*points, strict=True), style, color=colour, lw=1.2, ms=4, label=label)
    left.plot([], [], "o-", color="0.4", lw=1.2, ms=4, label="literal")
    left.plot([], [], "s--", color="0.4", lw=1.2, ms=4, label="synchronised")
    left.set_xticks(WINDOWS, [f"{window}" for window in WINDOWS])
    left.minorticks_off()
    left.set_xlabel("window [periods of 1 ms]")
    left.set_ylabel("certified share")
    left.set_title("certified for a varying ratio / stable for a constant one (log)", fontsize="medium")
    for colour, degree in zip(COLOURS, DEGREES, strict=False):
        shares = [found.windows[degree, delay].share for delay in DELAYS]
        right.semilogx(
            DELAYS, shares, "o-", color=colour, lw=1.2, ms=4, label=f"window, repaired Theorem 2, Λ = {degree}"
        )
    names = {"Theorem 1": "delay, Theorem 1", "Theorem 1 without its D⁻¹ term": "the same without its $D^{-1}$ term"}
    for colour, style, (name, label) in zip(COLOURS[2:], (":", "-."), names.items(), strict=False):
        right.axhline(found.delays[name].share, color=colour, ls=style, lw=1.2, label=label)
    right.set_xticks(DELAYS, [f"{delay:g}" for delay in DELAYS])
    right.minorticks_off()
    right.set_xlabel("delay $\\omega_n h$")
    right.set_title("nominal loop: certified / largest stable", fontsize="medium")
    for axes in (left, right):
        axes.set_ylim(0, 1)
        axes.yaxis.set_major_formatter("{x:.0%}")
        axes.grid(alpha=0.3)
        axes.legend(fontsize="small", frameon=False, loc="lower left")
    drawing.savefig(path, dpi=150)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tightness", description=__doc__)
    parser.add_argument("--markdown", action="store_true", help="tables in Markdown")
    parser.add_argument("--figure", type=Path, metavar="PATH", help="where to draw them as well")
    options = parser.parse_args()
    begin = time.perf_counter()
    found = measure()
    console = Console(width=None if Console().is_terminal else 140)
    for title, heads, rows in tables(found):
        if options.markdown:
            lines = [f"{title}:", "", *(f"| {' | '.join(cells)} |" for cells in (heads, ["---"] * len(heads), *rows))]
            print("\n".join(lines) + "\n")
            continue
        table = Table(*heads, title=title, title_justify="left")
        for row in rows:
            table.add_row(*row)
        console.print(table)
    if options.figure:
        figure(found, options.figure)
    Console(stderr=True).print(f"{time.perf_counter() - begin:.0f} s", style="dim", highlight=False)


if __name__ == "__main__":
    main()
