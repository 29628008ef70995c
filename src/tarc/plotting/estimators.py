"""The figure of an estimator."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from tarc.plotting.style import COLOURS, StyledFigure

if TYPE_CHECKING:
    from tarc.estimators.base import Estimator


def estimator_figure(estimator: "Estimator") -> Figure:
    """Draw the gain relative to the ideal derivative, and the phase error, over frequency."""
    period = estimator.sampling_period
    frequency = np.geomspace(1.0, np.pi / period, 600)
    figure = StyledFigure(figsize=(7, 5), layout="constrained")
    gain, phase = figure.subplots(2, 1, sharex=True)
    for colour, order, name in zip(COLOURS, (1, 2), ("velocity", "acceleration"), strict=False):
        if order > estimator.max_derivative:
            continue
        ratio = estimator.frequency_response(frequency, order) / (1j * frequency) ** order
        delay, noise = round(estimator.group_delay(order) * 1e3, 9) + 0.0, estimator.noise_gain(order)
        label = f"{name}: delay {delay:.2f} ms, noise gain {noise:.3g} s$^{{-{order}}}$"
        gain.loglog(frequency, np.abs(ratio), color=colour, label=label)
        lag = np.rad2deg(np.unwrap(np.angle(ratio)))
        phase.semilogx(frequency, np.where(np.abs(ratio) > 1e-3, lag, np.nan), color=colour)
    gain.axhline(1.0, color="0.6", lw=0.8)
    gain.set_ylim(1e-2, 10)
    gain.set_ylabel("gain / ideal")
    gain.legend(fontsize="small", loc="lower left")
    phase.set_ylabel("phase error [°]")
    phase.set_xlabel("frequency [rad/s]")
    gain.set_title(f"{type(estimator).__name__}, period {period * 1e3:g} ms", fontsize="medium")
    for axes in (gain, phase):
        axes.grid(alpha=0.3)
        axes.margins(x=0)
    return figure
