"""Motors, links and gears between: against closed forms, energy and the rigid robot."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

import tarc
from tarc.core.errors import InvalidParameter
from tarc.plants import Gearbox, MassSpringDamper, RigidBody, TwoLinkArm, load_robot
from tarc.plants.gearbox import elastic_torque, stribeck_friction
from tarc.scenario.model import Scenario
from tarc.signals import Encoder, ParameterSchedule, Sinusoid

PERIOD = 1e-3
MASS = MassSpringDamper(masses=[2.0], springs=0.0, dampers=0.0)
ARM = TwoLinkArm()


def motion(plant, start, torque, duration, **options):
    """Integrate a plant from its coordinates (m,), at rest, under a constant torque (n,)."""
    m = plant.n_coordinates

    def slope(_, x):
        return np.concatenate([x[m:], plant.evaluate("acceleration", x[:m], x[m:], np.asarray(torque, dtype=float))])

    first = np.concatenate([start, np.zeros(m)])
    return solve_ivp(slope, (0, duration), first, rtol=1e-9, atol=1e-11, max_step=duration / 50, **options)


def test_two_masses_resonate_at_their_frequency():
    """ω² = K (1/J + 1/m), and a mode that moves as one."""
    plant = Gearbox(plant=MASS, stiffness=800.0, motor_inertia=0.5)
    M, D, G = plant.linearised(np.zeros(2))
    assert not D.any()
    squares = eigh(G, M, eigvals_only=True)
    assert squares == pytest.approx([0.0, 800.0 * (1 / 0.5 + 1 / 2.0)], abs=1e-9)
    frequency = np.sqrt(squares[1])
    run = motion(plant, np.array([0.0, 0.1]), [0.0], 1.0, t_eval=np.linspace(0, 1, 60))
    twist = run.y[1] - run.y[0]
    np.testing.assert_allclose(twist, 0.1 * np.cos(frequency * run.t), atol=1e-6)


def test_damping_acts_on_the_twist():
    plant = Gearbox(plant=MASS, stiffness=800.0, twist_damping=3.0, motor_inertia=0.5)
    _, D, _ = plant.linearised(np.zeros(2))
    np.testing.assert_allclose(D, [[3.0, -3.0], [-3.0, 3.0]])


def test_teeth_push_and_do_not_pull():
    p = {"stiffness": 1000.0, "twist_damping": 10.0, "backlash": 0.02}
    cases = [
        (0.005, 1.0, 0.0),
        (0.015, 0.0, 5.0),
        (-0.015, 0.0, -5.0),
        (0.015, 0.1, 6.0),
        (0.015, -10.0, 0.0),
        (-0.015, 10.0, 0.0),
        (-0.015, -0.1, -6.0),
    ]
    for twist, rate, expected in cases:
        assert float(elastic_torque(twist, rate, p)) == pytest.approx(expected)
    assert float(elastic_torque(0.015, -10.0, {**p, "backlash": 0.0})) == pytest.approx(15.0 - 100.0)


def test_a_motor_crosses_the_play_before_the_link_moves():
    """From tooth to tooth in the time of a free motor, b = τ t² / (2 J)."""
    width, torque, inertia = 0.01, 0.5, 0.2
    plant = Gearbox(plant=MASS, stiffness=1e5, motor_inertia=inertia, backlash=width)
    crossing = np.sqrt(2 * width * inertia / torque)
    start = np.array([0.0, -width / 2])
    run = motion(plant, start, [torque], 1.1 * crossing, t_eval=[0.99 * crossing, 1.1 * crossing])
    assert run.y[2, 0] == 0.0
    assert run.y[1, 0] == pytest.approx(-width / 2 + 0.99**2 * width, rel=1e-6)
    assert run.y[2, 1] > 0.0


@pytest.mark.parametrize("speed", [0.02, 0.5])
def test_a_mass_bounces_between_the_teeth_with_the_period_of_spring_and_flight(speed):
    """Beside a motor that stands, T = 2π √(m/K) + 2 b/v: half a swing at each tooth, and the free flight twice."""
    width, stiffness, mass = 0.01, 3000.0, 2.0
    plant = Gearbox(plant=MASS, stiffness=stiffness, motor_inertia=1e12, backlash=width)

    def slope(_, x):
        return np.concatenate([x[2:], plant.evaluate("acceleration", x[:2], x[2:], np.zeros(1))])

    def middle(_, x):
        return x[0]

    setattr(middle, "direction", 1.0)  # noqa: B010, an attribute that SciPy reads
    period = 2 * np.pi * np.sqrt(mass / stiffness) + 2 * width / speed
    start = np.array([-1e-9, 0.0, speed, 0.0])
    run = solve_ivp(slope, (0, 3.2 * period), start, rtol=1e-9, atol=1e-12, max_step=period / 200, events=middle)
    np.testing.assert_allclose(np.diff(run.t_events[0]), period, rtol=1e-6)
    assert len(run.t_events[0]) == 4


def test_stribeck_curve():
    """F_S about rest, F_C + (F_S − F_C)/e at the Stribeck speed, F_C + F_v q̇ far above; odd."""
    p = {"coulomb": 2.0, "breakaway": 3.0, "stribeck_speed": 0.1, "viscous": 0.5, "friction_width": 1e-4}
    cases = [(0.0, 0.0), (1e-3, 3.0 + 5e-4), (0.1, 2.0 + np.exp(-1) + 0.05), (2.0, 3.0), (-2.0, -3.0)]
    for speed, expected in cases:
        assert float(stribeck_friction(speed, p)) == pytest.approx(expected, abs=2e-4)
    plant = Gearbox(plant=MASS, coulomb=2.0, breakaway=3.0, viscous=0.5, friction_width=1e-4)
    assert plant.evaluate("acceleration", [0.0], [2.0], [1.0])[0] == pytest.approx((1.0 - 3.0) / 2.0)
    assert plant.evaluate("friction", [0.0], [2.0])[0] == pytest.approx(3.0)
    assert plant.bias([0.0], [2.0])[0] == pytest.approx(1.0)  # without dry friction


def test_ripple_depends_on_the_position_of_the_motor():
    plant = Gearbox(plant=MASS, ripple=0.3, ripple_cycles=20.0, ripple_phase=0.4)
    assert plant.evaluate("acceleration", [0.1], [0.0], [0.0])[0] == pytest.approx(-0.3 * np.sin(2.4) / 2.0)
    elastic = Gearbox(plant=MASS, stiffness=1e3, motor_inertia=0.5, ripple=0.3, ripple_cycles=20.0)
    assert elastic.evaluate("acceleration", [0.1, 0.1], [0.0, 0.0], [0.0]) == pytest.approx([0, -0.6 * np.sin(2.0)])


def test_energy_stays_without_friction():
    plant = Gearbox(plant=ARM, stiffness=[900.0, 400.0], motor_inertia=[0.4, 0.2])
    q = np.array([0.3, -0.5, 0.32, -0.55])
    run = motion(plant, q, [0.0, 0.0], 0.5, t_eval=np.linspace(0, 0.5, 20))

    def energy(x):
        twist = x[2:4] - x[:2]
        motors = [0.4, 0.2] @ x[6:] ** 2 / 2 + [900.0, 400.0] @ twist**2 / 2
        return ARM.evaluate("energy", x[:2], x[4:6]) + motors

    energies = np.array([energy(x) for x in run.y.T])
    assert np.ptp(energies) < 1e-6
    assert np.ptp(run.y[4]) > 0.5


def test_a_rigid_gearbox_without_friction_is_the_robot():
    plant = Gearbox(plant=ARM)
    q, dq, torque = np.array([0.3, 0.7]), np.array([1.0, -2.0]), np.array([3.0, 1.0])
    np.testing.assert_allclose(
        plant.evaluate("acceleration", q, dq, torque), ARM.evaluate("acceleration", q, dq, torque)
    )
    np.testing.assert_array_equal(plant.inertia(q), ARM.inertia(q))
    heavier = Gearbox(plant=ARM, motor_inertia=0.4)
    np.testing.assert_allclose(heavier.inertia(q), ARM.inertia(q) + 0.4 * np.eye(2))


def test_a_stiff_gearbox_moves_as_the_robot_with_its_motors():
    rigid = Gearbox(plant=ARM, motor_inertia=0.4)
    q = np.array([0.2, 0.4])
    expected = motion(rigid, q, [20.0, 5.0], 0.3, t_eval=[0.3]).y[:2, 0]
    errors = []
    for stiffness in (1e3, 1e4):
        plant = Gearbox(plant=ARM, stiffness=stiffness, motor_inertia=0.4)
        moved = motion(plant, plant.coordinates(q), [20.0, 5.0], 0.3, t_eval=[0.3]).y[2:4, 0]
        errors.append(np.max(np.abs(moved - expected)))
    assert errors[1] < 0.2 * errors[0] < 0.02


def test_rotor_inertia_moves_to_the_motors():
    arm = load_robot("ur5e", armature=0.1)
    assert isinstance(arm, RigidBody)
    plant = Gearbox(plant=arm, stiffness=1e4)
    q = np.linspace(0.1, 0.6, 6)
    M = plant.inertia(np.concatenate([q, q]))
    np.testing.assert_allclose(M[:6, :6] + M[6:, 6:], arm.inertia(q), atol=1e-12)
    np.testing.assert_array_equal(M[6:, 6:], 0.1 * np.eye(6))
    assert not M[:6, 6:].any()


@pytest.mark.parametrize("encoder", ["motor", "link"])
@pytest.mark.parametrize("backlash", [0.0, 0.01])
def test_the_start_is_at_rest(encoder, backlash):
    plant = Gearbox(plant=ARM, stiffness=500.0, motor_inertia=0.3, backlash=backlash, encoder=encoder)
    q = np.array([0.3, 0.5])
    both = plant.coordinates(q)
    np.testing.assert_allclose(both[list(plant.measured)], q)
    torque = plant.holding_torque(both)
    np.testing.assert_allclose(torque, ARM.gravity_torque(both[:2]), rtol=1e-9)
    np.testing.assert_allclose(plant.evaluate("acceleration", both, np.zeros(4), torque), 0.0, atol=1e-9)


def law(**options):
    return tarc.laws.TDC(
        inertia=[0.1, 0.05],
        natural_frequency=10.0,
        period=PERIOD,
        estimator=tarc.estimators.Algebraic(window=0.01),
        **options,
    )


REFERENCE = Sinusoid(amplitude=[0.2, 0.2], frequency=2.0)


def test_encoders_at_the_motors_do_not_see_the_play():
    """The link is off by up to half the play; behind encoders at the links the law hunts for it."""
    runs = {}
    for encoder in ("motor", "link"):
        plant = Gearbox(
            plant=TwoLinkArm(gravity=0.0),
            stiffness=1e4,
            twist_damping=5.0,
            motor_inertia=0.5,
            backlash=0.004,
            encoder=encoder,
        )
        runs[encoder] = tarc.simulate(plant, law(), REFERENCE, 3.0, sensor=Encoder(bits=18)).data
    at_motor = runs["motor"].sel(time=slice(1.0, None))
    assert list(at_motor["passive_joint"]) == ["joint1 link", "joint2 link"]
    off = np.abs(at_motor["passive_position"].values - at_motor["position"].values)
    assert 0.0019 < off.max() < 0.004
    error = {name: np.abs(run["position"] - run["reference"]).values.max() for name, run in runs.items()}
    assert error["link"] > 3 * error["motor"]


def test_a_schedule_wears_the_gears():
    plant = Gearbox(plant=ARM, stiffness=1e4, motor_inertia=0.5)
    wear = ParameterSchedule(parameter="gearbox_backlash", times=[0.0, 0.3], values=[[0.0, 0.0], [0.02, 0.02]])
    run = tarc.simulate(plant, law(), REFERENCE, 0.6, disturbance=wear, initial_torque="rest", substeps=4).data
    off = np.abs(run["passive_position"].values - run["position"].values).max(axis=1)
    assert off[:300].max() < 0.01 < off[300:].max()
    changed = plant.with_parameters({"gearbox_backlash": [0.02, 0.01], "payload": 1.0})
    assert changed.parameters["payload"] == 1.0
    np.testing.assert_array_equal(changed.parameters["gearbox_backlash"], [0.02, 0.01])


def test_a_scenario_has_a_gearbox_that_its_certificates_do_not_know():
    content = {
        "robot": {"kind": "TwoLinkArm"},
        "gearbox": {"stiffness": 1e4, "motor_inertia": [0.5, 0.5], "backlash": 1e-3, "encoder": "link"},
        "law": {"kind": "TDC", "inertia": [0.1, 0.05], "natural_frequency": 10.0},
        "estimator": {"kind": "Algebraic", "window": 0.010},
        "reference": {"kind": "Sinusoid", "amplitude": [0.2, 0.2], "frequency": 2.0},
        "initial_torque": "rest",
        "duration": 0.2,
    }
    scenario = Scenario.parse(content)
    assert scenario.run()["TDC"].data.sizes["passive_joint"] == 2
    setup = scenario.build()
    assert setup.plant.is_fully_driven
    assert isinstance(setup.simulated, Gearbox)
    assert scenario.not_certified == ["gearbox"]
    late = Scenario.parse({**content, "gearbox": {}, "sensor": {"delay": [0.0, 0.5]}, "jitter": 0.1})
    assert late.not_certified == ["jitter", "sensor.delay"]
    with pytest.raises(InvalidParameter, match="use the robot without it"):
        tarc.certificates.certify_robot(
            law(), setup.simulated, tarc.analysis.Workspace.box([-0.3, -0.3], [0.3, 0.3], speed=1.0)
        )
    with pytest.raises(InvalidParameter, match=r"gearbox.encoder: got 'load'; known are motor, link"):
        Scenario.parse({**content, "gearbox": {**content["gearbox"], "encoder": "load"}}).run()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"plant": "arm"}, "gearbox: got 'arm'; needs a robot of tarc.plants"),
        ({"stiffness": 1e3}, "motor_inertia: TwoLinkArm has no rotor inertia; give that of the motors"),
        ({"backlash": 0.1}, "backlash: given without a stiffness"),
        ({"twist_damping": 0.1}, "twist_damping: given without a stiffness"),
        ({"stiffness": -1.0, "motor_inertia": 1.0}, "stiffness: got .*; each must be above 0"),
        ({"coulomb": 2.0, "breakaway": 1.0}, "breakaway: got 1.0; needs at least the dry friction, coulomb = 2.0"),
        ({"ripple": [1.0] * 3}, r"ripple: got shape \(3,\); needs one number or 2"),
        ({"plant": load_robot("ur5e"), "stiffness": 1e3}, "motor_inertia: the rotor inertia of ur5e.* is .*0.0"),
    ],
)
def test_what_makes_no_gearbox_is_refused(options, message):
    with pytest.raises(InvalidParameter, match=message):
        Gearbox(**{"plant": ARM, **options})
