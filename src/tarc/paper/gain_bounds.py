"""The paper's bounds on the switching gain and on its rise times, evaluated for a run, beside the run's own values."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.core.types import Array
from tarc.core.validation import Matrix
from tarc.laws.base import Law
from tarc.laws.tarc import TARC

if TYPE_CHECKING:
    import xarray as xr

    from tarc.simulation.run import Run

PRINTED_NOTE = (
    "as printed the bounds have no value: they divide by λmin(Θ), which is positive for no gains (see the certificate "
    "of Theorem 2); give decay_rate, such as λmin(Ψ) of Theorem 1, for a substitute"
)
SUBSTITUTE_NOTE = (
    "λmin(Θ), which is never positive, is replaced by the given decay rate {decay_rate:g}; this proves nothing"
)
FUNCTIONAL_NOTE = (
    "V_f depends on the error's past, and e_f on instants and means of it, so no ρ, ρ̲ with ρ̲ ‖e_f‖² ≤ V_f ≤ ρ ‖e_f‖² "
    "exist; V_f is replaced by eᵀPe, and they by the extreme eigenvalues of P"
)
RATE_NOTE = "'ĉ ≥ c̄ϖ' is read as ĉ' ≥ c̄ϖ, which its integral needs"
UNITS_NOTE = "in ĉ_M and ĉ_m the term c̄ δt stands over α ϖ, where its unit does not fit; evaluated as printed"
NO_FORCING_NOTE = "Γ is left out, because no D/β was given; with it the bounds are larger"
ZERO_CROSSING_NOTE = (
    "ϖ is measured, because the theory gives none: where ‖s‖ passes zero during a rise, t2 and ĉ_m have no limit"
)


class Constants(NamedTuple):
    """Constants of the bounds.

    Attributes
    ----------
    tde_error
        c, largest ‖σ1‖ [rad/s²].
    correction_jump
        Υ, largest ‖Δu − Δu_h‖ [rad/s²].
    forcing
        Γ.
    iota_norm
        ‖ι1‖ = ‖[P2 P3]‖.
    decay_rate
        λ, in place of λmin(Θ).
    decay_share
        z/λ.
    max_eigenvalue
        ρ, with which V_f ≤ ρ ‖e_f‖².
    """

    tde_error: float
    correction_jump: float
    forcing: float
    iota_norm: float
    decay_rate: float
    decay_share: float
    max_eigenvalue: float


class GainRise(NamedTuple):
    """Rises of the gain in a run, on one side of the boundary layer.

    Attributes
    ----------
    min_sliding
        ϖ, smallest ‖s‖ during a rise; not a number without a rise.
    longest_duration
        Duration of the longest uninterrupted rise [s].
    functional_ratio
        V_f/(ρ̲ ‖e1‖²) at its end; not a number without a rise.
    peak_gain
        Largest gain [rad/s²].
    """

    min_sliding: float
    longest_duration: float
    functional_ratio: float
    peak_gain: float


class Bound(NamedTuple):
    """One bound of the paper.

    Attributes
    ----------
    symbol, unit
        As in the paper.
    value
        Its value; infinite for none.
    observed
        The run's own value of the bounded quantity; not a number where it has none.
    """

    symbol: str
    unit: str
    value: float
    observed: float


class LayerBounds(NamedTuple):
    """Bounds on one side of the boundary layer: t, δt and the largest gain."""

    rise_time: Bound
    fade_time: Bound
    gain: Bound


class PaperBounds(NamedTuple):
    """All bounds of the paper.

    Attributes
    ----------
    error
        ϖ0, the bound on ‖e‖.
    outside, inside
        Outside and inside the boundary layer.
    gain
        c*, the larger bound on the gain.
    """

    error: Bound
    outside: LayerBounds
    inside: LayerBounds
    gain: Bound

    def by_name(self) -> Iterator[tuple[str, Bound]]:
        """Yield the name of each bound, and the bound."""
        yield "error", self.error
        for side, layer in (("outside", self.outside), ("inside", self.inside)):
            yield f"rise time {side}", layer.rise_time
            yield f"fade time {side}", layer.fade_time
            yield f"gain {side}", layer.gain
        yield "gain", self.gain


@dataclass(frozen=True, kw_only=True, eq=False)
class GainBounds:
    """The bounds of a run; print it for a table.

    Attributes
    ----------
    constants
        Constants of the bounds.
    rise_outside, rise_inside
        Rises of the gain outside the boundary layer, ‖s‖ ≥ ε, and inside it.
    bounds
        The bounds.
    notes
        What the numbers assume, and why a bound is infinite.
    """

    constants: Constants
    rise_outside: GainRise
    rise_inside: GainRise
    bounds: PaperBounds
    notes: tuple[str, ...]

    def __str__(self) -> str:
        c = self.constants
        head = (
            f"c = {c.tde_error:.4g}, Υ = {c.correction_jump:.4g} rad/s², Γ = {c.forcing:.4g}, "
            f"‖ι1‖ = {c.iota_norm:.4g}, ϖ = {_format_number(self.rise_outside.min_sliding)} outside the layer, "
            f"{_format_number(self.rise_inside.min_sliding)} inside"
        )
        rows = [f"{'bound':<22}{'symbol':<10}{'value':>12}{'run':>12}  unit"]
        for name, bound in self.bounds.by_name():
            numbers = f"{_format_number(bound.value):>12}{_format_number(bound.observed):>12}"
            rows.append(f"{name:<22}{bound.symbol:<10}{numbers}  {bound.unit}")
        return "\n".join([head, *rows, *(f"- {note}" for note in self.notes)])


def evaluate_gain_bounds(
    run: "Run",
    law: Law,
    *,
    decay_rate: float | None = None,
    delay_weight: Matrix | None = None,
    decay_share: float = 0.5,
    start_time: float = 0,
) -> GainBounds:
    """Evaluate the paper's bounds t1, δt1, ĉ_M outside the boundary layer and t2, δt2, ĉ_m inside it, for a run.

    The constants are measured from the true motion, with s = P2 e1 and Δu = −α ĉ s / max(‖s‖, ε):

        σ1 = ë1 + K1 e1_h + K2 ė̂1_h − Δu_h,     c = max ‖σ1‖,     Υ = max ‖Δu − Δu_h‖,     ϖ = min ‖s‖ while ĉ rises
        Γ = max (h/β) ∫_{−h}^0 (Bσ)ᵀ D Bσ,      σ = Δu_h + K2 ė1_h + σ1

    Parameters
    ----------
    run
        A run of the law.
    law
        The run's `tarc.laws.TARC`.
    decay_rate
        λ in place of λmin(Θ), which is never positive, such as λmin(Ψ) of Theorem 1. None for the bounds as printed,
        which are infinite.
    delay_weight
        D/β of the same theorem, (2n, 2n), 2n numbers or one; None leaves Γ out.
    decay_share
        z/λ, between 0 and 1.
    start_time
        Time from which samples count [s].

    Raises
    ------
    UnsupportedLaw
        For a law that is not TARC.
    InvalidParameter
        For a law that differs from the run's, numbers out of range, and a run with fewer than two samples.

    References
    ----------
    Paper, proof of Theorem 2, part 2, (c low) to (appen bound2).
    """
    law, signals = _signals(run, law, check.number("start_time", start_time, 0))
    if decay_rate is not None:
        check.number("decay_rate", decay_rate, 0, strict=True)
    if not 0 < check.number("decay_share", decay_share) < 1:
        raise InvalidParameter(
            f"decay_share: got {decay_share:g}; z must lie above 0 and below the decay rate, so give a share between 0 "
            "and 1"
        )
    eigenvalues = np.linalg.eigvalsh(law.P)
    constants = Constants(
        tde_error=_max_norm(signals.sigma1),
        correction_jump=_max_norm(signals.correction - signals.past_correction),
        forcing=0.0 if delay_weight is None else _forcing(law, signals, delay_weight),
        iota_norm=float(np.linalg.norm(np.hstack([law.P2, law.P3]), 2)),
        decay_rate=0.0 if decay_rate is None else decay_rate,
        decay_share=decay_share,
        max_eigenvalue=float(eigenvalues[-1]),
    )
    state = np.hstack([signals.error, signals.error_rate])
    with np.errstate(divide="ignore", invalid="ignore"):
        functional = np.einsum("ki,ij,kj->k", state, law.P, state)
        functional_ratio = functional / (eigenvalues[0] * np.sum(signals.error**2, axis=1))
    is_outside = signals.sliding >= law.boundary_layer
    outside = _rise(law, signals, is_outside, functional_ratio)
    inside = _rise(law, signals, ~is_outside, functional_ratio)
    return GainBounds(
        constants=constants,
        rise_outside=outside,
        rise_inside=inside,
        bounds=paper_bounds(law, constants, outside, inside, max_error=_max_norm(state)),
        notes=_notes(decay_rate, delay_weight is not None, outside, inside),
    )


def paper_bounds(
    law: TARC, constants: Constants, outside: GainRise, inside: GainRise, *, max_error: float
) -> PaperBounds:
    """Return the bounds, as printed, from their constants.

        μ1 = (Υ+c) ‖ι1‖ / (λ−z),     ϖ0 = μ1 + √(Γ/(λ−z) + μ1²),     l(c̄δt) = (Υ + c + c̄δt) ‖ι1‖ ϖ0 + Γ/2
        t1 = l(0) / (α c̄ ϖ²),        δt = (ρ/λ) ln(V_f / ρ̲φ²),        ĉ_M = l(c̄δt1) / (α ϖ)
        t2 = ε l(0) / (α c̄ ϖ³),                                       ĉ_m = ε l(c̄δt2) / (α ϖ²)

    with φ = ‖e1‖. All are infinite for λ = 0.

    Parameters
    ----------
    law
        For α, c̄ and ε.
    constants, outside, inside
        As measured; ρ̲ is in the functional ratio.
    max_error
        Largest ‖e‖ of the run.
    """
    disturbance = (constants.correction_jump + constants.tde_error) * constants.iota_norm
    remaining = constants.decay_rate * (1 - constants.decay_share)
    level = np.inf
    if remaining > 0:
        mu = disturbance / remaining
        level = float(mu + np.sqrt(constants.forcing / remaining + mu**2))
    drive = disturbance * level + constants.forcing / 2
    outer = _layer_bounds(law, constants, outside, drive, level, symbols=("t1", "δt1", "ĉ_M"), is_inside=False)
    inner = _layer_bounds(law, constants, inside, drive, level, symbols=("t2", "δt2", "ĉ_m"), is_inside=True)
    largest = float(np.fmax(outer.gain.value, inner.gain.value))
    observed = float(np.fmax(outer.gain.observed, inner.gain.observed))
    return PaperBounds(
        error=Bound("ϖ0", "of e", level, max_error),
        outside=outer,
        inside=inner,
        gain=Bound("c*", "rad/s²", largest, observed),
    )


def _layer_bounds(
    law: TARC,
    constants: Constants,
    rise: GainRise,
    drive: float,
    level: float,
    *,
    symbols: tuple[str, str, str],
    is_inside: bool,
) -> LayerBounds:
    """Return t, δt and the largest gain of one side of the layer; ``drive`` is l(0)."""
    factor = law.boundary_layer if is_inside else 1.0
    divisor = law.gain_factor * rise.min_sliding ** (2 if is_inside else 1)
    static_gain = factor * _quotient(drive, divisor)
    rise_time = _quotient(static_gain, law.rise_rate * rise.min_sliding)
    fade_time = np.nan
    if not np.isnan(rise.min_sliding):
        growth = np.log(max(rise.functional_ratio, 1.0))
        fade_time = constants.max_eigenvalue * _quotient(growth, constants.decay_rate)
    added_gain = factor * _quotient(law.rise_rate * fade_time * constants.iota_norm * level, divisor)
    return LayerBounds(
        rise_time=Bound(symbols[0], "s", rise_time, rise.longest_duration),
        fade_time=Bound(symbols[1], "s", fade_time, np.nan),
        gain=Bound(symbols[2], "rad/s²", static_gain + added_gain, rise.peak_gain),
    )


def _notes(decay_rate: float | None, has_forcing: bool, outside: GainRise, inside: GainRise) -> tuple[str, ...]:
    """Return what the numbers assume."""
    notes = [PRINTED_NOTE if decay_rate is None else SUBSTITUTE_NOTE.format(decay_rate=decay_rate)]
    notes += [FUNCTIONAL_NOTE, RATE_NOTE, UNITS_NOTE]
    if not has_forcing:
        notes.append(NO_FORCING_NOTE)
    notes += [
        f"{side} the boundary layer the gain never rises, so nothing is bounded there"
        for side, rise in (("outside", outside), ("inside", inside))
        if np.isnan(rise.min_sliding)
    ]
    return (*notes, ZERO_CROSSING_NOTE)


class _Signals(NamedTuple):
    """Signals of a run from the first sample with one h before it: vectors (k, n), and the last three (k,)."""

    error: Array
    error_rate: Array
    past_error_rate: Array
    correction: Array
    past_correction: Array
    sigma1: Array
    sliding: Array
    gain: Array
    is_rising: Array


def _signals(run: "Run", law: Law, start_time: float) -> tuple[TARC, _Signals]:
    """Return the law and the signals of its run, up to its fault or divergence."""
    if not isinstance(law, TARC):
        raise UnsupportedLaw(f"law: got {type(law).__name__}; the bounds are those of tarc.laws.TARC")
    data = run.data
    error = (data["position"] - data["reference"]).values
    sliding = np.linalg.norm(error @ law.P2.T, axis=1) if error.shape[1] == law.n_joints else np.zeros(0)
    _check_same_law(data, law, sliding)
    error_rate = (data["velocity"] - data["velocity_reference"]).values
    estimated_rate = (data["velocity_estimate"] - data["velocity_reference"]).values
    acceleration = (data["acceleration"] - data["acceleration_reference"]).values
    gain = data["gain"].values
    correction = -law.gain_factor * (gain / np.maximum(sliding, law.boundary_layer))[:, None] * (error @ law.P2.T)
    is_finite = np.isfinite(error + error_rate + acceleration).all(axis=1) & np.isfinite(gain)
    is_valid = (data["fault"].values == 0) & is_finite
    m = law.delay_periods
    end = len(is_valid) if is_valid.all() else int(np.argmin(is_valid))
    first = max(m, int(np.searchsorted(data["time"].values, start_time - 1e-9)))
    if end - first < 2:
        raise InvalidParameter(
            f"run: {max(end - first, 0)} samples of it can be used after {start_time:g} s ({run.status}); needs 2"
        )
    now, past = slice(first, end), slice(first - m, end - m)
    return law, _Signals(
        error=error[now],
        error_rate=error_rate[now],
        past_error_rate=error_rate[past],
        correction=correction[now],
        past_correction=correction[past],
        sigma1=acceleration[now] + error[past] @ law.K1.T + estimated_rate[past] @ law.K2.T - correction[past],
        sliding=sliding[now],
        gain=gain[now],
        is_rising=data["rising"].values[now] > 0.5,
    )


def _check_same_law(data: "xr.Dataset", law: TARC, sliding: Array) -> None:
    """Check that the run was made with this law.

    Raises
    ------
    InvalidParameter
        For another parameter, or another P2.
    """
    recorded = {**json.loads(data.attrs["law"]), "n_joints": data.sizes["joint"]}
    names = ("period", "n_joints", "rise_rate", "fall_rate", "boundary_layer", "gain_factor", "delay")
    for name, value in {"kind": "TARC", **{name: getattr(law, name) for name in names}}.items():
        if recorded.get(name) != value:
            raise InvalidParameter(
                f"law: its {name} is {value}, and that of the run's law {recorded.get(name)}; give that law"
            )
    if not np.allclose(sliding, data["sliding"].values, rtol=1e-6, equal_nan=True):
        raise InvalidParameter(
            "law: its P2 is not that of the run's law; give that law, with the same gains and Lyapunov weight"
        )


def _forcing(law: TARC, signals: _Signals, delay_weight: Matrix) -> float:
    """Return Γ, the largest of the integrals over one delay."""
    n, m = law.n_joints, law.delay_periods
    h = m * law.period
    sigma = signals.past_correction + signals.past_error_rate @ law.K2.T + signals.sigma1
    D = check.positive_definite("delay_weight", delay_weight, 2 * n)[n:, n:]
    power = np.einsum("ki,ij,kj->k", sigma, D, sigma)
    return float(h * law.period * np.max(np.convolve(power, np.ones(min(m, len(power))), "valid")))


def _rise(law: TARC, signals: _Signals, side: Array, functional_ratio: Array) -> GainRise:
    """Return the rises of the gain on one side of the layer."""
    is_rising = signals.is_rising & side
    peak_gain = float(np.max(signals.gain[side])) if side.any() else np.nan
    if not is_rising.any():
        return GainRise(np.nan, 0.0, np.nan, peak_gain)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_rising.astype(int), [0]])))
    starts, ends = edges[::2], edges[1::2]
    longest = int(np.argmax(ends - starts))
    return GainRise(
        min_sliding=float(np.min(signals.sliding[is_rising])),
        longest_duration=float((ends - starts)[longest] * law.period),
        functional_ratio=float(functional_ratio[ends[longest] - 1]),
        peak_gain=peak_gain,
    )


def _format_number(value: float) -> str:
    """Return a number with four digits, a dash for none."""
    return "–" if np.isnan(value) else f"{value:.4g}"


def _max_norm(rows: Array) -> float:
    """Return the largest norm of a row."""
    return float(np.max(np.linalg.norm(rows, axis=1)))


def _quotient(numerator: float, denominator: float) -> float:
    """Return the quotient, infinite for a denominator of zero."""
    return float(numerator / denominator) if denominator else np.inf
