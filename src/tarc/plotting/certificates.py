"""Figures of certificates."""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from tarc.plotting.runs import COLOURS

if TYPE_CHECKING:
    from tarc.certificates.base import Certificate
    from tarc.laws.pole_placement import PolePlacement


VERDICT_COLOURS = {"certified": COLOURS[2], "refuted": COLOURS[1], "inconclusive": COLOURS[4]}


def certificate_figure(certificate: "Certificate") -> Figure:
    """The evidence of one certificate, as suits its kind."""
    return FIGURES.get(certificate.kind, _forms)(certificate)


def _finish(figure: Figure, certificate: "Certificate") -> Figure:
    for axes in figure.axes:
        axes.grid(alpha=0.3)
    figure.suptitle(
        f"{certificate.kind}: {certificate.verdict}", fontsize="medium", color=VERDICT_COLOURS[certificate.verdict]
    )
    return figure


def _eigenvalues(axes: Axes, loops: dict[str, np.ndarray]) -> None:
    """Eigenvalues of loops in the unit circle, by label."""
    turn = np.linspace(0, 2 * np.pi, 400)
    axes.plot(np.cos(turn), np.sin(turn), color="0.6", lw=0.8)
    for colour, marker, (label, A) in zip(COLOURS, "x+1", loops.items(), strict=False):
        values = np.linalg.eigvals(A)
        axes.plot(values.real, values.imag, marker, color=colour, label=label)
    axes.set_aspect("equal")
    axes.set_title("eigenvalues", fontsize="medium")
    axes.legend(fontsize="small", loc="upper left")
    axes.grid(alpha=0.3)


def _block(loops: list[tuple[np.ndarray, ...]], ratio: float) -> np.ndarray:
    from scipy.linalg import block_diag

    return np.asarray(block_diag(*(A + ratio * b @ c for A, b, c in loops)))


def _loop(certificate: "Certificate") -> Figure:
    """Eigenvalues at both ends of the range, and the spectral radius over the ratio."""
    low, high = certificate.numbers["low"], certificate.numbers["high"]
    count = sum(name.startswith("A") for name in certificate.matrices)
    loops = [tuple(certificate.matrices[f"{letter}{i}"] for letter in "Abc") for i in range(count)]
    figure = Figure(figsize=(9, 4.2), layout="constrained")
    circle, radius = figure.subplots(1, 2)
    _eigenvalues(circle, {f"ρ = {ratio:.4g}": _block(loops, ratio) for ratio in dict.fromkeys((low, high))})
    ratios = np.geomspace(low / 30, high * 30, 400)
    largest = np.array([max(np.max(np.abs(np.linalg.eigvals(A + r * b @ c))) for A, b, c in loops) for r in ratios])
    gap = np.maximum(np.abs(largest - 1), 1e-9)
    radius.loglog(ratios, gap, color="0.3", lw=0.6)
    for sign, colour, label in ((largest < 1, COLOURS[2], "stable"), (largest >= 1, COLOURS[1], "unstable")):
        radius.plot(ratios, np.where(sign, gap, np.nan), color=colour, lw=2, label=label)
    radius.axvspan(low, high if high > low else low * 1.01, color=COLOURS[0], alpha=0.25, label="claimed")
    radius.set_xlabel("inertia ratio ρ")
    radius.set_ylabel("distance of the spectral radius from 1")
    radius.legend(fontsize="small")
    return _finish(figure, certificate)


def _slope(certificate: "Certificate") -> Figure:
    """S(e^{jω}), which must stay to the right of −1/k."""
    figure = Figure(figsize=(5.5, 4.5), layout="constrained")
    axes = figure.subplots()
    z = np.exp(1j * np.geomspace(1e-5, np.pi, 3000))[:, None, None]
    count, least = len(certificate.matrices) // 3, 0.0
    for i in range(count):
        A, B, C = (certificate.matrices[f"{letter}{i}"] for letter in "ABC")
        S = C @ np.linalg.solve(z * np.eye(len(A)) - A, B + 0 * z)
        values = np.linalg.eigvals(S).T
        for branch in values:
            axes.plot(branch.real, branch.imag, color=COLOURS[i], lw=1)
        least = min(least, float(values.real.min()))
    kappa = certificate.numbers["kappa"]
    if kappa > 0:
        axes.axvline(
            -1 / kappa, color=VERDICT_COLOURS[certificate.verdict], ls="--", label=f"−1/k, k = {kappa:.4g} 1/s²"
        )
        axes.legend(fontsize="small")
    axes.set_xlabel("real part of S [s²]")
    axes.set_ylabel("imaginary part [s²]")
    return _finish(figure, certificate)


