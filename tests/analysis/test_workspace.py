"""Spread of the inertia ratio: against dense sweeps, random postures, and the known ratios of two robots."""

import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy as np
import pytest

from tarc import signals
from tarc.analysis.inertia_ratio import InertiaFunction, inertia_spread, inverse_ratios, maximise_over_workspace
from tarc.analysis.inertia_shape import best_inertia_shape
from tarc.analysis.workspace import Workspace
from tarc.core.errors import InvalidParameter
from tarc.plants import MassSpringDamper, MujocoPlant, NLinkArm, TwoLinkArm
from tarc.plants.base import Plant

ROBOTS = Path(sysconfig.get_path("purelib"), "cmeel.prefix", "share", "example-robot-data", "robots")
ARM = TwoLinkArm()
LOADED = TwoLinkArm(payload=2.0)
MIXED = np.array([[0.4, 0.1], [0.1, 0.2]])
SLIDE = """<mujoco><worldbody><body><joint type="slide" axis="1 0 0"/>
<geom size="0.1" mass="1"/></body></worldbody></mujoco>"""


def ratio_eigenvalues(plant, nominal, postures):
    """By another route: of M⁻¹M̂ itself, at the rows of postures."""
    M = np.array([plant.inertia(posture) for posture in postures])
    return np.sort(np.linalg.eigvals(np.linalg.solve(M, np.broadcast_to(nominal, M.shape))).real, axis=1)


def elbow_sweep(bottom, top, count=2001):
    angles = np.linspace(bottom, top, count)
    return np.column_stack([0 * angles, angles])


def ratios_at_posture(plant, nominal, where):
    return ratio_eigenvalues(plant, nominal, where[None])[0]


@pytest.mark.parametrize("nominal", [MIXED, np.diag([1.0, 0.3]), ARM.inertia([0.0, 1.0])])
@pytest.mark.parametrize("ends", [(-np.pi, np.pi), (0.3, 2.0)])
def test_two_link_arm_against_a_dense_sweep(nominal, ends):
    """M depends on the second joint alone."""
    found = inertia_spread(ARM, nominal, Workspace.box([-1, ends[0]], [1, ends[1]]))
    known = ratio_eigenvalues(ARM, nominal, elbow_sweep(*ends))
    assert found.min_ratio <= known[:, 0].min() * (1 + 1e-12)
    assert found.max_ratio >= known[:, -1].max() * (1 - 1e-12)
    assert found.min_ratio == pytest.approx(known[:, 0].min(), rel=1e-5)
    assert found.max_ratio == pytest.approx(known[:, -1].max(), rel=1e-5)
    assert ratios_at_posture(ARM, nominal, found.min_posture)[0] == pytest.approx(found.min_ratio, rel=1e-12)
    assert ratios_at_posture(ARM, nominal, found.max_posture)[-1] == pytest.approx(found.max_ratio, rel=1e-12)
    assert found.ratio == found.max_ratio / found.min_ratio
    assert found.min_ratio <= found.sampled_min <= found.sampled_max <= found.max_ratio


@pytest.mark.parametrize("tube", [0.0, 0.2])
def test_along_a_path(tube):
    reference = signals.Sinusoid(amplitude=[0.5, 0.7], frequency=[2.0, 3.0], offset=[0.0, 1.0])
    found = inertia_spread(ARM, MIXED, Workspace.from_reference(reference, 1.0, tube=tube))
    passed = reference.sample(np.linspace(0, 1.0, 2001))[0][1]
    known = ratio_eigenvalues(ARM, MIXED, elbow_sweep(passed.min() - tube, passed.max() + tube))
    assert found.min_ratio == pytest.approx(known[:, 0].min(), rel=1e-5)
    assert found.max_ratio == pytest.approx(known[:, -1].max(), rel=1e-5)


def test_payload_lowers_the_ratio_and_its_ends_stand_for_all_between():
    postures = Workspace.from_joint_limits(ARM)
    both = inertia_spread([ARM, LOADED], MIXED, postures)
    assert (both.min_plant, both.max_plant) == (1, 0)
    for payload in (0.3, 1.1):
        between = inertia_spread(TwoLinkArm(payload=payload), MIXED, postures)
        assert both.min_ratio < between.min_ratio < between.max_ratio < both.max_ratio


