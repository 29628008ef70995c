"""Gains for which a law is certified on a robot."""

from dataclasses import replace

import numpy as np
import pytest

import tarc
from tarc.analysis import Workspace
from tarc.certificates import certified_gains, certify_gains, certify_known_inertia, certify_robot
from tarc.core.errors import InvalidParameter, UnsupportedLaw

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
    progress: list[tuple[int, int]] = []
    found = certify_gains(
        law, ARM, WORKSPACE, samples=50, on_certificate=lambda count, most: progress.append((count, most))
    )
    assert progress == [(count, 19) for count in range(1, len(progress) + 1)]  # the law, 4 slopes, 7 steps each way
    assert len(progress) <= 19
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


def with_model(**gains: float) -> tarc.laws.TDC:
    return tarc.laws.TDC(
        inertia=tarc.NominalInertia(ARM, 0.1),
        period=1e-3,
        estimator=tarc.estimators.Algebraic(window=0.010),
        **gains,  # type: ignore[arg-type] - gains by their names
    )


def test_gains_of_a_law_with_a_model_have_certificates_of_their_own() -> None:
    law = with_model(natural_frequency=66.0)
    frequencies = certify_gains(law, ARM, WORKSPACE, samples=20).ranges()["natural_frequency"].values
    assert len(frequencies) > 3
    assert 66.0 in frequencies
    certified = {
        value: certify_known_inertia(
            replace(law, natural_frequency=value), ARM, WORKSPACE, samples=20, quick=True
        ).certified
        for value in (frequencies[0], frequencies[-1], 1.1 * frequencies[-1])
    }
    assert list(certified.values()) == [True, True, False]


@pytest.mark.slow
def test_the_largest_gain_of_a_law_with_a_model_is_certified(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(certified_gains, "MAX_FACTOR", 1.0)  # no other natural frequency
    law = replace(adaptive(), inertia=tarc.NominalInertia(ARM, 0.1), natural_frequency=66.0)
    found = certify_gains(law, ARM, WORKSPACE, samples=20)
    ranges = found.ranges()
    largest = ranges["max_gain"].high
    assert largest > 1.0
    assert ranges["natural_frequency"].values == (66.0,)
    changed = found.change(law, {"max_gain": largest})
    assert certify_known_inertia(changed, ARM, WORKSPACE, samples=20, quick=True).certified


def test_a_model_needs_speeds() -> None:
    law = replace(adaptive(), inertia=tarc.NominalInertia(ARM, 0.1))
    with pytest.raises(UnsupportedLaw, match="give the largest speed"):
        certify_gains(law, ARM, Workspace(low=WORKSPACE.low, high=WORKSPACE.high), samples=50)
