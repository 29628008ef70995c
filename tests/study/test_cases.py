"""Cases: drawn values reach their parts, and no others; what does not arrive is refused."""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest

import tarc.plants
from tarc.core.errors import InvalidParameter
from tarc.plants import EulerLagrange, TwoLinkArm
from tarc.study.cases import Cases
from tarc.study.specification import Study

SCENARIO = {
    "robot": {"kind": "TwoLinkArm", "viscous": [0.5, 0.5]},
    "law": [
        {"kind": "TDC", "inertia": {"fraction": 0.08}, "natural_frequency": 15.0},
        {
            "kind": "PID",
            "inertia": 1.0,
            "natural_frequency": 12.0,
            "estimator": {"kind": "Algebraic", "window": 0.004, "degree": 1},
        },
    ],
    "estimator": {"kind": "Algebraic", "window": 0.010, "degree": 2},
    "reference": {"kind": "Sinusoid", "amplitude": [0.3, 0.2], "frequency": 1.0},
    "sensor": {"bits": 16},
    "disturbance": [
        {"kind": "Payload", "mass": 2.0, "start_time": 0.5},
        {"kind": "StepDisturbance", "amplitude": [1.0, 2.0], "start_time": 0.2},
    ],
    "duration": 1.0,
}
RANGE = {"uniform": [0.5, 0.9]}


def cases(*keys, known=(), **changes):
    draws = {key: RANGE for key in keys}
    return Cases(Study.parse({"scenario": {**SCENARIO, **changes}, "draws": draws, "known": list(known)}))


def built(key, value=0.7, known=(), **changes):
    return cases(key, known=known, **changes).build(np.array([value]))


@pytest.mark.parametrize(
    ("key", "read"),
    [
        ("robot.payload", lambda case: case.setup.simulated.parameters["payload"]),
        ("robot.viscous.1", lambda case: case.setup.simulated.parameters["viscous"][1]),
        ("robot.masses.0", lambda case: case.setup.simulated.parameters["masses"][0]),
        ("sensor.noise", lambda case: case.setup.sensor.noise),
        ("disturbance.0.mass", lambda case: case.setup.events[0].mass),
        ("disturbance.1.amplitude.0", lambda case: case.setup.events[1].amplitude[0]),
        ("reference.amplitude.1", lambda case: case.setup.reference.amplitude[1]),
        ("initial_position.1", lambda case: case.initial_position[1]),
        ("initial_velocity", lambda case: case.initial_velocity),
        ("jitter", lambda case: case.jitter),
        ("law.0.natural_frequency", lambda case: case.setup.laws["TDC"].natural_frequency),
        ("law.1.inertia", lambda case: case.setup.laws["PID"].inertia),
        ("law.inertia.fraction", lambda case: 0.08 * np.trace(case.setup.laws["TDC"].inertia) / tdc_trace()),
    ],
)
def test_a_drawn_value_reaches_its_part_and_is_read_back(key, read):
    case = built(key)
    assert np.max(read(case)) == pytest.approx(0.7, rel=1e-12)
    assert np.nanmax(case.applied[key]) == pytest.approx(0.7, rel=1e-12)


def tdc_trace():
    return np.trace(cases("sensor.noise").nominal.laws["TDC"].inertia)


def test_what_is_not_drawn_stays_the_same_object():
    own = cases("robot.payload")
    first, second = own.build(np.array([0.6])), own.build(np.array([0.8]))
    for name in ("reference", "sensor", "laws", "events"):
        assert getattr(first.setup, name) is getattr(second.setup, name) or name == "events"
    assert first.setup.events[0] is second.setup.events[0]
    assert own.plant_parameters == ("payload",)
    assert not own.plant_is_rebuilt


def test_laws_do_not_know_the_drawn_robot_unless_the_study_says_so():
    blind, informed = built("robot.payload"), built("robot.payload", known=["robot.payload"])
    nominal = cases("sensor.noise").nominal.laws["TDC"].inertia
    np.testing.assert_array_equal(blind.setup.laws["TDC"].inertia, nominal)
    built_for = cases("sensor.noise", robot={**SCENARIO["robot"], "payload": 0.7}).nominal.laws["TDC"].inertia
    np.testing.assert_allclose(informed.setup.laws["TDC"].inertia, built_for, rtol=1e-12)
    assert np.trace(built_for) > 1.1 * np.trace(nominal)


def test_a_key_of_laws_changes_those_that_have_it():
    case = built("law.natural_frequency")
    assert [law.natural_frequency for law in case.setup.laws.values()] == [0.7, 0.7]
    only = built("law.0.natural_frequency")
    assert [law.natural_frequency for law in only.setup.laws.values()] == [0.7, 12.0]
    np.testing.assert_array_equal(only.applied["law.0.natural_frequency"], [0.7, np.nan])


def test_the_shared_estimator_and_those_of_laws_are_drawn_apart():
    shared = Cases(Study.parse({"scenario": SCENARIO, "draws": {"estimator.window": {"choice": [0.012, 0.014]}}}))
    case = shared.build(np.array([0.014]))
    assert case.setup.laws["TDC"].estimator.window == 0.014
    assert case.setup.laws["PID"].estimator.window == 0.004
    np.testing.assert_array_equal(case.applied["estimator.window"], [0.014, np.nan])
    own = Cases(Study.parse({"scenario": SCENARIO, "draws": {"law.estimator.window": {"choice": [0.006, 0.008]}}}))
    case = own.build(np.array([0.006]))
    assert [law.estimator.window for law in case.setup.laws.values()] == [0.010, 0.006]


