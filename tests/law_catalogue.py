"""Every law and estimator that the package has, found by itself."""

import inspect
from typing import Any

import numpy as np

from tarc import estimators, laws, plants
from tarc.scenario.schema import parameters

PERIOD = 1e-3

ESTIMATORS: dict[str, estimators.Estimator] = {
    "algebraic": estimators.Algebraic(window=0.008, degree=2),
    "cubic": estimators.Algebraic(window=0.010, degree=3),
    "difference": estimators.BackwardDifference(),
    "filtered": estimators.FilteredDifference(cutoff=300.0),
    "kalman": estimators.Kalman(noise=1e-5, jerk=100.0),
    "high gain": estimators.HighGain(time_constant=0.004),
    "implicit": estimators.RobustDifferentiator(lipschitz=100.0),
    "explicit": estimators.RobustDifferentiator(lipschitz=100.0, implicit=False),
    "truth": estimators.TrueDerivatives(),
}

REQUIRED_PARAMETERS: dict[str, Any] = {
    "inertia": None,
    "rise_rate": 3000.0,
    "fall_rate": 2000.0,
    "state_rise_rate": 200.0,
    "state_fall_rate": 100.0,
    "position_limit": 0.1,
    "velocity_limit": 3.0,
    "gain": 5.0,
    "reaching_gain": 5.0,
    "adaptation_rate": 20.0,
    "threshold": 0.1,
    "ideal_velocity_gain": 10.0,
    "time_constant": 0.1,
    "nonlinear_damping": 5.0,
    "observer_bandwidth": 60.0,
    "disturbance_rate": 200.0,
    "uncertainty_bound": 5.0,
    "model": None,
    "max_consequent": 30.0,
    "parameter_bounds": {"masses": [0.5, 2.0], "dampers": [0.0, 1.0]},
}
"""Values for the parameters that some law needs."""


def concrete_laws() -> list[type[laws.Law]]:
    """Every law of the package that can be constructed."""
    public = [getattr(laws, name) for name in laws.__all__]
    return [
        kind for kind in public if inspect.isclass(kind) and issubclass(kind, laws.Law) and not inspect.isabstract(kind)
    ]


def make_law(kind: type[laws.Law], joints: int = 2, estimator_name: str = "algebraic", **options: Any) -> Any:
    """Return a law of this kind with plain gains."""
    mixed = 0.05 * (np.eye(joints) + 0.2 * np.ones((joints, joints)))
    given: dict[str, Any] = {**REQUIRED_PARAMETERS, "inertia": mixed, "natural_frequency": 12.0}
    needed = {name: parameter for name, parameter in parameters(kind).items() if parameter.needed}
    unknown = set(needed) - set(given)
    assert not unknown, f"give {unknown} of {kind.__name__} a value in REQUIRED_PARAMETERS in tests/law_catalogue.py"
    needed = {name: given[name] for name in needed}
    if "model" in needed:
        needed["model"] = plants.MassSpringDamper(masses=(1.0,) * joints, springs=0.0, dampers=0.2)
    if "natural_frequency" in parameters(kind):
        needed["natural_frequency"] = 12.0
    return kind(**{"period": PERIOD, "estimator": ESTIMATORS[estimator_name], **needed, **options})


def make_tdc(
    window: int = 10, synchronised: bool = False, natural_frequency: Any = 10.0, inertia: Any = 0.1, **options: Any
) -> laws.TDC:
    """TDC at 1 kHz with a window of so many periods, whose stable ranges of the inertia ratio are known."""
    return laws.TDC(
        inertia=inertia,
        natural_frequency=natural_frequency,
        period=PERIOD,
        estimator=estimators.Algebraic(window=window * PERIOD, degree=2),
        synchronised=synchronised,
        **options,
    )


KNOWN_RANGES = [
    (2, False, 0.00495, 0.8016),
    (10, False, 0.00486, 0.2616),
    (20, False, 0.00476, 0.1263),
    (10, True, 0.0255, 2.815),
    (20, True, 0.0450, 2.569),
    (50, True, 0.088, 1.994),
]
"""Window in periods, synchronised or not, stable range of the inertia ratio of `make_tdc`, known independently."""


def agrees_to_digits(value: Any, expected: float) -> bool:
    """Whether a number is the known one, to the digits that it is known by."""
    digit = 10.0 ** -len(str(expected).split(".")[1])
    return abs(value - expected) <= 0.5 * digit + 1e-6
