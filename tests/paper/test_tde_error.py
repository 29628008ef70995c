"""Lemma 1 for M̂(q), and the bound on the TDE error, against the equations of motion evaluated densely."""

import numpy as np
import pytest

from law_catalogue import make_tdc
from tarc import NominalInertia
from tarc.analysis import Workspace
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.paper import bound_tde_error, check_lemma1
from tarc.plants import MassSpringDamper, TwoLinkArm

ARM, LOADED = TwoLinkArm(), TwoLinkArm(payload=0.5)
ROBOTS = [ARM, LOADED]
WORKSPACE = Workspace.box([-1.0, -np.pi], [1.0, np.pi], speed=[1.0, 1.5], acceleration=[3.0, 4.0])
ANGLES = np.linspace(-np.pi, np.pi, 241)
H = 1e-3


def model_law(fraction=1.1, **terms):
    return make_tdc(inertia=NominalInertia(ARM, fraction, **terms))


def dense_ratios(fraction):
    """M(q)⁻¹M̂(q) over the second joint, the only one that counts, for both robots."""
    return np.array(
        [np.linalg.solve(robot.inertia([0, q]), fraction * ARM.inertia([0, q])) for robot in ROBOTS for q in ANGLES]
    )


@pytest.mark.parametrize("fraction", [0.3, 1.1, 1.9])
def test_norm_of_a_model_is_the_peak_of_a_dense_sweep(fraction):
    certificate = check_lemma1(model_law(fraction), ROBOTS, WORKSPACE, samples=100)
    products = dense_ratios(fraction)
    norm = np.linalg.norm(products - np.eye(2), 2, axis=(1, 2)).max()
    values = np.linalg.eigvals(products).real
    assert certificate.evidence.norm == pytest.approx(norm, rel=1e-3)
    assert certificate.evidence.min_ratio == pytest.approx(values.min(), rel=1e-4)
    assert certificate.evidence.max_ratio == pytest.approx(values.max(), rel=1e-4)
    assert certificate.evidence.scaled_norm >= np.abs(values - 1).max() * (1 - 1e-4)
    assert certificate.certified == (norm < 1)
    assert certificate.verify()


def test_an_exact_model_leaves_nothing_but_the_fraction():
    evidence = check_lemma1(model_law(0.7), ARM, WORKSPACE, samples=50).evidence
    assert evidence.norm == pytest.approx(0.3, rel=1e-9)
    resting = Workspace.box(WORKSPACE.low, WORKSPACE.high)
    assert check_lemma1(model_law(0.7), ARM, resting, samples=50).evidence.scaled_norm == pytest.approx(0.3, rel=1e-9)


def forcing_by_differences(law, robot, q, v, a, step=1e-5):
    """‖M⁻¹M̂ dβ/dt‖ h, with β by central differences along the motion."""

    def beta(time):
        position, velocity = q + v * time, v + a * time
        torque = robot.inertia(position) @ a + robot.bias(position, velocity)
        if isinstance(law.inertia, NominalInertia):
            torque = torque - np.array(law.inertia.forces(position, velocity)).ravel()
        return np.linalg.solve(np.array(law.inertia_at(position)), torque)

    rate = (beta(step) - beta(-step)) / (2 * step)
    return H * float(np.linalg.norm(np.linalg.solve(robot.inertia(q), np.array(law.inertia_at(q)) @ rate)))