def _ball(certificate: "Certificate") -> Figure:
    """The gain that limits the radius, over frequency, and the ratios that the ball holds and the robot needs."""
    from tarc.analysis.uncertain_loop import Parts, system, weighed
    from tarc.numerics.norms import gains, greatest

    numbers = certificate.numbers
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    if "centre" in numbers:
        angles = np.geomspace(1e-4, np.pi, 600)
        parts = Parts(*(certificate.matrices[name] for name in Parts._fields))
        if numbers["radius"] > 0 and "step" in numbers:
            A, B, Q, S, R = _form(certificate)
            left.semilogx(angles / numbers["period"], 1 + greatest(A, B, Q, S, R, angles), color=COLOURS[0])
        elif numbers["radius"] > 0:
            loop = system(parts, numbers["centre"], numbers.get("weight", 0.0))
            norm = gains(*weighed(loop, numbers["radius"], numbers.get("scale")), angles)
            left.semilogx(angles / numbers["period"], norm, color=COLOURS[0])
        left.axhline(1.0, color="0.5", ls="--", label="limit")
        left.set_xlabel("frequency [rad/s]")
        slow = "step" in numbers
        left.set_ylabel("weighted square gain, with the multiplier" if slow else "weighted gain of the loop")
        left.set_ylim(0, 1.1)
        left.legend(fontsize="small")
    rows = {"ball": (numbers.get("centre", np.nan) - numbers.get("radius", 0), numbers.get("centre", np.nan))}
    rows["ball"] = rows["ball"][0], numbers.get("centre", np.nan) + numbers.get("radius", 0)
    if "least ratio" in numbers:
        rows["robot"] = numbers["least ratio"], numbers["greatest ratio"]
    for place, (label, (low, high)) in enumerate(rows.items()):
        right.plot([low, high], [place, place], lw=6, solid_capstyle="butt", color=COLOURS[place], label=label)
    right.set_yticks(range(len(rows)), list(rows))
    right.set_ylim(-0.7, len(rows) - 0.3)
    right.set_xscale("log")
    right.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    right.xaxis.set_major_formatter("{x:g}")
    right.xaxis.set_minor_formatter(NullFormatter())
    right.set_xlabel("inertia ratio, eigenvalues of M(q)⁻¹M̂")
    return _finish(figure, certificate)


def _form(certificate: "Certificate") -> tuple[np.ndarray, ...]:
    """The form that a ball of bounded speed asks to be negative."""
    from tarc.analysis.uncertain_loop import Parts
    from tarc.certificates.iqc import dissipation
    from tarc.certificates.varying_ratio import multiplier_of

    numbers, parts = certificate.numbers, Parts(*(certificate.matrices[name] for name in Parts._fields))
    multiplier = multiplier_of(certificate.matrices, numbers)
    given = numbers["centre"], numbers["radius"], numbers["step"], multiplier
    return dissipation(parts, *given, numbers.get("weight", 0.0), numbers.get("stiffness", 0.0))


def _forms(certificate: "Certificate") -> Figure:
    """Eigenvalues of the symmetric forms that must be positive definite, their diagonals scaled to one."""
    figure = Figure(figsize=(6, 3.8), layout="constrained")
    axes = figure.subplots()
    forms = certificate.evidence.forms()
    for colour, (label, form) in zip(COLOURS, forms.items(), strict=False):
        scale = 1 / np.sqrt(np.maximum(np.abs(np.diag(form)), 1e-300))
        values = np.sort(np.linalg.eigvalsh(form * scale * scale[:, None]))
        axes.plot(np.arange(1, len(values) + 1), values, "o-", color=colour, lw=0.8, label=label)
    axes.axhline(0.0, color="0.4", lw=0.8)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("number of the eigenvalue")
    axes.set_ylabel("eigenvalue, diagonal scaled to one")
    axes.legend(fontsize="small")
    return _finish(figure, certificate)


FIGURES: dict[str, Callable[[Any], Figure]] = {"loop": _loop, "slope": _slope, "ball": _ball, "robot": _ball}


