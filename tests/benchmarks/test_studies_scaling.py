import pytest

from benchmarks import studies_scaling
from tarc.study import Study


def test_the_study_of_the_benchmark_has_three_drawn_values_and_lasts_ten_seconds():
    study = Study.parse({**studies_scaling.CONTENT, "runs": 16})
    assert study.draw().values.shape == (16, 3)
    assert study.law_names == ["TARC"]
    assert studies_scaling.CONTENT["scenario"]["duration"] == 10.0


@pytest.mark.slow
def test_a_large_store_is_complete(tmp_path, monkeypatch):
    monkeypatch.setattr(studies_scaling, "LARGE_STORE", 4000)
    rows = studies_scaling.large_store(tmp_path, 0)
    assert [row.what for row in rows][1:] == ["opened", "opened, and one column read"]
    assert studies_scaling.same_results(tmp_path / "large", tmp_path / "large")
