"""Sets of gains per second of `tarc tune`: as one run after the other, and as trials that share what they can.

``python -m benchmarks.tuning`` tries the same random gains both ways in one process, one scenario after the other.
The first way builds the whole scenario for each trial and runs it as `tarc run` does. Times include the sampler.
"""

import argparse
import time
from collections.abc import Callable, Sequence

import numpy as np
import optuna

from tarc import Scenario
from tarc.study import SearchSpace, default_search_spaces
from tarc.study.law_scores import objective
from tarc.study.search_sampler import MAX_BATCH, SeededSampler
from tarc.study.trials import Trials

SCENARIOS = ("train_two_link", "train_ur5e", "train_masses")
LIMIT = 1e3
"""Limit on torque variation [N m/s or N/s], which does not change the time."""


def gains_around(space: SearchSpace, count: int) -> list[dict[str, float]]:
    """Draw gains as a search has them when it has learnt: within a factor of two of what holds the robots."""
    rng = np.random.default_rng(0)
    known = {"inertia.fraction": 0.06, "natural_frequency": 20.0, "estimator.window": 0.010}
    middle = {**space.middle, **{key: value for key, value in known.items() if key in space.free}}
    return [{key: value * 2 ** rng.uniform(-0.5, 0.5) for key, value in middle.items()} for _ in range(count)]


def seconds(call: Callable[[], object]) -> float:
    """Return the time that a call takes [s]."""
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


def sampling(space: SearchSpace, count: int) -> float:
    """Return the time of Optuna for a trial [s], for trials that all have the same value."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    gains = {key: optuna.distributions.FloatDistribution(*ends, log=True) for key, ends in space.free.items()}
    study = optuna.create_study(sampler=SeededSampler(gains, 0, count // 3, is_long=True))

    def search() -> None:
        for _ in range(count):
            study.tell(study.ask(dict(gains)), 1.0)

    return seconds(search) / count


def measure(name: str, law: str, before: int, after: int) -> tuple[float, float]:
    """Return the time of a trial [s] as a run of its own, and with what trials share."""
    scenario, space = Scenario.load(name), default_search_spaces()[law]
    parts = [space.law(gains, scenario.period) for gains in gains_around(space, max(before, after))]

    def one_by_one(some: Sequence[dict[str, object]]) -> None:
        for part in some:
            objective(scenario, part, LIMIT)

    examples = [space.law(values, scenario.period) for values in space.examples()]
    tried = Trials([scenario], examples=examples)

    def shared(some: Sequence[dict[str, object]]) -> None:
        for start in range(0, len(some), MAX_BATCH):
            tried.evaluate(some[start : start + MAX_BATCH], run_unstable=True)

    one_by_one(parts[:2])
    shared(parts)  # compiles what pays off
    return seconds(lambda: one_by_one(parts[:before])) / before, seconds(lambda: shared(parts[:after])) / after


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--laws", default="tdc,tarc", help="names with commas between")
    parser.add_argument("--before", type=int, default=24)
    parser.add_argument("--after", type=int, default=96)
    options = parser.parse_args()
    print(f"{'law':12}{'scenario':18}{'runs [1/s]':>12}{'trials [1/s]':>14}{'ratio':>8}")
    for law in options.laws.split(","):
        times = {name: measure(name, law, options.before, options.after) for name in SCENARIOS}
        for name, (one, shared) in times.items():
            print(f"{law:12}{name:18}{1 / one:12.1f}{1 / shared:14.1f}{one / shared:8.1f}")
        draw = sampling(default_search_spaces()[law], 200)
        one, shared = (sum(pair[i] for pair in times.values()) + draw for i in (0, 1))
        what = f"all three, {1e3 * draw:.1f} ms by Optuna"
        print(f"{law:12}{what:18}\n{'':30}{1 / one:12.1f}{1 / shared:14.1f}{one / shared:8.1f}", flush=True)


if __name__ == "__main__":
    main()
