"""`tarc verify` on files as they were written, and on forged ones."""

import json

import pytest
from typer.testing import CliRunner

import tarc
from tarc.certificates import certify_constant_ratio, certify_varying_ratio
from tarc.cli.main import app
from tarc.core.errors import InvalidParameter
from tarc.estimators import Algebraic

LAW = tarc.laws.TDC(
    inertia=0.1, natural_frequency=10.0, period=1e-3, estimator=Algebraic(window=0.010, degree=2), synchronised=True
)


def run(*words):
    return CliRunner().invoke(app, ["verify", *map(str, words)])


@pytest.fixture
def file(tmp_path):
    content = {
        "constant_ratio": certify_constant_ratio(LAW, (0.2, 0.9)).to_dict(),
        "varying_ratio": certify_varying_ratio(LAW, 0.5).to_dict(),
    }
    path = tmp_path / "certificates.json"
    path.write_text(json.dumps(content))
    return path


def test_verdicts_hold_as_written(file):
    result = run(file)
    assert result.exit_code == 0
    assert "2 of 2 verdicts hold" in result.stdout
    assert result.stdout.count("assumes: the torque reaches the joints") == 1


@pytest.mark.parametrize("kind", ["constant_ratio", "varying_ratio"])
def test_a_forged_file_is_found_out(file, kind):
    content = json.loads(file.read_text())
    content[kind]["verdict"] = "refuted"
    file.write_text(json.dumps(content))
    assert "1 of 2 verdicts hold" in run(file).stdout
    result = run(file, "--json")
    assert result.exit_code == 1
    assert [row["holds"] for row in json.loads(result.stdout)] == [name != kind for name in content]


def test_one_certificate_by_itself(tmp_path):
    path = tmp_path / "one.json"
    path.write_text(certify_constant_ratio(LAW, 0.5).to_json())
    assert run(path).exit_code == 0


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"kind": "robot"}', '{"robot": 3}', "no: json"])
def test_what_is_no_certificate_is_named(tmp_path, text):
    path = tmp_path / "wrong.json"
    path.write_text(text)
    error = run(path).exception
    assert isinstance(error, InvalidParameter)
    assert "wrong.json" in str(error)
    assert isinstance(run(tmp_path / "absent.json").exception, InvalidParameter)
