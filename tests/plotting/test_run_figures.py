"""Figures of runs: every joint and law finds room, events are marked, and the fonts are those that IEEE accepts."""

import json
import re
import zlib
from itertools import combinations

import numpy as np
import pytest
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.text import Text

from tarc import Run, Scenario, estimators
from tarc.plotting.runs import error_norms, run_figure
from tarc.simulation.run_events import payload_mass, run_events, saturated_spans

LAWS = ("TARC", "TDC", "MonotoneASMC", "NonsingularTerminal", "TARC, 30 rad/s, window 20 ms", "PID + gravity")
JOINTS = ("shoulder_pan_joint", "left_arm_shoulder_yaw_joint_17")
EVENTS = [
    {"kind": "Payload", "mass": 2.0, "start_time": 0.5, "stop_time": 1.5},
    {"kind": "StepDisturbance", "amplitude": 3.0, "start_time": 0.2, "stop_time": 0.4},
    {"kind": "ImpulseDisturbance", "amplitude": 3.0, "start_time": 1.7},
]


def run_of(n_joints: int, number: int, events: list[dict[str, object]]) -> Run:
    """Return a run put together by hand; every second law has a gain, of another size."""
    count = 101
    time = np.arange(count) * 0.02
    rng = np.random.default_rng(number)
    reference = np.sin(time)[:, None] * np.ones(n_joints)
    error = 1e-3 * rng.standard_normal((count, n_joints))
    torque = 100 * np.sin(2 * time)[:, None] * np.linspace(0.2, 1, n_joints)
    variables = {
        "position": (("time", "joint"), reference + error, {"units": "rad"}),
        "reference": (("time", "joint"), reference, {"units": "rad"}),
        "torque": (("time", "joint"), torque, {"units": "N m"}),
        "torque_limit": ("joint", np.full(n_joints, 99.0)),
    }
    if number % 2 == 0:
        variables["gain"] = ("time", 40.0**number * (1 + np.sin(time)), {"units": "rad/s²"})
    coordinates = {
        "time": time,
        "joint": [f"{JOINTS[i % 2]}{i}" for i in range(n_joints)],
        "joint_unit": ("joint", ["rad"] * n_joints),
    }
    attributes = {"period": 0.02, "divergence_time": np.nan, "disturbance": json.dumps(events), "plant": "{}"}
    return Run(xr.Dataset(variables, coordinates, attributes))


def runs_of(n_joints: int, n_laws: int, events: list[dict[str, object]] = EVENTS) -> dict[str, Run]:
    return {name: run_of(n_joints, number, events) for number, name in enumerate(LAWS[:n_laws])}


