"""Laws and robots in other libraries: python-control and Gymnasium give the numbers of `tarc.simulate`."""

import warnings
from typing import Any

import control
import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import tarc
from tarc.core.errors import InvalidParameter
from tarc.runtime import LawEnvironment, to_iosys

LIMITS = [150.0, 60.0]
REFERENCE = tarc.signals.Sinusoid(amplitude=[0.6, 0.6], frequency=[2.0, 2.5], phase=np.pi / 2)


def arm():
    return tarc.plants.TwoLinkArm(viscous=[0.5, 0.5])


def tarc_law(**options):
    return tarc.laws.TARC(
        inertia=0.05 * np.array([[3.0, 1.0], [1.0, 1.0]]),
        natural_frequency=10.0,
        period=1e-3,
        estimator=tarc.estimators.Algebraic(window=0.010),
        rise_rate=2e3,
        fall_rate=1e3,
        torque_limit=LIMITS,
        **options,
    )


def simulated(law, duration, **options):
    return tarc.simulate(arm(), law, REFERENCE, duration, substeps=2, initial_torque="rest", **options).data


def environment(duration=0.2, **options):
    return LawEnvironment(arm(), tarc_law(), REFERENCE, duration, **options)


@pytest.mark.slow
def test_a_loop_in_python_control_is_our_simulation():
    law, robot = to_iosys(tarc_law()), to_iosys(arm(), period=1e-3)
    assert law.dt == robot.dt == 1e-3
    references = [label for label in law.input_labels if not label.startswith("position")]
    outputs = ["position[0]", "position[1]", "torque[0]", "torque[1]"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # the robot's velocity is connected to nothing
        loop = control.interconnect([law, robot], inputs=references, outputs=outputs, name="loop")
    expected = simulated(tarc_law(), 0.05)
    times = expected["time"].values
    start = REFERENCE.sample(0.0)[0].ravel()
    state = tarc.Controller(tarc_law()).state_at_start(start, arm().holding_torque(start))
    inputs: Any = np.vstack(REFERENCE.sample(times))
    response = control.input_output_response(loop, times, inputs, np.r_[state, start, 0.0, 0.0])
    np.testing.assert_allclose(response.outputs[:2].T, expected["position"].values, rtol=0, atol=1e-13)
    np.testing.assert_allclose(response.outputs[2:].T, expected["torque"].values, rtol=0, atol=1e-9)


def test_what_is_no_system_is_refused():
    with pytest.raises(InvalidParameter, match="needs a law, or a robot with a period"):
        to_iosys(arm())
    with pytest.raises(InvalidParameter, match="needs a robot in symbols"):
        to_iosys(tarc.plants.load_robot("panda", backend="mujoco"), period=1e-3)


@pytest.mark.parametrize("action", ["residual", "torque"])
def test_gymnasium_accepts_the_environment(action):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        made = environment(0.05, action=action, initial_error=0.01, sensor=tarc.signals.Encoder(bits=16))
        check_env(made, skip_render_check=True)


def test_an_agent_that_does_nothing_leaves_our_simulation():
    sensor = tarc.signals.Encoder(bits=16)
    expected = simulated(tarc_law(), 0.1, sensor=sensor)
    made = environment(0.1, sensor=sensor)
    _, info = made.reset(seed=0)
    truncated = False
    for k in range(100):
        assert np.array_equal(info["law_torque"], expected["torque"].values[k])
        np.testing.assert_allclose(
            info["error"], (expected["position"] - expected["reference"]).values[k], rtol=0, atol=1e-14
        )
        _, _, terminated, truncated, info = made.step(np.zeros(2))
        assert not terminated
    assert truncated


def test_the_same_seed_gives_the_same_episode_and_another_does_not():
    def episode(seed):
        made = environment(initial_error=0.02, sensor=tarc.signals.Encoder(noise=1e-4))
        seen = [made.reset(seed=seed)[0]]
        actions = np.random.default_rng(3).uniform(-1, 1, (50, 2))
        return np.array(seen + [made.step(action)[0] for action in actions])

    assert np.array_equal(episode(5), episode(5))
    assert not np.array_equal(episode(5), episode(6))


def test_action_reward_and_limits_are_as_stated():
    made = environment(action="residual", effort_weight=0.5)
    _, before = made.reset(seed=0)
    _, reward, _, _, after = made.step(np.array([1.0, -1.0]))
    np.testing.assert_allclose(after["applied_torque"], before["law_torque"] + 0.2 * np.array([150.0, -60.0]))
    assert reward == pytest.approx(-np.mean(after["error"] ** 2) / 0.01**2 - 0.5)
    alone = environment(action="torque")
    alone.reset(seed=0)
    assert alone.step(np.array([2.0, 0.1]))[4]["applied_torque"].tolist() == [150.0, 6.0]
    ended = [alone.step(np.array([1.0, 1.0]))[2] for _ in range(199)]
    assert not ended[0]
    with pytest.raises(InvalidParameter, match="action"):
        alone.step(np.array([np.nan, 0.0]))
    falling = environment(2.0, action="torque", divergence_threshold=0.2)
    falling.reset(seed=0)
    assert any(falling.step(np.array([1.0, 1.0]))[2] for _ in range(800))


def test_an_environment_needs_torque_limits_and_takes_a_scenario():
    law = tarc.laws.TDC(
        inertia=[0.1, 0.1], natural_frequency=10.0, period=1e-3, estimator=tarc.estimators.Algebraic(window=0.01)
    )
    with pytest.raises(InvalidParameter, match="torque limit"):
        LawEnvironment(arm(), law, REFERENCE, 1.0)
    made = LawEnvironment.from_scenario("two_link_payload", torque_limit=LIMITS)
    assert isinstance(made, gymnasium.Env)
    assert made.sensor.bits == 16
    with pytest.raises(InvalidParameter, match="the scenario has TDC"):
        LawEnvironment.from_scenario("two_link_payload", "PID")
