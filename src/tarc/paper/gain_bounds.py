"""The paper's bounds on the switching gain and on how long it rises, evaluated for a run, beside what the run did."""

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import TarcError
from tarc.core.types import Array
from tarc.core.validation import Matrix
from tarc.laws.base import Law
from tarc.laws.tarc import TARC

if TYPE_CHECKING:
    from tarc.simulation.run import Run

PRINTED = (
    "as printed the bounds have no value: they divide by λmin(Θ), and Θ is positive for no gains at all (see the "
    "certificate of Theorem 2); give decay, such as λmin(Ψ) of Theorem 1, for a stand-in"
)
STAND_IN = "λmin(Θ), which is never positive, is replaced by the decay {decay:g} that was given: a stand-in, no proof"
FUNCTIONAL = (
    "V_f depends on all of the error's recent past and e_f on instants and means of it, so that no ρ and ρ̲ with "
    "ρ̲ ‖e_f‖² ≤ V_f ≤ ρ ‖e_f‖² exist; V_f is taken as eᵀPe, and they as the extreme eigenvalues of P"
)
RATE = "'ĉ ≥ c̄ϖ' is read as ĉ' ≥ c̄ϖ, which is what its integral needs"
UNITS = "in ĉ_M and ĉ_m the term c̄ δt stands over α ϖ, where its unit does not fit; evaluated as printed"


class Constants(NamedTuple):
    """What the bounds are made of.

    Attributes
    ----------
    tde_error
        c, largest ‖σ1‖ [rad/s²].
    jump
        Υ, largest ‖Δu − Δu_h‖ [rad/s²].
    forcing
        Γ.
    size
        ‖ι1‖ = ‖[P2 P3]‖.
    decay
        λ, in place of λmin(Θ).
    share
        z/λ.
    stretch
        ρ, with which V_f ≤ ρ ‖e_f‖².
    """

    tde_error: float
    jump: float
    forcing: float
    size: float
    decay: float
    share: float
    stretch: float


class Rise(NamedTuple):
    """What the run shows on one side of the boundary layer while the gain rises; not a number where it never does.

    Attributes
    ----------
    least
        ϖ, smallest ‖s‖ of a rise.
    longest
        Duration of the longest uninterrupted rise [s].
    excess
        V_f/(ρ̲ ‖e1‖²) at the end of that one.
    peak
        Largest gain [rad/s²].
    """

    least: float
    longest: float
    excess: float
    peak: float


class Bound(NamedTuple):
    """One bound of the paper: its symbol and unit, its value, and what it bounds in the run."""

    symbol: str
    unit: str
    value: float
    run: float


@dataclass(frozen=True, kw_only=True, eq=False)
class GainBounds:
    """The bounds of a run; print it for a table.

    Attributes
    ----------
    constants
        What they are made of.
    outside, inside
        The run outside the boundary layer, ‖s‖ ≥ ε, and inside it.
    bounds
        By name; ``level`` is the error ϖ0, ``rise`` t and ``fade`` δt, ``gain`` the greatest gain.
    notes
        What the numbers take for granted, and why a bound is infinite.
    """

    constants: Constants
    outside: Rise
    inside: Rise
    bounds: dict[str, Bound]
    notes: tuple[str, ...]

    def __str__(self) -> str:
        c = self.constants
        head = (
            f"c = {c.tde_error:.4g}, Υ = {c.jump:.4g} rad/s², Γ = {c.forcing:.4g}, ‖ι1‖ = {c.size:.4g}, ϖ = "
            f"{_shown(self.outside.least)} outside the layer, {_shown(self.inside.least)} inside"
        )
        rows = [f"{'bound':<22}{'symbol':<10}{'value':>12}{'run':>12}  unit"]
        rows += [
            f"{name:<22}{one.symbol:<10}{_shown(one.value):>12}{_shown(one.run):>12}  {one.unit}"
            for name, one in self.bounds.items()
        ]
        return "\n".join([head, *rows, *(f"- {note}" for note in self.notes)])


