"""Search a small agent on top of a law, in Gymnasium: a linear feedback of error and error rate."""

import numpy as np

import tarc

N_CANDIDATES = 6


def episode(env: tarc.runtime.LawEnvironment, gains: np.ndarray) -> float:
    """Return the sum of rewards of an agent with two gains."""
    observation, _ = env.reset(seed=0)
    total, done = 0.0, False
    while not done:
        error, rate = observation[:2], observation[2:4]
        action = np.clip(-gains[0] * error - gains[1] * rate, -1, 1)
        observation, reward, terminated, truncated, _ = env.step(action)
        total += reward
        done = terminated or truncated
    return total


if __name__ == "__main__":
    scenario = tarc.Scenario.load("two_link_payload", ["duration=0.4"])
    env = tarc.runtime.LawEnvironment.from_scenario(scenario, torque_limit=[150.0, 60.0], initial_error=0.05)
    rng = np.random.default_rng(0)
    best, best_reward = np.zeros(2), episode(env, np.zeros(2))
    print("the law alone", best_reward)
    for _ in range(N_CANDIDATES):
        gains = best + rng.normal(0, [0.02, 0.05])
        reward = episode(env, gains)
        if reward > best_reward:
            best, best_reward = gains, reward
    print("with the agent", best_reward, "gains", best)
