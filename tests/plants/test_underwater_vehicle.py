"""The underwater vehicle against Fossen's equations in the vehicle's frame, and against its thrusters."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import tarc
from tarc.core.errors import InvalidParameter
from tarc.plants import UnderwaterVehicle

WEIGHT_IN_WATER = (13.5 - 1000.0 * 0.0134) * 9.82


def rotation(yaw):
    result = np.eye(4)
    result[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    return result


def fossen_acceleration(vehicle, q, dq, force, load=0.0):
    """q̈ by M ν̇ + C(ν) ν + D(νr) νr + g = Rᵀ τ, with q̈ = R ν̇ + Ṙ ν."""
    turn = rotation(q[3])
    nu = turn.T @ dq
    mass = 13.5 + load
    m11, m22, m33, m44 = mass + 6.36, mass + 7.12, mass + 18.68, 0.37 + 0.222
    u, v, _, r = nu
    coriolis = np.array([-m22 * v * r, m11 * u * r, 0.0, (m22 - m11) * u * v])
    relative = nu - turn.T @ [*vehicle.current, 0.0]
    drag = np.array([13.7, 0.0, 33.0, 0.0]) * relative + np.array([141.0, 217.0, 190.0, 1.5]) * abs(relative) * relative
    restoring = np.array([0.0, 0.0, -(WEIGHT_IN_WATER + load * 9.82), 0.0])
    rate = (turn.T @ force - coriolis - drag - restoring) / [m11, m22, m33, m44]
    spin = r * np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]])
    return turn @ rate + turn @ spin @ nu


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("current", [(0.0, 0.0, 0.0), (0.3, -0.2, 0.1)])
def test_it_moves_as_fossen_s_equations(seed, current):
    rng = np.random.default_rng(seed)
    vehicle = UnderwaterVehicle(current=current, payload=2.0)
    q, dq, force = rng.standard_normal((3, 4)) * [[3.0], [1.0], [20.0]]
    expected = fossen_acceleration(vehicle, q, dq, force, 2.0)
    assert np.allclose(vehicle.evaluate("acceleration", q, dq, force), expected, rtol=1e-10, atol=1e-10)


def test_a_held_heading_is_the_vehicle_without_its_yaw():
    rng = np.random.default_rng(0)
    q, dq, force = rng.standard_normal((3, 3))
    free = UnderwaterVehicle()
    held = UnderwaterVehicle(heading=0.7)
    assert (held.n_joints, held.joint_names, held.units) == (3, ["x", "y", "z"], ["m"] * 3)
    full = free.evaluate("acceleration", np.append(q, 0.7), np.append(dq, 0.0), np.append(force, 0.0))
    assert np.allclose(held.evaluate("acceleration", q, dq, force), full[:3], rtol=1e-12)
    assert "heading" in held.parameters
    assert "heading" not in free.parameters


def test_a_thrust_ahead_ends_at_the_speed_at_which_drag_balances_it():
    yaw = 0.5
    vehicle = UnderwaterVehicle(mass=13.4, heading=yaw)  # floats
    ahead = rotation(yaw)[:3, 0]
    motion = solve_ivp(
        lambda t, x: np.append(x[3:], vehicle.evaluate("acceleration", x[:3], x[3:], 40.0 * ahead)),
        (0, 30),
        np.zeros(6),
        rtol=1e-9,
        atol=1e-9,
    )
    speed = (-13.7 + np.sqrt(13.7**2 + 4 * 141.0 * 40.0)) / (2 * 141.0)
    assert np.allclose(motion.y[3:, -1], speed * ahead, rtol=0, atol=1e-6)


def test_ahead_it_is_directionally_unstable_as_munk_found():
    """The larger added mass in sway turns a vehicle without fins across its course."""
    vehicle = UnderwaterVehicle(linear_drag=0.0, quadratic_drag=0.0)
    moment = -vehicle.bias(np.zeros(4), np.array([1.0, 0.05, 0.0, 0.0]))[3]
    assert moment == pytest.approx((6.36 - 7.12) * 0.05, rel=1e-9)


def test_it_drifts_with_the_current():
    vehicle = UnderwaterVehicle(current=(0.3, -0.2, 0.0), heading=1.0)
    drag = vehicle.evaluate("friction", np.zeros(3), np.array([0.3, -0.2, 0.0]))
    assert np.allclose(drag, 0, rtol=0, atol=1e-12)
    assert vehicle.evaluate("friction", np.zeros(3), np.zeros(3)) @ np.array([0.3, -0.2, 0.0]) < 0


def test_weight_and_buoyancy_pull_along_z():
    assert np.allclose(UnderwaterVehicle().gravity_torque(np.ones(4)), [0, 0, -WEIGHT_IN_WATER, 0])
    floats = UnderwaterVehicle(water_density=1025.0)
    assert floats.gravity_torque(np.ones(4))[2] > 0


def test_the_limits_can_be_had_in_every_direction_at_once():
    """Least thrusts of four thrusters at 45° that turn about the vertical with a lever, at every corner."""
    vehicle = UnderwaterVehicle(thrust=40.0)
    planar, _, vertical, yaw = vehicle.torque_limits
    angles = np.radians([45.0, -45.0, 135.0, -135.0])
    turns = 0.19 * np.array([1.0, -1.0, -1.0, 1.0])
    allocation = np.linalg.pinv(np.vstack([np.cos(angles), np.sin(angles), turns]))
    largest = 0.0
    for heading in np.linspace(0, np.pi, 181):
        for x, y, n in np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T:
            body = rotation(heading)[:2, :2].T @ [planar * x, planar * y]
            largest = max(largest, np.abs(allocation @ [*body, yaw * n]).max())
    assert largest == pytest.approx(40.0, rel=1e-3)
    assert vertical == pytest.approx(0.8 * 4 * 40.0)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"mass": 0.0}, "mass: got 0"),
        ({"added_mass": (1.0, 2.0, 3.0)}, "added_mass: got shape"),
        ({"quadratic_drag": -1.0}, "quadratic_drag: .* at least 0"),
        ({"current": (1.0, 2.0)}, "current: got shape"),
        ({"heading": "north"}, "heading: got 'north'"),
    ],
)
def test_impossible_parameters_are_refused(values, message):
    with pytest.raises(InvalidParameter, match=message):
        UnderwaterVehicle(**values)


@pytest.mark.parametrize("heading", [None, 0.3])
def test_a_law_holds_its_place_in_a_current(heading):
    vehicle = UnderwaterVehicle(heading=heading, current=(0.2, 0.1, 0.0))
    law = tarc.laws.TDC(
        inertia=0.1 * vehicle.inertia(vehicle.home),
        natural_frequency=1.0,
        period=0.05,
        estimator=tarc.estimators.Algebraic(window=0.2, period=0.05),
    )
    still = tarc.signals.Sinusoid(amplitude=np.zeros(vehicle.n_joints), frequency=1.0)
    payload = tarc.signals.Payload(mass=1.0, start_time=20.0)
    run = tarc.simulate(vehicle, law, still, 40.0, disturbance=payload)
    assert run.status.completed
    assert np.abs(run.data["position"].values[-100:]).max() < 1e-3
