"""Plants with passive coordinates: against equations of their own, energy and a closed form."""

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import tarc
from tarc.analysis.workspace import Workspace
from tarc.core.errors import InvalidParameter
from tarc.plants import EulerLagrange

PERIOD = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class CartPole(EulerLagrange):
    """A driven cart with a free pendulum on it, hanging down at zero."""

    cart: float = 1.0
    mass: float = 0.3
    length: float = 0.5
    gravity: float = 9.81

    @property
    def n_joints(self):
        return 1

    @property
    def n_coordinates(self):
        return 2

    @property
    def joint_names(self):
        return ["rail"]

    @property
    def coordinate_names(self):
        return ["rail", "pivot"]

    @property
    def units(self):
        return ["m"]

    def kinetic_energy(self, q, dq, p):
        """Return T."""
        return (
            (p.cart + p.mass) * dq[0] ** 2 / 2
            + p.mass * p.length * ca.cos(q[1]) * dq[0] * dq[1]
            + p.mass * p.length**2 * dq[1] ** 2 / 2
        )

    def potential_energy(self, q, p):
        """Return V."""
        return -p.mass * p.gravity * p.length * ca.cos(q[1])


@dataclass(frozen=True, kw_only=True, eq=False)
class ElasticJoint(EulerLagrange):
    """A motor that drives a load over a spring."""

    motor: float = 0.2
    load: float = 0.5
    spring: float = 300.0

    @property
    def n_joints(self):
        return 1

    @property
    def n_coordinates(self):
        return 2

    @property
    def driven(self):
        return (0,)

    def kinetic_energy(self, q, dq, p):
        """Return T."""
        return (p.motor * dq[0] ** 2 + p.load * dq[1] ** 2) / 2

    def potential_energy(self, q, p):
        """Return V."""
        return p.spring * (q[0] - q[1]) ** 2 / 2


class LinkSide(ElasticJoint):
    """The same with the encoder at the load, and a start without twist."""

    @property
    def measured(self):
        return (1,)

    def coordinates(self, position):
        """Return motor and load at the same angle."""
        return np.repeat(position, 2)


def law(inertia, **options):
    return tarc.laws.TDC(
        inertia=inertia,
        natural_frequency=10.0,
        period=PERIOD,
        estimator=tarc.estimators.Algebraic(window=0.010),
        **options,
    )


def cart_pole_rates(state, force):
    """Return the derivative of (x, θ, ẋ, θ̇), from Newton's equations of cart and pendulum."""
    _, angle, v, w = state
    sine, cosine = np.sin(angle), np.cos(angle)
    x = (force + 0.3 * sine * (0.5 * w**2 + 9.81 * cosine)) / (1.0 + 0.3 * sine**2)
    return [v, w, x, -(x * cosine + 9.81 * sine) / 0.5]


def test_cart_pole_under_a_law_moves_by_its_own_equations():
    plant = CartPole()
    run = tarc.simulate(
        plant,
        law(0.1),
        tarc.signals.Sinusoid(amplitude=0.2, frequency=0.7),
        1.0,
        initial_position=[0.0, 0.4],
        disturbance=tarc.signals.SineDisturbance(amplitude=0.5, frequency=3.0),
    )
    data = run.data
    assert data["passive_position"].dims == ("time", "passive_joint")
    assert data["passive_joint"].values.tolist() == ["pivot"]
    assert data["passive_position"].attrs["units"] == "rad"
    assert data["position"].attrs["units"] == "m"
    assert data["passive_position"].values[0, 0] == 0.4
    substeps = int(data.attrs["substeps"])
    state = [0.0, 0.4, 0.0, 0.0]
    for k, force in enumerate(data["torque"].values[:-1, 0]):
        for i in range(substeps):
            time = (k + i / substeps) * PERIOD
            total = force + 0.5 * np.sin(3.0 * time)
            span = 0, PERIOD / substeps
            state = solve_ivp(
                lambda _, x, force: cart_pole_rates(x, force), span, state, args=(total,), rtol=1e-10, atol=1e-12
            ).y[:, -1]
    end = data.isel(time=-1)
    assert state[0] == pytest.approx(float(end["position"][0]), abs=1e-6)
    assert state[1] == pytest.approx(float(end["passive_position"][0]), abs=2e-6)
    assert state[3] == pytest.approx(float(end["passive_velocity"][0]), abs=1e-5)


