"""The order of the plant's integration, alone and inside the closed loop."""

from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

import tarc
from tarc.laws.base import LawInput
from tarc.plants import MassSpringDamper, NLinkArm, Pendulum, TwoLinkArm, WheeledMobileRobot
from tarc.plants.euler_lagrange import EulerLagrange
from tarc.simulation.closed_loop import runge_kutta

SMOOTH_PLANTS = [TwoLinkArm(viscous=0.5), NLinkArm(viscous=0.1), WheeledMobileRobot(coulomb=0.0), Pendulum(viscous=0.1)]


def convergence_order(solutions: list[np.ndarray]) -> float:
    """Order of convergence from three solutions, each with half the step of the one before."""
    coarse, medium, fine = solutions
    return float(np.log2(np.max(np.abs(coarse - medium)) / np.max(np.abs(medium - fine))))


@pytest.mark.parametrize("plant", SMOOTH_PLANTS, ids=lambda plant: type(plant).__name__)
def test_runge_kutta_is_of_fourth_order(plant: EulerLagrange) -> None:
    def end(steps: int) -> np.ndarray:
        n = plant.n_joints
        q, dq = np.linspace(0.5, -0.3, n), np.linspace(1, -1, n)
        for _ in range(steps):
            q, dq, _ = runge_kutta(plant, q, dq, np.linspace(2, -1, n), 1.0 / steps)
        return np.concatenate([q, dq])

    assert convergence_order([end(200), end(400), end(800)]) == pytest.approx(4, abs=0.2)


def test_runge_kutta_reports_the_acceleration_at_the_start_of_the_step() -> None:
    plant, q, dq, torque = TwoLinkArm(), np.array([0.3, 0.8]), np.array([1.0, -2.0]), np.array([5.0, 1.0])
    first = runge_kutta(plant, q, dq, torque, 0.1, {"payload": 2.0})[2]
    assert np.array_equal(first, plant.evaluate("acceleration", q, dq, torque, parameters={"payload": 2.0}))


ESTIMATOR = tarc.estimators.Algebraic(window=0.05)
COMMON: dict[str, Any] = {"natural_frequency": 5.0, "period": 0.01, "estimator": ESTIMATOR}
LAWS = [
    tarc.laws.TDC(inertia=[0.1, 0.1], **COMMON),
    tarc.laws.TDC(inertia=[0.5, 0.5], synchronised=True, **COMMON),
    tarc.laws.TARC(inertia=[0.5, 0.5], synchronised=True, rise_rate=5.0, fall_rate=1.0, **COMMON),
]


@pytest.mark.parametrize("law", LAWS, ids=["TDC", "synchronised TDC", "TARC"])
def test_a_loop_with_its_torque_held_converges_with_fourth_order_in_the_substep(law: tarc.laws.Law) -> None:
    reference = tarc.signals.Sinusoid(amplitude=[0.5, 0.3], frequency=2.0, phase=np.pi / 2)

    def motion(substeps: int) -> np.ndarray:
        run = tarc.simulate(TwoLinkArm(viscous=0.5), law, reference, 1.0, substeps=substeps, initial_torque="rest")
        assert run.status.completed
        return run.data["position"].values

    assert convergence_order([motion(2), motion(4), motion(8)]) == pytest.approx(4, abs=0.2)


@pytest.mark.parametrize("computation_delay", [0, 2])
def test_a_loop_around_a_linear_plant_is_the_exact_sampled_system(computation_delay: int) -> None:
    mass, spring, damper, period = 2.0, 30.0, 1.0, 0.01
    law = tarc.laws.TDC(inertia=[0.2], **COMMON)
    chirp = tarc.signals.Chirp(amplitude=[0.2], start_frequency=1.0, stop_frequency=5.0, sweep_time=1.0, offset=0.1)
    plant = MassSpringDamper(masses=(mass,), springs=(spring,), dampers=(damper,))
    run = tarc.simulate(plant, law, chirp, 1.0, substeps=16, computation_delay=computation_delay)

    flow = expm(period * np.array([[0, 1, 0], [-spring / mass, -damper / mass, 1 / mass], [0, 0, 0]]))
    motion, torque, expected = np.array([0.1, 0.0]), [0.0] * computation_delay, []
    state = law.init(motion[:1])
    for reference in np.array(chirp.sample(np.arange(100) * period)).transpose(2, 0, 1):
        state, output = law.step(state, LawInput(motion[:1], *reference))
        torque.append(output.torque.item())
        expected.append(motion[0])
        motion = flow[:2] @ [*motion, torque[-1 - computation_delay]]
    # (ω dt)⁵/120 a substep with ω = 4 rad/s, raised by a loop that is free to amplify it
    assert np.allclose(run.data["position"].values[:, 0], expected, rtol=0, atol=1e-10)