def evaluate_gain_bounds(
    run: "Run",
    law: Law,
    *,
    decay: float | None = None,
    weight: Matrix | None = None,
    share: float = 0.5,
    start: float = 0,
) -> GainBounds:
    """The paper's bounds t1, δt1, ĉ_M outside the boundary layer and t2, δt2, ĉ_m inside it, for a run.

    The constants are measured from the true motion, with s = P2 e1 and Δu = −α ĉ s / max(‖s‖, ε):

        σ1 = ë1 + K1 e1_h + K2 ė̂1_h − Δu_h,     c = max ‖σ1‖,     Υ = max ‖Δu − Δu_h‖,     ϖ = min ‖s‖ while ĉ rises
        Γ = max (h/β) ∫_{−h}^0 (Bσ)ᵀ D Bσ,      σ = Δu_h + K2 ė1_h + σ1

    Parameters
    ----------
    run
        A run of the law.
    law
        The `tarc.laws.TARC` that made it.
    decay
        λ in place of λmin(Θ), for which there is no positive value, such as λmin(Ψ) of Theorem 1; None for the bounds
        as printed, which are infinite.
    weight
        D/β of the same theorem, (2n, 2n), 2n numbers or one; None leaves Γ out.
    share
        z/λ, between 0 and 1.
    start
        Leave out what came before [s].

    Raises
    ------
    TarcError
        For a law that did not make the run, numbers out of range, and a run too short.

    References
    ----------
    Paper, proof of Theorem 2, part 2, (c low) to (appen bound2).
    """
    law, signals = _signals(run, law, check.number("start", start, 0))
    if decay is not None:
        check.number("decay", decay, 0, strict=True)
    if not 0 < check.number("share", share) < 1:
        raise TarcError(
            f"share: got {share:g}; z must lie above 0 and below the decay, so give a share between 0 and 1"
        )
    n, m, h = law.n_joints, law.delay_periods, law.delay_periods * law.period
    sigma = signals.correction_past + signals.rate_past @ law.K2.T + signals.sigma1
    forcing = 0.0
    if weight is not None:
        D = check.positive_definite("weight", weight, 2 * n)[n:, n:]
        power = np.einsum("ki,ij,kj->k", sigma, D, sigma)
        forcing = float(h * law.period * np.max(np.convolve(power, np.ones(min(m, len(power))), "valid")))
    values = np.linalg.eigvalsh(law.P)
    constants = Constants(
        tde_error=_peak(signals.sigma1),
        jump=_peak(signals.correction - signals.correction_past),
        forcing=forcing,
        size=float(np.linalg.norm(np.hstack([law.P2, law.P3]), 2)),
        decay=0.0 if decay is None else decay,
        share=share,
        stretch=float(values[-1]),
    )
    state = np.hstack([signals.error, signals.rate])
    with np.errstate(divide="ignore", invalid="ignore"):
        excess = np.einsum("ki,ij,kj->k", state, law.P, state) / (values[0] * np.sum(signals.error**2, axis=1))
    far = signals.sliding >= law.boundary_layer
    outside, inside = (_rise(law, signals, side, excess) for side in (far, ~far))
    notes = [PRINTED if decay is None else STAND_IN.format(decay=decay), FUNCTIONAL, RATE, UNITS]
    if weight is None:
        notes.append("Γ is left out, for no D/β was given; with it the bounds are larger")
    notes += [
        f"{where} the boundary layer the gain never rises, so nothing is bounded there"
        for where, side in (("outside", outside), ("inside", inside))
        if np.isnan(side.least)
    ]
    notes.append(
        "ϖ is measured, and the theory gives none: where ‖s‖ passes zero during a rise, t2 and ĉ_m have no limit"
    )
    bounds = evaluate(law, constants, outside, inside, error=_peak(state))
    return GainBounds(constants=constants, outside=outside, inside=inside, bounds=bounds, notes=tuple(notes))


def evaluate(law: TARC, constants: Constants, outside: Rise, inside: Rise, *, error: float) -> dict[str, Bound]:
    """The bounds, as printed, from their constants.

        μ1 = (Υ+c) ‖ι1‖ / (λ−z),     ϖ0 = μ1 + √(Γ/(λ−z) + μ1²),     l(c̄δt) = (Υ + c + c̄δt) ‖ι1‖ ϖ0 + Γ/2
        t1 = l(0) / (α c̄ ϖ²),        δt = (ρ/λ) ln(V_f / ρ̲φ²),        ĉ_M = l(c̄δt1) / (α ϖ)
        t2 = ε l(0) / (α c̄ ϖ³),                                       ĉ_m = ε l(c̄δt2) / (α ϖ²)

    with φ = ‖e1‖. Infinite for λ = 0.

    Parameters
    ----------
    law
        For α, c̄ and ε.
    constants, outside, inside
        As measured; ρ̲ is in the ``excess``.
    error
        Largest ‖e‖ of the run.
    """
    c = constants
    push = (c.jump + c.tde_error) * c.size
    rest = c.decay * (1 - c.share)
    level = push / rest + np.sqrt(c.forcing / rest + (push / rest) ** 2) if rest > 0 else np.inf
    found = {"level": Bound("ϖ0", "of e", float(level), error)}
    for name, side, order, symbols in (
        ("outside", outside, 1, ("t1", "δt1", "ĉ_M")),
        ("inside", inside, 2, ("t2", "δt2", "ĉ_m")),
    ):
        layer = law.boundary_layer if order == 2 else 1.0
        needed = layer * _by(push * level + c.forcing / 2, law.gain_factor * side.least**order)
        rise = _by(needed, law.rise_rate * side.least)
        fade = np.nan if np.isnan(side.least) else c.stretch * _by(np.log(max(side.excess, 1.0)), c.decay)
        more = layer * _by(law.rise_rate * fade * c.size * level, law.gain_factor * side.least**order)
        found |= {
            f"rise {name}": Bound(symbols[0], "s", rise, side.longest),
            f"fade {name}": Bound(symbols[1], "s", fade, np.nan),
            f"gain {name}": Bound(symbols[2], "rad/s²", needed + more, side.peak),
        }
    gains = [found[f"gain {name}"] for name in ("outside", "inside")]
    top, seen = (float(np.fmax(*(getattr(one, what) for one in gains))) for what in ("value", "run"))
    return found | {"gain": Bound("c*", "rad/s²", top, seen)}


