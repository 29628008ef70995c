import io
import zipfile

import pytest

pytest.importorskip("nicegui")

import xarray as xr

import urdf_text
from tarc.scenario.model import Scenario
from tarc.scenario.yaml_text import read_yaml
from tarc.studio.design_state import DesignState
from tarc.studio.export_menu import FILES
from tarc.studio.exports import send_file
from tarc.studio.robots import Robots
from tarc.studio.study_runs import send_replay, send_study
from tarc.studio.upload import UploadedRobot
from tarc.studio.upload_panel import scenario_content

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


def test_an_uploaded_robot_is_named_as_in_its_upload(tmp_path):
    file = tmp_path / "upload-1" / "urdf" / "arm.urdf"
    file.parent.mkdir(parents=True)
    file.write_text(urdf_text.arm())
    robots, sent = Robots(), []
    robot = UploadedRobot(file, ("a", "b"), (0.0, 0.0), (0.1, 0.1), ())
    robots.add("upload-1", "arm (uploaded)", scenario_content(robot, {"armature": 0.1}))
    send_file(sent.append, "design.yaml", STATE.with_changes(robot="upload-1"), robots)
    (tmp_path / "upload-1" / "design.yaml").write_bytes(sent[0])
    assert str(tmp_path) not in sent[0].decode()
    assert Scenario.load(tmp_path / "upload-1" / "design.yaml").build_plant().n_joints == 2
    send_file(sent.append, "design.yaml", STATE.with_changes(robot="ur5e"), robots)
    assert read_yaml(sent[1].decode(), "design")["robot"]["file"] == "ur5e"


@pytest.mark.slow
def test_replayed_run_is_that_of_the_study():
    sent, replayed = [], []
    send_study(sent.append, DesignState(), Robots(), 16)
    start, *chunks = sent
    assert start.labels["disturbance.0.mass"] == "payload [kg]"
    assert start.labels["sensor.noise"] == "noise of the encoders [rad]"
    assert (start.units["rms_error"], start.scales["rms_error"]) == ("mrad", 1e3)
    assert sum(len(chunk.runs) for chunk in chunks) == 16
    send_replay(replayed.append, start.content, 5)
    (pair,) = replayed
    for column, curves in enumerate((pair.design, pair.rival)):
        assert curves.measures["rms_error"] == pytest.approx(chunks[0].measures["rms_error"][5, column], rel=1e-9)