def design_figure(law: "PolePlacement", certificates: dict[str, "Certificate"], computation_delay: int = 0) -> Figure:
    """Where a design stands: stability over window and ratio, gains over frequency, eigenvalues.

    Parameters
    ----------
    law
        The law that was certified.
    certificates
        As `tarc.certify_law` gives them.
    computation_delay
        Periods between a measurement and its torque.
    """
    from tarc.analysis.linearise import decouple
    from tarc.analysis.stability import from_disturbance, from_noise
    from tarc.numerics.norms import gains

    verdict = certificates["robot"]
    low, high = verdict.numbers["least ratio"], verdict.numbers["greatest ratio"]
    ratios = {"least ratio": low, "mean": float(np.sqrt(low * high)), "greatest ratio": high}
    channels = decouple(law, computation_delay)
    figure = Figure(figsize=(13, 8), layout="constrained")
    (map_axes, circle), (error, torque) = figure.subplots(2, 2)
    _map(map_axes, law, low, high, computation_delay, verdict.numbers.get("rate"))
    from scipy.linalg import block_diag

    _eigenvalues(
        circle,
        {
            f"{name}, {one:.4g}": np.asarray(block_diag(*(c.closed(one) for c in channels)))
            for name, one in ratios.items()
        },
    )
    angles = np.geomspace(1e-4, 0.99 * np.pi, 500)
    for axes, system, label in (
        (error, from_disturbance, "disturbing acceleration to error [s²]"),
        (torque, from_noise, "noise to M̂⁻¹τ [1/s²]"),
    ):
        for colour, (name, one) in zip(COLOURS, ratios.items(), strict=False):
            gain = np.max([gains(*system(channel, one), angles) for channel in channels], axis=0)
            axes.loglog(angles / law.period, gain, color=colour, label=name)
        axes.set_xlabel("frequency [rad/s]")
        axes.set_ylabel(label)
        axes.legend(fontsize="small")
        axes.grid(alpha=0.3)
    figure.suptitle(
        f"{type(law).__name__}: {verdict.verdict}", fontsize="large", color=VERDICT_COLOURS[verdict.verdict]
    )
    return figure


def _map(axes: Axes, law: "PolePlacement", low: float, high: float, computation_delay: int, rate: float | None) -> None:
    """Stable ratios, and the widest ball, over the window, with the design marked; without a window over the ratio.

    With a rate it is the ball that suits the design: the widest may be at another scale of M̂, and so another rate.
    """
    from tarc.analysis.linearise import alike, decouple
    from tarc.analysis.stability import stable_intervals
    from tarc.certificates.varying_ratio import certify_varying_ratio
    from tarc.core.errors import TarcError
    from tarc.estimators.algebraic import Algebraic

    estimator = law.estimator
    own, estimators = 1, [estimator]
    if isinstance(estimator, Algebraic):
        own = estimator.samples - 1
        longest = max(min(4 * own, 40), 30, 1.3 * own)  # the time grows with its cube
        counts = sorted({*np.geomspace(estimator.degree, longest, 14).astype(int).tolist(), own})
        estimators = [replace(estimator, window=count * law.period) for count in counts]
    else:
        counts = [0, 2]
        estimators = [estimator, estimator]
    if any(channel.width > 1 for channel in decouple(law)):
        axes.set_axis_off()
        axes.text(0.5, 0.5, "the gains couple the joints: no map", ha="center", transform=axes.transAxes)
        return
    exact, held = np.full((len(counts), 2), np.nan), np.full((len(counts), 2), np.nan)
    for i, one in enumerate(estimators):
        other = replace(law, estimator=one)
        found = stable_intervals(other, computation_delay=computation_delay)
        if found:
            exact[i] = max(found, key=lambda ends: ends[1] / max(ends[0], 1e-300))
        if alike(law):
            try:
                about = None if rate is None else (low, high)
                numbers = certify_varying_ratio(
                    other, contains=about, rate=rate, computation_delay=computation_delay
                ).numbers
                held[i] = numbers["low"], numbers["high"]
            except TarcError:
                pass
    axes.fill_between(
        counts, exact[:, 0], exact[:, 1], color=COLOURS[5], alpha=0.5, lw=0, label="stable if the ratio is constant"
    )
    words = "stable if it varies: widest ball" if rate is None else "if it varies as fast as the joints move: a ball"
    axes.fill_between(counts, held[:, 0], held[:, 1], color=COLOURS[2], alpha=0.6, lw=0, label=words)
    axes.plot([own, own], [low, high], "o-", color=COLOURS[1], lw=3, ms=4, label="this design on this robot")
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter("{x:g}")
    if len(counts) > 2:
        axes.set_xlabel("window [periods]")
    else:
        axes.set_xticks([])
    axes.set_ylabel("inertia ratio")
    axes.legend(fontsize="small")
    axes.grid(alpha=0.3)
