"""M̂(q) from a model, and feed-forward along the reference."""

from typing import Any

import numpy as np
import pytest

import tarc
from law_catalogue import make_law
from law_runs import SMALL_INERTIA
from tarc import Controller, Feedforward, NominalInertia, plants, signals, simulate
from tarc.analysis.linearise import decoupled_channels
from tarc.analysis.rest_stability import loop_with_model, rest_state_matrix, unstable_posture
from tarc.certificates import certify_affine, certify_constant_ratio, certify_robot, certify_varying_ratio
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.core.tracing import trace
from tarc.core.trees import leaves, pack, unpack
from tarc.laws import PID, TARC, TDC, TDCIM, LawInput

T = 1e-3
ARM = plants.TwoLinkArm(payload=0.5)
CHAIN = plants.NLinkArm()
WHEELS = plants.WheeledMobileRobot()
MASSES = plants.MassSpringDamper(masses=(1.0, 2.0), springs=(50.0, 20.0), dampers=(1.0, 0.5))
SINUSOID = signals.Sinusoid(amplitude=[0.3, 0.4], frequency=[2.0, 3.0])


@pytest.fixture(scope="module")
def ur5e():
    return plants.load_robot("ur5e", armature=0.1)


def known(model: Any = ARM, fraction: float = 0.1, **options: Any) -> NominalInertia:
    return NominalInertia(model, fraction, **options)


def zero_order_hold(law, plant, start, n_periods, seed=0):
    """Step a law with M(q) q̈ + N(q, q̇ᵈ) = τ at each sample and q̈ held over the period; return positions and signals.

    The reference is at rest, so that only the positions enter N.
    """
    rng = np.random.default_rng(seed)
    n = law.n_joints
    q, v, zero = start + 0.1 * rng.normal(size=n), np.zeros(n), np.zeros(n)
    state = law.init(q)
    positions, accelerations = [q], []
    for _ in range(n_periods):
        state, output = law.step(state, LawInput(q, start, zero, zero))
        a = np.linalg.solve(plant.inertia(q), output.torque - plant.bias(q, zero))
        q, v = q + T * v + T**2 / 2 * a, v + T * a
        positions.append(q)
        accelerations.append(a)
    return np.array(positions), np.array(accelerations)


def linear_recursion(law, first, start, accelerations):
    """Return positions of a_k = a_{k−1} + u_k − â_{k−1} on q̈ = a, by the weights of the window alone."""
    w1, w2 = law.estimator.weights(1), law.estimator.weights(2)
    past = np.repeat(first[None], len(w1), axis=0)
    q, v, a = first, np.zeros_like(first), accelerations
    estimate, positions = np.zeros_like(first), [q]
    for _ in range(60):
        past = np.concatenate([q[None], past[:-1]])
        u = -law.K2 @ (w1 @ past) - law.K1 @ (q - start)
        a, estimate = a + u - estimate, w2 @ past
        q, v = q + T * v + T**2 / 2 * a, v + T * a
        positions.append(q)
    return np.array(positions)


@pytest.mark.parametrize("plant", [ARM, CHAIN, WHEELS], ids=lambda plant: plant.label)
def test_exact_model_gives_the_linear_recursion(plant):
    start = np.linspace(0.4, 0.8, plant.n_joints)
    model = known(plant.with_parameters({"coulomb": 0.0, "viscous": 0.0}), 1.0, gravity=True, coriolis=True)
    law = make_law(TDC, inertia=model)
    smooth = model.robot
    positions, _ = zero_order_hold(law, smooth, start, 60)
    a = np.linalg.solve(smooth.inertia(positions[0]), -smooth.bias(positions[0], np.zeros(plant.n_joints)))
    expected = linear_recursion(law, positions[0], start, a)
    np.testing.assert_allclose(positions, expected, rtol=1e-7)


def test_file_robot_gives_the_linear_recursion(ur5e):
    start = ur5e.home
    law = make_law(TDC, inertia=known(ur5e, 1.0, gravity=True))
    positions, _ = zero_order_hold(law, ur5e, start, 12)
    a = np.linalg.solve(ur5e.inertia(positions[0]), -ur5e.gravity_torque(positions[0]))
    np.testing.assert_allclose(positions, linear_recursion(law, positions[0], start, a)[:13], rtol=1e-7)