def test_one_number_for_all_joints_is_read_back_from_all():
    case = built("robot.viscous")
    np.testing.assert_array_equal(case.setup.plant.parameters["viscous"], [0.7, 0.7])
    assert case.applied["robot.viscous"] == 0.7


def test_whole_numbers_stay_whole():
    study = Study.parse(
        {"scenario": SCENARIO, "draws": {"sensor.bits": {"choice": [14, 16]}, "computation_delay": {"choice": [0, 1]}}}
    )
    case = Cases(study).build(np.array([14.0, 1.0]))
    assert isinstance(case.setup.sensor.bits, int)
    assert isinstance(case.computation_delay, int)


def test_an_index_beyond_the_joints_is_refused():
    with pytest.raises(InvalidParameter, match=r"robot.viscous.5: got 5, which is no index of 2 numbers; use 0 to 1"):
        built("robot.viscous.5")


def test_a_value_that_a_part_refuses_names_its_key():
    for key in ("sensor.noise", "robot.payload", "law.natural_frequency"):
        with pytest.raises(InvalidParameter, match=rf"{key.replace('law', 'law.0')}: got .?-0.7"):
            built(key, -0.7)


class DeafArm(TwoLinkArm):
    """An arm that forgets the payload that it is given."""

    def validate(self) -> None:
        super().validate()
        object.__setattr__(self, "payload", 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class HiddenMass(EulerLagrange):
    """A mass whose energy has the number in place of the symbol."""

    mass: float = 1.0

    @property
    def n_joints(self) -> int:
        return 1

    def kinetic_energy(self, q, dq, p):
        return self.mass * dq[0] ** 2 / 2

    def potential_energy(self, q, p):
        return ca.SX(0)


def test_a_draw_that_does_not_reach_the_plant_is_refused(monkeypatch):
    monkeypatch.setattr(tarc.plants, "TwoLinkArm", DeafArm)
    with pytest.raises(InvalidParameter, match=r"draws.robot.payload: 0.7 was drawn, and the applied value is 0: "):
        built("robot.payload")


def test_a_schedule_from_the_start_hides_a_draw():
    schedule = {"kind": "ParameterSchedule", "parameter": "payload", "times": [0.0], "values": [1.0]}
    with pytest.raises(InvalidParameter, match=r"draws.robot.payload: disturbance.0 sets payload from the start"):
        built("robot.payload", disturbance=[schedule])


def test_energies_with_numbers_in_place_of_symbols_are_derived_anew(monkeypatch):
    monkeypatch.setattr(tarc.plants, "Pendulum", HiddenMass)
    one = {**SCENARIO, "robot": {"kind": "Pendulum"}, "law": {"kind": "TDC", "inertia": 0.1, "natural_frequency": 9.0}}
    one |= {"reference": {"kind": "Sinusoid", "amplitude": [0.3], "frequency": 1.0}, "disturbance": []}
    own = Cases(Study.parse({"scenario": one, "draws": {"robot.mass": RANGE}}))
    assert own.plant_is_rebuilt
    plant = own.build(np.array([0.7])).setup.simulated
    assert plant.inertia([0.0])[0, 0] == pytest.approx(0.7)
    hidden = HiddenMass()
    for mass in (2.0, 3.0):
        assert hidden.with_parameters({"mass": mass}).inertia([0.0])[0, 0] == pytest.approx(mass)


def test_plants_with_other_parameters_share_their_equations():
    arm = TwoLinkArm()
    first = arm.with_parameters({"payload": 1.0})
    second = arm.with_parameters({"payload": 2.0})
    assert second._functions is arm._functions
    assert first._functions is not arm._functions
    np.testing.assert_array_equal(second.inertia([0.2, 0.5]), TwoLinkArm(payload=2.0).inertia([0.2, 0.5]))
    with pytest.raises(InvalidParameter, match="payload: got -1"):
        arm.with_parameters({"payload": -1.0})


def test_a_gearbox_is_drawn_by_its_parameters():
    gearbox = {"stiffness": 5000.0, "motor_inertia": 0.05}
    own = Cases(
        Study.parse(
            {
                "scenario": {**SCENARIO, "gearbox": gearbox, "disturbance": []},
                "draws": {"gearbox.stiffness": {"uniform": [4000, 6000]}, "robot.viscous.0": RANGE},
            }
        )
    )
    case = own.build(np.array([4500.0, 0.7]))
    assert own.plant_parameters == ("gearbox_stiffness", "viscous")
    np.testing.assert_array_equal(case.setup.simulated.parameters["gearbox_stiffness"], [4500.0, 4500.0])
    assert case.setup.simulated.parameters["viscous"][0] == 0.7
    assert case.setup.plant.parameters["viscous"][0] == 0.7


def test_the_model_in_a_law_is_drawn_apart_from_the_robot():
    law = {"kind": "TDC", "inertia": {"model": {"payload": 1.0}, "fraction": 0.1}, "natural_frequency": 15.0}
    case = built("law.inertia.model.payload", law=law)
    model = case.setup.laws["TDC"].inertia.model
    assert model.parameters["payload"] == 0.7
    np.testing.assert_array_equal(case.applied["law.inertia.model.payload"], [0.7])
    assert case.setup.simulated.parameters["payload"] == 0.0
    assert built("law.inertia.fraction", law=law).setup.laws["TDC"].inertia.fraction == 0.7
