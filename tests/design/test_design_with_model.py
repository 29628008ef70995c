"""Designs with M̂(q): the robots at the ends of the model's intervals, refusals, the scenario and the prediction."""

from dataclasses import replace

import numpy as np
import pytest

import tarc
from slow_cases import slow
from tarc import plants
from tarc.analysis import Workspace
from tarc.analysis.operating_points import SEARCH_MARGIN
from tarc.certificates import certify_known_inertia
from tarc.core.errors import InvalidParameter
from tarc.design import DesignRequirements, design_controller, predict_design_error, stress_test, try_design
from tarc.design.known_model import KnownModel, uncertain_robots
from tarc.design.prediction import predict_error
from tarc.design.problem import DesignProblem
from tarc.design.writer import law_section
from tarc.laws.nominal_inertia import Feedforward, NominalInertia
from tarc.scenario.known_model import model_terms

ARM = plants.TwoLinkArm(viscous=[0.5, 0.5])
UR5E = plants.load_robot("ur5e", armature=0.1, viscous=1.0, coulomb=2.0)
SPEEDS = Workspace.box([-np.pi] * 2, [np.pi] * 2, speed=1.0, acceleration=4.0)
GIVEN = {"payload": (0.0, 2.0), "torque_limits": [100.0, 50.0], "samples": 60, "speed": 1.0}


def requirements(**options):
    return DesignRequirements(**{**GIVEN, "model": "known", **options})


def test_ratios_of_every_robot_within_the_intervals_lie_between_those_of_the_ends():
    given = DesignRequirements(payload=(0.0, 5.0), model="inertia", armature_error=0.2, mass_error=0.1)
    ends = uncertain_robots([UR5E.with_parameters({"payload": mass}) for mass in (0.0, 5.0)], given, SPEEDS)
    assert len(ends) == 8
    nominal = UR5E.with_parameters({"payload": 1.0})
    random = np.random.default_rng(1)
    for _ in range(10):
        posture = random.uniform(-3, 3, 6)
        M = nominal.inertia(posture)
        at_ends = np.array([np.linalg.eigvals(np.linalg.solve(robot.inertia(posture), M)).real for robot in ends])
        inside = UR5E.with_parameters(
            {
                "payload": random.uniform(0, 5),
                "armature": 0.1 * random.uniform(0.8, 1.2, 6),
                "masses": np.asarray(UR5E.parameters["masses"])
                * random.uniform(0.9, 1.1, np.shape(UR5E.parameters["masses"])),
            }
        )
        ratios = np.linalg.eigvals(np.linalg.solve(inside.inertia(posture), M)).real
        assert at_ends.min() * (1 - 1e-9) <= ratios.min()
        assert ratios.max() <= at_ends.max() * (1 + 1e-9)


def test_ratios_of_every_arm_within_the_lengths_lie_within_the_margin_of_those_of_the_ends():
    given = DesignRequirements(payload=(0.0, 2.0), model="inertia", length_error=0.1)
    ends = uncertain_robots([ARM, ARM.with_parameters({"payload": 2.0})], given, SPEEDS)
    assert len(ends) == 18
    random = np.random.default_rng(1)
    for _ in range(60):
        posture = np.array([0.0, random.uniform(-np.pi, np.pi)])
        M = ARM.inertia(posture)
        at_ends = np.array([np.linalg.eigvals(np.linalg.solve(robot.inertia(posture), M)).real for robot in ends])
        factors = random.uniform(0.9, 1.1, 2)
        inside = ARM.with_parameters({"payload": random.uniform(0, 2), "lengths": factors, "centres": factors})
        ratios = np.linalg.eigvals(np.linalg.solve(inside.inertia(posture), M)).real
        assert at_ends.min() * (1 - 1e-9) <= ratios.min()
        assert ratios.max() <= at_ends.max() * (1 + SEARCH_MARGIN)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"model": "all"}, "model: got 'all'"),
        ({"mass_error": 1.2}, "mass_error: got 1.2; needs a share below 1"),
        ({"armature_error": -0.1}, "armature_error"),
    ],
)
def test_requirements_refuse_what_no_model_is(options, message):
    with pytest.raises(InvalidParameter, match=message):
        requirements(**options)


@pytest.mark.parametrize(
    ("plant", "options", "message"),
    [
        (ARM, {"speed": np.inf}, "speed: model='known' needs the largest joint speed"),
        (plants.Pendulum(), {"length_error": 0.1, "torque_limits": 9.0}, "length_error: .* has no parameter lengths"),
        (ARM, {"armature_error": 0.2}, "armature_error: .* has no parameter armature"),
        (UR5E, {"torque_limits": None}, "friction_width: missing"),
    ],
)
def test_a_model_refuses_what_it_needs(plant, options, message):
    with pytest.raises(InvalidParameter, match=message):
        design_controller(plant, requirements(**options), progress=False)


@pytest.fixture(scope="module")
def known():
    return KnownModel.from_problem(DesignProblem.from_plant(ARM, requirements()))