@pytest.mark.parametrize(
    ("kind", "options"),
    [(TDC, {}), (TDC, {"synchronised": True}), (TDC, {"actuation_delay": 2}), (TARC, {}), (TDCIM, {})],
)
def test_constant_inertia_equals_numbers(kind, options):
    """For masses M̂(q) = ρM is a constant: accelerations in the memory give the torques that torques give."""
    runs = [
        simulate(MASSES, make_law(kind, inertia=inertia, torque_limit=2.0, **options), SINUSOID, 0.3)
        for inertia in (known(MASSES, 0.1), 0.1 * MASSES.inertia(np.zeros(2)))
    ]
    np.testing.assert_allclose(runs[0].data["torque"], runs[1].data["torque"], rtol=1e-9, atol=1e-9)
    assert np.abs(runs[0].data["torque"]).max() == 2.0, "the limit acts here"


def test_constant_inertia_has_no_new_state():
    law = make_law(TDC)
    assert law.init(np.zeros(2)).control._fields == ("torque", "acceleration", "robust")


def test_applied_torque_is_fed_back():
    """After a limit the memory has M̂(q)⁻¹ (τ − ĥ) of the torque that passed it, at the posture of that torque."""
    law = make_law(TDC, inertia=known(gravity=True, coriolis=True), torque_limit=1.5)
    q, v = np.array([0.3, 0.6]), np.array([0.5, -0.4])
    value = LawInput(q, q - 0.2, v, np.zeros(2))
    state, output = law.step(law.init(q), value)
    assert np.all(np.abs(output.torque) <= 1.5)
    assert np.any(np.abs(output.torque) == 1.5)
    state, _ = law.step(state, value._replace(position=q + 0.01))
    bias = ARM.bias(q, v)
    expected = np.linalg.solve(0.1 * ARM.inertia(q), output.torque - bias)
    np.testing.assert_allclose(state.control.control.torque[:, 0], expected, rtol=1e-12)


def test_traced_equals_numpy_and_controller_equals_simulation():
    law = make_law(TARC, inertia=known(friction=True), torque_limit=40.0, feedforward=Feedforward(ARM, friction=False))
    function, _ = trace(law.step, *law.example())
    rng = np.random.default_rng(1)
    state = law.init(rng.normal(size=2), rng.normal(size=2))
    for _ in range(3):
        value = LawInput(*rng.normal(size=(4, 2)))
        next_state, output = law.step(state, value)
        traced_state, traced_output = (np.array(part).ravel() for part in function(pack(state), pack(value)))
        np.testing.assert_allclose(traced_state, pack(next_state), rtol=1e-9, atol=1e-8)
        np.testing.assert_allclose(traced_output, pack(output), rtol=1e-9, atol=1e-8)
        state = next_state
    run = simulate(ARM, law, SINUSOID, 0.2, sensor=signals.Encoder(bits=14, dropout=0.02), initial_torque="rest")
    data = run.data
    controller = Controller(law)
    controller.reset(data["reference"].values[0], ARM.gravity_torque(data["reference"].values[0]))
    names = ("measured_position", "reference", "velocity_reference", "acceleration_reference")
    rows = zip(*(data[name].values for name in names), strict=True)
    torques = np.array([controller.step(*row).copy() for row in rows])
    np.testing.assert_array_equal(torques, data["torque"].values)


def test_never_emits_nan():
    rng = np.random.default_rng(3)
    for model in (ARM, MASSES):
        law = make_law(TDC, inertia=known(model, gravity=True), feedforward=Feedforward(model, gravity=False))
        state, _ = law.example()
        for _ in range(200):
            value = rng.choice([0.0, 1.0, -2.0, 1e9, 1e99, -1e160, 1e308, np.nan, np.inf], size=(4, 2))
            with np.errstate(all="ignore"):
                state, output = law.step(state, LawInput(*value))
            assert all(np.all(np.isfinite(leaf)) for leaf in leaves(state) + leaves(output))


