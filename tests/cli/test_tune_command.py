"""`tarc tune` with two objectives, a storage, a margin and a best scenario."""

import csv
import subprocess
import sys
from pathlib import Path

import pytest

from tarc import Scenario, TarcError
from tarc.cli.tune import check_objectives
from tarc.scenario.yaml_text import read_yaml

TARC = str(Path(sys.executable).parent / "tarc")
SCENARIO = """
robot: {kind: TwoLinkArm, viscous: [0.8, 0.8], coulomb: [2.0, 1.0]}
law: {kind: TDC, inertia: {fraction: 0.05}, natural_frequency: 12.0}
estimator: {kind: Algebraic, window: 0.010, degree: 2}
reference: {kind: Multisine, amplitude: [0.25, 0.3], frequency: [1.2, 2.6], offset: [0.2, 1.2]}
sensor: {bits: 15}
initial_torque: rest
duration: 0.8
metrics_start: 0.3
"""


def tarc(folder, *arguments):
    """Run the command in a folder."""
    (folder / "arm.yaml").write_text(SCENARIO)
    call = [TARC, *arguments]
    return subprocess.run(call, cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_the_front_is_written_and_its_knee_runs(tmp_path):
    call = ["tune", "arm.yaml", "--laws", "tdc", "--trials", "16", "--jobs", "1", "--budget", "1000"]
    call += ["--objectives", "error,variation", "--margin", "0", "--storage", "search.journal"]
    done = tarc(tmp_path, *call, "--front", "front.csv", "--best", "best.yaml")
    assert done.returncode == 0, done.stderr
    rows = list(csv.DictReader((tmp_path / "front.csv").read_text().splitlines()))
    assert all(float(row["margin"]) >= 0 for row in rows)
    assert (tmp_path / "front.png").stat().st_size > 5000
    best = Scenario.load(tmp_path / "best.yaml")
    assert list(best.laws) == ["tdc"]
    (run,) = best.run(progress=False).values()
    assert run.status.completed
    error = run.metrics(start_time=0.3)["rms_error"]
    assert min(abs(float(row["rms_error"]) / error - 1) for row in rows) < 0.01
    assert best.certify(samples=50)["tdc"].verdict.certified  # as the margin has it

    again = tarc(tmp_path, *call, "--front", "again.yaml", "--pick", "error")
    points = read_yaml((tmp_path / "again.yaml").read_text(), "again")["points"]
    assert [point["rms_error"] for point in points] == [float(row["rms_error"]) for row in rows]
    assert read_yaml((tmp_path / "gains.yaml").read_text(), "gains")["laws"]["tdc"] == points[0]["law"]
    assert again.returncode == 0

    other = tarc(tmp_path, *call[:-1], "other.journal", "--seed", "1", "--storage", "search.journal")
    assert other.returncode == 2
    assert "other seed" in other.stderr


@pytest.mark.parametrize(
    ("objectives", "pick", "words"),
    [("error,margin", "knee", "allowed: error, or error,variation"), ("error", "elbow", "knee")],
)
def test_wrong_options_are_refused(objectives, pick, words):
    with pytest.raises(TarcError, match=words):
        check_objectives(objectives, pick)


@pytest.mark.slow
def test_a_law_without_a_certificate_is_named_and_the_others_go_on(tmp_path):
    call = ["tune", "arm.yaml", "--laws", "tdc,asmc-tde", "--trials", "6", "--jobs", "1", "--budget", "1000"]
    done = tarc(tmp_path, *call, "--margin", "0")
    assert done.returncode == 0, done.stderr
    assert "asmc-tde: none. margin: nothing bounds the slope" in done.stdout
    assert set(read_yaml((tmp_path / "gains.yaml").read_text(), "gains")["laws"]) == {"tdc"}
