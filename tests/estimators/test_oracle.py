"""The oracle tells the truth in simulation and is refused everywhere else."""

import numpy as np
import pytest

from law_catalogue import make_law
from tarc import Controller, Scenario, analysis, certificates, estimators, laws, signals, simulate
from tarc.core.errors import InvalidParameter, NotLinearisable
from tarc.plants import MujocoPlant, Pendulum, TwoLinkArm

T = 1e-3
ORACLE = estimators.TrueDerivatives()
SWING = signals.Sinusoid(amplitude=[0.5], frequency=3.0)
ARM = signals.Sinusoid(amplitude=[0.5, 0.5], frequency=[1.5, 2.1], offset=[0.0, 1.5])


def tdc(inertia, period=T, **options):
    return laws.TDC(inertia=inertia, natural_frequency=10.0, period=period, estimator=ORACLE, **options)


def pendulum_file(folder, integrator):
    file = folder / "pendulum.xml"
    file.write_text(
        f'<mujoco><option integrator="{integrator}"/><worldbody><body><joint name="j" axis="0 -1 0" damping="0.3"/>'
        '<inertial pos="0 0 -1" mass="1" diaginertia="1e-9 1e-9 1e-9"/></body></worldbody></mujoco>'
    )
    return MujocoPlant.from_file(file)


def robots(folder):
    return {
        "symbolic": Pendulum(viscous=0.3, rotor=1e-9),
        "euler": pendulum_file(folder, "Euler"),
        "rk4": pendulum_file(folder, "RK4"),
    }


@pytest.mark.parametrize("engine", ["symbolic", "euler", "rk4"])
@pytest.mark.parametrize("substeps", [1, 3])
def test_the_law_has_the_true_derivatives_in_both_engines(engine, substeps, tmp_path):
    """The velocity is the recorded one, whatever the encoder shows; the acceleration is the one before the torque."""
    plant, push = robots(tmp_path)[engine], signals.StepDisturbance(amplitude=[2.0], start_time=0.1004)
    stiffer = signals.ParameterSchedule(parameter="viscous", times=[0.2], values=[1.0])
    sensor = signals.Encoder(bits=8, dropout=0.05)
    events, start = [push, stiffer], {"initial_position": [0.2], "initial_velocity": 0.7, "initial_torque": [1.5]}
    law = tdc(0.6)
    data = simulate(plant, law, SWING, 0.4, sensor=sensor, disturbance=events, substeps=substeps, **start).data
    q, v, torque, u = (data[name].values[:, 0] for name in ("position", "velocity", "torque", "auxiliary"))
    np.testing.assert_array_equal(data["velocity_estimate"].values[:, 0], v)
    assert (
        np.max(np.abs(data["measured_position"].values[:, 0] - q)[~np.isnan(data["measured_position"].values[:, 0])])
        > 0.01
    )

    past = np.concatenate([[1.5], torque[:-1]])
    t = data["time"].values
    pushed = past + 2.0 * (t - T / substeps > 0.1004)  # by the last substep before t
    a = pushed - np.where(t > 0.2 + 1e-9, 1.0, 0.3) * v - 9.81 * np.sin(q)
    np.testing.assert_allclose(torque, 0.6 * (u - a) + past, rtol=0, atol=1e-8)


@pytest.mark.parametrize("delay", [1, 3])
def test_a_delayed_acceleration_goes_with_its_torque(delay):
    arm, M = TwoLinkArm(viscous=[0.5, 0.2]), np.diag([0.4, 0.1])
    data = simulate(arm, tdc(M, delay=delay * T), ARM, 0.5, initial_torque="rest").data
    q, v, torque, u = (data[name].values for name in ("position", "velocity", "torque", "auxiliary"))
    accelerations = np.array([arm.evaluate("acceleration", *row) for row in zip(q[1:], v[1:], torque, strict=False)])
    k = np.arange(delay, len(q))
    np.testing.assert_allclose(torque[k], (u[k] - accelerations[k - delay]) @ M + torque[k - delay], rtol=0, atol=1e-9)


def test_both_engines_give_the_same_run(tmp_path):
    push = signals.StepDisturbance(amplitude=[3.0], start_time=0.25)
    plain, file = (
        simulate(robots(tmp_path)[engine], tdc(0.9), SWING, 1.0, substeps=4, disturbance=push, initial_torque="rest")
        for engine in ("symbolic", "rk4")
    )
    for name, tolerance in (("position", 1e-11), ("velocity_estimate", 1e-10), ("torque", 1e-8)):
        np.testing.assert_allclose(plain.data[name], file.data[name], rtol=0, atol=tolerance, err_msg=name)


def test_with_the_inertia_itself_nothing_is_left_of_the_pendulum():
    """M̂ = M and true derivatives: q̈ = u after every change of the torque."""
    run = simulate(Pendulum(viscous=0.5, coulomb=1.0), tdc(1.0), SWING, 1.0, initial_position=[0.3])
    assert run.metrics()["rms_tde_error"] < 1e-12


