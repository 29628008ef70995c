"""M̂ from records against the M that made them: constant inertias exactly, robots within bounds."""

from typing import Any

import numpy as np
import pytest

from slow_cases import slow
from tarc import TarcError, plants, signals, simulate
from tarc.core.errors import NotIdentifiable
from tarc.design import IdentifiedInertia, excitation_reference, identify, inertia_from_data, inertia_from_file
from tarc.estimators import Algebraic
from tarc.laws import TDC

T = 1e-3
M3 = np.array([[2.0, 0.4, 0.1], [0.4, 0.6, -0.15], [0.1, -0.15, 0.1]])


def measured_motion(M, duration=10.0, coulomb: Any = 0.0, motion=None, noise=0.0, seed=0, period=T):
    """Positions measured and torques of M q̈ + coulomb sgn q̇ + constant = τ, held over each period; a servo without
    noise moves it, so that only what is measured has any.
    """
    n, count = len(M), round(duration / period)
    motion = excitation_reference(np.zeros(n), duration=duration) if motion is None else motion
    ref, rate, acceleration = motion.sample(np.arange(count) * period)
    inverse, load = np.linalg.inv(M), np.linspace(1.0, -2.0, n)
    q, v, qs, taus = ref[:, 0].copy(), rate[:, 0].copy(), np.zeros((count, n)), np.zeros((count, n))
    for k in range(count):
        tau = M @ (acceleration[:, k] - 20 * (v - rate[:, k]) - 100 * (q - ref[:, k])) + load
        qs[k], taus[k] = q, tau
        a = inverse @ (tau - load - coulomb * np.sign(v))
        q, v = q + period * v + period**2 / 2 * a, v + period * a
    return qs + noise * np.random.default_rng(seed).standard_normal(qs.shape), taus


def ur5e():
    return plants.MujocoPlant.from_file("ur5e", armature=0.1, viscous=1.0, coulomb=1.0)


def panda():
    return plants.MujocoPlant.from_file("panda", armature=0.1, viscous=1.0, coulomb=1.0)


def inertia_ratios(plant, found, motion):
    """Eigenvalues of M⁻¹M̂ for the mean M along the motion, and of the diagonals alone."""
    M = plant.mean_inertia(motion.sample(np.arange(0, 20, 0.05))[0])
    return np.linalg.eigvals(np.linalg.solve(M, found.inertia)).real, np.diag(found.inertia) / np.diag(M)


@pytest.mark.parametrize("options", [{}, {"window": 0.010}, {"window": 0.030, "degree": 3}])
def test_constant_inertia_exactly(options):
    found = inertia_from_data(*measured_motion(M3), T, diagonal=False, **options)
    np.testing.assert_allclose(found.inertia, M3, rtol=1e-6, atol=1e-7)
    assert np.all(found.explained > 1 - 1e-9)
    assert np.all(found.error < 1e-6)


def test_diagonal_is_that_of_the_whole():
    q, tau = measured_motion(M3)
    found = inertia_from_data(q, tau, T)
    np.testing.assert_allclose(found.inertia, np.diag(np.diag(M3)), rtol=1e-6)
    assert np.count_nonzero(found.error) == 3


def test_coulomb_friction_is_distinguished():
    found = inertia_from_data(*measured_motion(M3, coulomb=np.array([1.0, 0.5, 0.1])), T, diagonal=False)
    np.testing.assert_allclose(found.inertia, M3, rtol=0.02, atol=0.005)


def test_another_period():
    found = inertia_from_data(*measured_motion(M3, period=4e-3, duration=20.0), 4e-3, diagonal=False)
    np.testing.assert_allclose(found.inertia, M3, rtol=1e-6, atol=1e-7)


