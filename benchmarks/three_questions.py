"""What is certified against what breaks, for three questions: ``python -m benchmarks.three_questions``.

How much may the inertia vary, how fast, and with what stiffness? The first two are of a loop of any number of joints,
broken by a mismatch of two joints that turns, whose growth is exact. The third is of a two-link arm whose gravity is
scaled, broken by motions that evolution breeds (``tests/reference``).
"""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from reference.law_parameters import PERIOD, LawParameters
from reference.law_recurrence import recurrence
from reference.motion_attacks import MotionAttacker
from reference.uncertain_case import UncertainCase, growth_per_period
from tarc.analysis import Workspace, stable_interval
from tarc.analysis.linearise import Channel, decoupled_channels
from tarc.certificates import Certificate, certify_affine, certify_varying_ratio
from tarc.certificates.robot import certify_robot, strengthen_robot
from tarc.certificates.robot_evidence import RobotEvidence
from tarc.core.progress import Progress
from tarc.estimators import Algebraic
from tarc.laws import TDC, TDE
from tarc.plants import TwoLinkArm
from tarc.plotting.style import COLOURS, StyledFigure

WINDOWS = (2, 5, 10, 20, 50)
RATES = (1.0, 10.0, 100.0, 300.0, 1000.0, 3000.0, 1e4)
"""Of the inertia in units of M̂ [1/s]."""
FREQUENCIES = (2.0, 4.0, 8.0, 16.0, 32.0)
"""Natural frequencies of the arm whose gravity grows [rad/s]."""
GRAVITIES = (1.0, 1e5)
"""Range of the search for its largest gravity [m/s²]."""
TURNS = np.geomspace(1e-4, np.pi, 60)
"""Rates at which the axes of a mismatch turn [rad per period]."""
SPREADS = np.geomspace(1.02, 1000.0, 60)
TOPS = (0.85, 0.96)
"""Upper ends of the ranges that the affine function is tried on, over that of the stable range."""


class HowMuch(NamedTuple):
    """Spreads of one loop, the largest over the smallest ratio: constant and stable, certified at any rate, broken."""

    synchronised: bool
    window: int
    constant: float
    certified: float
    broken: float


class HowFast(NamedTuple):
    """Spreads of one loop for a rate [1/s]: certified by the multiplier's ball and the affine function, and broken.

    Broken is about the same centre as the wider one of the two, or below the same upper end.
    """

    rate: float
    ball: float
    affine: float
    broken: float


class Stiffness(NamedTuple):
    """Largest stiffness [1/s²] that is certified at a natural frequency [rad/s], and smallest that is broken."""

    natural_frequency: float
    certified: float
    broken: float


def _loop(window: int, synchronised: bool) -> LawParameters:
    return LawParameters(window=window, synchronised=synchronised)


def broken_spread(
    design: LawParameters, *, centre: float | None = None, top: float = 0.0, rate: float = np.inf
) -> float:
    """Return the smallest spread that a turning mismatch breaks, about a centre or below an upper end.

    ‖ΔE⁻¹‖ of a period is at most the rate times T: that of a pair whose axes turn by φ is sin φ times the difference of
    its eigenvalues.
    """
    law = recurrence(design)

    def is_broken(spread: float) -> bool:
        middle = top * (1 + 1 / spread) / 2 if centre is None else centre
        radius = middle * (spread - 1) / (spread + 1)
        difference = 1 / (middle - radius) - 1 / (middle + radius)
        turns = TURNS[difference * np.sin(np.minimum(TURNS, np.pi / 2)) <= rate * PERIOD]
        case = UncertainCase(law, middle, radius)
        return bool(np.any(growth_per_period(case, 0.0, np.append(turns, 0.0)) > 1 + 1e-9))

    first = next((k for k, spread in enumerate(SPREADS) if is_broken(float(spread))), len(SPREADS) - 1)
    ends = float(SPREADS[max(first - 1, 0)]), float(SPREADS[first])
    return _last(ends, lambda spread: not is_broken(spread), 1.005)[1]


