"""Gains for which a law is certified on a robot."""

from dataclasses import replace

import numpy as np
import pytest

import tarc
from tarc.analysis import Workspace
from tarc.certificates import certify_gains, certify_robot
from tarc.core.errors import InvalidParameter

ARM = tarc.plants.TwoLinkArm()
WORKSPACE = Workspace(low=np.array([-0.3, 1.0]), high=np.array([0.3, 1.4]), speed=np.full(2, 1.0))


def adaptive() -> tarc.laws.TARC:
    return tarc.laws.TARC(
        inertia=0.18 * ARM.inertia(np.array([0.0, 1.2])),
        natural_frequency=15.0,
        period=1e-3,
        estimator=tarc.estimators.Algebraic(window=0.010),
        rise_rate=1e4,
        fall_rate=5e3,
        boundary_layer=0.015,
        max_gain=1.0,
    )


def test_each_listed_gain_is_certified_and_the_next_one_is_not() -> None:
    law = adaptive()
    found = certify_gains(law, ARM, WORKSPACE, samples=50)
    ranges = found.ranges()

    def is_certified(**gains: float) -> bool:
        return certify_robot(replace(law, **gains), ARM, WORKSPACE, samples=50).certified

    frequencies = ranges["natural_frequency"].values
    assert len(frequencies) > 3
    assert 15.0 in frequencies
    assert all(is_certified(natural_frequency=value) for value in (frequencies[0], frequencies[-1]))
    assert max(frequencies) == pytest.approx(30.0, rel=0.1) or not is_certified(natural_frequency=1.1 * frequencies[-1])
    largest = ranges["max_gain"].high
    assert largest > 1.0
    assert is_certified(max_gain=largest)
    assert largest == pytest.approx(2.0, rel=0.05) or not is_certified(max_gain=1.06 * largest)
    for value in frequencies:
        assert found.change(law, {"natural_frequency": value}).natural_frequency == value


def test_a_law_that_is_not_certified_has_no_gains() -> None:
    law = replace(adaptive(), natural_frequency=100.0)
    found = certify_gains(law, ARM, WORKSPACE, samples=50)
    assert not found.ranges()
    with pytest.raises(InvalidParameter, match="the law is .* on this robot"):
        found.change(law, {"max_gain": 0.5})


def test_one_natural_frequency_for_all_joints_is_needed() -> None:
    with pytest.raises(InvalidParameter, match="natural_frequency: .* needs one number for all joints"):
        certify_gains(replace(adaptive(), natural_frequency=[15.0, 20.0]), ARM, WORKSPACE)
