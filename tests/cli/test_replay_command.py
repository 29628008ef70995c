"""`tarc replay`: its tables, files and refusals."""

import json

import numpy as np
import pytest

from tarc_command import run_tarc


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with a log of two joints, whose columns have names of their own."""
    place = tmp_path_factory.mktemp("log")
    times = 0.002 * np.arange(1500)
    q = np.column_stack([0.3 * np.sin(4 * times), 0.5 * np.cos(3 * times)])
    table = np.column_stack([times, np.degrees(q), 2 * q])
    np.savetxt(place / "log.csv", table, delimiter=",", header="clock,a,b,fa,fb", comments="")
    (place / "columns.yaml").write_text(
        "time: clock\nposition: [a, b]\ntorque: [fa, fb]\nunits: {position: deg}\n", encoding="utf-8"
    )
    return place


def test_tables_figure_and_page(folder):
    done = run_tarc("replay", "log.csv", "--columns", "columns.yaml", "--window", "0.01,0.02", cwd=folder)
    assert "samples per second" in done.stdout
    assert "delay is predicted as 10 ms" in done.stdout
    assert (folder / "runs" / "log" / "replay.png").stat().st_size > 10_000
    assert "<h2>Timing</h2>" in (folder / "runs" / "log" / "replay.html").read_text(encoding="utf-8")


def test_json_and_refusals(folder):
    done = run_tarc("replay", "log.csv", "--columns", "columns.yaml", "--json", "--no-figures", cwd=folder)
    found = json.loads(done.stdout)
    assert found["timing"]["rate"] == pytest.approx(500, rel=1e-3)
    assert found["windows"][0]["delay"] == pytest.approx([0.005, 0.005], abs=1e-4)
    error = run_tarc("replay", "log.csv", cwd=folder, status=2).stderr
    assert error.startswith("error: path: log.csv has no position that is known by its name; it has clock, a, b")
    error = run_tarc("replay", "log.csv", "panda", "--columns", "columns.yaml", cwd=folder, status=2).stderr
    assert "has 7 joints" in error