def test_lost_samples_cost_their_windows_only():
    q, tau = measured_motion(M3)
    whole = inertia_from_data(q, tau, T, window=0.008)
    lost = np.random.default_rng(1).integers(len(q), size=50)
    q[lost, 0], tau[lost[:5], 2] = np.nan, np.inf
    found = inertia_from_data(q, tau, T, window=0.008)
    np.testing.assert_allclose(found.inertia, whole.inertia, rtol=1e-6)
    # each takes its own window and that of the smoothed velocity's sign, on every second instant
    assert whole.samples - 55 * 20 / 2 < found.samples < whole.samples - 50 * 9 / 2 * 0.8


def test_error_falls_with_the_length_and_is_what_it_says():
    """Torques read with white noise, which leaves least squares unbiased: a quarter of the variance in four times."""
    errors, said = {}, {}
    for duration in (10.0, 40.0):
        q, tau = measured_motion(M3, duration, motion=excitation_reference(np.zeros(3), duration=10.0))
        rng = np.random.default_rng(0)
        found = [inertia_from_data(q, tau + rng.standard_normal(tau.shape), T, window=0.03) for _ in range(20)]
        wrong = np.array([np.diag(one.inertia) - np.diag(M3) for one in found])
        errors[duration] = np.sqrt(np.mean(wrong**2, axis=0))
        said[duration] = np.mean([np.diag(one.error) for one in found], axis=0)
    np.testing.assert_allclose(errors[40.0] / errors[10.0], 0.5, rtol=0.6)
    np.testing.assert_allclose(said[40.0] / said[10.0], 0.5, rtol=0.2)
    np.testing.assert_allclose([said[d] / errors[d] for d in said], 1.0, rtol=0.5)


@pytest.mark.parametrize("bits", [14, 17, 20])
def test_window_is_chosen_to_suit_the_encoder(bits):
    q, tau = measured_motion(M3)
    step = 2 * np.pi / 2**bits
    found = inertia_from_data(step * np.round(q / step), tau, T)
    np.testing.assert_allclose(np.diag(found.inertia), np.diag(M3), rtol=0.02)
    short = inertia_from_data(q, tau, T)
    assert found.window >= short.window


@pytest.mark.parametrize("coulomb", [0.0, 2.0])
def test_two_link_arm(coulomb):
    plant = plants.TwoLinkArm(viscous=1.0, coulomb=coulomb)
    motion = excitation_reference([0.3, 1.0])
    found = identify(plant, reference=motion, sensor=signals.Encoder(bits=17), diagonal=False)
    eigenvalues, diagonal = inertia_ratios(plant, found, motion)
    assert np.all((eigenvalues > 0.9) & (eigenvalues < 1.1))
    assert np.all((diagonal > 0.95) & (diagonal < 1.05))


@pytest.mark.parametrize("robot", [ur5e, slow(panda)])
def test_robots_with_friction_and_encoders(robot):
    plant = robot()
    motion = excitation_reference(plant.home)
    found = identify(plant, reference=motion, sensor=signals.Encoder(bits=17), diagonal=False)
    eigenvalues, diagonal = inertia_ratios(plant, found, motion)
    assert np.all((eigenvalues > 0.9) & (eigenvalues < 1.2))
    assert np.all((diagonal > 0.95) & (diagonal < 1.15))
    assert np.all(found.explained > 0.7)


def test_it_does_without_the_model_and_without_a_hand_at_the_start(monkeypatch):
    plant, options = plants.TwoLinkArm(viscous=1.0), {"sensor": signals.Encoder(bits=17), "duration": 10.0}
    honest = identify(plant, **options)
    monkeypatch.setattr(plants.TwoLinkArm, "inertia", lambda self, position: 5 * np.eye(2))
    np.testing.assert_array_equal(identify(plant, **options).inertia, honest.inertia)
    let_go = identify(plant, torque=0.0, **options)
    np.testing.assert_allclose(np.diag(let_go.inertia), np.diag(honest.inertia), rtol=0.05)


def test_masses_far_apart():
    plant = plants.MassSpringDamper(masses=(1000.0, 3.0), springs=(0.0, 5.0), dampers=1.0)
    found = identify(plant, sensor=signals.Encoder(resolution=1e-5))
    np.testing.assert_allclose(np.diag(found.inertia), [1000.0, 3.0], rtol=0.01)


