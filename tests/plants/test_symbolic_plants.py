"""Symbolic plants against closed forms, Newton–Euler equations and energy balances."""

from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.linalg import expm
from scipy.special import ellipk

from tarc.core.errors import InvalidParameter
from tarc.plants import MassSpringDamper, NLinkArm, Pendulum, TwoLinkArm, WheeledMobileRobot
from tarc.plants.base import Plant
from tarc.plants.euler_lagrange import EulerLagrange
from tarc.simulation.closed_loop import runge_kutta

SMOOTH: dict[str, Any] = {"coulomb_width": 0.5}  # wide enough for the energy balance to show the integrator's order
FOUR: dict[str, Any] = {
    "masses": (2.0, 1.5, 1.0, 0.5),
    "lengths": (0.4, 0.5, 0.3, 0.2),
    "centres": (0.2, 0.25, 0.1, 0.1),
}
BARE: dict[str, EulerLagrange] = {
    "two links": TwoLinkArm(viscous=(0.3, 0.2), coulomb=(0.5, 0.4), **SMOOTH),
    "three links": NLinkArm(viscous=0.1, coulomb=0.2, **SMOOTH),
    "four links": NLinkArm(**FOUR, inertias=(0.02, 0.03, 0.01, 0.005), viscous=0.05),
    "pendulum": Pendulum(rotor=0.1, viscous=0.2, coulomb=0.3, **SMOOTH),
    "one mass": MassSpringDamper(),
    "three masses": MassSpringDamper(masses=(1.0, 2.0, 0.5), springs=(50.0, 80.0, 30.0), dampers=(1.0, 0.5, 2.0)),
    "wheeled robot": WheeledMobileRobot(viscous=0.05, **SMOOTH),
}
LOADED: dict[str, EulerLagrange] = {
    "two links, loaded": TwoLinkArm(viscous=(0.3, 0.2), coulomb=(0.5, 0.4), payload=2.0, **SMOOTH),
    "three links, loaded": NLinkArm(viscous=0.1, coulomb=0.2, payload=2.0, **SMOOTH),
    "four links, loaded": NLinkArm(**FOUR, inertias=(0.02, 0.03, 0.01, 0.005), viscous=0.05, payload=1.0),
    "pendulum, loaded": Pendulum(rotor=0.1, viscous=0.2, payload=0.7),
    "three masses, loaded": MassSpringDamper(
        masses=(1.0, 2.0, 0.5), springs=(50.0, 80.0, 30.0), dampers=(1.0, 0.5, 2.0), payload=1.5
    ),
    "wheeled robot, loaded": WheeledMobileRobot(viscous=0.05, payload=8.0, **SMOOTH),
}
PLANTS = BARE | LOADED
every_plant = pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS.keys())
sampled = settings(max_examples=20)


def vectors(size: int, limit: float = 3.0) -> st.SearchStrategy[np.ndarray]:
    return arrays(float, size, elements=st.floats(-limit, limit, allow_subnormal=False))


