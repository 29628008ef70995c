"""The speed among the changes that admit a design: first where the file states it, confirmed, however small."""

from importlib import import_module
from typing import Any

import numpy as np
import pytest

from tarc.core.errors import InfeasibleDesign, Relaxation, RobotFileWarning
from tarc.design import design_controller
from tarc.design.candidates import enumerate_candidates
from tarc.design.problem import DesignProblem
from tarc.design.relaxations import RelaxedRobots, suggest_changes
from tarc.design.requirements import DesignRequirements
from tarc.design.robustness import RobustnessSpec
from tarc.plants import load_robot
from urdf_text import arm, joint

ARMATURE = Relaxation("armature", 0.1, "more rotor inertia")


@pytest.fixture(autouse=True)
def few_candidates(monkeypatch):
    monkeypatch.setattr(import_module("tarc.design.candidates"), "WINDOWS", (8, 16))
    monkeypatch.setattr(import_module("tarc.design.candidates"), "NATURAL_FREQUENCIES", (4.0, 8.0))
    monkeypatch.setattr(RelaxedRobots, "armature", lambda self: ARMATURE)
    for name in ("payload", "workspace"):
        monkeypatch.setattr(RelaxedRobots, name, lambda self: None)


@pytest.fixture
def read(tmp_path):
    def load(shoulder, elbow):
        limits = [f'<limit lower="-2" upper="2" effort="80" velocity="{speed}"/>' for speed in (shoulder, elbow)]
        file = tmp_path / "arm.urdf"
        file.write_text(
            arm(
                shoulder=joint("shoulder", "base", "upper", inside=limits[0]),
                elbow=joint("elbow", "upper", "fore", inside=limits[1]),
            )
        )
        return load_robot(file, armature=0.1)

    return load


def speed_value(relaxation: Relaxation) -> Any:
    """Speeds of a relaxation [rad/s], one per joint."""
    return relaxation.value


def relaxations(plant, **options):
    with pytest.raises(InfeasibleDesign) as caught:
        design_controller(plant, samples=100, progress=False, **options)
    return caught.value.relaxations


@pytest.mark.slow
def test_the_speed_of_the_file_is_the_first_remedy_and_admits_a_design(read):
    plant = read(95, 90)
    speed, other = relaxations(plant)
    assert (speed.requirement, other) == ("speed", ARMATURE)
    shoulder, elbow = speed_value(speed)
    assert 40 < elbow < 90
    assert shoulder / 95 == pytest.approx(elbow / 90, rel=0.01)
    assert f"% of the speed, at most {shoulder:g}, {elbow:g} rad/s (--speed {shoulder:g},{elbow:g})" in speed.text
    design = design_controller(plant, samples=100, progress=False, speed=speed_value(speed))
    assert design.certificates
    assert design.candidate.feasible


def relaxed(plant, monkeypatch, largest, **options):
    """Robots on which a loop is feasible up to a largest speed, with no loop assessed."""
    module = import_module("tarc.design.relaxations")
    speed_of = staticmethod(lambda plants, workspace, *args, **keywords: workspace.speed.max())
    monkeypatch.setattr(module.RobustnessSpec, "from_robot", speed_of)
    monkeypatch.setattr(module, "any_feasible", lambda trials, spec, *args: spec <= largest)
    problem = DesignProblem.from_plant(plant, DesignRequirements(samples=10, **options))
    return RelaxedRobots(problem, np.eye(2), enumerate_candidates(1e-3)[:1], 0.1)


@pytest.mark.parametrize("largest", [50.0, 0.5, 0.004])
def test_the_speed_is_a_remedy_however_low(largest, read, monkeypatch):
    speed = relaxed(read(90, 90), monkeypatch, largest).speed()
    assert speed is not None
    value = speed_value(speed)[0]
    assert 0.9 * largest < value <= largest
    assert f"% of the speed, at most {value:.4g} rad/s (--speed {value:.4g})" in speed.text


def test_a_speed_that_nobody_states_is_a_remedy(read, monkeypatch):
    with pytest.warns(RobotFileWarning):
        plant = read(3, 1000)
    robots = relaxed(plant, monkeypatch, 7.0)
    assert robots.problem.has_own_speed
    speed = robots.speed()
    assert speed is not None
    assert 6 < speed_value(speed)[0] <= 7
    assert speed.text.startswith("a speed of at most 6.")


def test_no_speed_is_no_remedy(read, monkeypatch):
    assert relaxed(read(90, 90), monkeypatch, 0.0).speed() is None


def test_a_speed_that_is_required_is_not_the_first_remedy(read, monkeypatch):
    robots = relaxed(read(90, 90), monkeypatch, 50.0, speed=90.0)
    assert not robots.problem.has_own_speed
    spec = RobustnessSpec.from_spread(2.0)
    changes = suggest_changes(robots.problem, robots.shape, spec, robots.candidates, 0.1)
    assert [change.requirement for change in changes] == ["speed", "armature"]
