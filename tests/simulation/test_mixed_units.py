"""Robots with revolute and prismatic joints: measures by kind, never one sum."""

import numpy as np
import pytest

import tarc
from tarc.core.errors import InvalidParameter
from tarc.plants import load_robot
from tarc.study import compare

GANTRY = """<robot name="gantry"><link name="base"/>
<link name="carriage"><inertial><mass value="8"/>
<inertia ixx="0.05" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="arm"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>
<inertia ixx="0.002" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="rail" type="prismatic"><parent link="base"/><child link="carriage"/><axis xyz="1 0 0"/>
<limit lower="-0.5" upper="0.5" effort="200" velocity="0.5"/></joint>
<joint name="wrist" type="revolute"><parent link="carriage"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" effort="20" velocity="1"/></joint></robot>"""


@pytest.fixture
def gantry_file(tmp_path):
    file = tmp_path / "gantry.urdf"
    file.write_text(GANTRY)
    return file


@pytest.fixture
def gantry_run(gantry_file):
    robot = load_robot(gantry_file)
    law = tarc.laws.TDC(
        inertia=[3.0, 0.04],
        natural_frequency=8.0,
        period=1e-3,
        estimator=tarc.estimators.Algebraic(window=0.01, degree=2),
    )
    return tarc.simulate(robot, law, tarc.signals.Sinusoid(amplitude=[0.2, 0.5], frequency=2.0), 1.0)


def test_each_kind_has_its_measures(gantry_run):
    data = gantry_run.data
    error = (data["position"] - data["reference"]).values
    torque = data["torque"].values
    measures = gantry_run.metrics()
    assert measures["rms_error_prismatic"] == pytest.approx(np.sqrt(np.mean(error[:, 0] ** 2)))
    assert measures["rms_error_revolute"] == pytest.approx(np.sqrt(np.mean(error[:, 1] ** 2)))
    assert measures["peak_torque_prismatic"] == np.abs(torque[:, 0]).max()
    assert measures["torque_variation_revolute"] == pytest.approx(np.abs(np.diff(torque[:, 1])).sum() / 0.999)
    assert not {"rms_error", "peak_error", "torque_variation", "peak_torque", "rms_tde_error"} & set(measures)


def test_tables_have_the_unit_of_each_kind(gantry_run):
    assert "RMS error, revolute" in repr(gantry_run)
    html = gantry_run._repr_html_()
    for label, unit in (
        ("RMS error, prismatic", "mm"),
        ("RMS error, revolute", "mrad"),
        ("peak torque, prismatic", "N"),
    ):
        assert f"<td>{label}</td>" in html
        assert f"<td>{unit}</td>" in html
    assert "rad or m" not in html.replace("(rad or m)/s²", "")


def test_a_saved_run_keeps_the_units(gantry_run, tmp_path):
    gantry_run.save(tmp_path / "run.nc")
    assert tarc.Run.load(tmp_path / "run.nc").metrics() == pytest.approx(gantry_run.metrics())


def test_laws_are_not_ranked_by_a_sum(gantry_file):
    scenario = tarc.Scenario.parse(
        {
            "robot": {"file": str(gantry_file)},
            "law": {"kind": "TDC", "inertia": [3.0, 0.04], "natural_frequency": 8.0},
            "estimator": {"kind": "Algebraic", "window": 0.01},
            "reference": {"kind": "Sinusoid", "amplitude": [0.2, 0.5], "frequency": 2.0},
            "duration": 1.0,
        }
    )
    with pytest.raises(InvalidParameter, match="rail in m and wrist in rad.*no sum"):
        compare(scenario)


def test_the_figure_has_an_error_for_each_unit(gantry_run):
    error = np.abs((gantry_run.data["position"] - gantry_run.data["reference"]).values)
    axes_list = gantry_run.plot().axes
    panels = {axes.get_ylabel(): axes for axes in axes_list}
    assert "error [mm]" in panels
    assert {"rail", "wrist [mrad]"} <= {axes.get_title() for axes in axes_list}
    norms = panels["‖error‖ [mm or mrad]"].get_lines()[:2]
    for line, joint in zip(norms, (0, 1), strict=True):
        assert line.get_ydata() == pytest.approx(np.maximum(error[:, joint], 1e-9) * 1e3)
    assert norms[0].get_linestyle() != norms[1].get_linestyle()
