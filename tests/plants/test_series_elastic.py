"""The series-elastic joint against its equations, its modes, and the rigid joint that it becomes."""

import numpy as np
import pytest

import tarc
from law_catalogue import make_tdc
from tarc.core.errors import InvalidParameter
from tarc.plants import Pendulum, SeriesElasticJoint

WEIGHT = 1.5 * 9.81 * 0.3


def test_it_moves_as_its_equations():
    joint = SeriesElasticJoint(payload=0.5)
    (motor, link), (motor_rate, link_rate), torque = (0.4, 0.2), (1.0, -0.5), 3.0
    spring = 400.0 * (motor - link) + 0.5 * (motor_rate - link_rate)
    friction = 0.5 * motor_rate + 0.5 * np.tanh(motor_rate / 0.05)
    inertia = 0.02 + 2.0 * 0.09
    expected = [
        (torque - friction - spring) / 0.15,
        (spring - 2.0 * 9.81 * 0.3 * np.sin(link)) / inertia,
    ]
    found = joint.evaluate("acceleration", [motor, link], [motor_rate, link_rate], [torque])
    assert np.allclose(found, expected, rtol=1e-12)


def test_its_mode_is_that_of_two_inertias_on_a_spring():
    joint = SeriesElasticJoint(gravity=0.0, viscous=0.0, coulomb=0.0, spring_damping=0.0)
    M, _, K = joint.linearised(np.zeros(2))
    link = 0.02 + 1.5 * 0.09
    frequencies = np.sqrt(np.abs(np.sort(np.linalg.eigvals(np.linalg.solve(M, K)).real)))
    assert frequencies == pytest.approx([0.0, np.sqrt(400.0 * (1 / 0.15 + 1 / link))], abs=1e-6)


@pytest.mark.parametrize("encoder", ["motor", "link"])
@pytest.mark.parametrize("position", [0.0, 1.0, -2.0])
def test_it_starts_in_equilibrium(encoder, position):
    joint = SeriesElasticJoint(encoder=encoder)
    coordinates = joint.coordinates(np.array([position]))
    assert coordinates[joint.measured[0]] == position
    torque = joint.gravity_torque(coordinates)
    assert torque == pytest.approx([WEIGHT * np.sin(coordinates[1]), 0.0], abs=1e-10)
    assert joint.passive_joints == ["link"]
    assert joint.joint_names == [encoder]


def run(joint, inertia=0.02, **options):
    law = make_tdc(inertia=[inertia], natural_frequency=10.0)
    reference = tarc.signals.Sinusoid(amplitude=0.3, frequency=1.5, phase=np.pi / 2, offset=0.5)
    return tarc.simulate(joint, law, reference, 4.0, initial_torque="rest", **options)


def test_with_a_stiff_spring_it_is_the_rigid_joint():
    elastic = run(SeriesElasticJoint(spring_stiffness=1e5, spring_damping=20.0, link_inertia=0.0), substeps=20)
    rigid = run(Pendulum(mass=1.5, length=0.3, rotor=0.15, viscous=0.5, coulomb=0.5, coulomb_width=0.05), substeps=20)
    difference = elastic.data["position"].values - rigid.data["position"].values
    assert np.abs(difference).max() < 1e-4


def test_the_link_sags_by_its_weight_behind_the_motor_s_encoder():
    found = run(SeriesElasticJoint())
    assert found.status.completed
    link = found.data["passive_position"].values[:, 0]
    motor = found.data["position"].values[:, 0]
    torque = 0.155 * np.gradient(np.gradient(link, 1e-3), 1e-3) + WEIGHT * np.sin(link)
    assert np.abs(400.0 * (motor - link) - torque)[500:-500].max() < 0.05
    error = (found.data["position"] - found.data["reference"]).values
    assert np.abs(error[1000:]).max() < 0.01


def test_an_encoder_on_the_link_allows_a_smaller_model_only():
    """Between torque and encoder lies the spring: what is stable on the motor's side is not on the link's."""
    assert run(SeriesElasticJoint(encoder="motor")).status.completed
    assert not run(SeriesElasticJoint(encoder="link")).status.completed
    stiff = SeriesElasticJoint(encoder="link", spring_stiffness=2000.0)
    assert run(stiff, inertia=0.005).status.completed


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"spring_stiffness": 0.0}, "spring_stiffness: got 0"),
        ({"encoder": "gear"}, "encoder: got 'gear'; known are motor, link"),
        ({"payload": -1.0}, "payload: got -1"),
    ],
)
def test_impossible_parameters_are_refused(values, message):
    with pytest.raises(InvalidParameter, match=message):
        SeriesElasticJoint(**values)


def test_certificates_refuse_it_by_name():
    from tarc.analysis.workspace import Workspace

    law = make_tdc(inertia=[0.05])
    with pytest.raises(InvalidParameter, match="no torque acts on the joint link of SeriesElasticJoint"):
        tarc.certify_law(law, SeriesElasticJoint(), Workspace.box([-1.0], [1.0]))


def test_a_scenario_has_it():
    content = {
        "robot": {"kind": "SeriesElasticJoint", "encoder": "link"},
        "law": {"kind": "TDC", "inertia": [0.05], "natural_frequency": 4.0},
        "estimator": {"kind": "Algebraic", "window": 0.010},
        "reference": {"kind": "Sinusoid", "amplitude": [0.3], "frequency": 1.0, "phase": 1.5708},
        "duration": 1.0,
        "initial_torque": "rest",
    }
    (found,) = tarc.Scenario.parse(content).run(progress=False).values()
    assert list(found.data["joint"].values) == ["link"]
    assert list(found.data["passive_joint"].values) == ["motor"]


def test_its_fields_hide_no_method_of_a_plant():
    joint = SeriesElasticJoint(coulomb=0.0)
    assert np.allclose(joint.damping(np.zeros(2)), [[1.0, -0.5], [-0.5, 0.5]])
