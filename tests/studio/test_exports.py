import io
import zipfile

import pytest

pytest.importorskip("nicegui")

import xarray as xr

from tarc.scenario.model import Scenario
from tarc.scenario.yaml_text import read_yaml
from tarc.studio.design_state import DesignState
from tarc.studio.export_menu import FILES
from tarc.studio.exports import send_file
from tarc.studio.robots import Robots
from tarc.studio.study_runs import send_replay, send_study

STATE = DesignState(law="TARC", natural_frequency=17.0)


def file_of(name):
    sent = []
    send_file(sent.append, name, STATE, Robots())
    return sent[0]


@pytest.mark.slow
def test_files_hold_the_design(tmp_path):
    content = {name: file_of(name) for name in FILES.values() if name != "law.fmu"}
    scenario = Scenario.parse(read_yaml(content["design.yaml"].decode(), "design"))
    assert next(iter(scenario.laws.values()))["natural_frequency"] == 17.0
    names = zipfile.ZipFile(io.BytesIO(content["law.zip"])).namelist()
    assert any(name.endswith("law.c") for name in names)
    (tmp_path / "run.nc").write_bytes(content["run.nc"])
    with xr.open_dataset(tmp_path / "run.nc", engine="h5netcdf") as data:
        assert "gain" in data
    assert content["runs.png"].startswith(b"\x89PNG")
    assert content["runs.pdf"].startswith(b"%PDF")


@pytest.mark.slow
def test_replayed_run_is_that_of_the_study():
    sent, replayed = [], []
    send_study(sent.append, DesignState(), Robots(), 16)
    content, *chunks = sent
    assert sum(len(chunk.runs) for chunk in chunks) == 16
    send_replay(replayed.append, content, 5)
    (pair,) = replayed
    for column, curves in enumerate((pair.design, pair.rival)):
        assert curves.measures["rms_error"] == pytest.approx(chunks[0].measures["rms_error"][5, column], rel=1e-9)
