"""Computed torque with models from energies and from files."""

import casadi as ca
import numpy as np
import pytest

from law_catalogue import PERIOD, make_law
from tarc import Controller, Scenario, estimators, laws, plants, signals, simulate
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.core.tracing import trace
from tarc.core.trees import pack
from tarc.laws import LawInput
from tarc.laws.model_based import inertia_and_bias


def largest_departure(period):
    """How far the error is, at most, from the double pole's e0 (1 + ωn t) e^(−ωn t), with the true model."""
    arm, start = plants.TwoLinkArm(viscous=0.3), np.array([0.2, -0.1])
    law = laws.ComputedTorque(
        model=arm, natural_frequency=10.0, period=period, estimator=estimators.BackwardDifference()
    )
    reference = signals.Sinusoid(amplitude=[0.5, 0.4], frequency=[2.0, 3.0], phase=np.pi / 2)
    first = reference.sample(np.zeros(1))[0][:, 0]
    data = simulate(arm, law, reference, 1.0, initial_position=first + start).data
    time = data["time"].values[:, None]
    error = data["position"].values - data["reference"].values
    return np.abs(error - start * (1 + 10 * time) * np.exp(-10 * time)).max()


def test_error_obeys_the_linear_dynamics():
    """Up to what the sampling adds, which is of first order."""
    coarse, fine = largest_departure(4e-4), largest_departure(1e-4)
    assert fine < 5e-4
    assert 3.0 < coarse / fine < 5.0


def test_is_the_torque_of_the_model():
    arm = plants.TwoLinkArm(coulomb=0.2)
    law = make_law(laws.ComputedTorque, model=arm, damping_ratio=[0.7, 1.2], natural_frequency=[8.0, 12.0])
    rng = np.random.default_rng(1)
    state, value = law.init(rng.normal(size=2)), LawInput(*rng.normal(size=(4, 2)))
    _, estimate = law.estimator.step(state.estimator, value.position)
    commanded_acceleration = (
        value.acceleration_reference
        - 2 * np.array([0.7, 1.2]) * [8.0, 12.0] * (estimate.velocity - value.velocity_reference)
        - np.array([64.0, 144.0]) * (value.position - value.reference)
    )
    expected = arm.inertia(value.position) @ commanded_acceleration + arm.evaluate(
        "bias", value.position, estimate.velocity
    )
    np.testing.assert_allclose(law.step(state, value)[1].torque, expected, rtol=1e-12)


@pytest.fixture(scope="module")
def robot():
    return plants.MujocoPlant.from_file("ur5e", armature=0.1, viscous=2.0)


def test_model_from_a_file_is_the_robot(robot):
    """Its M and N give the acceleration that MuJoCo computes."""
    import mujoco

    rng = np.random.default_rng(2)
    q, v, torque = rng.normal(size=(3, 6))
    M, N = inertia_and_bias(robot, q, v)
    data = mujoco.MjData(robot.model)
    data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, v, torque
    mujoco.mj_forward(robot.model, data)
    np.testing.assert_allclose(np.linalg.solve(M, torque - N), data.qacc, rtol=1e-8)
    np.testing.assert_allclose(M, robot.inertia(q), rtol=1e-12)
    np.testing.assert_allclose(inertia_and_bias(robot, q, 0 * v)[1], robot.gravity_torque(q), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("symbol", [ca.SX, ca.MX], ids=["SX", "MX"])
def test_model_from_a_file_is_traced(robot, symbol):
    law = make_law(laws.ComputedTorque, model=robot)
    function, _ = trace(law.step, *law.example(), symbol=symbol)
    rng = np.random.default_rng(3)
    state, value = law.init(rng.normal(size=6)), LawInput(*rng.normal(size=(4, 6)))
    expected = [pack(part) for part in law.step(state, value)]
    for traced, stepped in zip(function(pack(state), pack(value)), expected, strict=True):
        np.testing.assert_allclose(np.array(traced)[:, 0], stepped, rtol=1e-9, atol=1e-8)


def test_model_from_a_file_accepts_missing_samples(robot):
    law = make_law(laws.ComputedTorque, model=robot)
    state, value = law.example()
    with np.errstate(invalid="ignore"):
        for position in (np.nan, 1e90):
            _, output = law.step(state, value._replace(position=np.full(6, position)))
            np.testing.assert_array_equal(np.isfinite(output.torque), True)


def test_scenario_names_its_own_robot():
    content = {
        "robot": {"file": "ur5e", "armature": 0.1},
        "law": [
            {"kind": "ComputedTorque", "model": "robot", "natural_frequency": 20.0},
            {
                "kind": "CorlessLeitmann",
                "model": "robot",
                "inertia": {"fraction": 1.0},
                "natural_frequency": 20.0,
                "uncertainty_bound": 2.0,
            },
        ],
        "estimator": {"kind": "Algebraic", "window": 0.010},
        "reference": {"kind": "Sinusoid", "amplitude": 0.3, "frequency": [2.0, 2.2, 2.4, 2.6, 2.8, 3.0]},
        "duration": 1.0,
        "initial_torque": "rest",
    }
    runs = Scenario.parse(content).run()
    assert all(run.status.completed for run in runs.values())
    assert runs["ComputedTorque"].metrics(start_time=0.5)["rms_error"] < 2e-3
    content["law"] = {"kind": "ComputedTorque", "model": "ur5e", "natural_frequency": 20.0}
    with pytest.raises(InvalidParameter, match=r"law.model: got 'ur5e'; known are robot"):
        Scenario.parse(content).run()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"model": "robot"}, "model: got 'robot'; needs one of tarc.plants"),
        ({"natural_frequency": 0.0}, "natural_frequency: .*above 0"),
        ({"damping_ratio": [1.0, -1.0]}, "damping_ratio: .*above 0"),
        ({"natural_frequency": [1.0, 2.0, 3.0]}, r"natural_frequency: got shape \(3,\)"),
    ],
)
def test_bad_parameters(options, message):
    with pytest.raises(InvalidParameter, match=message):
        make_law(laws.ComputedTorque, period=PERIOD, **options)