def test_from_files(tmp_path):
    q, tau = measured_motion(M3)
    direct = inertia_from_data(q, tau, T)
    names = ["q1", "q2", "q3", "tau1", "tau2", "tau3"]
    table = np.column_stack([T * np.arange(len(q)), q, tau])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=",".join(["t", *names]), comments="", fmt="%.17g")
    for period in (None, T):
        found = inertia_from_file(tmp_path / "log.csv", period)
        np.testing.assert_allclose(found.inertia, direct.inertia, rtol=1e-6)

    plant = plants.MassSpringDamper(masses=2.0, springs=0.0, dampers=0.0)
    law = TDC(inertia=[1.0], natural_frequency=10.0, period=T, estimator=Algebraic(window=0.01), synchronised=True)
    run = simulate(plant, law, excitation_reference([0.0]), 10.0)
    assert inertia_from_file(run.save(tmp_path / "run.nc")).inertia == pytest.approx(2.0, rel=1e-6)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("q1,torque\n0,1\n1,2\n", "it lacks tau1"),
        ("t,tau1\n0,1\n1,2\n", "it lacks q1"),
        ("q1,tau1\n0,1\n1,2\n", "give the period"),
        ("t,q1,tau1\n0,0,1\n1,1,2\n5,2,3\n", "not even"),
        ("t,q1,tau1\n0,0\n1,1,2\n", "does not read"),
    ],
)
def test_files_that_do_not_do(tmp_path, text, message):
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(TarcError, match=message):
        inertia_from_file(path)
    with pytest.raises(TarcError, match="no file"):
        inertia_from_file(tmp_path / "other.csv")


def test_excitation_starts_at_rest_and_stays_within_bounds():
    home = np.array([0.0, -0.5, 1.0])
    low, high = np.array([-0.1, -2.0, 0.95]), np.array([2.0, -0.45, 3.0])
    motion = excitation_reference(home, low=low, high=high, amplitude=[0.3, 0.3, 0.3], speed=[1.0, 1.0, 0.05])
    q, v, a = motion.sample(np.arange(0, 40, 1e-3))
    np.testing.assert_allclose([q[:, 0], v[:, 0], a[:, 0]], [home, 0 * home, 0 * home], atol=1e-12)
    np.testing.assert_allclose(motion.sample([20.0])[0][:, 0], home, atol=1e-9)
    assert np.all((q > low[:, None]) & (q < high[:, None]))
    reach, speed = np.abs(q - home[:, None]).max(axis=1), np.abs(v).max(axis=1)
    assert np.all(reach < 0.3)
    assert np.all(speed < [1.0, 1.0, 0.05])
    room = np.array([0.1, 0.05, 0.05])
    assert np.all(np.maximum(reach / room, speed / [1.0, 1.0, 0.05]) > 0.97)


def test_excitation_gives_each_joint_odd_multiples_of_its_own():
    motion = excitation_reference(np.zeros(7))
    multiples = np.asarray(motion.frequency) * 20.0 / (2 * np.pi)
    np.testing.assert_allclose(multiples, np.round(multiples))
    assert np.all(np.round(multiples) % 2 == 1)
    assert np.all(np.diff(multiples) > 1.5)
    used = np.asarray(motion.amplitude) != 0
    assert np.all(used.sum(axis=0) == 1)
    assert np.all(used.sum(axis=1) == 4)
    a = motion.sample(np.arange(0, 20, 1e-2))[2]
    np.testing.assert_allclose(np.corrcoef(a), np.eye(7), atol=1e-6)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"home": [0.0], "tones": 3}, "even number"),
        ({"home": [0.0], "high": -0.1}, "not inside its range"),
        ({"home": [0.0, 0.0], "high": [1.0, 1.0, 1.0]}, "low, high: got shapes"),
        ({"home": np.zeros(7), "duration": 5.0}, "longer"),
        ({"home": [0.0], "speed": 0.0}, "speed: got"),
        ({"home": [np.nan]}, "home: got"),
        ({"home": [0.0], "band": (5.0, 2.0)}, "band: got"),
    ],
)
def test_excitations_that_cannot_be(options, message):
    with pytest.raises(TarcError, match=message):
        excitation_reference(**options)


