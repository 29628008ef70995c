"""The gains of each law that are searched for; the same gain has the same range in every law."""

import copy
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.scenario.schema import parameters_of_law
from tarc.scenario.user_law import law_name


@dataclass(frozen=True)
class SearchSpace:
    """A law with fixed keys, and a range for each free key.

    Attributes
    ----------
    fixed
        The law as a scenario writes it, without its free keys.
    free
        Smallest and largest value of each free key, searched on a logarithmic scale. A point leads into a section, as
        in ``inertia.fraction`` and ``estimator.window``. A window is rounded to whole periods.
    extends
        Name of a simpler law that this one contains. Half of the random trials keep its best gains, so that they need
        not be found again.
    """

    fixed: dict[str, Any]
    free: dict[str, tuple[float, float]] = field(default_factory=dict)
    extends: str = ""

    @property
    def middle(self) -> dict[str, float]:
        """Return the geometric middle of each range."""
        return {key: (low * high) ** 0.5 for key, (low, high) in self.free.items()}

    def examples(self, count: int = 3) -> list[dict[str, float]]:
        """Return values that differ in every key: random ones, after those at all lower and all upper ends of windows.

        Parameters
        ----------
        count
            Number of random ones.
        """
        rng = np.random.default_rng(0)
        drawn = [
            {key: float(low * (high / low) ** rng.uniform(0.2, 0.5)) for key, (low, high) in self.free.items()}
            for _ in range(count + 2)
        ]
        for values, end in zip(drawn, (0, 1), strict=False):
            values |= {key: ends[end] for key, ends in self.free.items() if key.split(".")[-1] == "window"}
        return drawn

    def law(self, values: dict[str, float], period: float) -> dict[str, Any]:
        """Return the law with these values, as a scenario writes it."""
        part = copy.deepcopy(self.fixed)
        for key, value in values.items():
            *path, last = key.split(".")
            node = part
            for step in path:
                node = node.setdefault(step, {})
            node[last] = max(round(value / period), 2) * period if last == "window" else float(f"{value:.4g}")
        return part

    def values(self, law: dict[str, Any]) -> dict[str, float]:
        """Return the values of a law that are free here: the reverse of `law`."""
        values: dict[str, Any] = {}
        for key in self.free:
            node: Any = law
            for step in key.split("."):
                node = node.get(step) if isinstance(node, dict) else None
            if node is not None:
                values[key] = float(node)
        return values


def user_search_space(kind: str, ranges: dict[str, tuple[float, float]]) -> SearchSpace:
    """Return the search space of any law: the common ranges of the gains that it has, and ranges of its own.

    Parameters
    ----------
    kind
        A class of `tarc.laws`, or ``my_file.py:MyLaw`` from a user's own file.
    ranges
        Smallest and largest value of further gains, by name.

    Raises
    ------
    InvalidParameter
        For a gain that the law lacks, and one that needs a range.
    """
    allowed = parameters_of_law(kind)
    for key in ranges:
        section, *_ = key.split(".")
        check.one_of("range", section, [*allowed, "estimator"])
    free = {key: value for key, value in COMMON.items() if key.split(".")[0] in (*allowed, "estimator")} | ranges
    model = {"model": "robot"} if "model" in allowed and allowed["model"].needed else {}
    covered = {key.split(".")[0] for key in free} | set(model)
    missing = [name for name, parameter in allowed.items() if parameter.needed and name not in covered]
    if missing:
        raise InvalidParameter(
            f"range: {law_name(kind)} needs a range for {', '.join(missing)}, such as --range {missing[0]}=0.1,10",
            missing[0],
        )
    return SearchSpace(_law(kind, **model), free)


INERTIA = {"inertia.fraction": (0.02, 5.0)}
POLES = {"natural_frequency": (2.0, 200.0)}
WINDOW = {"estimator.window": (0.002, 0.050)}
COMMON = {**INERTIA, **POLES, **WINDOW}
LAYER = {"boundary_layer": (0.01, 2.0)}
GAIN = (0.1, 100.0)


