"""Records of real robots reach what the page promises, where they lie beside the project."""

import json

import numpy as np
import pytest
from benchmarks.page_values.registry import DataMissingError, Source, Value

from benchmarks import numbers, real_robots


@pytest.fixture
def records():
    try:
        return real_robots.data_folder()
    except DataMissingError as missing:
        pytest.skip(str(missing))


def test_delay_of_the_window_on_a_run_of_the_kuka(records):
    for check in real_robots.kuka("A").windows:
        assert check.delay == pytest.approx(np.full(6, check.predicted_delay), abs=0.3e-3)
        assert check.delay_by_velocity == pytest.approx(np.full(6, check.predicted_delay), abs=0.3e-3)
    velocity = real_robots.kuka("A").velocity
    assert velocity is not None
    assert np.min(velocity.correlation) > 0.9999


@pytest.mark.slow
def test_time_torque_and_delay_estimation_of_the_panda(records):
    found = real_robots.panda()
    assert np.all(found.timing.residual < 5e-6)
    assert found.timing.stale == pytest.approx(0.062, abs=0.002)
    assert found.timing.missing == pytest.approx(0.080, abs=0.002)
    assert found.windows[0].error_without_delay == pytest.approx(found.windows[0].noise, rel=0.1)
    left = found.delay_estimation
    assert left is not None
    assert np.mean(left.synchronised) <= 0.047
    assert np.mean(left.literal) <= 0.067
    part = real_robots.panda(whole=False).model
    assert part is not None
    assert np.all(np.round(part.explained, 3) >= [0.83, 0.986, 0.966, 0.957, 0.77, 0.68, 0.03])


def test_without_the_records_the_page_keeps_its_values(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("TARC_ROBOT_DATA", str(tmp_path))
    kept = tmp_path / "numbers.json"
    monkeypatch.setattr(numbers, "VALUES", kept)
    real_robots.panda.cache_clear()
    real_robots.kuka.cache_clear()
    monkeypatch.setattr(numbers, "SOURCES", {"real_robots": Source(real_robots.values, long=False)})
    values: dict[str, dict[str, Value]] = {"real_robots": {"noise": 0.5}}
    numbers.save(values)
    numbers.compute(["real_robots"], values)
    assert "skipped: no records of real robots" in capsys.readouterr().out
    assert json.loads(kept.read_text(encoding="utf-8")) == {"real_robots": {"noise": 0.5}}
    real_robots.main()
    assert "skipped" in capsys.readouterr().out