@pytest.mark.parametrize("terms", [{}, {"gravity": True, "coriolis": True}], ids=["inertia", "bias"])
@pytest.mark.parametrize("delay", [0, 1])
def test_linearisation_at_rest_by_differences(terms, delay):
    """The state matrix at rest has the eigenvalues of the stepped loop's differences."""
    arm = plants.TwoLinkArm(viscous=0.3)
    law = make_law(TDC, inertia=known(plants.TwoLinkArm(payload=0.4), 0.08, **terms), estimator_name="algebraic")
    posture = np.array([0.5, 0.7])
    hold = arm.gravity_torque(posture)
    loop = loop_with_model(law, posture, hold, delay)
    expected = np.linalg.eigvals(rest_state_matrix(loop, law.inertia.at(posture), arm.linearised(posture), T))
    start = law.init(posture, hold)
    line = np.repeat(hold[:, None], delay + 1, axis=1)
    labels = (posture, np.zeros(2), line, start.estimator, start.control, start.torque)

    def period(x):
        q, v, line, estimator, control, torque = unpack(labels, x)
        state = start._replace(estimator=estimator, control=control, torque=torque)
        zero = np.zeros(2)
        state, output = law.step(state, LawInput(q, posture, zero, zero))
        line = np.column_stack([output.torque, line])[:, : delay + 1]
        for _ in range(4):
            q, v = runge_kutta(arm, q, v, line[:, -1], T / 4)
        return pack((q, v, line, state.estimator, state.control, state.torque))

    x = pack(labels)
    steps = 1e-6 * np.maximum(1, np.abs(x))
    columns = [(period(x + d) - period(x - d)) / (2 * step) for d, step in zip(np.diag(steps), steps, strict=True)]
    found = np.linalg.eigvals(np.column_stack(columns))
    slow = expected[np.abs(expected) > 0.9]
    assert len(slow) >= 4
    assert max(np.abs(found - value).min() for value in slow) < 1e-6
    assert abs(np.abs(found).max() - np.abs(expected).max()) < 1e-6
    channel = decoupled_channels(law, delay)[0].closed_loop(0.0)[:3]
    without = np.linalg.eigvals(rest_state_matrix(channel, law.inertia.at(posture), arm.linearised(posture), T))
    assert max(np.abs(without - value).min() for value in slow) > 1e-5, "the stiffness of the model counts here"


def runge_kutta(plant, q, v, torque, step):
    """Return position and velocity after a step of the fourth order."""

    def slope(q, v):
        return v, np.linalg.solve(plant.inertia(q), torque - plant.bias(q, v))

    v1, a1 = slope(q, v)
    v2, a2 = slope(q + step / 2 * v1, v + step / 2 * a1)
    v3, a3 = slope(q + step / 2 * v2, v + step / 2 * a2)
    v4, a4 = slope(q + step * v3, v + step * a3)
    return q + step / 6 * (v1 + 2 * v2 + 2 * v3 + v4), v + step / 6 * (a1 + 2 * a2 + 2 * a3 + a4)


def test_channels_are_those_of_a_ratio():
    """At a constant ratio the loop is that of numbers; an exact model has the ratio ρ in every posture."""
    (channel,), (expected,) = (
        decoupled_channels(make_law(TDC, inertia=inertia)) for inertia in (known(), 0.1 * np.eye(2))
    )
    np.testing.assert_array_equal(channel.state_matrix(0.2), expected.state_matrix(0.2))
    assert certify_constant_ratio(make_law(TDC, inertia=known()), (0.05, 0.1)).certified
    postures = np.array([[0.0, 0.4], [0.3, 1.2]])
    assert unstable_posture(make_law(TDC, inertia=known(fraction=0.1)), ARM, postures) is None
    worst = unstable_posture(make_law(TDC, inertia=known(fraction=1.0)), ARM, postures)
    assert worst is not None
    assert worst.ratio == pytest.approx(1.0)
    uneven = make_law(TDC, inertia=known(fraction=1.0), natural_frequency=[12.0, 12.001])
    other = unstable_posture(uneven, ARM, postures)
    assert other is not None
    assert other.growth_rate == pytest.approx(worst.growth_rate, rel=1e-3)