def test_the_error_falls_as_the_error_equation_says():
    """ë + 2ω ė + ω² e = 0 from rest at e(0): e(t) = e(0) (1 + ωt) e^(−ωt), missed by O(T)."""
    still = signals.Sinusoid(amplitude=[0.0], frequency=1.0)

    def miss(period):
        data = simulate(Pendulum(viscous=0.5), tdc(1.0, period), still, 1.0, initial_position=[0.2]).data
        wt = 10.0 * data["time"].values
        return np.max(np.abs(data["position"].values[:, 0] - 0.2 * (1 + wt) * np.exp(-wt)))

    coarse, fine = miss(1e-3), miss(5e-4)
    assert coarse < 1e-3
    assert coarse == pytest.approx(2 * fine, rel=0.02)


def test_where_the_inertia_changes_the_error_is_of_first_order():
    """q̈ − u = (1 − M⁻¹M̂)(q̈⁻ − u), and u changes by O(T) a period."""
    M = TwoLinkArm().mean_inertia(ARM.sample(np.linspace(0, 4, 200))[0])

    def error(period):
        return simulate(TwoLinkArm(), tdc(M, period), ARM, 3.0, initial_torque="rest").metrics(1.0)["rms_tde_error"]

    coarse, fine = error(1e-3), error(5e-4)
    assert coarse < 2e-3
    assert coarse == pytest.approx(2 * fine, rel=0.02)


@pytest.mark.parametrize("kind", [laws.TARC, laws.PID, laws.ADRC, laws.ComputedTorque, laws.SuperTwisting])
def test_any_law_takes_it(kind):
    run = simulate(TwoLinkArm(), make_law(kind, estimator=ORACLE), ARM, 0.1, initial_torque="rest")
    assert run.status.completed
    np.testing.assert_array_equal(run.data["velocity_estimate"], run.data["velocity"])


def test_a_missing_sample_is_moved_on_by_the_true_velocity():
    state = ORACLE.with_period(T).init(np.array([0.5, 0.1]))._replace(velocity=np.array([2.0, 3.0]))
    state, estimate = ORACLE.with_period(T).step(state, np.array([np.nan, 0.2]))
    np.testing.assert_allclose(estimate.position, [0.502, 0.2])
    np.testing.assert_array_equal(estimate.valid, [0, 1])
    np.testing.assert_array_equal(state.position, estimate.position)


def test_a_scenario_can_name_it():
    content = {
        "robot": {"kind": "TwoLinkArm"},
        "law": {"kind": "TDC", "inertia": {"fraction": 1.0}, "natural_frequency": 10.0},
        "estimator": {"kind": "TrueDerivatives"},
        "reference": {"kind": "Sinusoid", "amplitude": [0.2, 0.2], "frequency": 2.0, "phase": 1.57},
        "duration": 0.5,
        "initial_torque": "rest",
    }
    scenario = Scenario.parse(content)
    assert scenario.run()["TDC"].metrics()["peak_error"] < 1e-2
    with pytest.raises(NotLinearisable, match="exists in simulation alone"):
        scenario.certify(samples=20)


def test_without_a_simulation_estimates_are_nan_and_the_torque_is_the_safe_one():
    law = tdc([0.1, 0.1])
    state, value = law.example()
    _, output = law.step(state, value._replace(reference=np.ones(2)))
    assert np.all(np.isnan(output.signals["velocity_estimate"]))
    np.testing.assert_array_equal(output.torque, 0.0)


@pytest.mark.parametrize(
    "use",
    [
        lambda: certificates.certify_constant_ratio(tdc(0.1), 0.5),
        lambda: analysis.stable_interval(tdc(0.1)),
        lambda: certificates.certify_varying_ratio(tdc(0.1)),
        lambda: ORACLE.with_period(T).transfer_function(1),
        lambda: ORACLE.with_period(T).group_delay(),
        lambda: ORACLE.with_period(T).noise_gain(2),
        lambda: ORACLE.with_period(T).plot(),
    ],
)
def test_it_is_refused_where_there_is_no_simulation(use):
    with pytest.raises(NotLinearisable, match="TrueDerivatives.* exists in simulation alone"):
        use()


def test_a_controller_refuses_it():
    with pytest.raises(InvalidParameter, match="estimator: got TrueDerivatives, which exists in simulation alone"):
        Controller(tdc([0.1, 0.1]))


@pytest.mark.parametrize(
    "use",
    [
        lambda: simulate(Pendulum(), tdc(1.0, synchronised=True), SWING, 0.1),
        lambda: ORACLE.with_period(T).matched_torque_filter(),
    ],
)
def test_synchronised_estimation_refuses_it(use):
    with pytest.raises(InvalidParameter, match="synchronised: TrueDerivatives has no delay"):
        use()


def test_orders_are_checked():
    with pytest.raises(InvalidParameter, match="derivative: got 3"):
        ORACLE.with_period(T).transfer_function(3)