def test_a_model_from_a_file_has_no_machine_code():
    law = make_law(laws.ComputedTorque, joints=6, model=plants.MujocoPlant.from_file("ur5e"))
    with pytest.raises(UnsupportedLaw, match="native: the law calls rigid_body, .* or give the law a model in symbols"):
        Controller(law, native=True)


def loaded_error(start_time, **options):
    """RMS error of an arm with a load that the model lacks, held in a posture."""
    model = plants.TwoLinkArm(viscous=0.5)
    law = make_law(laws.ComputedTorque, model=model, natural_frequency=10.0, **options)
    still = signals.Sinusoid(amplitude=[0.0, 0.0], frequency=1.0, offset=[0.4, 0.7])
    robot = model.with_parameters({"payload": 1.0})
    return simulate(robot, law, still, 6.0).metrics(start_time=start_time)["rms_error"]


def test_the_integral_removes_the_offset_of_a_load():
    assert loaded_error(5.0) > 0.02
    assert loaded_error(5.0, integral_gain=3.0) < 1e-4


def test_the_integral_grows_by_eulers_rule_and_is_held_at_a_limit():
    arm = plants.TwoLinkArm()
    options = {"model": arm, "natural_frequency": 10.0, "integral_gain": 2.0}
    reference = np.array([0.01, 0.02])
    value = LawInput(np.zeros(2), reference, np.zeros(2), np.zeros(2))
    for limit, growth in ((None, [1, 2, 3]), (1e-3, [1, 1, 1])):
        law = make_law(laws.ComputedTorque, torque_limit=limit, **options)
        state = law.init(np.zeros(2))
        integrals = []
        for _ in growth:
            state, output = law.step(state, value)
            integrals.append(output.signals["integral"])
        np.testing.assert_allclose(integrals, PERIOD * 2.0 * 100.0 * np.outer(growth, reference), rtol=1e-9)


def test_friction_at_the_reference():
    arm = plants.TwoLinkArm(viscous=[0.5, 0.7], coulomb=0.4)
    plain, changed = (
        make_law(laws.ComputedTorque, model=arm, friction_at_reference=choice) for choice in (False, True)
    )
    rng = np.random.default_rng(2)
    start, value = rng.normal(size=2), LawInput(*rng.normal(size=(4, 2)))
    (_, first), (_, second) = (law.step(law.init(start), value) for law in (plain, changed))
    velocity = first.signals["velocity_estimate"]
    friction = [arm.evaluate("friction", value.position, rate) for rate in (value.velocity_reference, velocity)]
    np.testing.assert_allclose(second.torque - first.torque, friction[0] - friction[1], rtol=1e-9, atol=1e-12)


def test_friction_at_the_reference_needs_a_robot_in_symbols(robot):
    with pytest.raises(InvalidParameter, match="friction_at_reference: got a model MujocoPlant"):
        make_law(laws.ComputedTorque, model=robot, friction_at_reference=True)
