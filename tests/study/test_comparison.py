"""Laws side by side: the runs are those of the scenario, the table is theirs, what fails is said."""

import csv
import json
import sys
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any

import numpy as np
import pytest

import tarc
from tarc.core.errors import InvalidParameter
from tarc.study import compare, default_search_spaces, tuned_laws
from tarc_command import run_tarc

SHORT = ["duration=1.2", "metrics_start=0.4"]


def short_scenario(name="two_link_payload", *settings):
    return tarc.Scenario.load(name, [*SHORT, *settings])


def test_runs_are_those_of_the_scenario_with_that_law():
    found = compare(short_scenario(), ["tdc"], jobs=1)
    alone = short_scenario("two_link_payload", "law=" + json.dumps(tuned_laws()["tdc"])).run()
    np.testing.assert_array_equal(found.runs["tdc"].data["torque"], alone["TDC"].data["torque"])
    assert found.measures["tdc"]["rms_error"] == alone["TDC"].metrics(start_time=0.4)["rms_error"]


@pytest.mark.slow
def test_processes_give_what_one_process_gives():
    one, two = (compare(short_scenario(), ["tarc", "tdc"], jobs=jobs) for jobs in (1, 2))
    assert list(one.runs) == list(two.runs) == ["tarc", "tdc"]
    for name in one.runs:
        np.testing.assert_array_equal(one.runs[name].data["position"], two.runs[name].data["position"])


def test_front_holds_those_that_no_other_beats_in_both():
    found = compare(short_scenario(), ["tarc", "tdc", "pid", "adrc", "smc"], jobs=1)
    points = {name: (one["rms_error"], one["torque_variation"]) for name, one in found.measures.items()}
    for name, (error, variation) in points.items():
        beaten = any(e <= error and v <= variation and (e, v) != (error, variation) for e, v in points.values())
        assert (name in found.front) == (not beaten)


def test_what_cannot_run_is_said_and_the_others_run():
    parts = {"fine": tuned_laws()["tdc"], "odd": {"kind": "TDC", "inertia": [1.0, 1.0, 1.0], "natural_frequency": 10.0}}
    found = compare(short_scenario(), parts, jobs=1)
    assert list(found.runs) == ["fine"]
    assert "joints" in found.failures["odd"]


@pytest.mark.parametrize(
    ("law", "message"),
    [
        ({"kind": "TDC", "inertia": 1.0, "natural_frequency": -1.0}, r"natural_frequency: got [-1.0, -1.0]"),
        ({"kind": "TDC", "inertia": 1.0, "natural_frequenzy": 1.0}, "natural_frequenzy: unknown key"),
    ],
)
def test_a_value_and_a_key_at_fault_are_failures(law, message):
    assert message in compare(short_scenario(), {"odd": law}, jobs=1).failures["odd"]


def test_an_empty_list_of_laws_is_refused():
    with pytest.raises(InvalidParameter, match="laws: got none; known are "):
        compare(short_scenario(), [])


def test_a_diverged_law_is_a_result():
    parts = {
        "wild": {"kind": "TDC", "inertia": {"fraction": 1.0}, "natural_frequency": 10.0},
        "tdc": tuned_laws()["tdc"],
    }
    found = compare(short_scenario(), parts, jobs=1)
    assert not found.runs["wild"].status.completed
    assert found.measures["wild"] == {}
    assert found.front == ["tdc"]
    assert "diverged" in found.to_csv()
    assert "wild & --" in found.to_latex()


def test_a_law_that_is_unstable_at_rest_is_named_and_never_marked():
    parts = {
        "hidden": {"kind": "TDC", "inertia": {"fraction": 0.23}, "natural_frequency": 15.0},
        "calm": {"kind": "PID", "inertia": {"fraction": 0.1}, "natural_frequency": 4.0},
    }
    found = compare(short_scenario("two_link_payload", "sensor={}"), parts, jobs=1)
    assert found.runs["hidden"].status.completed
    assert found.measures["hidden"]["rms_error"] < found.measures["calm"]["rms_error"]
    assert found.front == ["calm"]
    assert "stable from" in found.unstable["hidden"]
    assert "completed, unstable at rest" in found.to_csv()