ARM = {"payload": [0.0, 3.0], "viscous": [0.0, 5.0], "coulomb": [0.0, 20.0]}
"""Parameter bounds of the law with projection; it needs a robot with these parameters."""


def _law(kind: str, **fixed: Any) -> dict[str, Any]:
    return {"kind": kind, "estimator": {"kind": "Algebraic", "window": 0.010, "degree": 2}, **fixed}


TARC_GAINS = {"rise_rate": (1e2, 1e5), "fall_rate": (1e2, 1e5), "boundary_layer": (1e-3, 0.1)}
TDARC_GAINS = {
    "rise_rate": (1.0, 1e4),
    "fall_rate": (1.0, 1e4),
    "state_rise_rate": (1.0, 1e5),
    "state_fall_rate": (1.0, 1e5),
    **LAYER,
}
BARRIER_GAINS = {
    "position_limit": (1e-3, 0.1),
    "velocity_limit": (0.1, 10.0),
    "barrier_gain": (1.0, 1e3),
    "adaptation_rate": (1.0, 1e4),
    "state_adaptation_rate": (1.0, 1e5),
    "leakage": (0.1, 100.0),
    **LAYER,
}
BOUND_CAPS = {"max_gain": 100.0, "max_state_gain": 100.0}

KNOWN = {"inertia": {"model": True, "gravity": True, "coriolis": True}}
"""M̂(q) of the scenario's own robot, without its friction."""

