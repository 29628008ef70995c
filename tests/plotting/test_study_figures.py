"""Figures of studies draw what they are handed."""

import numpy as np
import pytest

from tarc.plotting.study import (
    distribution_figure,
    levels_figure,
    rate_figure,
    ratio_figure,
    scatter_figure,
    sensitivity_figure,
    worst_case_figure,
)
from tarc.study.rare_events import RareProbability, SplittingLevel
from tarc.study.sensitivity import Sensitivity
from tarc.study.statistics import Interval, compare_laws


def lines_of(axes):
    return [np.asarray(line.get_xdata(), dtype=float).tolist() for line in axes.lines]


def test_rates_have_a_bar_and_a_point_each():
    (axes,) = rate_figure({"TDC": Interval(0.9, 0.85, 0.94), "TARC": Interval(1.0, 0.97, 1.0)}).axes
    assert lines_of(axes) == [pytest.approx([85, 94]), pytest.approx([90]), pytest.approx([97, 100]), [100]]


def test_diverged_runs_keep_a_distribution_below_all():
    values = np.append(np.arange(1.0, 91.0), np.full(10, np.nan))
    (axes,) = distribution_figure({"TDC": values}, {"TDC": {0.5: Interval(50, 40, 60)}}, "error").axes
    curve = axes.lines[0].get_ydata()
    assert np.max(np.asarray(curve)) == pytest.approx(90)
    assert lines_of(axes)[1] == [40, 60]


def test_many_laws_differ_by_line_style_and_their_legend_is_beside_the_curves():
    rng = np.random.default_rng(3)
    values = {f"law {number}": rng.lognormal(size=50) for number in range(20)}
    figure = distribution_figure(values, {name: {} for name in values}, "error")
    (axes,) = figure.axes
    assert len({(line.get_color(), line.get_linestyle()) for line in axes.lines}) == 20
    figure.draw_without_rendering()
    legend, curves = figure.legends[0].get_window_extent(), axes.get_window_extent()
    assert curves.x1 < legend.x0
    assert legend.y0 >= 0
    assert legend.y1 <= figure.bbox.y1


def test_ratios_show_which_interval_excludes_one():
    reference = np.random.default_rng(1).lognormal(size=(100, 1))
    comparisons = compare_laws(reference * [1.0, 0.5, 1.0], ["TDC", "less", "same"])
    (axes,) = ratio_figure(comparisons, "RMS error").axes
    assert axes.lines[1].get_xdata() == pytest.approx([0.5])
    assert axes.lines[0].get_color() != axes.lines[2].get_color()
    assert "TDC" in axes.get_xlabel()


def test_sensitivities_of_words_have_no_coefficient():
    found = Sensitivity(
        ("a", "b"),
        {"a": Interval(0.7, 0.6, 0.8), "b": Interval(0.1, 0.0, 0.2)},
        {"a": Interval(0.8, 0.7, 0.9), "b": None},
        0.7,
        100,
        True,
    )
    left, right = sensitivity_figure({"TDC": found}, ["a", "b"]).axes
    assert len(left.lines) == 5  # two bars, two points and the entry of the legend
    assert len(right.lines) == 3  # a bar, a point and zero


def test_of_many_laws_and_draws_a_figure_has_those_that_matter():
    keys = [f"key {number}" for number in range(40)]
    index = {key: Interval(0.02, 0.01 if key == "key 30" else -0.01, 0.05) for key in keys}
    found = Sensitivity(tuple(keys), index, dict.fromkeys(keys), 0.7, 100, True)
    left, _ = sensitivity_figure({f"law {number}": found for number in range(9)}, keys).axes
    assert [text.get_text() for text in left.get_yticklabels()] == ["key 30"]
    assert len({line.get_label() for line in left.lines if not str(line.get_label()).startswith("_")}) == 7


def test_scatter_matrix_is_a_triangle():
    rng = np.random.default_rng(2)
    measure = rng.lognormal(size=200)
    measure[:5] = np.nan
    draws = {"a": rng.random(200), "b": 10 ** (-6 + 3 * rng.random(200)), "c": rng.choice([14.0, 16.0], 200)}
    figure = scatter_figure(draws, measure, "error [mrad]")
    drawn = [axes for axes in figure.axes if axes.axison]
    assert len(drawn) == 6
    assert np.size(drawn[0].lines[0].get_xdata()) == 195
    assert drawn[2].get_xticks().tolist() == [14, 16]
    figure.draw_without_rendering()


def test_worst_case_and_levels():
    time = np.linspace(0, 1, 50)
    (axes,) = worst_case_figure({"typical": (time, 1 + time), "worst": (time, 100 * time)}, "error", 5000.0).axes
    assert len(axes.lines) == 2  # the threshold is far away
    levels = (SplittingLevel(1.0, 0.1, 1.0, 0.3), SplittingLevel(2.0, 0.2, 0.4, 0.4))
    found = RareProbability(2.0, Interval(0.02, 0.01, 0.04), (0.02,) * 3, (levels,) * 3, 0.5, 100, np.zeros(1), 1)
    (axes,) = levels_figure(found, "log error").axes
    assert axes.lines[0].get_ydata() == pytest.approx([0.1, 0.02])
