import io
import zipfile

import pytest

pytest.importorskip("nicegui")

import xarray as xr

from tarc.scenario.model import Scenario
from tarc.scenario.yaml_text import read_yaml
from tarc.studio.design_state import DesignState
from tarc.studio.exports import writers
from tarc.studio.robots import Robots
from tarc.studio.runs import run_pair
from tarc.studio.study_runs import replay, send_study, study_content

STATE = DesignState(law="TARC", natural_frequency=17.0)


@pytest.mark.slow
def test_files_hold_the_design(tmp_path):
    robots = Robots()
    pair = run_pair(STATE, robots)
    content = {name: make() for name, make in writers(STATE, robots, pair).values() if name != "law.fmu"}
    scenario = Scenario.parse(read_yaml(content["design.yaml"].decode(), "design"))
    assert next(iter(scenario.laws.values()))["natural_frequency"] == 17.0
    names = zipfile.ZipFile(io.BytesIO(content["law.zip"])).namelist()
    assert any(name.endswith("law.c") for name in names)
    (tmp_path / "run.nc").write_bytes(content["run.nc"])
    with xr.open_dataset(tmp_path / "run.nc", engine="h5netcdf") as data:
        assert "gain" in data
    assert content["runs.png"].startswith(b"\x89PNG")
    assert content["runs.pdf"].startswith(b"%PDF")


def test_without_a_run_there_are_no_figures():
    assert {name for name, _ in writers(STATE, Robots(), None).values()} == {"design.yaml", "law.zip", "law.fmu"}


@pytest.mark.slow
def test_replayed_run_is_that_of_the_study():
    content = study_content(DesignState(), Robots(), 16)
    chunks = []
    send_study(chunks.append, content)
    assert sum(len(chunk.runs) for chunk in chunks) == 16
    pair = replay(content, 5)
    for column, curves in enumerate((pair.design, pair.rival)):
        assert curves.measures["rms_error"] == pytest.approx(chunks[0].measures["rms_error"][5, column], rel=1e-9)
