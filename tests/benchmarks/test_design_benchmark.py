"""The benchmark of the design, on the smallest robot and with little time."""

import csv

import numpy as np
import pytest

import tarc
from benchmarks import design as bench

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def report():
    arm = tarc.plants.TwoLinkArm(viscous=[0.5, 0.5], coulomb=[1.0, 0.5])
    return bench.measure(
        "two-link",
        arm,
        1.0,
        sweeps=bench.SWEEPS[:1],
        budget=2.0,
        motion=False,
        duration=4.0,
        samples=100,
        natural_frequency=10.0,
        torque_limits=[100.0, 50.0],
    )


def test_design_is_certified_and_carries_the_payload(report):
    assert report.verdict == "certified"
    assert report.picked_up == report.loaded == "completed"


def test_torque_noise_is_within_a_factor_of_two_of_the_prediction(report):
    assert bench.within(report), report.ratios


def test_hand_pick_keeps_to_the_terms(report):
    (pick,) = report.picks
    assert pick.tried > 1
    assert pick.verdict in ("certified", "inconclusive", "refuted")
    assert pick.variation <= report.variation
    assert pick.natural_frequency == report.natural_frequency


def test_tables_and_files_hold_what_was_measured(report, tmp_path):
    for sheet in bench.sheets([report]):
        assert all(len(row) == len(sheet.heads) for row in sheet.rows)
    bench.write([report], {"other": "nothing tolerates it"}, tmp_path)
    text = (tmp_path / "design.md").read_text(encoding="utf-8")
    assert "two-link: m I" in text
    assert "other: no design. nothing tolerates it" in text
    with (tmp_path / "noise.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["measured"]) for row in rows] == pytest.approx(report.measured)
    with (tmp_path / "designs.csv").open(encoding="utf-8") as file:
        assert float(next(csv.DictReader(file))["error"]) == pytest.approx(report.error)


def test_picks_are_literal_with_the_switching_gain_and_without(report):
    estimator = tarc.estimators.Algebraic(window=0.01)
    common = {"inertia": 0.1, "natural_frequency": 10.0, "period": 1e-3, "estimator": estimator, "torque_limit": 5.0}
    law = tarc.laws.TARC(**common, rise_rate=100.0, fall_rate=50.0, max_gain=1.0, synchronised=True)
    own, plain = bench.literal(law)
    assert isinstance(own, tarc.laws.TARC)
    assert own.rise_rate == 100.0
    assert isinstance(plain, tarc.laws.TDC)
    assert plain.torque_limit == 5.0
    assert not own.synchronised
    assert not plain.synchronised


def test_points_fill_the_cube_evenly():
    points = np.array([bench._spread_out(i) for i in range(512)])
    cells = np.unique((points * 4).astype(int), axis=0)
    assert len(cells) == 64