def second_joint_at_rest(q, tau):
    return np.where([True, False, True], q, 0.1), tau


def joints_in_step(q, tau):
    return q[:, [0, 0, 2]], tau


def motion_of_one_tone(q, tau):
    motion = signals.Sinusoid(amplitude=[0.2, 0.2, 0.2], frequency=[3.0, 4.0, 5.0])
    return measured_motion(M3, motion=motion, noise=1e-5)


def wrapped_positions(q, tau):
    return np.where(q > 0.05, q - 2 * np.pi, q), tau


REFUSED: list[tuple[Any, str]] = [
    (second_joint_at_rest, "joint 2 never moves; move each joint"),
    (joints_in_step, "accelerate together.* frequencies of its own"),
    (motion_of_one_tone, "does not show its inertia.* faster, farther|accelerate together"),
    (wrapped_positions, "unwrap"),
    (lambda q, tau: (q[:150], tau[:150]), "record for longer"),
    (lambda q, tau: (np.where(np.arange(len(q))[:, None] % 5 == 0, np.nan, q), tau), "lose fewer samples"),
    (lambda q, tau: (q, tau[:-1]), "got shapes"),
    (lambda q, tau: (q[:, 0], tau[:, 0]), "got shapes"),
    (lambda q, tau: (q, -tau), "does not show its inertia"),
    (lambda q, tau: (q, np.random.default_rng(0).standard_normal(tau.shape)), "does not show its inertia"),
]


@pytest.mark.parametrize(("spoil", "message"), REFUSED)
def test_records_that_do_not_show_it_are_refused(spoil, message):
    q, tau = spoil(*measured_motion(M3))
    with pytest.raises(TarcError, match=message):
        inertia_from_data(q, tau, T)


def test_motion_that_friction_swallows_is_refused():
    arm, slow = plants.TwoLinkArm(coulomb=20.0), excitation_reference([0.0, 1.0], amplitude=0.02)
    with pytest.raises(NotIdentifiable, match="does not follow the motion.* a larger one where friction"):
        identify(arm, reference=slow, sensor=signals.Encoder(bits=17))


def test_a_robot_that_friction_holds_is_refused():
    """Held, it creeps with the torque, which a large inertia seems to explain to the last."""
    plant = ur5e()
    law = TDC(inertia=[1e-3] * 6, natural_frequency=5.0, period=T, estimator=Algebraic(window=0.01), synchronised=True)
    run = simulate(plant, law, excitation_reference(plant.home), 20.0, initial_torque="rest")
    with pytest.raises(NotIdentifiable, match="does not show its inertia"):
        inertia_from_data(run.data["measured_position"].values, run.data["torque"].values, T)


def test_identify_refuses_what_it_cannot_use():
    rest = signals.Sinusoid(amplitude=[0.1, 0.0], frequency=1.0)
    with pytest.raises(TarcError, match="joint at rest"):
        identify(plants.TwoLinkArm(), reference=rest)
    robot: Any = "ur5e"
    with pytest.raises(TarcError, match="needs one of tarc.plants"):
        identify(robot)


def test_more_data_than_one_posture():
    """Records at several postures: their mean is the mean M, which is how a robot that moves far is to be done."""
    plant = plants.TwoLinkArm(viscous=1.0)
    postures = [[0.0, 0.5], [0.0, 1.5], [0.0, 2.5]]
    found: list[IdentifiedInertia] = [
        identify(plant, reference=excitation_reference(one), sensor=signals.Encoder(bits=17), diagonal=False)
        for one in postures
    ]
    M = plant.mean_inertia(np.array(postures).T)
    np.testing.assert_allclose(np.mean([one.inertia for one in found], axis=0), M, rtol=0.03, atol=0.03)
