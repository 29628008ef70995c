"""How near laws with their best parameters come to the best linear controller: ``python -m benchmarks.optimum``.

One joint, an encoder of 17 bits at 1 kHz, and a disturbing acceleration that is a random walk. For budgets of torque
variation, the parameters of each law are searched for the least error, and that error is divided by the least one of
any linear controller. Then the window's polynomial weights give way to free ones.
"""

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.optimize import minimize

from tarc.analysis.linearise import Channel, decoupled_channels
from tarc.analysis.optimum import least_error, loop_deviations
from tarc.analysis.uncertain_loop import UncertainLoop
from tarc.certificates.ball_centre import best_centre
from tarc.certificates.ball_radius import max_radius_any_rate
from tarc.core.errors import InvalidParameter
from tarc.core.progress import Progress
from tarc.estimators import Algebraic
from tarc.laws import ADRC, PID, TDC
from tarc.plotting.style import COLOURS, StyledFigure

PERIOD = 1e-3
NOISE = 2 * np.pi / 2**17 / 12**0.5
"""RMS error of an encoder of 17 bits [rad]."""
WALKS = (0.005, 0.05)
"""RMS steps of the disturbing acceleration per period [rad/s²]."""
BUDGETS = (0.03, 0.1, 0.3, 1.0, 3.0)
"""RMS changes of the acceleration by the torque per period [rad/s²]."""
STARTS = ((0.05, 1.0), (0.3, 2.0), (1.0, 0.3))
"""Inertia ratio at which a search starts, and the natural frequency over that of its kind."""
PENALTY = 20.0
"""Factor of log(change / budget) beyond the budget."""


class Kind(NamedTuple):
    """A law of one joint by its window, degree and other parameters, with where the search starts and ends."""

    name: str
    build: Callable[[int, int, Sequence[float]], Channel]
    start: tuple[float, ...]
    degrees: tuple[int, ...]
    windows: tuple[int, ...]


def _builder(kind: Any, *names: str, **fixed: Any) -> Callable[[int, int, Sequence[float]], Channel]:
    """Return what makes the loop of a law from natural frequency, damping ratio and the further gains by name."""

    def build(window: int, degree: int, values: Sequence[float]) -> Channel:
        gains = dict(zip(("natural_frequency", "damping_ratio", *names), values, strict=True))
        estimator = Algebraic(window=window * PERIOD, degree=degree)
        return decoupled_channels(kind(inertia=1.0, period=PERIOD, estimator=estimator, **gains, **fixed))[0]

    return build


LITERAL = "TDC, literal"

WINDOWS = (2, 3, 4, 6, 8, 11, 15, 20, 28, 40)

KINDS = (
    Kind(LITERAL, _builder(TDC), (20.0, 1.0), (1, 2, 3), WINDOWS),
    Kind(
        "TDC, synchronised", _builder(TDC, synchronised=True), (20.0, 1.0), (2, 3), (2, 3, 4, 6, 8, 11, 15, 20, 28, 40)
    ),
    Kind("PID", _builder(PID, "integral_gain"), (20.0, 1.0, 3.0), (1, 2), (2, 4, 8, 15, 28)),
    Kind("ADRC", _builder(ADRC, "observer_bandwidth"), (20.0, 1.0, 80.0), (2,), (2,)),
)


class Best(NamedTuple):
    """The best loop of a kind within a budget."""

    error: float
    window: int
    degree: int
    ratio: float
    values: tuple[float, ...]
    channel: Channel


def best_loop(kind: Kind, walk: float, budget: float, former: Best | None = None) -> Best:
    """Return the loop with the least error whose RMS change of acceleration is within the budget.

    For each degree the windows are tried from short to long, each from where the search for the one before ended. The
    best loop of a smaller budget is a start as well.
    """
    found: list[Best] = [] if former is None else [former]
    for degree in kind.degrees:
        starts = [np.log([ratio, pace * kind.start[0], *kind.start[1:]]) for ratio, pace in STARTS]
        for window in kind.windows:
            if window < degree:
                continue
            best = _search(kind, window, degree, walk, budget, starts)
            if best is not None:
                found.append(best)
                starts = [np.log([one.ratio, *one.values]) for one in (best, former) if one is not None]
    return min(found, key=lambda best: best.error)


def _search(
    kind: Kind, window: int, degree: int, walk: float, budget: float, starts: Sequence[np.ndarray]
) -> Best | None:
    """Search the inertia ratio and the other parameters of a loop on logarithmic scales."""

    def loop(x: np.ndarray) -> tuple[Channel, float] | None:
        try:
            return kind.build(window, degree, np.exp(x[1:]).tolist()), float(np.exp(x[0]))
        except InvalidParameter:
            return None

    def score(x: np.ndarray) -> float:
        made = loop(x) if np.max(np.abs(x)) < 12 else None
        return 1e3 if made is None else score_of(*made, walk, budget)

    results = [
        minimize(score, start, method="Nelder-Mead", options={"maxiter": 200, "fatol": 1e-4, "xatol": 1e-2})
        for start in starts
    ]
    best = min(results, key=lambda result: result.fun)
    made = loop(best.x)
    if made is None or best.fun > 100:
        return None
    error = loop_deviations(*made, NOISE, walk).error
    return Best(error, window, degree, made[1], tuple(np.exp(best.x[1:]).tolist()), made[0])


