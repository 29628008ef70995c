"""`tarc study`, as a user runs it."""

import json

import pytest
from typer.testing import CliRunner

import tarc.study.store as store_module
from swing_study import STUDY
from tarc.cli.main import app
from tarc.core.errors import InvalidParameter
from tarc.scenario.yaml_text import write_yaml
from tarc.study.specification import Study


def run(*arguments, status=0):
    result = CliRunner().invoke(app, ["study", *arguments])
    assert result.exit_code == status, result.output
    return result


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "study.yaml").write_text(write_yaml(STUDY), encoding="utf-8")
    return tmp_path


def test_the_example_is_a_study(tmp_path):
    text = run("--example").stdout
    (tmp_path / "study.yaml").write_text(text, encoding="utf-8")
    example = Study.load(tmp_path / "study.yaml")
    assert example.law_names == ["TDC", "TARC"]
    assert example.draw().values.shape == (64, 5)


def test_a_study_prints_rates_quantiles_and_where_it_is(folder):
    out = run("study.yaml").stdout
    assert "10 runs per law" in out
    assert "TDC: 100 % completed (69.15 … 100 %)" in out
    assert "RMS error [mrad]" in " ".join(out.split())
    assert "runs/swings.study" in out
    assert (folder / "runs" / "swings.study" / "results.zarr").is_dir()


def test_as_json_with_another_folder_and_number_of_runs(folder):
    summary = json.loads(run("study.yaml", "--json", "--out", "own", "--runs", "9").stdout)
    assert (summary["runs"], summary["finished"], summary["folder"]) == (9, 9, "own")
    assert summary["laws"]["TDC"]["success_rate"] == 1.0
    assert 0 < summary["laws"]["TDC"]["quantiles"]["rms_error"]["0.5"] < 1


def test_ctrl_c_says_what_is_kept_and_how_to_go_on(folder, monkeypatch):
    write = store_module.Store._mark

    def mark(store, start, stop):
        write(store, start, stop)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(store_module.Store, "_mark", mark)
        result = run("study.yaml", "--jobs", "1", status=130)
    assert "interrupted: 8 of 10 runs are stored in runs/swings.study; the same command goes on" in result.stderr
    assert "10 runs per law" in run("study.yaml").stdout


def test_no_file_and_an_unknown_engine_are_refused(folder):
    assert "--example prints one to start from" in run(status=2).stderr
    with pytest.raises(InvalidParameter, match="engine: got 'fast'"):
        CliRunner().invoke(app, ["study", "study.yaml", "--engine", "fast"], catch_exceptions=False)


def test_help_teaches_by_examples():
    text = run("--help").stdout
    assert "tarc study --example > study.yaml" in text
    assert "goes on where it stopped" in text


@pytest.mark.slow
def test_limits_and_the_worst_case_are_in_the_report(folder):
    run("study.yaml", "--limit", "rms_error=1e-9", "--reference", "TDC", "--worst-case", "TDC")
    results = folder / "runs" / "swings.study"
    text = (results / "report.html").read_text(encoding="utf-8")
    assert "10 did not" in text
    assert "Worst case" in text
    worst = Study.load(results / "worst.yaml")
    assert worst.runs == 1


@pytest.mark.parametrize("limit", ["rms_eror=1", "rms_error", "rms_error=-1", "rms_error=much"])
def test_a_limit_needs_a_measure_and_a_number(folder, limit):
    assert isinstance(run("study.yaml", "--limit", limit, status=1).exception, InvalidParameter)