def test_an_undriven_cart_pole_keeps_its_energy():
    plant = CartPole()
    reference = tarc.signals.Sinusoid(amplitude=[0.0], frequency=1.0)
    run = tarc.simulate(plant, law(0.1, torque_limit=1e-12), reference, 2.0, initial_position=[0.0, 2.0], substeps=4)
    data = run.data
    q = np.hstack([data["position"].values, data["passive_position"].values])
    v = np.hstack([data["velocity"].values, data["passive_velocity"].values])
    energy = np.array([plant.evaluate("energy", *state) for state in zip(q[::50], v[::50], strict=True)])
    assert np.ptp(q[:, 1]) > 3
    np.testing.assert_allclose(energy, energy[0], atol=1e-9)


@pytest.mark.parametrize("kind", [ElasticJoint, LinkSide])
def test_two_masses_with_a_spring_under_a_constant_torque(kind):
    """J₁ θ̈ = τ − k φ and J₂ q̈ = k φ, so that φ = θ − q = τ (1 − cos ωt)/(J₁ ω²) with ω² = k (1/J₁ + 1/J₂)."""
    plant = kind()
    reference = tarc.signals.Sinusoid(amplitude=[0.0], frequency=1.0, offset=1e3)
    run = tarc.simulate(
        plant, law(0.1, torque_limit=2.0), reference, 0.5, initial_position=[0.3], divergence_threshold=1e4, substeps=4
    )
    data = run.data
    assert np.all(data["torque"].values[1:] == 2.0)
    time = data["time"].values
    rate = np.sqrt(300.0 * (1 / 0.2 + 1 / 0.5))
    twist = 2.0 * (1 - np.cos(rate * time)) / (0.2 * rate**2)
    middle = 2.0 * time**2 / 2 / 0.7
    is_motor = kind is ElasticJoint
    start = np.array([0.3, 0.0] if is_motor else [0.3, 0.3])
    motor, load = ("position", "passive_position") if is_motor else ("passive_position", "position")
    offset = start[0] - start[1]
    found = data[motor].values[:, 0] - data[load].values[:, 0]
    np.testing.assert_allclose(found, twist + offset * np.cos(rate * time), atol=1e-8)
    centre = (0.2 * data[motor].values[:, 0] + 0.5 * data[load].values[:, 0]) / 0.7
    np.testing.assert_allclose(centre, middle + (0.2 * start[0] + 0.5 * start[1]) / 0.7, atol=1e-8)


def test_the_inertia_at_the_joints_is_that_with_passive_coordinates_free():
    plant = CartPole()
    torque, step = 1.7, np.array([1.7])
    acceleration = plant.evaluate("acceleration", [0.1, 0.0], [0.0, 0.0], step)
    assert plant.joint_inertia([0.1]) == pytest.approx(torque / acceleration[0])
    assert plant.mean_inertia([[0.1, 0.2]]) == pytest.approx(plant.joint_inertia([0.1]))
    with pytest.raises(InvalidParameter, match="give the inertia of the law as numbers"):
        LinkSide().joint_inertia([0.1])


def test_certificates_designs_and_models_name_passive_joints():
    plant = CartPole()
    message = "no torque acts on the joint pivot of CartPole, and a .* needs one on every joint"
    with pytest.raises(InvalidParameter, match=message):
        tarc.certify_law(law(0.1), plant, Workspace.box([-1.0], [1.0]))
    with pytest.raises(InvalidParameter, match=message):
        tarc.design.design_controller(plant)
    with pytest.raises(InvalidParameter, match="pivot of CartPole, and the model of ComputedTorque needs one"):
        tarc.laws.ComputedTorque(
            model=plant,
            natural_frequency=10.0,
            period=PERIOD,
            estimator=tarc.estimators.Algebraic(window=0.010),
        )


def test_a_plant_without_passive_coordinates_has_no_more_than_its_joints():
    arm = tarc.plants.TwoLinkArm()
    assert arm.is_fully_driven
    assert arm.driven == arm.measured == (0, 1)
    assert arm.unmeasured == ()
    assert arm.passive_joints == []
    assert arm.coordinate_names == arm.joint_names
    assert arm.coordinates([0.1, 0.2]).tolist() == [0.1, 0.2]