def score_of(channel: Channel, ratio: float, walk: float, budget: float) -> float:
    """Return the log of the error, raised steeply beyond the budget."""
    found = loop_deviations(channel, ratio, NOISE, walk)
    if not np.isfinite(found.error):
        return 500.0
    return float(np.log(found.error / NOISE)) + PENALTY * max(0.0, float(np.log(found.change / budget)))


def free_window(best: Best, walk: float, budget: float, least_spread: float = 1.0) -> Channel:
    """Return the loop with free weights instead of a polynomial's that has the least error.

    A literal law commands τ_k = τ_{k−1} + M̂ Σ c_i q_{k−i}: its only freedom is the N + 1 weights. So they stand for
    windows of any shape, for two windows, and for any filter of that length. They are searched from those of the law.

    Parameters
    ----------
    best
        The law.
    walk, budget
        Disturbance and RMS change of acceleration.
    least_spread
        Smallest range of varying ratios that the loop must be certified for, largest over smallest.
    """
    start = position_weights(best.channel) * best.ratio

    def score(x: np.ndarray) -> float:
        channel = channel_of_weights(start * (1 + x))
        value = score_of(channel, 1.0, walk, budget)
        if least_spread > 1 and value < 100:
            value += PENALTY * max(0.0, float(np.log(least_spread / varying_spread(channel))))
        return value

    x = np.zeros(len(start))
    for _ in range(4):  # a simplex that has collapsed is opened again
        x = minimize(score, x, method="Powell", options={"maxiter": 30, "ftol": 1e-6}).x
    return channel_of_weights(start * (1 + x))


def position_weights(channel: Channel) -> np.ndarray:
    """Return c of v_k − v_{k−1} = Σ c_i q_{k−i}, from the response of a literal law to one position."""
    state, v, response = np.zeros((len(channel.F), 1)), 0.0, []
    for k in range(len(channel.F) + 2):
        q = float(k == 0)
        present = (channel.C @ state + channel.D * q).item()
        response.append(present - v)
        v = present
        state = channel.F @ state + channel.G * q
    weights = np.array(response)
    return weights[: int(np.max(np.flatnonzero(np.abs(weights) > 1e-9 * np.abs(weights).max()))) + 1]


def channel_of_weights(c: np.ndarray) -> Channel:
    """Return the loop of v_k = v_{k−1} + Σ c_i q_{k−i}; its states are v and past positions."""
    n = len(c)
    F, G, H = np.zeros((n, n)), np.zeros((n, 1)), np.zeros((n, 1))
    F[0, 0], F[0, 1:] = 1.0, c[1:]
    G[0, 0] = c[0]
    if n > 1:
        G[1, 0] = 1.0
        F[2:, 1:-1] = np.eye(n - 2)
    C, D = F[:1].copy(), np.array([[c[0]]])
    return Channel(F=F, G=G, H=H, C=C, D=D, E=np.zeros((1, 1)), period=PERIOD, joints=(0,))


ANGLES = np.geomspace(1e-3, np.pi, 400)
"""Frequencies ω T [rad] of `varying_spread`."""
CENTRES = np.geomspace(0.05, 8.0, 50)
"""Centres of the balls in `varying_spread`, over a ratio that is stable."""


def varying_spread(channel: Channel) -> float:
    """Return the largest over the smallest ratio of the widest ball of ratios that vary at any rate, on a grid.

    With K from q to v and P from the mean and the skew acceleration of a period to q, a ball about ρ0 is tolerated up
    to δ = 1/‖K P/(1 − ρ0 K P)‖∞. The loop of `channel_of_weights` is taken at the ratio one.
    """
    c = np.concatenate([channel.D[0], channel.C[0, 1:]])
    z = np.exp(1j * ANGLES)
    K = z[:, None] ** -np.arange(len(c)) @ c / (1 - 1 / z)
    mean, skew = PERIOD**2 * np.array([1 / (z - 1) ** 2 + 0.5 / (z - 1), 12**-0.5 / (z - 1)])
    size = np.abs(K) * np.hypot(np.abs(mean), np.abs(skew))
    radii = 1 / np.max(size / np.abs(1 - CENTRES[:, None] * K * mean), axis=1)
    spreads = (CENTRES + radii) / np.maximum(CENTRES - radii, 1e-9)
    for k in np.argsort(spreads)[::-1]:
        if np.max(np.abs(np.linalg.eigvals(channel.state_matrix(float(CENTRES[k]))))) < 1:
            return float(spreads[k])
    return 1.0


