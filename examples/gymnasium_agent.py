"""Let an agent add its torque to a law.

The loop is an environment of Gymnasium; a random search finds the two gains of the agent.
"""

import numpy as np
from matplotlib.figure import Figure

import tarc

N_CANDIDATES = 6


def episode(env: tarc.runtime.LawEnvironment, gains: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the sum of rewards of an agent with two gains, and the errors [rad], shape (k, 2)."""
    observation, _ = env.reset(seed=0)
    total, done, errors = 0.0, False, []
    while not done:
        error, rate = observation[:2], observation[2:4]
        action = np.clip(-gains[0] * error - gains[1] * rate, -1, 1)
        observation, reward, terminated, truncated, info = env.step(action)
        total += reward
        errors.append(info["error"])
        done = terminated or truncated
    return total, np.array(errors)


if __name__ == "__main__":
    scenario = tarc.Scenario.load("two_link_payload", ["duration=0.4"])
    env = tarc.runtime.LawEnvironment.from_scenario(scenario, torque_limit=[150.0, 60.0], initial_error=0.05)
    rng = np.random.default_rng(0)
    alone = best = episode(env, np.zeros(2))
    best_gains = np.zeros(2)
    for _ in range(N_CANDIDATES):
        gains = best_gains + rng.normal(0, [0.02, 0.05])
        tried = episode(env, gains)
        if tried[0] > best[0]:
            best, best_gains = tried, gains
    print("the law alone", alone[0], "with the agent", best[0], "gains", best_gains)

    figure = Figure(figsize=(7, 3.2), layout="constrained")
    axes = figure.add_subplot()
    for (_, errors), name, style in ((alone, "law alone", "-"), (best, "with the agent", "--")):
        for joint, colour in enumerate(("tab:blue", "tab:orange")):
            axes.plot(1e3 * errors[:, joint], style, color=colour, label=f"joint {joint + 1}, {name}", lw=1.3)
    axes.set_xlabel("time [ms]")
    axes.set_ylabel("error [mrad]")
    axes.legend(frameon=False)
    figure.savefig("gymnasium_agent.png", dpi=110)