class _Signals(NamedTuple):
    """From the first sample with an instant h before it: (k, n), and (k,) for the last three."""

    error: Array
    rate: Array
    rate_past: Array
    correction: Array
    correction_past: Array
    sigma1: Array
    sliding: Array
    gain: Array
    rising: Array


def _signals(run: "Run", law: Law, start: float) -> tuple[TARC, _Signals]:
    """The law, and the signals of its run, up to where it gave up or diverged."""
    if not isinstance(law, TARC):
        raise TarcError(f"law: got {type(law).__name__}; the bounds are those of tarc.laws.TARC")
    data = run.data
    made = json.loads(data.attrs["law"])
    own = {"kind": "TARC", "period": law.period, "joints": law.n_joints}
    own |= {name: getattr(law, name) for name in ("rise_rate", "fall_rate", "boundary_layer", "gain_factor", "delay")}
    theirs = {**made, "joints": data.sizes["joint"]}
    for name, value in own.items():
        if theirs.get(name) != value:
            raise TarcError(f"law: its {name} is {value}, and that of the run's law {theirs.get(name)}; give that law")
    error = (data["position"] - data["reference"]).values
    sliding = np.linalg.norm(error @ law.P2.T, axis=1)
    if not np.allclose(sliding, data["sliding"].values, rtol=1e-6, equal_nan=True):
        raise TarcError("law: its P2 is not that of the run's law; give that law, with the same gains and weight")
    rate = (data["velocity"] - data["velocity_reference"]).values
    estimated = (data["velocity_estimate"] - data["velocity_reference"]).values
    acceleration = (data["acceleration"] - data["acceleration_reference"]).values
    gain = data["gain"].values
    correction = -law.gain_factor * (gain / np.maximum(sliding, law.boundary_layer))[:, None] * (error @ law.P2.T)
    m = law.delay_periods
    whole = (data["fault"].values == 0) & np.isfinite(error + rate + acceleration).all(axis=1) & np.isfinite(gain)
    end = len(whole) if whole.all() else int(np.argmin(whole))
    first = max(m, int(np.searchsorted(data["time"].values, start - 1e-9)))
    if end - first < 2:
        raise TarcError(
            f"run: {max(end - first, 0)} samples of it can be used after {start:g} s ({run.status}); needs 2"
        )
    now, past = slice(first, end), slice(first - m, end - m)
    sigma1 = acceleration[now] + error[past] @ law.K1.T + estimated[past] @ law.K2.T - correction[past]
    return law, _Signals(
        error[now],
        rate[now],
        rate[past],
        correction[now],
        correction[past],
        sigma1,
        sliding[now],
        gain[now],
        data["rising"].values[now] > 0.5,
    )


def _rise(law: TARC, signals: _Signals, side: Array, excess: Array) -> Rise:
    """The rises of the gain on one side of the layer."""
    rising = signals.rising & side
    peak = float(np.max(signals.gain[side])) if side.any() else np.nan
    if not rising.any():
        return Rise(np.nan, 0.0, np.nan, peak)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], rising.astype(int), [0]])))
    starts, ends = edges[::2], edges[1::2]
    longest = int(np.argmax(ends - starts))
    duration = float((ends - starts)[longest] * law.period)
    return Rise(float(np.min(signals.sliding[rising])), duration, float(excess[ends[longest] - 1]), peak)


def _shown(value: float) -> str:
    return "–" if np.isnan(value) else f"{value:.4g}"


def _peak(rows: Array) -> float:
    return float(np.max(np.linalg.norm(rows, axis=1)))


def _by(above: float, below: float) -> float:
    """Quotient; infinite for a divisor of zero."""
    return float(above / below) if below else np.inf
