"""``tarc certify --region``: errors from which the laws of a scenario recover."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from tarc import Scenario
from tarc.cli.main import app
from tarc.core.errors import UnsupportedLaw
from tarc.scenario.yaml_text import write_yaml

CONTENT = {
    "name": "swing",
    "robot": {"kind": "Pendulum", "viscous": 0.1},
    "law": [
        {"kind": "TDC", "inertia": 0.1, "natural_frequency": 20.0},
        {"kind": "TDC", "label": "model", "inertia": {"model": True, "fraction": 0.1}, "natural_frequency": 20.0},
        {"kind": "PID", "label": "other", "inertia": 0.1, "natural_frequency": 20.0},
    ],
    "estimator": {"kind": "Algebraic", "window": 0.003},
    "reference": {"kind": "Quintic", "points": [[0.2], [1.0]], "times": [0.0, 1.0]},
    "sensor": {"bits": 17, "noise": 1e-5},
    "duration": 1.0,
}


@pytest.mark.slow
def test_region_of_a_scenario_as_text_and_json(tmp_path):
    path = tmp_path / "swing.yaml"
    path.write_text(write_yaml(CONTENT))
    command = ["certify", str(path), "--region", "0.5", "--torque-rate", "5", "--out", str(tmp_path / "out")]
    shown = CliRunner().invoke(app, [*command, "--json", "--no-figures"])
    assert shown.exit_code == 0, shown.output
    summary = json.loads(shown.stdout)
    found = summary["regions"]["TDC"]
    assert found["verdict"] == "certified"
    assert found["final_errors"] < found["start_errors"] < found["tube_errors"]
    assert summary["regions"]["model"]["verdict"] == "certified"
    assert "covers tarc.laws.TDC and TARC" in summary["skipped"]["other"]
    verified = CliRunner().invoke(app, ["verify", summary["files"][0]])
    assert verified.exit_code == 0, verified.output


def test_a_region_takes_noise_payload_and_friction_from_the_scenario(monkeypatch):
    given = {}

    def record(law, plants, reference, duration, **options):
        given.update(options, plants=plants, law=law)
        raise UnsupportedLaw("law: recorded")

    monkeypatch.setattr("tarc.scenario.certified_regions.certify_region", record)
    robot = {"kind": "TwoLinkArm", "coulomb": [0.5, 0.2]}
    scenario = Scenario.parse(
        CONTENT
        | {
            "robot": robot,
            "law": {"kind": "TDC", "inertia": 0.1, "natural_frequency": 20.0},
            "reference": {"kind": "Quintic", "points": [[0.2, 0.5], [1.0, 1.0]], "times": [0.0, 1.0]},
            "disturbance": [{"kind": "Payload", "mass": 2.0, "start_time": 0.5}],
        }
    )
    with pytest.raises(UnsupportedLaw, match="recorded"):
        scenario.certify_regions(0.1, torque_rate=3.0)
    assert given["friction"] == pytest.approx([0.5, 0.2])
    assert given["measurement_error"] == pytest.approx(np.full(2, np.pi / 2**17 + 5e-5))
    assert [float(plant.parameters["payload"]) for plant in given["plants"]] == [0.0, 2.0]
    assert given["law"].torque_limit is None