@pytest.mark.parametrize("name", ["ur5e", "panda"])
def test_search_finds_more_than_many_random_postures(name):
    robot = MujocoPlant.from_file(name, armature=0.1)
    postures = Workspace.from_joint_limits(robot)
    drawn = np.random.default_rng(0).uniform(postures.low, postures.high, (20_000, robot.n_joints))
    M = np.array([robot.inertia(posture) for posture in drawn])
    nominal = M.mean(axis=0)
    inverse = inverse_ratios(M, nominal)
    ends = []
    for seed in range(3):
        found = inertia_spread(robot, nominal, postures, seed=seed)
        assert found.min_ratio < 1 / inverse.max()
        assert found.max_ratio > 1 / inverse.min()
        assert np.all((postures.low <= found.min_posture) & (found.max_posture <= postures.high))
        ends.append((found.min_ratio, found.max_ratio))
    np.testing.assert_allclose(ends, np.tile(ends[0], (3, 1)), rtol=1e-4)  # the search finds the same ends each time


def test_ranges_of_the_joints():
    panda = MujocoPlant.from_file("panda")
    np.testing.assert_array_equal(
        np.column_stack([Workspace.from_joint_limits(panda).low, Workspace.from_joint_limits(panda).high])[3],
        [-3.0718, -0.0698],
    )
    np.testing.assert_array_equal(Workspace.from_joint_limits(NLinkArm()).high, np.full(3, np.pi))


def test_a_fixed_joint_and_a_single_posture():
    known = ratios_at_posture(ARM, MIXED, np.array([0.2, 0.9]))
    found = inertia_spread(ARM, MIXED, Workspace.box([0.2, 0.9], [0.2, 0.9]))
    assert (found.min_ratio, found.max_ratio) == pytest.approx(tuple(known), rel=1e-12)
    half = inertia_spread(ARM, MIXED, Workspace.box([0.2, 0.9], [1.2, 0.9]))
    assert (half.min_ratio, half.max_ratio) == pytest.approx(tuple(known), rel=1e-12)


def test_any_function_of_the_inertia_matrix():
    first = InertiaFunction(lambda M: -M[:, 0, 0], lambda M: np.diag([-1.0, 0.0]))
    (found,) = maximise_over_workspace([first], ARM, Workspace.from_joint_limits(ARM))
    assert -found.value == pytest.approx(1.0, rel=1e-9)  # arm folded back, both masses of 1 kg: only the first counts
    assert abs(found.posture[1]) == pytest.approx(np.pi, abs=1e-3)


class Broken(Plant):
    """An arm whose M(q) is singular, or not a number, where its second joint passes 1 rad."""

    def __init__(self, bad):
        self.bad = bad

    n_joints = property(lambda self: 2)  # type: ignore[assignment] - abstract there
    joint_names = property(lambda self: ["a", "b"])  # type: ignore[assignment] - abstract there
    parameters = property(lambda self: {})  # type: ignore[assignment] - abstract there

    def inertia(self, position):
        return np.diag([1.0, self.bad if np.asarray(position)[1] > 1 else 1.0])

    def bias(self, position, velocity):
        return np.zeros(2)

    def gravity_torque(self, position):
        return np.zeros(2)

    def with_parameters(self, values):
        return self


def test_a_link_without_mass_is_named_with_its_posture():
    box = Workspace.box([-2, -2], [2, 2])
    with pytest.raises(
        InvalidParameter, match=r"M\(q\) is singular \(smallest eigenvalue 0\) at q = \[.*\]; .*armature=0\.1"
    ):
        inertia_spread(Broken(0.0), MIXED, box)
    with pytest.raises(InvalidParameter, match=r"M\(q\) is not finite at q = \["):
        inertia_spread(Broken(np.nan), MIXED, box)


def sliding_body(tmp_path):
    (tmp_path / "slide.xml").write_text(SLIDE)
    return MujocoPlant.from_file(tmp_path / "slide.xml")


def test_slides_need_a_range(tmp_path):
    for plant in (sliding_body(tmp_path), MassSpringDamper()):
        with pytest.raises(InvalidParameter, match=r"joint .* slides \[m\] and has no range; .* Workspace\.box"):
            Workspace.from_joint_limits(plant)


BOX = Workspace.box([-1, -1], [1, 1])