def test_writes_what_it_says(tmp_path):
    found = compare(short_scenario(), ["tarc", "tdc"], jobs=1)
    files = found.save(tmp_path / "deep" / "folder")
    assert {file.name for file in files} == {
        "comparison.csv",
        "comparison.tex",
        "tarc.nc",
        "tdc.nc",
        "plane.png",
        "side.png",
        "gain.png",
    }
    rows = {row["law"]: row for row in csv.DictReader(files[0].read_text().splitlines())}
    assert float(rows["tdc"]["rms_error"]) == found.measures["tdc"]["rms_error"]
    assert tarc.Run.load(files[2]).status.completed
    assert all(file.stat().st_size > 5000 for file in files if file.suffix == ".png")


def test_units_are_those_of_the_joints():
    found = compare(short_scenario("vibration"), ["tdc"], jobs=1)
    assert found.columns["rms_error"][2] == "mm"
    assert "RMS error [mm]" in found.to_latex()
    assert "peak torque [N]" in found.to_latex()


def test_every_space_has_tuned_gains_and_every_gain_lies_in_its_space():
    known = tuned_laws()
    assert set(known) == set(default_search_spaces())
    for name, space in default_search_spaces().items():
        for key, (low, high) in space.free.items():
            node: Any = known[name]
            for step in key.split("."):
                node = node[step]
            assert low * 0.99 <= node <= high * 1.01, (name, key)


@pytest.mark.parametrize("name", sorted(tuned_laws()))
def test_every_tuned_law_is_bounded_on_the_two_link_arm(name):
    found = compare(short_scenario("two_link_friction", "duration=2.0"), [name], jobs=1)
    torque = found.runs[name].data["torque"].values
    assert np.all(np.isfinite(torque))
    if found.runs[name].status.completed:
        assert np.abs(torque).max() < 500.0


@pytest.mark.slow
def test_command(tmp_path):
    arguments = ["two_link_payload", "--laws", "tarc,tdc", "--set", "duration=1.2", "--set", "metrics_start=0.4"]
    call = ["compare", *arguments, "--out", "here", "--jobs", "1"]
    done = run_tarc(*call, cwd=tmp_path)
    assert "tarc *" in done.stdout or "tdc *" in done.stdout
    assert "[mrad]" in done.stdout
    assert (tmp_path / "here" / "comparison.tex").is_file()
    plain = run_tarc(*call, "--json", "--no-figures", cwd=tmp_path)
    content = json.loads(plain.stdout)
    assert set(content["laws"]) == {"tarc", "tdc"}
    assert content["failures"] == {}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--laws", "tarcc"], "laws: got 'tarcc'"),
        (["--jobs", "0"], "jobs: got 0"),
    ],
)
def test_bad_input(tmp_path, arguments, message):
    done = run_tarc("compare", "two_link_payload", *arguments, cwd=tmp_path, status=2)
    assert message in done.stderr


class Dying(ThreadPoolExecutor):
    """A pool whose process is killed when it comes to one of the laws."""

    def __init__(self, count, mp_context):
        super().__init__(count)

    def submit(self, function, /, content, name, part):  # type: ignore[override] - of this one call
        def work():
            if name == "pid":
                raise BrokenProcessPool
            return function(content, name, part)

        return super().submit(work)


def test_a_killed_process_loses_only_what_it_ran(monkeypatch):
    module = sys.modules["tarc.study.comparison"]
    monkeypatch.setattr(module, "ProcessPoolExecutor", Dying)
    found = compare(short_scenario(), ["tdc", "pid"], jobs=2)
    assert list(found.runs) == ["tdc"]
    assert "killed" in found.failures["pid"]
    assert 'pid,"failed: its process was killed' in found.to_csv()