def integrate(
    plant: EulerLagrange, q: np.ndarray, dq: np.ndarray, torque: np.ndarray, dt: float, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities at 0, dt, …, steps·dt, one row an instant."""
    n, start = plant.n_joints, np.concatenate([q, dq])
    x = ca.SX.sym("x", 2 * n)
    step = ca.Function("step", [x], [ca.vertcat(*runge_kutta(plant, x[:n], x[n:], torque, dt)[:2])])
    path = np.vstack([start, np.array(step.mapaccum(steps)(start)).T])
    return path[:, :n], path[:, n:]


@every_plant
@sampled
@given(data=st.data())
def test_inertia_is_symmetric_positive_definite(plant: EulerLagrange, data: st.DataObject) -> None:
    M = plant.inertia(data.draw(vectors(plant.n_joints)))
    assert np.allclose(M, M.T, rtol=0, atol=1e-14 * np.max(np.abs(M)))
    assert np.linalg.eigvalsh(M)[0] > 0


@every_plant
@sampled
@given(data=st.data())
def test_inertia_rate_minus_twice_coriolis_is_skew_symmetric(plant: EulerLagrange, data: st.DataObject) -> None:
    q, dq = data.draw(vectors(plant.n_joints)), data.draw(vectors(plant.n_joints))
    dt = 1e-5
    rate = (plant.inertia(q + dt * dq) - plant.inertia(q - dt * dq)) / (2 * dt)
    skew = rate - 2 * plant.evaluate("coriolis", q, dq)
    # The central difference is off by dt²/6·|q̇|³·|M'''| + ε|M|/dt: below 1e-8 of |M| for |q̇| ≤ 3 a joint.
    assert np.allclose(skew, -skew.T, rtol=0, atol=1e-8 * np.max(np.abs(plant.inertia(q))))


@every_plant
@sampled
@given(data=st.data())
def test_acceleration_solves_the_equation_of_motion(plant: EulerLagrange, data: st.DataObject) -> None:
    q, dq, torque = (data.draw(vectors(plant.n_joints)) for _ in range(3))
    acceleration = plant.evaluate("acceleration", q, dq, torque)
    N = plant.evaluate("bias", q, dq)
    parts = plant.evaluate("coriolis", q, dq) @ dq + plant.gravity_torque(q) + plant.evaluate("friction", q, dq)
    assert np.allclose(N, parts, rtol=1e-12, atol=1e-12)
    assert np.allclose(plant.inertia(q) @ acceleration + N, torque, rtol=1e-9, atol=1e-9 * (1 + np.max(np.abs(N))))


@every_plant
@sampled
@given(data=st.data())
def test_linearised_about_a_motion_it_is_the_slope_of_the_torque(plant: EulerLagrange, data: st.DataObject) -> None:
    """M, D and G against differences of M(q) q̈ + N(q, q̇) along a random direction."""
    q, dq, ddq, way = (data.draw(vectors(plant.n_joints)) for _ in range(4))
    M, D, G = plant.linearised(q, dq, ddq)
    assert np.allclose(M, plant.inertia(q))
    assert np.allclose(D, plant.damping(q, dq), rtol=1e-9, atol=1e-9)
    step = 1e-6

    def torque(share: float, *on: float) -> np.ndarray:
        a, b = (share * step * unit * way for unit in on)
        return plant.inertia(q + a) @ ddq + plant.bias(q + a, dq + b)

    for matrix, on in ((G, (1.0, 0.0)), (D, (0.0, 1.0))):
        slope = (torque(1.0, *on) - torque(-1.0, *on)) / (2 * step)
        assert np.allclose(matrix @ way, slope, rtol=1e-5, atol=1e-5 * (1 + np.abs(matrix).max()))
    still = plant.linearised(q)
    assert np.allclose(still[1], plant.damping(q))
    assert np.allclose(still[2], Plant.linearised(plant, q)[2], rtol=1e-5, atol=1e-5 * (1 + np.abs(still[2]).max()))


def test_many_states_at_once_are_the_states_one_by_one() -> None:
    plant = TwoLinkArm(coulomb=[1.0, 2.0], viscous=[0.3, 0.1])
    q, v = np.random.default_rng(1).normal(size=(2, 2, 40))
    for count in (3, 40):
        expected = [plant.bias(*state) for state in zip(q.T[:count], v.T[:count], strict=True)]
        np.testing.assert_allclose(plant.biases(q[:, :count], v[:, :count]), expected, rtol=1e-12)


@every_plant
@sampled
@given(data=st.data())
def test_gravity_is_the_gradient_of_the_potential(plant: EulerLagrange, data: st.DataObject) -> None:
    q, still, h = data.draw(vectors(plant.n_joints)), np.zeros(plant.n_joints), 1e-4

    def potential(x: np.ndarray) -> float:
        return plant.evaluate("energy", x, still)

    slope = [(potential(q + h * e) - potential(q - h * e)) / (2 * h) for e in np.eye(plant.n_joints)]
    # h²/6·|V'''| + ε|V|/h, with V and its derivatives at most some 1000 J
    assert np.allclose(plant.gravity_torque(q), slope, rtol=0, atol=2e-6)


@every_plant
@sampled
@given(data=st.data())
def test_kinetic_energy_is_the_quadratic_form_of_the_inertia(plant: EulerLagrange, data: st.DataObject) -> None:
    q, dq = data.draw(vectors(plant.n_joints)), data.draw(vectors(plant.n_joints))
    kinetic = plant.evaluate("energy", q, dq) - plant.evaluate("energy", q, np.zeros(plant.n_joints))
    assert kinetic == pytest.approx(dq @ plant.inertia(q) @ dq / 2, rel=1e-9, abs=1e-10)


@every_plant
@sampled
@given(data=st.data())
def test_friction_never_feeds_energy_in(plant: EulerLagrange, data: st.DataObject) -> None:
    q, dq = data.draw(vectors(plant.n_joints)), data.draw(vectors(plant.n_joints))
    assert dq @ plant.evaluate("friction", q, dq) >= 0


@every_plant
def test_energy_gained_is_work_done_with_the_error_of_a_fourth_order_method(plant: EulerLagrange) -> None:
    n, duration = plant.n_joints, 1.0
    torque = np.linspace(1.0, -0.5, n)

    def imbalance(steps: int) -> float:
        dt = duration / steps
        q, dq = integrate(plant, np.linspace(0.3, -0.4, n), np.linspace(-0.5, 1.0, n), torque, dt, steps)
        power = [v @ (torque - plant.evaluate("friction", x, v)) for x, v in zip(q, dq, strict=True)]
        simpson = dt / 3 * (power[0] + 4 * sum(power[1::2]) + 2 * sum(power[2:-1:2]) + power[-1])
        return abs(plant.evaluate("energy", q[-1], dq[-1]) - plant.evaluate("energy", q[0], dq[0]) - simpson)

    coarse, fine = imbalance(400), imbalance(800)
    assert fine < 2e-7
    assert coarse == pytest.approx(16 * fine, rel=0.1)  # order four, of Simpson's rule as of Runge–Kutta


@sampled
@given(q=vectors(2), dq=vectors(2), load=st.floats(0, 5), sizes=arrays(float, 8, elements=st.floats(0.1, 3)))
def test_two_links_are_the_textbook_s(q: np.ndarray, dq: np.ndarray, load: float, sizes: np.ndarray) -> None:
    m1, m2, l1, l2, c1, c2, I1, I2 = sizes
    values = {"masses": (m1, m2), "lengths": (l1, l2), "centres": (c1, c2), "inertias": (I1, I2), "payload": load}
    arm, g = BARE["two links"], 9.81
    cos2, sin2 = np.cos(q[1]), np.sin(q[1])
    # Slotine & Li (1991), Section 9.1, with the tip mass as a third body at l2
    a3, coupling = I2 + m2 * c2**2 + load * l2**2, l1 * (m2 * c2 + load * l2)
    a1 = I1 + m1 * c1**2 + (m2 + load) * l1**2
    M = [[a1 + a3 + 2 * coupling * cos2, a3 + coupling * cos2], [a3 + coupling * cos2, a3]]
    C = coupling * sin2 * np.array([[-dq[1], -dq[0] - dq[1]], [dq[0], 0]])
    outer = (m2 * c2 + load * l2) * g * np.cos(q.sum())
    gravity = [(m1 * c1 + (m2 + load) * l1) * g * np.cos(q[0]) + outer, outer]
    close = {"rtol": 1e-12, "atol": 1e-12 * max(a1, a3) * 100}
    assert np.allclose(arm.evaluate("inertia", q, parameters=values), M, **close)
    assert np.allclose(arm.evaluate("coriolis", q, dq, parameters=values), C, **close)
    assert np.allclose(arm.evaluate("gravity", q, parameters=values), gravity, **close)


def test_two_point_masses_at_a_right_angle() -> None:
    assert np.allclose(TwoLinkArm().inertia([0.7, np.pi / 2]), [[3, 1], [1, 1]], rtol=1e-15)


@pytest.mark.parametrize("name", ["three links", "three links, loaded", "four links", "four links, loaded"])
@sampled
@given(data=st.data())
def test_many_links_are_the_sum_of_bodies(name: str, data: st.DataObject) -> None:
    arm = PLANTS[name]
    n = arm.n_joints
    q = data.draw(vectors(n))
    link = np.exp(1j * np.cumsum(q))  # directions in the complex plane
    M, gravity = np.zeros((n, n)), np.zeros(n)
    p = arm.parameters
    bodies = list(zip(p["masses"], p["inertias"], range(n), p["centres"], strict=True))
    for mass, inertia, last, reach in [*bodies, (p["payload"], 0.0, n - 1, p["lengths"][-1])]:
        arms = np.append(p["lengths"][:last], reach) * link[: last + 1]
        J = np.array([1j * arms[j:].sum() for j in range(n)])
        spin = (np.arange(n) <= last).astype(float)
        M += mass * np.real(np.outer(J.conj(), J)) + inertia * np.outer(spin, spin)
        gravity += mass * 9.81 * np.imag(J)
    assert np.allclose(arm.inertia(q), M, rtol=1e-12, atol=1e-13)
    assert np.allclose(arm.gravity_torque(q), gravity, rtol=1e-12, atol=1e-12)


def test_pendulum_swings_slightly_at_its_small_angle_frequency() -> None:
    plant = Pendulum(mass=2.0, length=0.5, rotor=0.3, payload=1.0)
    frequency = np.sqrt(3 * 9.81 * 0.5 / (3 * 0.25 + 0.3))
    q, dq = integrate(plant, np.array([1e-3]), np.zeros(1), np.zeros(1), 2 * np.pi / frequency / 200, 200)
    # after one period: amplitude²/16 of it late, which the position feels in second order
    assert q[-1, 0] == pytest.approx(1e-3, rel=1e-6)
    assert q[100, 0] == pytest.approx(-1e-3, rel=1e-6)
    assert abs(dq[-1, 0]) < 1e-3 * frequency * 1e-6


def test_pendulum_swings_widely_at_the_period_of_the_elliptic_integral() -> None:
    plant, amplitude = Pendulum(length=0.8), 2.0
    period = 4 * np.sqrt(0.8 / 9.81) * ellipk(np.sin(amplitude / 2) ** 2)
    q, dq = integrate(plant, np.array([amplitude]), np.zeros(1), np.zeros(1), period / 800, 800)
    assert q[-1, 0] == pytest.approx(amplitude, abs=1e-8)
    assert dq[-1, 0] == pytest.approx(0, abs=1e-8)  # (2 π/800)⁴ of an angle of 2


@pytest.mark.parametrize("payload", [0.0, 1.5])
def test_chain_of_masses_is_the_matrix_exponential(payload: float) -> None:
    plant = MassSpringDamper(masses=(1, 2, 0.5), springs=(50, 80, 30), dampers=(1, 0.5, 2), payload=payload)

    def chain(a: float, b: float, c: float) -> np.ndarray:
        return np.array([[a + b, -b, 0], [-b, b + c, -c], [0, -c, c]])

    K, D, M = chain(50, 80, 30), chain(1, 0.5, 2), np.diag([1, 2, 0.5 + payload])
    force, begin = np.array([3.0, -2.0, 1.0]), np.array([0.1, -0.2, 0.05, 0.0, 1.0, -0.5])
    A = np.zeros((7, 7))  # the constant force as a seventh state
    A[:3, 3:6] = np.eye(3)
    A[3:6] = np.linalg.solve(M, np.hstack([-K, -D, force[:, None]]))
    exact = (expm(A) @ [*begin, 1.0])[:6]
    q, dq = integrate(plant, begin[:3], begin[3:], force, 1 / 1000, 1000)
    assert np.allclose([*q[-1], *dq[-1]], exact, rtol=0, atol=1e-7)  # (15 rad/s · dt)⁴, times ω for the velocity


@sampled
@given(wheels=vectors(2), torque=vectors(2), load=st.floats(0, 20), offset=st.floats(-0.2, 0.2))
def test_wheeled_robot_obeys_newton_and_euler(
    wheels: np.ndarray, torque: np.ndarray, load: float, offset: float
) -> None:
    robot = WheeledMobileRobot(coulomb=0.0, viscous=0.0)
    values = {"payload": load, "offset": offset}
    m, inertia, r, b, J = robot.mass, robot.inertia_body, robot.wheel_radius, robot.half_track, robot.wheel_inertia
    spin = robot.evaluate("acceleration", np.zeros(2), wheels, torque, parameters=values)
    v, w = r * wheels.sum() / 2, r * (wheels[0] - wheels[1]) / (2 * b)
    dv, dw = r * spin.sum() / 2, r * (spin[0] - spin[1]) / (2 * b)
    push = (torque - J * spin) / r  # each tyre's force forward
    side = m * (v * w + offset * dw)  # what holds the axle from slipping, less the load's own share
    assert m * (dv - offset * w**2) + load * dv == pytest.approx(push.sum(), abs=1e-9)
    assert inertia * dw == pytest.approx(b * (push[0] - push[1]) - offset * side, abs=1e-9)


def test_wheeled_robot_keeps_its_energy_without_torque_and_friction() -> None:
    robot = WheeledMobileRobot(coulomb=0.0, viscous=0.0, payload=3.0)
    q, dq = integrate(robot, np.zeros(2), np.array([12.0, 5.0]), np.zeros(2), 2e-3, 1000)
    energy = [robot.evaluate("energy", x, v) for x, v in zip(q, dq, strict=True)]
    assert np.ptp(dq[:, 0]) > 1  # it does turn, so the speeds do change
    assert np.allclose(energy, energy[0], rtol=1e-9)


def test_wheeled_robot_runs_straight_and_reaches_torque_over_friction() -> None:
    robot = WheeledMobileRobot(coulomb=0.0, viscous=0.2, payload=3.0)
    inertia = 20.0 * 0.095**2 / 2 + 0.01  # each wheel carries half of m + payload, and itself
    q, dq = integrate(robot, np.zeros(2), np.zeros(2), np.array([0.8, 0.8]), 2e-3, 500)
    speed = 0.8 / 0.2 * (1 - np.exp(-0.2 / inertia * 1.0))
    assert np.allclose(dq[-1], speed, rtol=1e-9)
    assert np.allclose(q[:, 0], q[:, 1], rtol=0, atol=1e-12)


def test_wheeled_robot_stays_on_a_circle_under_the_torque_that_it_needs() -> None:
    robot = WheeledMobileRobot(coulomb=0.0, viscous=0.2)
    m, d, r, b = 17.0, 0.05, 0.095, 0.165
    wheels = np.array([10.0, 4.0])
    v, w = r * 14 / 2, r * 6 / (2 * b)
    forward, turning = -m * d * w**2, m * d * v * w
    torque = 0.2 * wheels + r / 2 * np.array([forward + turning / b, forward - turning / b])
    _, dq = integrate(robot, np.zeros(2), wheels, torque, 2e-3, 500)
    assert np.allclose(dq, wheels, rtol=1e-12)


@every_plant
def test_posture_columns_average_to_the_mean_inertia(plant: EulerLagrange) -> None:
    postures = np.linspace(-1, 1, 3 * plant.n_joints).reshape(plant.n_joints, 3)
    mean = (plant.inertia(postures[:, 0]) + plant.inertia(postures[:, 1]) + plant.inertia(postures[:, 2])) / 3
    assert np.allclose(plant.mean_inertia(postures), mean, rtol=1e-14)
    with pytest.raises(InvalidParameter, match=r"positions: got shape .* one position per column"):
        plant.mean_inertia(postures[:, 0])


@pytest.mark.parametrize(
    ("kind", "values", "message"),
    [
        (TwoLinkArm, {"masses": (1.0, 0.0)}, "masses: .* above 0"),
        (TwoLinkArm, {"masses": (1.0, 1.0, 1.0)}, "masses: .* has 2. For more use NLinkArm"),
        (TwoLinkArm, {"lengths": (1.0, 1.0, 1.0)}, "lengths: got shape .* needs one number or 2"),
        (TwoLinkArm, {"viscous": -0.1}, "viscous: .* at least 0"),
        (TwoLinkArm, {"centres": (1.0, 0.0)}, "not positive definite at q"),
        (NLinkArm, {"coulomb_width": 0.0}, "coulomb_width: got 0; needs a finite number above 0"),
        (NLinkArm, {"gravity": np.nan}, "gravity: got nan"),
        (Pendulum, {"payload": -1.0}, "payload: got -1"),
        (Pendulum, {"mass": "heavy"}, "mass: got 'heavy'; needs one number"),
        (MassSpringDamper, {"masses": (1.0, 2.0), "springs": (1.0, 2.0, 3.0)}, "springs: got shape"),
        (WheeledMobileRobot, {"wheel_radius": 0.0}, "wheel_radius: got 0"),
    ],
)
def test_impossible_parameters_are_refused(kind: Any, values: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidParameter, match=message):
        kind(**values)


def test_fields_that_hide_a_method_are_refused() -> None:
    from dataclasses import dataclass

    @dataclass(frozen=True, kw_only=True, eq=False)
    class Damped(Pendulum):
        damping: float = 1.0  # pyright: ignore[reportIncompatibleMethodOverride] - the test's subject

    with pytest.raises(InvalidParameter, match="Damped: its fields damping hide methods that every plant has"):
        Damped()


def test_energies_with_functions_that_symbols_do_not_know_are_refused() -> None:
    """``math.sin`` makes a NaN of a symbol, whose slope would pass for no gravity at all."""
    import math
    from dataclasses import dataclass

    @dataclass(frozen=True, kw_only=True, eq=False)
    class Broken(Pendulum):
        def potential_energy(self, q: Any, p: Any) -> Any:
            return p.mass * 9.81 * math.sin(q[0])

    with pytest.raises(InvalidParameter, match="its energy is not a number .* casadi.sin, not with those of math"):
        Broken()
