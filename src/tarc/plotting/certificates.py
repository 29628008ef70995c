"""Figures of certificates."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from tarc.plotting.style import COLOURS, StyledFigure

if TYPE_CHECKING:
    from tarc.certificates.base import Certificate
    from tarc.certification import LawCertification, StabilityMap


TITLES = {
    "robot": "robot certificate",
    "constant_ratio": "constant-ratio certificate",
    "sector": "sector certificate",
    "varying_ratio": "varying-ratio certificate",
    "lemma1": "Lemma 1",
    "c2": "condition (c2)",
    "theorem1": "Theorem 1",
    "theorem2": "Theorem 2",
    "nominal": "nominal loop",
    "region": "region of attraction",
}
VERDICT_COLOURS = {"certified": COLOURS[2], "refuted": COLOURS[1], "inconclusive": COLOURS[4]}


def certificate_figure(certificate: "Certificate") -> Figure:
    """Draw the evidence of one certificate."""
    if certificate.kind in FIGURES:
        return FIGURES[certificate.kind](certificate)
    return conditions_figure([certificate])


def _margins(*, bottom: float = 0.13, top: float = 0.88, **more: float) -> dict[str, float]:
    """Return the margins of a figure; to measure all labels takes as long as to draw them."""
    return {"bottom": bottom, "top": top, **more}


def _power_of_ten(value: float, place: int) -> str:
    """Return the label of a tick; as plain text, since mathematical text takes most of the drawing time."""
    exponent = int(np.rint(np.log10(value)))
    return "10" + str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def _label_powers(axes: Axes, names: str) -> None:
    """Label the ticks of logarithmic axes, ``"x"``, ``"y"`` or ``"xy"``, and drop those between."""
    for name in names:
        axis: Axis = getattr(axes, f"{name}axis")
        axis.set_major_formatter(FuncFormatter(_power_of_ten))
    axes.minorticks_off()


def _finish(figure: Figure, certificate: "Certificate") -> Figure:
    for axes in figure.axes:
        axes.grid(alpha=0.3)
        axes.minorticks_off()  # those of logarithmic axes take most of the drawing time
    figure.suptitle(
        f"{TITLES[certificate.kind]}: {certificate.verdict}",
        fontsize="medium",
        color=VERDICT_COLOURS[certificate.verdict],
    )
    return figure


def _eigenvalues(axes: Axes, loops: dict[str, np.ndarray]) -> None:
    """Draw eigenvalues in the unit circle, by label."""
    turn = np.linspace(0, 2 * np.pi, 400)
    axes.plot(np.cos(turn), np.sin(turn), color="0.6", lw=0.8)
    for colour, marker, (label, values) in zip(COLOURS, "x+1", loops.items(), strict=False):
        axes.plot(np.real(values), np.imag(values), marker, color=colour, label=label)
    axes.set_aspect("equal", anchor="W")
    axes.set_title("eigenvalues", fontsize="medium")
    axes.set_xlabel("real part")
    axes.set_ylabel("imaginary part")
    axes.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    axes.grid(alpha=0.3)


def _block(loops: list[tuple[np.ndarray, ...]], ratio: float) -> np.ndarray:
    from scipy.linalg import block_diag

    return np.asarray(block_diag(*(A + ratio * b @ c for A, b, c in loops)))


def _constant_ratio(certificate: "Certificate") -> Figure:
    """Draw the eigenvalues at both ends of the range, and the spectral radius over the ratio."""
    evidence = certificate.evidence
    low, high = evidence.min_ratio, evidence.max_ratio
    loops = [(loop.A, loop.B, loop.C) for loop in evidence.loops]
    figure = StyledFigure(figsize=(9, 4.2))
    circle, radius = figure.subplots(1, 2, gridspec_kw=_margins(left=0.1, right=0.98, wspace=0.6))
    _eigenvalues(
        circle, {f"ρ = {ratio:.4g}": np.linalg.eigvals(_block(loops, ratio)) for ratio in dict.fromkeys((low, high))}
    )
    ratios = np.geomspace(low / 30, high * 30, 250)
    largest = np.array([max(np.max(np.abs(np.linalg.eigvals(A + r * b @ c))) for A, b, c in loops) for r in ratios])
    gap = np.maximum(np.abs(largest - 1), 1e-9)
    radius.loglog(ratios, gap, color="0.3", lw=0.6)
    for sign, colour, label in ((largest < 1, COLOURS[2], "stable"), (largest >= 1, COLOURS[1], "unstable")):
        radius.plot(ratios, np.where(sign, gap, np.nan), color=colour, lw=2, label=label)
    radius.axvspan(low, high if high > low else low * 1.01, color=COLOURS[0], alpha=0.25, label="claimed")
    _label_powers(radius, "xy")
    radius.set_xlabel("inertia ratio ρ")
    radius.set_ylabel("|spectral radius − 1|")
    radius.legend(fontsize="small")
    return _finish(figure, certificate)


def _sector(certificate: "Certificate") -> Figure:
    """Draw S(e^{jω}), which must stay to the right of −1/k."""
    figure = StyledFigure(figsize=(5.5, 4.5))
    axes = figure.subplots(gridspec_kw=_margins(left=0.2, right=0.96))
    z = np.exp(1j * np.geomspace(1e-5, np.pi, 3000))[:, None, None]
    least = 0.0
    for i, loop in enumerate(certificate.evidence.loops):
        A, B, C = loop.A, loop.B, loop.C
        S = C @ np.linalg.solve(z * np.eye(len(A)) - A, B + 0 * z)
        values = np.linalg.eigvals(S).T
        for branch in values:
            axes.plot(branch.real, branch.imag, color=COLOURS[i], lw=1)
        least = min(least, float(values.real.min()))
    kappa = certificate.evidence.max_slope
    if kappa > 0:
        axes.axvline(
            -1 / kappa, color=VERDICT_COLOURS[certificate.verdict], ls="--", label=f"−1/k, k = {kappa:.4g} 1/s²"
        )
        axes.legend(fontsize="small")
    axes.set_xlabel("real part of S [s²]")
    axes.set_ylabel("imaginary part [s²]")
    return _finish(figure, certificate)


def _varying_ratio(certificate: "Certificate") -> Figure:
    """Draw the gain that limits the radius over frequency, and the ratios that are allowed and that the robot has."""
    evidence = certificate.evidence
    ball = evidence.ball
    figure = StyledFigure(figsize=(9, 3.8))
    left, right = figure.subplots(1, 2, gridspec_kw=_margins(left=0.07, right=0.98, wspace=0.22, bottom=0.14, top=0.89))
    rows = {"allowed": (np.nan, np.nan)}
    if ball is not None:
        rows["allowed"] = ball.min_ratio, ball.max_ratio
        angles = np.geomspace(1e-4, np.pi, 600)
        if ball.radius > 0:
            left.semilogx(angles / evidence.period, ball.gains(angles), color=COLOURS[0])
            _label_powers(left, "x")
        left.axhline(1.0, color="0.5", ls="--", label="limit")
        left.set_xlabel("frequency [rad/s]")
        has_rate = ball.max_change is not None
        left.set_ylabel("weighted square gain, with the multiplier" if has_rate else "weighted gain of the loop")
        left.set_ylim(0, 1.1)
        left.legend(fontsize="small")
    if certificate.kind == "robot":
        rows["robot"] = evidence.min_ratio, evidence.max_ratio
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


def conditions_figure(certificates: Sequence["Certificate"]) -> Figure:
    """Draw the smallest eigenvalue of each matrix that must be positive definite, its diagonal scaled to one."""
    labels: list[str] = []
    eigenvalues: list[float] = []
    colours: list[str] = []
    for certificate in certificates:
        for name, form in certificate.evidence.forms().items():
            scale = 1 / np.sqrt(np.maximum(np.abs(np.diag(form)), 1e-300))
            labels.append(f"{TITLES[certificate.kind]}, {name}")
            eigenvalues.append(float(np.linalg.eigvalsh(form * scale * scale[:, None])[0]))
            colours.append(VERDICT_COLOURS[certificate.verdict])
    figure = StyledFigure(figsize=(8, 1.2 + 0.32 * len(labels)), layout="constrained")
    axes = figure.subplots()
    rows = np.arange(len(labels))[::-1]
    axes.barh(rows, eigenvalues, height=0.6, color=colours)
    axes.axvline(0.0, color="0.3", lw=0.8)
    axes.set_yticks(rows, labels)
    axes.margins(x=0.15)
    for row, value in zip(rows, eigenvalues, strict=True):
        offset = 4 if value >= 0 else -4
        axes.annotate(
            f"{value:.3g}",
            (value, row),
            (offset, 0),
            textcoords="offset points",
            va="center",
            fontsize="small",
            ha="left" if value >= 0 else "right",
        )
    axes.set_xlabel("smallest eigenvalue, diagonal scaled to one; above zero is positive definite")
    axes.grid(axis="x", alpha=0.3)
    verdicts = {str(certificate.verdict): VERDICT_COLOURS[certificate.verdict] for certificate in certificates}
    handles = [Patch(color=colour, label=verdict) for verdict, colour in verdicts.items()]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), fontsize="small")
    return figure


def _region(certificate: "Certificate") -> Figure:
    """Draw the largest error of each joint that ever occurs, at the start, and in the end."""
    evidence = certificate.evidence
    sizes = {"allowed": evidence.max_error}
    if evidence.proof is not None:
        sizes |= {"never exceeded": evidence.tube_errors, "at the start, one joint alone": evidence.start_errors}
        sizes["in the end"] = evidence.final_errors
    figure = StyledFigure(figsize=(6.5, 4.2))
    axes = figure.subplots(gridspec_kw=_margins(left=0.14, right=0.97))
    joints = np.arange(1, len(evidence.max_error) + 1)
    for (label, errors), marker in zip(sizes.items(), "_vo^", strict=False):
        axes.semilogy(joints, errors, marker, label=label, ms=9)
    _label_powers(axes, "y")
    axes.set_xticks(joints)
    axes.set_xlim(0.5, len(joints) + 0.5)
    axes.set_xlabel("joint")
    axes.set_ylabel("error [rad or m]")
    axes.legend(fontsize="small")
    return _finish(figure, certificate)


FIGURES: dict[str, Callable[[Any], Figure]] = {
    "region": _region,
    "robot": _varying_ratio,
    "constant_ratio": _constant_ratio,
    "sector": _sector,
    "varying_ratio": _varying_ratio,
}


def design_figure(certification: "LawCertification") -> Figure:
    """Draw stability over window and ratio, gains over frequency, and eigenvalues of a law that was certified."""
    law, verdict = certification.law, certification.verdict
    figure = StyledFigure(figsize=(13, 8))
    margins = _margins(left=0.065, right=0.98, bottom=0.07, top=0.92, wspace=0.17, hspace=0.24)
    (map_axes, circle), (error, torque) = figure.subplots(2, 2, gridspec_kw=margins)
    _map(map_axes, certification.stability_map)
    labels = {name: f"{name}, {ratio:.4g}" for name, ratio in certification.ratios.items()}
    _eigenvalues(circle, {labels[name]: values for name, values in certification.eigenvalues.items()})
    angles = np.geomspace(1e-4, 0.99 * np.pi, 500)
    disturbed, noisy = certification.gains_over_frequency(angles)
    for axes, curves, label in (
        (error, disturbed, "disturbing acceleration to error [s²]"),
        (torque, noisy, "noise to M̂⁻¹τ [1/s²]"),
    ):
        for colour, (name, gain) in zip(COLOURS, curves.items(), strict=False):
            axes.loglog(angles / law.period, gain, color=colour, label=name)
        axes.set_xlabel("frequency [rad/s]")
        axes.set_ylabel(label)
        axes.legend(fontsize="small")
        axes.grid(alpha=0.3)
        _label_powers(axes, "xy")
    figure.suptitle(
        f"{type(law).__name__}: {verdict.verdict_in_words}",
        fontsize="large",
        color=VERDICT_COLOURS[verdict.verdict],
    )
    return figure


def _map(axes: Axes, data: "StabilityMap | None") -> None:
    """Draw stable constant and varying ratios over the window, with the law marked."""
    if data is None:
        axes.set_axis_off()
        axes.text(0.5, 0.5, "the gains couple the joints: no map", ha="center", transform=axes.transAxes)
        return
    label = "stable if the ratio is constant"
    axes.fill_between(data.windows, *data.stable.T, color=COLOURS[5], alpha=0.5, lw=0, label=label)
    label = "stable if the ratio varies"
    if data.rate is not None:
        label = "stable if it varies as fast as the joints move"
    axes.fill_between(data.windows, *data.tolerated.T, color=COLOURS[2], alpha=0.6, lw=0, label=label)
    window = [data.window, data.window]
    axes.plot(window, data.required, "o-", color=COLOURS[1], lw=3, ms=4, label="this design on this robot")
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())
    if len(data.windows) > 2:
        axes.set_xlabel("window [periods]")
    else:
        axes.set_xticks([])
    axes.set_ylabel("inertia ratio")
    axes.legend(fontsize="small")
    axes.grid(alpha=0.3)