def overlaps(figure: Figure) -> list[str]:
    """Return the texts and legends of a figure that overlap others, or lie outside the figure."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    boxes = []
    for legend in figure.findobj(Legend):
        boxes.append(("legend", legend.get_window_extent(renderer)))
    in_legends = {text for legend in figure.findobj(Legend) for text in legend.get_texts()}
    for axes in figure.axes:
        boxes += [(f"panel {axes.get_title()}", axes.get_window_extent(renderer))] if axes.axison else []
    skipped = set(in_legends)
    for axes in figure.axes:
        drawn, known = tick_labels(axes)
        skipped |= known - set(drawn) if axes.axison else {text for text in axes.findobj(Text)}
    for text in figure.findobj(Text):
        if text.get_visible() and text.get_text().strip() and text not in skipped:
            boxes.append((text.get_text(), text.get_window_extent(renderer)))
    page = figure.bbox
    problems = [
        f"{name} leaves the page"
        for name, box in boxes
        if box.x0 < page.x0 - 1 or box.y0 < page.y0 - 1 or box.x1 > page.x1 + 1 or box.y1 > page.y1 + 1
    ]
    for (first, a), (second, b) in combinations(boxes, 2):
        width, height = min(a.x1, b.x1) - max(a.x0, b.x0), min(a.y1, b.y1) - max(a.y0, b.y0)
        if width > 0.5 and height > 0.5:
            problems.append(f"{first} on {second}")
    return problems


def tick_labels(axes: Axes) -> tuple[list[Text], set[Text]]:
    """Return the labels of ticks that are drawn, and the labels of all ticks."""
    drawn, known = [], set()
    for axis in (axes.xaxis, axes.yaxis):
        known |= {tick.label1 for tick in [*axis.get_major_ticks(), *axis.get_minor_ticks()]}
        drawn += [tick.label1 for tick in axis._update_ticks()]  # type: ignore[attr-defined] - no public method knows which are drawn
        known |= set(drawn)
    return drawn, known


@pytest.mark.parametrize(("n_joints", "n_laws"), [(1, 5), (7, 3)])
@pytest.mark.parametrize("style", ["screen", "column"])
def test_nothing_overlaps(style, n_joints, n_laws):
    assert not overlaps(run_figure(runs_of(n_joints, n_laws), style))


def test_nothing_overlaps_where_there_is_most():
    assert not overlaps(run_figure(runs_of(12, 6)))


@pytest.mark.slow
@pytest.mark.parametrize("n_laws", range(1, 7))
@pytest.mark.parametrize("n_joints", range(1, 13))
@pytest.mark.parametrize("style", ["screen", "column"])
def test_nothing_overlaps_over_the_whole_grid(style, n_joints, n_laws):
    assert not overlaps(run_figure(runs_of(n_joints, n_laws), style))


def test_overlaps_are_found():
    figure = Figure()
    axes = figure.subplots()
    axes.text(0.5, 0.5, "one")
    axes.text(0.5, 0.5, "two")
    assert "one on two" in overlaps(figure)


def test_errors_of_every_joint_come_first_and_gains_are_in_scale():
    runs = runs_of(4, 5)
    figure = run_figure(runs)
    for i, axes in enumerate(figure.axes[:4]):
        drawn = axes.lines[-len(runs) :]
        error = 1e3 * (runs["TARC"].data["position"] - runs["TARC"].data["reference"]).values[:, i]
        assert any(np.array_equal(line.get_ydata(), error) for line in axes.lines), len(drawn)
    gain = next(axes for axes in figure.axes if axes.get_ylabel().startswith("gain"))
    assert len(gain.lines[:3]) == 3
    for line in gain.lines[:3]:
        peak = float(np.max(np.asarray(line.get_ydata())))
        assert gain.get_ylim()[0] <= peak <= gain.get_ylim()[1]
        assert gain.transAxes.inverted().transform(gain.transData.transform((0.0, peak)))[1] > 0.05, "can be seen"


def test_laws_and_events_are_named():
    figure = run_figure(runs_of(2, 2))
    (legend,) = figure.legends
    labels = [text.get_text() for text in legend.get_texts()]
    named = [
        "TARC",
        "TDC",
        "torque step",
        "payload 2 kg",
        "torque impulse",
        "torque at its limit",
        "ĉ rises",
        "ĉ falls",
    ]
    assert labels == named
    dashed = [np.asarray(line.get_xdata()) for line in figure.axes[0].lines if line.get_linestyle() == "--"]
    assert sorted({float(times[0]) for times in dashed}) == [0.5, 1.5, 1.7]


@pytest.mark.parametrize("style", ["screen", "column"])
def test_fonts_of_a_pdf_are_truetype(style, tmp_path):
    run_figure(runs_of(1, 1), style).savefig(tmp_path / "run.pdf")
    estimators.Algebraic(window=0.01, period=1e-3).plot().savefig(tmp_path / "estimator.pdf")
    for file in tmp_path.glob("*.pdf"):
        content = file.read_bytes()
        for stream in re.findall(rb"stream\r?\n(.*?)endstream", content, re.DOTALL):
            try:
                content += zlib.decompress(stream)
            except zlib.error:
                continue
        assert b"/CIDFontType2" in content
        assert b"/FontFile2" in content, "embedded"
        assert not re.search(rb"/Type3\b", content)


def test_events_are_those_of_the_simulation():
    run = Scenario.load("ur5e", ["duration=0.1", "disturbance.0.start_time=0.05", "native=false"]).run(progress=False)
    data = run["TDC"].data
    (event,) = run_events(data)
    assert (event.kind, event.start_time, event.label) == ("payload", 0.05, "payload 5 kg")
    assert payload_mass(data, np.array([0.0, 0.049, 0.05, 0.09])).tolist() == [0, 0, 5, 5]


def test_saturated_spans_by_hand():
    run = run_of(1, 1, [])
    torque = np.zeros((101, 1))
    torque[[10, 11, 12, 50, 60]] = 99.0
    data = run.data.assign(torque=(("time", "joint"), torque))
    assert np.array(saturated_spans(data)) == pytest.approx(np.array([[0.2, 0.24], [1.0, 1.0], [1.2, 1.2]]))
    assert np.array(saturated_spans(data, 0.3)) == pytest.approx(np.array([[0.2, 0.24], [1.0, 1.2]]))
    assert saturated_spans(run.data.assign(torque=(("time", "joint"), 0 * torque))) == []


def test_error_norm_is_by_unit():
    data = run_of(2, 1, []).data
    error = (data["position"] - data["reference"]).values
    assert error_norms(data)["rad"] == pytest.approx(np.hypot(*error.T))