def certified_spread(channel: Channel) -> float:
    """Return the spread of ratios that vary at any rate for which the package certifies a loop."""
    loop = UncertainLoop.from_channel(channel, 0.0, intersample=True)
    centre = best_centre(loop, None)
    radius = max_radius_any_rate(loop, centre)[1]
    return (centre + radius) / (centre - radius)


class Row(NamedTuple):
    """Errors over the least one, for one walk and one budget, and certified spreads.

    Those are of laws, of free weights, and of free weights that must reach the spread of the literal law.
    """

    walk: float
    budget: float
    least: float
    laws: dict[str, Best]
    free: float
    equal: float
    law_spread: float
    free_spread: float
    equal_spread: float

    def over(self, name: str) -> float:
        """Return the error of a law over the least one."""
        return self.laws[name].error / self.least


def rows(walks: Sequence[float] = WALKS, budgets: Sequence[float] = BUDGETS) -> list[Row]:
    """Search all laws for all walks and budgets."""
    found = []
    with Progress("searching the best loops", len(walks) * len(budgets) * len(KINDS)) as bar:
        for walk in walks:
            laws: dict[str, Best] = {}
            for budget in sorted(budgets):
                laws = dict(laws)
                for kind in KINDS:
                    laws[kind.name] = best_loop(kind, walk, budget, laws.get(kind.name))
                    bar.advance()
                literal = laws[LITERAL]
                least = least_error(budget, noise=NOISE, disturbance=walk, period=PERIOD)
                own = channel_of_weights(position_weights(literal.channel) * literal.ratio)
                free = free_window(literal, walk, budget)
                equal = free
                if varying_spread(free) < varying_spread(own):
                    equal = free_window(literal, walk, budget, varying_spread(own))
                errors = [loop_deviations(channel, 1.0, NOISE, walk).error / least for channel in (free, equal)]
                spreads = [certified_spread(channel) for channel in (own, free, equal)]
                found.append(Row(walk, budget, least, laws, *errors, *spreads))
    return found


def figure(found: Sequence[Row]) -> StyledFigure:
    """Draw errors over torque variation, with the bound."""
    drawn = StyledFigure(figsize=(9.0, 3.8), layout="constrained")
    walks = sorted({row.walk for row in found})
    panels = drawn.subplots(1, len(walks), squeeze=False)[0]
    for axes, walk in zip(panels, walks, strict=True):
        part = [row for row in found if row.walk == walk]
        budgets = [row.budget for row in part]
        ends = np.geomspace(budgets[0], budgets[-1], 60)
        bound = [least_error(float(end), noise=NOISE, disturbance=walk, period=PERIOD) / NOISE for end in ends]
        axes.loglog(ends, bound, color="black", lw=1.5, label="any linear controller")
        for colour, marker, kind in zip(COLOURS, "os^D", KINDS, strict=False):
            errors = [row.laws[kind.name].error / NOISE for row in part]
            axes.loglog(budgets, errors, marker, ms=5, ls=":", lw=1, color=colour, label=kind.name)
        free = [row.free * row.least / NOISE for row in part]
        axes.loglog(budgets, free, "+", ms=8, color=COLOURS[4], label="literal, free window")
        equal = [row.equal * row.least / NOISE for row in part]
        axes.loglog(budgets, equal, "x", ms=6, color=COLOURS[5], label="the same, as robust")
        axes.set_title(f"disturbance walks by {walk:g} rad/s² a period", fontsize="medium")
        axes.set_xlabel("RMS change of acceleration a period [rad/s²]")
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("RMS error over that of the encoder")
    panels[-1].legend(frameon=False, fontsize="small")
    return drawn


def main() -> None:
    """Print the table; draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--figure", type=Path, help="where to draw the errors")
    options = parser.parse_args()
    found = rows()
    table = Table(title="error over the least one of any linear controller", title_justify="left")
    for head in ("walk", "change", "least / σ", *(kind.name for kind in KINDS), "free", "free, as robust", "spreads"):
        table.add_column(head, justify="right")
    for row in found:
        cells = [f"{row.walk:g}", f"{row.budget:g}", f"{row.least / NOISE:.3g}"]
        cells += [f"{row.over(kind.name):.3f}" for kind in KINDS]
        spreads = f"{row.law_spread:.3g}, {row.free_spread:.3g}, {row.equal_spread:.3g}"
        table.add_row(*cells, f"{row.free:.3f}", f"{row.equal:.3f}", spreads)
    Console().print(table)
    if options.figure:
        figure(found).savefig(options.figure, dpi=110)


if __name__ == "__main__":
    main()
