"""Another law of the same structure takes over between two steps."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import tarc
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.laws.base import LawInput

PERIODS = 60
CHANGE = 25


def adaptive(**changes: Any) -> tarc.laws.TARC:
    parameters: dict[str, Any] = {
        "inertia": [0.1, 0.05],
        "natural_frequency": 20.0,
        "rise_rate": 1e4,
        "fall_rate": 7e3,
        "max_gain": 6.0,
        "period": 1e-3,
        "estimator": tarc.estimators.Algebraic(window=0.005),
        "torque_limit": 30.0,
    }
    return tarc.laws.TARC(**(parameters | changes))


def inputs() -> list[LawInput]:
    rng = np.random.default_rng(1)
    times = 1e-3 * np.arange(PERIODS)
    position = 0.1 * np.sin(5 * times) + 1e-4 * rng.standard_normal((2, PERIODS))
    reference = 0.12 * np.sin(5 * times) * np.ones((2, 1))
    columns = zip(position.T, reference.T, np.gradient(reference, 1e-3, axis=1).T, strict=True)
    return [LawInput(*row, np.zeros(2)) for row in columns]


def by_the_equations(laws: list[tarc.laws.TARC]) -> Array:
    """Step the equations themselves in NumPy, with one law per period and the state handed on."""
    state = laws[0].init(np.zeros(2))
    torques = []
    for law, value in zip(laws, inputs(), strict=True):
        state, output = law.step(state, value)
        torques.append(output.torque)
    return np.array(torques)


@pytest.mark.parametrize("native", [False, True])
def test_the_torque_is_that_of_the_equations_with_another_law_from_then_on(native: bool) -> None:
    first = adaptive()
    second = replace(first, natural_frequency=30.0, max_gain=3.0, rise_rate=2e4)
    controller = tarc.Controller(first, native=native)
    prepared = controller.prepare(second)
    controller.reset(np.zeros(2))
    torques = []
    for k, value in enumerate(inputs()):
        if k == CHANGE:
            controller.change_law(prepared)
        torques.append(controller.step(*value).copy())
    assert controller.law is second
    expected = by_the_equations([first] * CHANGE + [second] * (PERIODS - CHANGE))
    np.testing.assert_allclose(torques, expected, rtol=1e-9)
    assert np.max(np.abs(expected - by_the_equations([first] * PERIODS))) > 0.1


def test_the_torque_jumps_by_the_proportional_terms_alone() -> None:
    first = tarc.laws.TDC(
        inertia=[0.1, 0.05],
        natural_frequency=20.0,
        period=1e-3,
        estimator=tarc.estimators.Algebraic(window=0.005),
    )
    second = replace(first, natural_frequency=30.0)
    unchanged, changed = tarc.Controller(first), tarc.Controller(first)
    *before, value = inputs()[: CHANGE + 1]
    for controller in (unchanged, changed):
        controller.reset(np.zeros(2))
        for earlier in before:
            controller.step(*earlier)
    changed.change_law(changed.prepare(second))
    jump = changed.step(*value) - unchanged.step(*value)
    error = value.position - value.reference
    error_rate = unchanged.signals["velocity_estimate"] - value.velocity_reference
    expected = first.M @ -((second.K1 - first.K1) @ error + (second.K2 - first.K2) @ error_rate)
    np.testing.assert_allclose(jump, expected, rtol=1e-9)


def test_another_structure_is_refused() -> None:
    controller = tarc.Controller(adaptive())
    with pytest.raises(InvalidParameter, match=r"law: got TARC with 2 joints and a period of 0.002 s; needs"):
        controller.prepare(adaptive(period=2e-3, estimator=tarc.estimators.Algebraic(window=0.01)))
    with pytest.raises(InvalidParameter, match=r"estimator: got .*; needs .*, whose state goes on"):
        controller.prepare(adaptive(estimator=tarc.estimators.Algebraic(window=0.006)))
    with pytest.raises(InvalidParameter, match="neither delay nor window"):
        controller.prepare(adaptive(delay=0.003))
