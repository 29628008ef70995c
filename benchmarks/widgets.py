"""Data of the widgets in the documentation: window, kernel, inertia ratio and stability map.

Run `python -m benchmarks.widgets`; it writes docs/assets/widget-data.js in two minutes. The pages then need no server.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

import tarc
from tarc.core.errors import NoStableRatio

PERIOD = 1e-3
TARGET = Path(__file__).parents[1] / "docs" / "assets" / "widget-data.js"
WINDOWS = (3, 5, 10, 20, 50)
DEGREES = (1, 2, 3)
DELAY_DIGITS = 9
"""Digits of a delay [periods]: what is less is rounding."""
FREQUENCIES = np.geomspace(10.0, 3000.0, 70)
"""Frequencies of the responses [rad/s]."""
NATURAL_FREQUENCIES = np.geomspace(2.0, 100.0, 20)
"""Of the stability map [rad/s]."""
RATIOS = np.geomspace(0.003, 4.0, 22)
"""Inertia ratios whose responses are stored."""
RESPONSE_TIME = 0.8
N_POINTS = 80
LOOP = {"natural_frequency": 10.0, "period": PERIOD}


def window(periods: int, degree: int) -> tarc.estimators.Algebraic:
    """Return an estimator with its period."""
    return tarc.estimators.Algebraic(window=periods * PERIOD, degree=degree).with_period(PERIOD)


def rounded(values: Any, digits: int = 4) -> list[float | None]:
    """Return numbers with a few significant digits; None for what is not finite."""
    return [float(f"{value:.{digits}g}") if np.isfinite(value) else None for value in np.asarray(values, float)]


def estimators() -> dict[str, Any]:
    """Return weights, kernel, delay, noise gain and relative response by window, degree and derivative."""
    data = {}
    for periods in WINDOWS:
        for degree in DEGREES:
            for derivative in range(1, min(degree, 2) + 1):
                data[f"{periods}/{degree}/{derivative}"] = estimator(periods, degree, derivative)
    return data


def estimator(periods: int, degree: int, derivative: int) -> dict[str, Any]:
    """Return what the widgets show of one estimator.

    Weights are those of the newest sample first [1/s^d]. The kernel has the same unit: it is multiplied by the period.
    """
    one = window(periods, degree)
    places = np.linspace(0.0, periods * PERIOD, 61)
    response = one.frequency_response(FREQUENCIES, derivative) / (1j * FREQUENCIES) ** derivative
    return {
        "weights": rounded(one.weights(derivative)),
        "kernel": rounded(one.kernel(-places, derivative=derivative) * PERIOD),
        "delay": round(float(f"{1e3 * abs(one.group_delay(derivative)):.3g}"), DELAY_DIGITS),
        "noise": float(f"{one.noise_gain(derivative):.3g}"),
        "gain": rounded(np.abs(response)),
    }


def law(periods: int, synchronised: bool, natural_frequency: float, inertia: float = 0.1) -> tarc.laws.TDC:
    """Return the law of a loop."""
    return tarc.laws.TDC(
        inertia=inertia,
        natural_frequency=natural_frequency,
        period=PERIOD,
        estimator=window(periods, 2),
        synchronised=synchronised,
    )


def interval(periods: int, synchronised: bool, natural_frequency: float) -> tuple[float, float]:
    """Return the widest stable interval of the inertia ratio, nan for none."""
    try:
        return tarc.analysis.stable_interval(law(periods, synchronised, natural_frequency))
    except NoStableRatio:
        return np.nan, np.nan


def stability_maps() -> dict[str, Any]:
    """Return the ends of the stable interval over the natural frequency, by window and kind of estimation."""
    maps = {}
    for periods in WINDOWS:
        for synchronised in (False, True):
            ends = np.array([interval(periods, synchronised, frequency) for frequency in NATURAL_FREQUENCIES])
            maps[f"{periods}/{int(synchronised)}"] = {"low": rounded(ends[:, 0]), "high": rounded(ends[:, 1])}
    return maps


def responses() -> dict[str, Any]:
    """Return errors after a start 0.1 rad away from the reference, by window, kind of estimation and ratio."""
    data = {}
    for periods in (5, 10, 20):
        for synchronised in (False, True):
            low, high = interval(periods, synchronised, LOOP["natural_frequency"])
            errors = [response(periods, synchronised, ratio) for ratio in RATIOS]
            data[f"{periods}/{int(synchronised)}"] = {"interval": rounded([low, high], 3), "errors": errors}
    return data


def response(periods: int, synchronised: bool, ratio: float) -> list[float | None]:
    """Return the error of a mass of 1 kg with M̂ = ρ kg [m], shape (N_POINTS,); None where it is beyond 1 m."""
    plant = tarc.plants.MassSpringDamper(springs=0.0, dampers=0.0)
    controlled = law(periods, synchronised, LOOP["natural_frequency"], ratio)
    reference = tarc.signals.Sinusoid(amplitude=[0.0], frequency=1.0)
    run = tarc.simulate(plant, controlled, reference, RESPONSE_TIME, initial_position=[0.1])
    times = np.linspace(0.0, RESPONSE_TIME - PERIOD, N_POINTS)
    recorded = run.data["time"].values
    error = np.interp(times, recorded, run.data["position"].values[:, 0], right=np.nan)
    return [None if value is None or abs(value) > 1 else value for value in rounded(error, 3)]


def main() -> None:
    """Write the data."""
    data = {
        "frequencies": rounded(FREQUENCIES),
        "estimators": estimators(),
        "natural_frequencies": rounded(NATURAL_FREQUENCIES),
        "maps": stability_maps(),
        "ratios": rounded(RATIOS),
        "response_time": RESPONSE_TIME,
        "responses": responses(),
    }
    text = json.dumps(data, separators=(",", ":"))
    TARGET.write_text(f"// written by python -m benchmarks.widgets\nwindow.tarcWidgetData={text};\n", encoding="utf-8")
    print(f"{TARGET}: {TARGET.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
