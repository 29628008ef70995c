"""M̂(q) and feed-forward in a scenario."""

import copy

import numpy as np
import pytest

from tarc import NominalInertia, Scenario
from tarc.core.errors import InvalidParameter, UnsupportedLaw

CONTENT = {
    "robot": {"kind": "TwoLinkArm", "coulomb": 0.5, "payload": 0.3},
    "law": {"kind": "TDC", "inertia": {"model": True, "fraction": 0.08}, "natural_frequency": 15.0},
    "estimator": {"kind": "Algebraic", "window": 0.010},
    "reference": {"kind": "Sinusoid", "amplitude": [0.3, 0.4], "frequency": 2.0, "phase": 1.5708},
    "duration": 0.2,
    "initial_torque": "rest",
}


def scenario(inertia=None, feedforward=None, **law):
    content = copy.deepcopy(CONTENT)
    content["law"] |= law
    if inertia is not None:
        content["law"]["inertia"] = inertia
    if feedforward is not None:
        content["law"]["feedforward"] = feedforward
    return Scenario.parse(content)


def law_of(**options):
    return scenario(**options).build().laws["TDC"]


def test_model_is_the_robot_or_differs():
    setup = scenario().build()
    assert setup.laws["TDC"].inertia.model is setup.plant
    inertia = law_of(inertia={"model": {"payload": 0.0, "coulomb": 1.4}, "fraction": 0.1}).inertia
    assert isinstance(inertia, NominalInertia)
    assert inertia.model.parameters["payload"] == 0
    np.testing.assert_array_equal(inertia.model.parameters["coulomb"], 1.4)
    own = {"kind": "TwoLinkArm", "masses": [1.2, 0.9]}
    law = law_of(feedforward={"model": own}, inertia={"fraction": 0.1})
    np.testing.assert_array_equal(law.feedforward.model.parameters["masses"], [1.2, 0.9])


def test_it_runs_and_has_a_certificate_of_its_own():
    both = scenario(feedforward={"model": True, "friction_width": 0.05})
    (run,) = both.run().values()
    assert run.status.completed
    certified = both.certify(samples=20)
    assert not certified
    assert certified.known_inertia["TDC"].verify()
    with pytest.raises(UnsupportedLaw, match="workspace has no speeds"):
        both.certify(samples=20, full_range=True)


@pytest.mark.slow
def test_other_laws_are_certified():
    content = copy.deepcopy(CONTENT)
    plain = {**CONTENT["law"], "label": "numbers", "inertia": {"fraction": 0.08}}
    content["law"] = [{**CONTENT["law"], "label": "model"}, plain]
    certified = Scenario.parse(content).certify(samples=50)
    assert list(certified) == ["numbers"]
    assert list(certified.known_inertia) == ["model"]


def test_file_of_a_model_is_found_beside_the_scenario(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    content = {**copy.deepcopy(CONTENT), "robot": {"file": "arm.xml"}}
    content["law"]["inertia"]["model"] = {"file": "arm.xml", "payload": 0.2}
    path = Scenario.parse({**content, "robot": {"file": str(tmp_path / "arm.xml")}}).save(tmp_path / "run.yaml")
    assert path.read_text().count("file: arm.xml") == 2
    law = Scenario.load(path).build().laws["TDC"]
    assert law.inertia.model.parameters["payload"] == 0.2


ARM = """<mujoco><worldbody><body><joint name="a" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .5 0 0" size=".04"/>
<body pos=".5 0 0"><joint name="b" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .4 0 0" size=".03"/></body>
</body></worldbody><actuator><motor joint="a"/><motor joint="b"/></actuator></mujoco>"""


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"inertia": {"model": True}}, "law.inertia.fraction: missing"),
        ({"inertia": {"model": True, "fraction": 3}}, "law.inertia.fraction: got 3"),
        ({"inertia": {"model": True, "fraction": 0.1, "gravty": True}}, "law.inertia.gravty: unknown key.*'gravity'"),
        ({"inertia": {"model": "robot", "fraction": 0.1}}, "law.inertia.model: got 'robot'; needs true"),
        ({"inertia": {"model": {"pay": 0}, "fraction": 0.1}}, "law.inertia.model: got 'pay'.*'payload'"),
        ({"inertia": {"model": {"payload": -1}, "fraction": 0.1}}, "law.inertia.model.payload: got -1"),
        (
            {"inertia": {"model": True, "fraction": 0.1, "friction": True}},
            r"law.inertia.friction_width: missing; the model has dry friction",
        ),
        ({"inertia": {"model": {"kind": "NLinkArm"}, "fraction": 0.1}}, "its joints are joint1, joint2, joint3"),
        (
            {
                "inertia": {
                    "model": {"kind": "MassSpringDamper", "masses": [1, 1], "springs": 0, "dampers": 0},
                    "fraction": 1,
                }
            },
            r"its joints are joint1, joint2 \[m, m\], those of the robot joint1, joint2 \[rad, rad\]",
        ),
        ({"feedforward": {"friction_width": 0.1}}, "law.feedforward.model: missing"),
        ({"inertia": {"fraction": 0.1, "modl": True}}, "or model and fraction. Did you mean 'model'"),
    ],
)
def test_bad_input(options, message):
    with pytest.raises(InvalidParameter, match=message):
        scenario(**options).build()


def test_robots_in_mujoco_have_no_model():
    content = {**copy.deepcopy(CONTENT), "robot": {"file": "ur5e", "backend": "mujoco"}}
    content["reference"]["amplitude"] = 6 * [0.1]
    with pytest.raises(
        InvalidParameter, match="law.inertia.model: got MujocoPlant; NominalInertia needs a robot in sym"
    ):
        Scenario.parse(content).build()