@pytest.mark.parametrize(
    "law",
    [make_tdc(inertia=[0.6, 0.2]), model_law(), model_law(gravity=True, coriolis=True)],
    ids=["constant", "model", "bias"],
)
def test_forcing_is_reached_and_exceeds_that_of_random_motions(law):
    found = bound_tde_error(law, ROBOTS, WORKSPACE, samples=300)
    q, v, a = found.forcing_point
    reached = max(forcing_by_differences(law, robot, q, v, a) for robot in ROBOTS)
    assert reached == pytest.approx(found.forcing, rel=1e-5)
    rng = np.random.default_rng(0)
    for _ in range(250):
        posture = rng.uniform([-1.0, -np.pi], [1.0, np.pi])
        speed, change = (limit * rng.choice([-1.0, 1.0], 2) for limit in (WORKSPACE.speed, WORKSPACE.acceleration))
        assert forcing_by_differences(law, ROBOTS[rng.integers(2)], posture, speed, change) <= found.forcing * (
            1 + 1e-6
        )
    assert np.all(np.abs(v) <= WORKSPACE.speed)
    assert np.all(np.abs(a) <= WORKSPACE.acceleration)
    assert WORKSPACE.low[1] <= q[1] <= WORKSPACE.high[1]


def test_a_perfect_model_with_all_terms_leaves_no_forcing():
    law = make_tdc(inertia=NominalInertia(ARM, 0.9, gravity=True, coriolis=True))
    found = bound_tde_error(law, ARM, WORKSPACE, samples=50, command_change=2.0)
    assert found.forcing < 1e-12
    assert found.bound == pytest.approx(0.1 * 2.0 / 0.9)
    assert found.amplification == pytest.approx(1 / 0.9)


def test_error_obeys_the_equation_and_stays_below_the_bound():
    """q̈ of the robot under the law with a known q̈_h, along a motion: the recursion, then the bound."""
    law, robot = model_law(0.8, gravity=True), LOADED
    assert isinstance(law.inertia, NominalInertia)
    place = Workspace.box([-1.0, -2.0], [1.0, 2.0], speed=1.0, acceleration=2.0)
    found = bound_tde_error(law, robot, place, samples=300, command_change=0.02)
    rng, error, largest = np.random.default_rng(1), np.zeros(2), 0.0
    phase = rng.uniform(0, 6, 2)
    memory, u = np.zeros(2), np.zeros(2)
    before = np.eye(2), np.eye(2), np.zeros(2)
    for k in range(600):
        t = k * H
        q = np.array([0.5, 1.0]) * np.sin(np.array([1.9, 0.9]) * t + phase)
        v = np.array([0.5, 1.0]) * np.array([1.9, 0.9]) * np.cos(np.array([1.9, 0.9]) * t + phase)
        nominal, M = np.array(law.inertia.at(q)), robot.inertia(q)
        unknown = robot.bias(q, v) - np.array(law.inertia.forces(q, v)).ravel()
        new_u = np.array([np.sin(7 * t), np.cos(7 * t)])
        if k:
            held = u + error  # q̈_h
            a = memory + new_u - held
            acceleration = np.linalg.solve(M, nominal @ a - unknown)
            B = np.linalg.solve(M, nominal)
            change = np.linalg.solve(before[0], before[1] @ held + before[2]) - np.linalg.solve(
                nominal, M @ held + unknown
            )
            expected = (np.eye(2) - B) @ error + (B - np.eye(2)) @ (new_u - u) + B @ change
            error = acceleration - new_u
            np.testing.assert_allclose(error, expected, atol=1e-9)
            memory = a
            largest = max(largest, float(np.linalg.norm(error)))
        else:
            memory = np.linalg.solve(nominal, M @ new_u + unknown)
        before, u = (nominal, M, unknown), new_u
    assert largest < found.bound
    assert found.contraction < 1


def test_bad_input():
    resting = Workspace.box([0, 0], [1, 1])
    with pytest.raises(UnsupportedLaw, match="speeds"):
        bound_tde_error(model_law(), ARM, resting)
    with pytest.raises(InvalidParameter, match="2 joints of the law"):
        bound_tde_error(model_law(), MassSpringDamper(), Workspace.box([0], [1], speed=1.0))
    with pytest.raises(InvalidParameter, match="command_change"):
        bound_tde_error(model_law(), ARM, WORKSPACE, command_change=-1.0)