def test_certificates_of_robots_refuse():
    law = make_law(TDC, inertia=known())
    workspace = tarc.analysis.Workspace.from_joint_limits(ARM).with_speed_limits(1.0, 4.0)
    with pytest.raises(UnsupportedLaw, match=r"M̂\(q\) from a model"):
        tarc.certify_law(law, ARM, workspace)
    with pytest.raises(UnsupportedLaw, match=r"M̂\(q\) from a model"):
        certify_robot(law, ARM, workspace)
    with pytest.raises(UnsupportedLaw, match=r"M̂\(q\) from a model"):
        certify_varying_ratio(law)
    with pytest.raises(UnsupportedLaw, match=r"M̂\(q\) from a model"):
        certify_affine(law, rate=1.0, ratio_range=(0.05, 0.2))
    with pytest.raises(UnsupportedLaw, match="constant M̂ is needed"):
        _ = law.M


@pytest.mark.parametrize("options", [{}, {"synchronised": True}, {"inertia": "model"}])
def test_feedforward_leaves_the_loop(options: dict[str, Any]):
    """A disturbance of the positions changes the torques by the same amount with feed-forward and without it."""
    if options.get("inertia") == "model":
        options = {"inertia": known(MASSES)}
    arm = plants.TwoLinkArm(coulomb=0.5)
    rng = np.random.default_rng(0)
    disturbance = 1e-3 * rng.normal(size=(40, 2))
    changes = []
    for forward in (None, Feedforward(arm, friction_width=0.05), Feedforward(arm, friction=False, same_window=False)):
        law = make_law(TDC, feedforward=forward, **options)
        plain, disturbed = (torques(law, change) for change in (0 * disturbance, disturbance))
        changes.append(disturbed - plain)
    np.testing.assert_allclose(changes[1], changes[0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(changes[2], changes[0], rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(
        decoupled_channels(law)[0].state_matrix(0.1),
        decoupled_channels(make_law(TDC, **options))[0].state_matrix(0.1),
    )


def torques(law, change):
    """Return the torques along a motion whose positions deviate from the reference by given values (k, n)."""
    times = T * np.arange(len(change))
    q, v, a = SINUSOID.sample(times)
    state, found = law.init(q[:, 0]), []
    for k in range(len(change)):
        state, output = law.step(state, LawInput(q[:, k] + change[k], q[:, k], v[:, k], a[:, k]))
        found.append(output.torque)
    return np.array(found)


ESTIMATOR_NAMES = "algebraic", "filtered", "kalman", "high gain", "implicit"


@pytest.mark.parametrize("estimator", ESTIMATOR_NAMES)
@pytest.mark.parametrize("late", [0, 3])
def test_an_initial_error_does_not_kick_the_window_of_the_reference(estimator, late):
    """At rest off a reference at rest each torque adds −M̂ K1 e alone, also where the reference comes late."""
    arm = plants.TwoLinkArm(payload=1.0)
    law = make_law(TDC, 2, estimator, inertia=SMALL_INERTIA, feedforward=Feedforward(arm))
    q, qd, applied, zero = np.array([0.4, 0.9]), np.array([0.1, 1.2]), np.array([3.0, -1.0]), np.zeros(2)
    state = law.init(q, applied)
    for _ in range(late):
        state, output = law.step(state, LawInput(q, zero + np.nan, zero, zero))
        np.testing.assert_allclose(output.torque, applied, rtol=1e-9)
    forward = arm.gravity_torque(qd) - arm.gravity_torque(q)
    for k in range(1, 5):
        state, output = law.step(state, LawInput(q, qd, zero, zero))
        np.testing.assert_allclose(output.torque, applied + forward - k * law.M @ law.K1 @ (q - qd), rtol=1e-9)


@pytest.mark.parametrize("estimator", ESTIMATOR_NAMES)
def test_a_constant_distance_from_a_moving_reference_adds_the_proportional_part(estimator):
    """Torques of a robot that keeps its distance e, less those without one: they differ by k M̂ K1 e."""
    arm = plants.TwoLinkArm(payload=1.0)
    law = make_law(TDC, 2, estimator, inertia=SMALL_INERTIA, feedforward=Feedforward(arm))
    distance, found = np.array([0.05, -0.02]), []
    for offset in (distance, 0 * distance):
        state, torques = law.init(SINUSOID.sample([0.0])[0][:, 0] + offset, np.array([1.0, 2.0])), []
        first = state.control.model_torque
        for q, v, a in zip(*(part.T for part in SINUSOID.sample(T * np.arange(12))), strict=True):
            state, output = law.step(state, LawInput(q + offset, q, v, a))
            torques.append(output.torque - output.signals["model_torque"] + first)
        found.append(torques)
    expected = -np.arange(1, 13)[:, None] * (law.M @ law.K1 @ distance)
    np.testing.assert_allclose(np.subtract(*found), expected, rtol=1e-6, atol=1e-9)


def test_exact_feedforward_follows_without_error():
    """With the robot as the model, a reference that the window fits exactly and no noise, no error is left."""
    arm = plants.TwoLinkArm(viscous=0.4)
    reference = signals.Sinusoid(amplitude=[0.3, 0.2], frequency=2.0, phase=np.pi / 2)
    errors = []
    for forward in (None, Feedforward(arm, same_window=False), Feedforward(arm)):
        law = make_law(TDC, inertia=SMALL_INERTIA, feedforward=forward)
        errors.append(simulate(arm, law, reference, 1.0, initial_torque="rest").metrics()["rms_error"])
    assert errors[1] < 0.5 * errors[0]
    assert errors[2] < 0.05 * errors[0]


def test_friction_is_taken_at_the_reference():
    model = plants.TwoLinkArm(coulomb=1.5, viscous=0.2)
    rate = np.array([0.05, -0.4])
    forces = known(model, friction=True, friction_width=0.1).forces(np.zeros(2), rate)
    np.testing.assert_allclose(forces, 0.2 * rate + 1.5 * np.tanh(rate / 0.1))


@pytest.mark.parametrize("terms", [("gravity",), ("coriolis",), ("gravity", "coriolis"), ("friction",)])
def test_terms_add_up(terms):
    arm = plants.TwoLinkArm(viscous=0.2)
    q, v = np.array([0.3, 0.8]), np.array([0.7, -1.1])
    expected = {
        "gravity": arm.gravity_torque(q),
        "coriolis": arm.evaluate("coriolis", q, v) @ v,
        "friction": 0.2 * v,
    }
    found = known(arm, **dict.fromkeys(terms, True)).forces(q, v)
    np.testing.assert_allclose(found, sum(expected[name] for name in terms), atol=1e-12)


def test_bad_input(ur5e):
    dry = plants.TwoLinkArm(coulomb=1.0)
    wrong: Any = "ur5e"
    number: Any = 1
    cases = [
        (lambda: known(fraction=0.0), "fraction: got 0"),
        (lambda: known(fraction=2.5), "at most 2"),
        (lambda: NominalInertia(wrong, 0.1), "needs a robot in symbols"),
        (lambda: NominalInertia(ur5e.mujoco, 0.1), "MujocoPlant; NominalInertia needs a robot in symbols"),
        (lambda: known(dry, friction=True), "friction_width: missing"),
        (lambda: known(dry, friction_width=0.1), "without friction=True"),
        (lambda: known(dry, friction=True, friction_width=0.0), "above 0"),
        (lambda: Feedforward(dry), "friction_width: missing"),
        (lambda: Feedforward(ARM, inertia=number), "inertia: got 1"),
        (lambda: known(ur5e.with_parameters({"masses": 0.0, "armature": 0.0})), "is singular at q"),
        (lambda: make_law(PID, inertia=known()), "PID takes a constant M̂"),
        (lambda: make_law(TDC, inertia=known(gravity=True), feedforward=Feedforward(ARM)), "gives this torque already"),
        (lambda: make_law(TDC, feedforward=Feedforward(CHAIN)), "it has 3 joints, the law 2"),
        (lambda: make_law(TDC, feedforward=True), "needs a tarc.Feedforward"),
    ]
    for make, message in cases:
        with pytest.raises(InvalidParameter, match=message.replace("(", r"\(")):
            make()