def how_much() -> list[HowMuch]:
    """Measure literal and synchronised loops over the window."""
    found = []
    for synchronised in (False, True):
        for window in WINDOWS:
            design = _loop(window, synchronised)
            low, high = stable_interval(design.law)
            ball = certify_varying_ratio(design.law, intersample=False).evidence
            broken = broken_spread(design, centre=ball.centre)
            found.append(HowMuch(synchronised, window, high / low, ball.ratio_spread, broken))
    return found


def how_fast(window: int = 5) -> list[HowFast]:
    """Measure one synchronised loop over the rate."""
    design, found = _loop(window, True), []
    with Progress("how fast", len(RATES)) as bar:
        for rate in RATES:
            ball = certify_varying_ratio(design.law, rate=rate, intersample=False).evidence
            low, high = stable_interval(design.law)
            affine = [_widest(design.law, rate, share * high, low) for share in TOPS]
            spread, top = max(zip(affine, TOPS, strict=True))
            is_ball = ball.ratio_spread > spread
            place = {"centre": ball.centre} if is_ball else {"top": top * high}
            broken = broken_spread(design, rate=rate, **place)
            found.append(HowFast(rate, float(ball.ratio_spread), spread, broken))
            bar.advance()
    return found


def _widest(law: TDE, rate: float, top: float, low: float) -> float:
    """Return the largest certified spread below an upper end, by bisection to 5 %."""
    certified, refused = 1.0, top / low
    while refused > 1.05 * certified:
        middle = (certified * refused) ** 0.5
        if certify_affine(law, (top / middle, top), rate, intersample=False).certified:
            certified = middle
        else:
            refused = middle
    return certified


def stiffnesses() -> list[Stiffness]:
    """Measure a two-link arm at 1 rad/s whose gravity grows until it is not certified, and until motions break it."""
    workspace = Workspace(low=np.full(2, -2.0), high=np.full(2, 2.0)).with_speed_limits(1.0)
    arm = TwoLinkArm(masses=(2.0, 1.0), inertias=(0.1, 0.1), viscous=(0.0, 0.0))
    inertia = 0.6 * arm.mean_inertia(workspace.sample(100).T)
    found = []
    with Progress("with what stiffness", len(FREQUENCIES)) as bar:
        for frequency in FREQUENCIES:
            law = TDC(
                inertia=inertia,
                natural_frequency=frequency,
                period=PERIOD,
                estimator=Algebraic(window=0.006, degree=2),
                synchronised=True,
            )
            loop = decoupled_channels(law)[0]

            def certificate(gravity: float, law: TDC = law) -> Certificate[RobotEvidence]:
                heavy = arm.with_parameters({"gravity": gravity})
                first = certify_robot(law, heavy, workspace, samples=200)
                return strengthen_robot(first, law, heavy, workspace, samples=200)

            def is_broken(gravity: float, loop: Channel = loop) -> bool:
                heavy = arm.with_parameters({"gravity": gravity})
                return MotionAttacker(loop, inertia, [heavy], workspace).attack(64, until_broken=True).broken > 0

            certified, _ = _last(GRAVITIES, lambda gravity: certificate(gravity).certified)
            _, broken = _last((certified, GRAVITIES[1]), lambda gravity: not is_broken(gravity))
            stiffness = [certificate(gravity).evidence.stiffness for gravity in (certified, broken)]
            found.append(Stiffness(frequency, *stiffness))
            bar.advance()
    return found


def _last(ends: tuple[float, float], holds: Callable[[float], bool], close: float = 1.05) -> tuple[float, float]:
    """Return the largest value that holds and one within a factor that does not, by bisection of logarithms."""
    low, high = ends
    while high > close * low:
        middle = (low * high) ** 0.5
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low, high


def figures(much: Sequence[HowMuch], fast: Sequence[HowFast], stiff: Sequence[Stiffness]) -> dict[str, StyledFigure]:
    """Draw what is certified and what breaks, by question."""
    return {"how-much": _draw_much(much), "how-fast": _draw_fast(fast), "how-stiff": _draw_stiff(stiff)}