@pytest.mark.parametrize(
    ("call", "message", "error"),
    [
        (
            lambda: Workspace.box([0, 1], [1, 0]),
            "low, high: number 2 goes from 1 to 0; needs low ≤ high",
            InvalidParameter,
        ),
        (lambda: Workspace.box([0, 1], [1]), r"low, high: got shapes \(2,\) and \(1,\)", InvalidParameter),
        (lambda: Workspace.box([0, -np.inf], [1, 1]), "low: got -inf", InvalidParameter),
        (
            lambda: Workspace.from_reference(signals.Sinusoid(amplitude=1.0, frequency=1.0), -1.0),
            "duration: got -1",
            InvalidParameter,
        ),
        (
            lambda: Workspace.from_reference(signals.Sinusoid(amplitude=1.0, frequency=1.0), 1.0, tube=-0.1),
            r"tube: got \[-0.1\]",
            InvalidParameter,
        ),
        (lambda: Workspace.from_reference("circle", 1.0), "reference: got str", InvalidParameter),  # type: ignore[arg-type]
        (
            lambda: inertia_spread(ARM, MIXED, Workspace.box([0], [1])),
            "it has 1 joints and the robot 2",
            InvalidParameter,
        ),
        (lambda: inertia_spread(ARM, MIXED, [0, 1]), "workspace: got list", InvalidParameter),  # type: ignore[arg-type]
        (lambda: inertia_spread([ARM, NLinkArm()], MIXED, BOX), r"robots of \[2, 3\] joints", InvalidParameter),
        (lambda: inertia_spread([], MIXED, BOX), "plant: got none", InvalidParameter),
        (lambda: inertia_spread("ur5e", MIXED, BOX), "plant: got str", InvalidParameter),  # type: ignore[arg-type]
        (lambda: inertia_spread(3, MIXED, BOX), "plant: got int", InvalidParameter),  # type: ignore[arg-type]
        (lambda: inertia_spread(ARM, np.eye(3), BOX), r"inertia: got shape \(3, 3\)", InvalidParameter),
        (lambda: inertia_spread(ARM, [[1, np.nan], [np.nan, 1]], BOX), "inertia: got nan", InvalidParameter),
        (lambda: inertia_spread(ARM, [[1, 2], [2, 1]], BOX), "inertia: its smallest eigenvalue", InvalidParameter),
        (lambda: inertia_spread(ARM, MIXED, BOX, samples=0), "samples: got 0", InvalidParameter),
        (lambda: inertia_spread(ARM, MIXED, BOX, refine=-1), "refine: got -1", InvalidParameter),
        (lambda: inertia_spread(ARM, MIXED, BOX, seed=-1), "seed: got -1", InvalidParameter),
        (lambda: best_inertia_shape(ARM, BOX, tolerance=0.0), "tolerance: got 0", InvalidParameter),
    ],
)
def test_bad_input(call, message, error):
    with pytest.raises(error, match=message):
        call()


def test_joint_limits_need_no_mujoco():
    code = """
import sys
import numpy as np
from tarc.analysis import Workspace
from tarc.plants import Pendulum

class LimitedPendulum(Pendulum):
    position_limits = np.array([[-1.0, 2.0]])

workspace = Workspace.from_joint_limits(LimitedPendulum())
assert (workspace.low, workspace.high) == (-1.0, 2.0)
assert "mujoco" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_workspace_about_a_record_follows_the_joints_by_name(tmp_path: Path) -> None:
    times = np.linspace(0, 1, 11)
    rows = {"joint1": 0.3 * times, "joint2": 1.5 * np.cos(times)}
    files = {}
    for order in (["joint1", "joint2"], ["joint2", "joint1"]):
        table = np.column_stack([times, *(rows[name] for name in order)])
        files[order[0]] = tmp_path / f"{order[0]}.csv"
        np.savetxt(files[order[0]], table, delimiter=",", header=",".join(["time", *order]), comments="")
    spreads = [
        inertia_spread(ARM, MIXED, Workspace.from_reference(signals.RecordedReference(path=file), 1.0), samples=50)
        for file in files.values()
    ]
    assert spreads[0].min_ratio == spreads[1].min_ratio
    assert np.array_equal(spreads[0].min_posture, spreads[1].min_posture)
    with pytest.raises(InvalidParameter, match="has the columns joint2, joint1; the robot's joints are a, b"):
        Workspace.from_reference(signals.RecordedReference(path=files["joint2"]), 1.0).for_joints(["a", "b"])