def test_the_model_has_the_low_end_of_friction_and_the_payload_of_least_spread(known):
    np.testing.assert_allclose(known.model.parameters["viscous"], 0.7 * np.array([0.5, 0.5]))
    postures = np.random.default_rng(0).uniform(-3, 3, (200, 2))

    def spread(mass):
        model = known.model.with_parameters({"payload": mass})
        ratios = [
            np.linalg.eigvals(np.linalg.solve(robot.inertia(posture), model.inertia(posture))).real
            for robot in known.robots
            for posture in postures
        ]
        return np.max(ratios) / np.min(ratios)

    own = float(np.squeeze(known.model.parameters["payload"]))
    assert spread(own) == pytest.approx(min(spread(mass) for mass in (0.0, 0.5, 1.0)), rel=0.02)
    assert known.spread == pytest.approx(spread(own), rel=0.03)


def test_torque_noise_is_that_of_the_worst_posture(known):
    norms = [
        np.linalg.norm(known.model.inertia(posture), axis=1) / known.evidence.min_ratio
        for posture in np.random.default_rng(3).uniform(-np.pi, np.pi, (300, 2))
    ]
    np.testing.assert_allclose(known.row_norms, np.max(norms, axis=0), rtol=0.03)


def make_law(**options):
    model = ARM.with_parameters({"payload": 0.5})
    return tarc.laws.TDC(
        inertia=NominalInertia(model, 0.08, gravity=True, coriolis=True, friction=True),
        feedforward=Feedforward(model, gravity=False, coriolis=False, friction=False),
        natural_frequency=30.0,
        period=1e-3,
        estimator=tarc.estimators.Algebraic(window=0.010),
        **options,
    )


def test_the_section_of_the_law_gives_the_law():
    law, robot = make_law(), ARM.with_parameters({"payload": 0.0})
    section = law_section(law, robot)
    for kind, name in ((NominalInertia, "inertia"), (Feedforward, "feedforward")):
        given = section[name]
        assert isinstance(given, dict)
        read = model_terms(kind, given, f"law.{name}", robot)
        own = getattr(law, name)
        assert read.terms == own.terms
        assert getattr(read, "fraction", None) == getattr(own, "fraction", None)
        for key, value in own.model.parameters.items():
            np.testing.assert_array_equal(read.model.parameters[key], value)
    own_model = replace(law, inertia=NominalInertia(robot, 0.08), feedforward=None)
    assert law_section(own_model, robot)["inertia"] == {"model": True, "fraction": 0.08}


@pytest.mark.parametrize("same_window", [True, False])
def test_the_linear_loop_predicts_the_error_of_a_law_with_a_model(same_window):
    law = make_law()
    assert law.feedforward is not None
    law = replace(law, feedforward=replace(law.feedforward, same_window=same_window))
    robot, sines = (
        ARM.with_parameters({"payload": 1.0}),
        tarc.signals.Sinusoid(amplitude=[0.4, 0.4], frequency=[1.5, 2.0], phase=np.pi / 2),
    )
    run = tarc.simulate(robot, law, sines, 3.0, initial_torque="rest", progress=False)
    measured = run.metrics(1.0)["rms_error"]
    predicted = float(np.sqrt(np.mean(predict_error(law, [robot], sines, 3.0).rms(1.0) ** 2)))
    assert predicted == pytest.approx(measured, rel=0.15)


@pytest.mark.parametrize("model", [slow("known")])
def test_a_design_with_a_model_is_certified_and_runs_as_predicted(model):
    design = design_controller(ARM, requirements(model=model, length_error=0.01), progress=False)
    verdict = design.certificates["robot"]
    assert verdict.verdict_in_words.startswith("certified on 60 sampled postures")
    assert verdict.verdict_in_words.endswith("each link shorter, as it is and longer")
    assert verdict.verify()
    trial, predicted = try_design(design), predict_design_error(design)
    assert trial.rms_error == pytest.approx(predicted, rel=0.5)
    scenario = design.scenario()
    (law,) = scenario.build().laws.values()
    assert isinstance(law, tarc.laws.TARC)
    assert isinstance(law.inertia, NominalInertia)
    assert isinstance(design.law.inertia, NominalInertia)
    assert law.inertia.fraction == design.law.inertia.fraction
    text = design.to_yaml()
    assert "model:" in text
    assert "rotor inertias within 0 %" in text


@pytest.mark.slow
def test_stress_test_of_a_design_with_a_model():
    """The payload beyond the last certified one is not certified by itself, with the robots of all ends."""
    arm = tarc.plants.TwoLinkArm(viscous=0.2)
    design = design_controller(
        arm, payload=(0.0, 1.0), torque_limits=[100.0, 50.0], samples=60, speed=1.0, model="known", progress=False
    )
    limit = stress_test(design, questions="payload", simulate=False, progress=False)["payload"]
    assert limit.value is not None
    assert limit.beyond is not None
    assert 1.0 <= limit.value < limit.beyond < 2.0
    ends = [arm.with_parameters({"payload": mass}) for mass in (0.0, limit.beyond)]
    assert not certify_known_inertia(design.law, ends, design.workspace, samples=60).certified
