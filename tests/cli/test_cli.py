"""The command line: what it prints and writes, once as it is installed."""

import importlib.metadata
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from typer.main import get_command

from tarc import Run
from tarc.cli.main import app
from tarc.scenario.yaml_text import write_yaml
from tarc_command import run_tarc

TARC = str(Path(sys.executable).parent / "tarc")


@pytest.fixture
def scenario(tmp_path):
    content = {
        "robot": {"kind": "Pendulum"},
        "law": [
            {"kind": "TARC", "inertia": 0.05, "natural_frequency": 10.0, "rise_rate": 1000.0, "fall_rate": 1000.0},
            {"kind": "TDC", "inertia": 0.05, "natural_frequency": 10.0},
        ],
        "estimator": {"kind": "Algebraic", "window": 0.010},
        "reference": {"kind": "Sinusoid", "amplitude": [0.5], "frequency": 2.0},
        "sensor": {"bits": 16},
        "duration": 1.0,
    }
    (tmp_path / "swing.yaml").write_text(write_yaml(content))
    return tmp_path


def test_help_shows_units():
    """Square brackets are styles in the help, unless a backslash is before them."""

    def commands(group):
        for command in getattr(group, "commands", {}).values():
            yield command
            yield from commands(command)

    texts = [parameter.help or "" for command in commands(get_command(app)) for parameter in command.params]
    assert len(texts) > 100
    assert [text for text in texts if re.search(r"(?<!\\)\[[a-zN]", text)] == []


def test_the_installed_command_writes_what_it_says(scenario):
    call = [TARC, "run", "swing.yaml", "--set", "law.natural_frequency=12"]
    done = subprocess.run(call, cwd=scenario, capture_output=True, text=True, check=True)
    assert "RMS error" in done.stdout
    folder = scenario / "runs" / "swing"
    assert {file.name for file in folder.iterdir()} == {
        "scenario.yaml",
        "TARC.nc",
        "TDC.nc",
        "tracking.png",
        "column.pdf",
    }
    assert (folder / "tracking.png").read_bytes().startswith(b"\x89PNG")
    assert (folder / "column.pdf").read_bytes().startswith(b"%PDF")
    run = Run.load(folder / "TARC.nc")
    assert json.loads(run.data.attrs["law"])["natural_frequency"] == 12
    again = run_tarc("run", "runs/swing/scenario.yaml", "--json", "--no-figures", "--out", "again", cwd=scenario)
    metrics = json.loads(again.stdout)["runs"]["TARC"]["metrics"]
    assert metrics["rms_error"] == pytest.approx(run.metrics()["rms_error"], rel=1e-12)


def test_run_writes_an_animation_of_all_laws(scenario):
    run_tarc("run", "swing.yaml", "--no-figures", "--animate", "swing.html", cwd=scenario)
    assert "<title>TARC on Pendulum, TDC on Pendulum</title>" in (scenario / "swing.html").read_text(encoding="utf-8")
    done = run_tarc("run", "swing.yaml", "--animate", "nosuch/swing.html", cwd=scenario, status=2)
    assert "the folder nosuch does not exist" in done.stderr


def test_divergence_is_a_result_not_a_failure(scenario):
    out = run_tarc("run", "swing.yaml", "--set", "law.inertia=3.0", "--json", "--no-figures", cwd=scenario).stdout
    results = json.loads(out)["runs"]
    assert results["TDC"]["status"] == "diverged"
    assert 0 < results["TDC"]["divergence_time"] < 1


def test_bad_input_is_one_line_and_status_2(scenario):
    done = run_tarc("run", "swing.yaml", "--set", "law.bandwith=3", cwd=scenario, status=2)
    assert done.stderr.startswith("error: law.0.bandwith: unknown key")
    assert "Traceback" not in done.stderr
    assert not (scenario / "runs").exists()


def test_unwritable_folder(scenario):
    (scenario / "taken").write_text("a file, not a folder")
    done = run_tarc("run", "swing.yaml", "--out", "taken/here", cwd=scenario, status=2)
    assert "error: --out: cannot write taken/here" in done.stderr


def test_show(tmp_path):
    everything = run_tarc("show", cwd=tmp_path).stdout
    for word in ("TARC", "TDC", "TwoLinkArm", "Algebraic", "Sinusoid", "Payload", "Encoder", "ur5e, "):
        assert word.strip(", ") in everything
    one = run_tarc("show", "TARC", cwd=tmp_path).stdout
    assert "rise_rate" in one
    assert "neither a bound on the uncertainty" in " ".join(one.split())
    assert "`" not in one
    assert "required" in one
    assert run_tarc("show", "tarc", cwd=tmp_path).stdout == one
    assert "shoulder_pan_joint" in run_tarc("show", "UR5e", cwd=tmp_path).stdout
    assert "kind: Multisine" in run_tarc("show", "panda_multisine", cwd=tmp_path).stdout
    assert "law" in json.loads(run_tarc("show", "--json", cwd=tmp_path).stdout)
    assert "Did you mean 'TARC'?" in run_tarc("show", "TRAC", cwd=tmp_path, status=2).stderr


def test_help_names_the_commands(tmp_path):
    text = run_tarc("--help", cwd=tmp_path).stdout
    for command in ("run", "demo", "show"):
        assert command in text


def test_names_stay_inside_the_folder(scenario):
    settings = ["--set", "name=../../evil", "--set", "law.0.label=a/b", "--set", "law.1.label=a-b"]
    run_tarc("run", "swing.yaml", *settings, "--no-figures", cwd=scenario)
    (folder,) = (scenario / "runs").iterdir()
    assert sorted(file.name for file in folder.glob("*.nc")) == ["a-b-2.nc", "a-b.nc"]


def test_python_m_tarc_works(tmp_path):
    done = subprocess.run([sys.executable, "-m", "tarc", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == importlib.metadata.version("tarc-control")
