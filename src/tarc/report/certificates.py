"""Figures of certificates."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from tarc.report.figures import COLOURS

if TYPE_CHECKING:
    from tarc.certificates.base import Certificate


def certificate_figure(certificate: "Certificate") -> Figure:
    """Eigenvalues of the loop in the unit circle at both ends of its range, and the spectral radius over the ratio."""
    low, high = certificate.numbers["low"], certificate.numbers["high"]
    count = sum(name.startswith("A") for name in certificate.matrices)
    loops = [[certificate.matrices[f"{letter}{i}"] for letter in "Abc"] for i in range(count)]
    figure = Figure(figsize=(9, 4.2), layout="constrained")
    circle, radius = figure.subplots(1, 2)
    turn = np.linspace(0, 2 * np.pi, 400)
    circle.plot(np.cos(turn), np.sin(turn), color="0.6", lw=0.8)
    for colour, ratio in zip(COLOURS, dict.fromkeys((low, high)), strict=False):
        values = np.concatenate([np.linalg.eigvals(A + ratio * b @ c) for A, b, c in loops])
        circle.plot(values.real, values.imag, "x", color=colour, label=f"ρ = {ratio:g}")
    circle.set_aspect("equal")
    circle.set_title("eigenvalues", fontsize="medium")
    circle.legend(fontsize="small", loc="upper left")
    ratios = np.geomspace(low / 30, high * 30, 400)
    largest = [max(np.max(np.abs(np.linalg.eigvals(A + ratio * b @ c))) for A, b, c in loops) for ratio in ratios]
    radius.loglog(ratios, np.maximum(np.abs(np.array(largest) - 1), 1e-9), color="0.3", lw=0.6)
    stable = np.array(largest) < 1
    for sign, colour, label in ((stable, COLOURS[2], "stable"), (~stable, COLOURS[1], "unstable")):
        gap = np.where(sign, np.maximum(np.abs(np.array(largest) - 1), 1e-9), np.nan)
        radius.plot(ratios, gap, color=colour, lw=2, label=label)
    radius.axvspan(low, high if high > low else low * 1.01, color=COLOURS[0], alpha=0.25, label="claimed")
    radius.set_xlabel("inertia ratio ρ")
    radius.set_ylabel("distance of the spectral radius from 1")
    radius.set_title(f"{certificate.kind}: {certificate.verdict}", fontsize="medium")
    radius.legend(fontsize="small")
    for axes in (circle, radius):
        axes.grid(alpha=0.3)
    return figure