def _draw_much(found: Sequence[HowMuch]) -> StyledFigure:
    drawn = StyledFigure(figsize=(9.0, 3.6), layout="constrained")
    panels = drawn.subplots(1, 2, sharey=True)
    for axes, synchronised in zip(panels, (False, True), strict=True):
        rows = [row for row in found if row.synchronised == synchronised]
        windows = [row.window for row in rows]
        broken = [row.broken for row in rows]
        axes.fill_between(windows, broken, 1e3, color=COLOURS[1], alpha=0.15, lw=0)
        axes.loglog(windows, [row.constant for row in rows], "--", color="0.4", label="constant ratio, exact")
        axes.loglog(windows, broken, "x-", color=COLOURS[1], label="a turning mismatch breaks it")
        axes.loglog(windows, [row.certified for row in rows], "o-", color=COLOURS[0], label="certified, any rate")
        axes.set_title("synchronised" if synchronised else "literal", fontsize="medium")
        axes.set_xlabel("window [periods]")
        axes.set_ylim(1, 1e3)
        axes.set_xticks(windows, labels=[str(window) for window in windows], minor=False)
        axes.set_xticks([], minor=True)
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("largest over smallest inertia ratio")
    panels[1].legend(frameon=False, fontsize="small")
    return drawn


def _draw_fast(found: Sequence[HowFast]) -> StyledFigure:
    drawn = StyledFigure(figsize=(6.5, 3.6), layout="constrained")
    axes = drawn.subplots()
    rates = [row.rate for row in found]
    broken = [row.broken for row in found]
    axes.fill_between(rates, broken, 1e3, color=COLOURS[1], alpha=0.15, lw=0)
    axes.loglog(rates, broken, "x-", color=COLOURS[1], label="a turning mismatch breaks it")
    axes.loglog(rates, [row.affine for row in found], "o-", color=COLOURS[0], label="certified, affine function")
    axes.loglog(rates, [row.ball for row in found], "s--", color=COLOURS[2], label="certified, ball with a multiplier")
    axes.set_xlabel("rate of the inertia in units of $\\hat M$ [1/s]")
    axes.set_ylabel("largest over smallest ratio")
    axes.set_ylim(10, 500)
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, fontsize="small")
    return drawn


def _draw_stiff(found: Sequence[Stiffness]) -> StyledFigure:
    drawn = StyledFigure(figsize=(6.5, 3.6), layout="constrained")
    axes = drawn.subplots()
    values = [row.natural_frequency for row in found]
    broken = [row.broken for row in found]
    axes.fill_between(values, broken, 10 * max(broken), color=COLOURS[1], alpha=0.15, lw=0)
    axes.loglog(values, broken, "x-", color=COLOURS[1], label="a motion breaks it")
    axes.loglog(values, [row.certified for row in found], "o-", color=COLOURS[0], label="certified")
    axes.set_xlabel("natural frequency [rad/s]")
    axes.set_ylabel("stiffness of gravity and motion [1/s²]")
    axes.set_ylim(top=10 * max(broken))
    axes.set_xticks(values, labels=[f"{value:g}" for value in values], minor=False)
    axes.set_xticks([], minor=True)
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, fontsize="small")
    return drawn


def main() -> None:
    """Print the tables; draw the figures."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.three_questions", description=__doc__)
    parser.add_argument("--figures", type=Path, help="folder for the figures")
    options = parser.parse_args()
    much, fast, stiff = how_much(), how_fast(), stiffnesses()
    console = Console(width=None if Console().is_terminal else 120)
    for title, rows in (("how much", much), ("how fast", fast), ("with what stiffness", stiff)):
        table = Table(*rows[0]._fields, title=title, title_justify="left")
        for row in rows:
            table.add_row(*(f"{value:.3g}" if isinstance(value, float) else str(value) for value in row))
        console.print(table)
    if options.figures:
        for name, drawn in figures(much, fast, stiff).items():
            drawn.savefig(options.figures / f"{name}.png", dpi=110)


if __name__ == "__main__":
    main()
