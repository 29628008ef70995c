"""`tarc export fmu`: what it writes and prints, and options that do not fit."""

import json
import zipfile

import pytest
from typer.testing import CliRunner

from tarc.cli.main import app

pytest.importorskip("fmpy")


def run(*words, status=0):
    result = CliRunner().invoke(app, ["export", "fmu", "two_link_payload", *map(str, words)])
    assert result.exit_code == status, result.output
    return result


def test_an_fmu_of_a_scenario_is_written_and_described(tmp_path):
    file = tmp_path / "build" / "arm.fmu"
    printed = run("-o", file, "--fmi", "3.0", "--platforms", "none").output
    assert "TDC by FMI 3.0" in printed
    assert "natural_frequency, damping_ratio" in printed
    assert "fixed: inertia, since it is a matrix" in printed
    assert "communication step: 0.001 s" in printed
    with zipfile.ZipFile(file) as archive:
        assert "scenario:" in archive.read("resources/law.yaml").decode()
        assert not [name for name in archive.namelist() if name.startswith("binaries/")]
    content = json.loads(run("-o", file, "--platforms", "none", "--tunable", "damping_ratio", "--json").output)
    assert content["tunable"] == ["damping_ratio"]
    assert content["fmi"] == "2.0"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--real", "float"], "not with the format fmu"),
        (["--firmware"], "only with the format c"),
        (["--platforms", "amiga"], "platforms: got 'amiga'"),
        (["--tunable", "inertia"], "cannot stay changeable: it is a matrix"),
        (["--fmi", "1.0"], "fmi: got '1.0'"),
    ],
)
def test_options_that_do_not_fit_are_refused(options, words, tmp_path):
    result = run("-o", tmp_path / "arm.fmu", *options, status=1)
    assert words in str(result.exception) + result.output
    assert not (tmp_path / "arm.fmu").exists()