SPACES: dict[str, SearchSpace] = {
    "tdc": SearchSpace(_law("TDC"), COMMON),
    "tdc-sync": SearchSpace(_law("TDC", synchronised=True), COMMON),
    "tdc-difference": SearchSpace(
        {"kind": "TDC", "estimator": {"kind": "BackwardDifference"}}, {"inertia.fraction": (1e-4, 1.5), **POLES}
    ),
    "tdc-filtered": SearchSpace(
        {"kind": "TDC", "estimator": {"kind": "FilteredDifference"}},
        {"inertia.fraction": (1e-3, 1.5), **POLES, "estimator.cutoff": (20.0, 1000.0)},
    ),
    "tdc-kalman": SearchSpace(
        {"kind": "TDC", "estimator": {"kind": "Kalman", "noise": 1e-5}},
        {**INERTIA, **POLES, "estimator.jerk": (0.1, 1000.0)},
    ),
    "tdc-differentiator": SearchSpace(
        {"kind": "TDC", "estimator": {"kind": "RobustDifferentiator"}},
        {**INERTIA, **POLES, "estimator.lipschitz": (1.0, 1e4)},
    ),
    "tarc": SearchSpace(
        _law("TARC", max_gain=10.0),
        {**COMMON, **TARC_GAINS},
        extends="tdc",
    ),
    "tdarc": SearchSpace(_law("TDARC", **BOUND_CAPS), {**COMMON, **TDARC_GAINS}, extends="tdc"),
    "barrier": SearchSpace(_law("BarrierTDARC", **BOUND_CAPS), {**COMMON, **BARRIER_GAINS}, extends="tdc"),
    "ivf": SearchSpace(_law("IVF"), {**COMMON, "ideal_velocity_gain": (0.5, 60.0)}, extends="tdc"),
    "tdcim": SearchSpace(_law("TDCIM"), {**COMMON, "time_constant": (0.01, 2.0)}, extends="tdc"),
    "terminal": SearchSpace(
        _law("TerminalSliding", max_gain=100.0),
        {**COMMON, "nonlinear_damping": (0.1, 100.0), "exponent": (0.5, 1.0), "error_scale": (0.01, 1.0)},
        extends="tdc",
    ),
    "nonsingular": SearchSpace(
        _law("NonsingularTerminal"),
        {**COMMON, "reaching_gain": GAIN, "exponent": (1.05, 1.9), "reaching_exponent": (0.3, 0.99), **LAYER},
        extends="tdc",
    ),
    "smc-tde": SearchSpace(_law("SlidingMode"), {**COMMON, "gain": GAIN, **LAYER}, extends="tdc"),
    "smc": SearchSpace(_law("SlidingMode", time_delay=False), {**COMMON, "gain": GAIN, **LAYER}),
    "asmc-tde": SearchSpace(
        _law("ASMC", max_gain=100.0),
        {**COMMON, "adaptation_rate": (1.0, 1e4), "threshold": (1e-3, 1.0), **LAYER},
        extends="tdc",
    ),
    "asmc": SearchSpace(
        _law("ASMC", time_delay=False, max_gain=300.0),
        {**COMMON, "adaptation_rate": (1.0, 1e4), "threshold": (1e-3, 1.0), **LAYER},
    ),
    "monotone-tde": SearchSpace(
        _law("MonotoneASMC", max_gain=100.0),
        {**COMMON, "adaptation_rate": (1.0, 1e4), "dead_zone": (1e-3, 1.0), **LAYER},
        extends="tdc",
    ),
    "monotone": SearchSpace(
        _law("MonotoneASMC", time_delay=False, max_gain=300.0),
        {**COMMON, "adaptation_rate": (1.0, 1e4), "dead_zone": (1e-3, 1.0), **LAYER},
    ),
    "pid": SearchSpace(_law("PID"), {**COMMON, "integral_gain": (0.1, 30.0)}),
    "pd-gravity": SearchSpace(_law("PID", model="robot"), COMMON),
    "adrc": SearchSpace(_law("ADRC"), {**INERTIA, **POLES, "observer_bandwidth": (20.0, 1000.0)}),
    "super-twisting": SearchSpace(
        _law("SuperTwisting"), {**COMMON, "disturbance_rate": (1.0, 1e5), "boundary_layer": (1e-3, 1.0)}
    ),
    "ipid": SearchSpace(_law("IntelligentPID"), {**COMMON, "window": WINDOW["estimator.window"]}),
    "corless-leitmann": SearchSpace(
        _law("CorlessLeitmann"), {**COMMON, "uncertainty_bound": GAIN, "boundary_layer": (1e-3, 1.0)}
    ),
    "fuzzy": SearchSpace(
        _law("AdaptiveFuzzy", max_consequent=300.0),
        {**COMMON, "adaptation_rate": (1.0, 1e7), "position_span": (0.5, 6.3)},
    ),
    "projection": SearchSpace(
        _law("ProjectionARC", model="robot", parameter_bounds=ARM),
        {
            **POLES,
            **WINDOW,
            "adaptation_gain": (1e-3, 1e3),
            "robust_fraction": (0.01, 1.0),
            "boundary_layer": (0.05, 10.0),
        },
    ),
    "computed-torque": SearchSpace(_law("ComputedTorque", model="robot"), {**POLES, **WINDOW}),
    "computed-torque-integral": SearchSpace(
        _law("ComputedTorque", model="robot", friction_at_reference=True),
        {**POLES, **WINDOW, "integral_gain": (0.1, 30.0)},
    ),
    "tdc-model": SearchSpace(_law("TDC", **KNOWN), COMMON),
    "tarc-model": SearchSpace(_law("TARC", max_gain=10.0, **KNOWN), {**COMMON, **TARC_GAINS}, extends="tdc-model"),
    "tdarc-model": SearchSpace(_law("TDARC", **BOUND_CAPS, **KNOWN), {**COMMON, **TDARC_GAINS}, extends="tdc-model"),
    "barrier-model": SearchSpace(
        _law("BarrierTDARC", **BOUND_CAPS, **KNOWN), {**COMMON, **BARRIER_GAINS}, extends="tdc-model"
    ),
}
