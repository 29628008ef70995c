"""Way-points in space, against MuJoCo's forward kinematics."""

import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

import tarc
from tarc.core.errors import InvalidParameter, MissingTool
from tarc.plants import load_robot
from tarc.plants.rigid_body import RigidBody
from tarc.scenario.cartesian import CartesianWaypoints, rotation_vectors

UR5E = load_robot("ur5e")
TIMES = [0.5, 1.5, 3.0, 4.5]
DOWN = np.array([0.0, 1.0, 1.0, 0.0]) / np.sqrt(2)
POINTS = np.array([[-0.49, -0.13, 0.49], [-0.39, -0.03, 0.39], [-0.49, 0.07, 0.29], [-0.49, -0.13, 0.49]])


def turned(angle, axis=(0.0, 0.0, 1.0)):
    """Return the tool turned by an angle about an axis of its own."""
    turn, product = np.zeros(4), np.zeros(4)
    mujoco.mju_axisAngle2Quat(turn, np.array(axis), angle)
    mujoco.mju_mulQuat(product, DOWN, turn)
    return product


TURNS = np.array([DOWN, turned(0.5), turned(0.8, (1.0, 0.0, 0.0)), DOWN])


def forward(postures, frame="tool"):
    """Positions and rotation matrices of a site at postures (k, n), by MuJoCo."""
    assert isinstance(UR5E, RigidBody)
    model = UR5E.mujoco.model
    data = mujoco.MjData(model)
    positions, matrices = [], []
    for posture in postures:
        data.qpos[:] = posture
        mujoco.mj_kinematics(model, data)
        positions.append(data.site(frame).xpos.copy())
        matrices.append(data.site(frame).xmat.reshape(3, 3).copy())
    return np.array(positions), np.array(matrices)


def matrix(quaternion):
    result = np.zeros(9)
    mujoco.mju_quat2Mat(result, quaternion)
    return result.reshape(3, 3)


def angle_between(a, b):
    return np.arccos(np.clip((np.trace(a.T @ b) - 1) / 2, -1, 1))


def reference(**options):
    return CartesianWaypoints(**{"frame": "tool", "points": POINTS, "times": TIMES, "robot": UR5E} | options)


@pytest.mark.parametrize("stop", [False, True], ids=["passing", "stopping"])
@pytest.mark.parametrize("quaternions", [None, TURNS], ids=["position", "pose"])
def test_the_tool_passes_the_way_points_and_follows_the_path(stop, quaternions):
    cartesian = reference(stop_at_points=stop, quaternions=quaternions)
    positions, matrices = forward(cartesian.sample(TIMES)[0].T)
    assert np.linalg.norm(positions - POINTS, axis=1).max() < 1e-6
    times = np.linspace(0, 5, 501)
    wanted, orientations = cartesian.pose(times)
    path, turns = forward(cartesian.sample(times)[0].T)
    assert np.linalg.norm(path - wanted, axis=1).max() < 1e-4
    if quaternions is not None:
        assert orientations is not None
        assert max(map(angle_between, matrices, map(matrix, TURNS))) < 1e-6
        assert max(map(angle_between, turns, map(matrix, orientations))) < 1e-4


@pytest.mark.parametrize("stop", [False, True], ids=["passing", "stopping"])
def test_derivatives_are_those_of_the_position(stop):
    cartesian = reference(stop_at_points=stop, quaternions=TURNS)
    times = np.linspace(0.5123, 4.4877, 200)
    step = 1e-5
    before, present, after = (cartesian.sample(times + shift) for shift in (-step, 0, step))
    for order in (0, 1):
        assert np.allclose((after[order] - before[order]) / (2 * step), present[order + 1], rtol=0, atol=1e-5)
    speed = np.abs(cartesian.sample(TIMES)[1]).max(axis=0)
    assert speed[[0, -1]] == pytest.approx(0, abs=1e-12)
    assert np.all(speed[1:-1] < 1e-10 if stop else speed[1:-1] > 0.01)
    assert not cartesian.sample([0.0, 5.0])[1].any()


def test_stops_lie_on_straight_lines():
    cartesian = reference(stop_at_points=True)
    positions, _ = forward(cartesian.sample(np.linspace(TIMES[0], TIMES[1], 20))[0].T)
    along = (POINTS[1] - POINTS[0]) / np.linalg.norm(POINTS[1] - POINTS[0])
    offsets = positions - POINTS[0]
    assert np.linalg.norm(offsets - np.outer(offsets @ along, along), axis=1).max() < 1e-5


def test_joint_limits_are_kept():
    postures = reference(quaternions=TURNS).sample(np.linspace(0, 5, 200))[0]
    low, high = UR5E.position_limits.T[:, :, None]
    assert np.all((postures >= low) & (postures <= high))


def test_the_posture_chooses_among_solutions():
    below = np.array([0.0, -0.4, -1.6, -1.1, -1.57, 0.0])
    up, down = (reference(quaternions=[DOWN] * 4, posture=posture) for posture in (None, below))
    assert up.sample([0.5])[0][2, 0] > 0 > down.sample([0.5])[0][2, 0]
    assert np.allclose(forward(down.sample(TIMES)[0].T)[0], POINTS, rtol=0, atol=1e-6)


def test_way_points_out_of_reach_are_named_with_their_distance():
    points = POINTS.copy()
    points[1] = [2.0, 0.0, 0.163]
    points[3] = [0.0, 3.0, 0.2]
    expected = r"tool of ur5e.* cannot reach way-point 2 of 4 at 1.5 s, \(2, 0, 0.163\) m, by (1\.\d+) m; way-point 4"
    with pytest.raises(InvalidParameter, match=expected) as caught:
        reference(points=points)
    assert "orientation" not in str(caught.value)
    with pytest.raises(InvalidParameter, match=r"by .* m and \d+.*°.*leave the orientation free"):
        reference(points=points, quaternions=TURNS)


def test_a_path_through_the_column_is_refused():
    points = [[-0.49, -0.13, 0.3], [0.49, 0.13, 0.3]]
    with pytest.raises(InvalidParameter, match="points: .*(leaves the reach|cannot follow the path)"):
        reference(points=points, times=[0.0, 2.0], quaternions=[DOWN, DOWN])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"frame": "tol"}, "frame: got 'tol'; known are tool, .* Did you mean 'tool'"),
        ({"points": POINTS[:, :2]}, r"points: got shape \(4, 2\); needs \(k, 3\)"),
        ({"times": [0.0, 1.0]}, "with 2 times"),
        ({"times": [0.0, 2.0, 1.0, 3.0]}, "times: .* must increase"),
        ({"quaternions": TURNS[:3]}, r"quaternions: got shape \(3, 4\) for 4 points"),
        ({"quaternions": 0 * TURNS}, "not zero"),
        ({"posture": [0.0, 1.0]}, "posture: .* needs one number or 6"),
        ({"robot": tarc.plants.TwoLinkArm()}, "robot: got TwoLinkArm.* need a robot from a file"),
    ],
)
def test_input_at_fault_is_refused(options, message):
    with pytest.raises(InvalidParameter, match=message):
        reference(**options)


def test_another_robot_is_refused():
    with pytest.raises(InvalidParameter, match="solved for the joints shoulder_pan_joint, .* the run has a, b"):
        reference().for_run(["a", "b"], 1.0)


def test_rotations_are_unwound():
    from scipy.spatial.transform import Rotation

    angles = np.array([0.0, 1.5, 3.0, 4.5, 6.0])
    vectors = rotation_vectors(Rotation.from_rotvec(np.outer(angles, [0.0, 0.6, 0.8])))
    assert np.allclose(vectors, np.outer(angles, [0.0, 0.6, 0.8]))


def test_without_mink_the_extra_is_named(monkeypatch):
    monkeypatch.delitem(sys.modules, "mink")
    monkeypatch.setattr("tarc.core.optional.find_spec", lambda name: None)
    with pytest.raises(MissingTool, match=r"CartesianWaypoints needs .*mink; pip install .*\[ik\]'"):
        reference()


def test_the_example_s_tool_goes_around_the_rectangle():
    scenario = tarc.Scenario.load(Path(__file__).parents[2] / "examples" / "cartesian.yaml", ["duration=5.5"])
    (run,) = scenario.run(progress=False).values()
    assert run.status.completed
    times = np.array(scenario.reference["times"])
    reached, _ = forward(run.data["position"].sel(time=times + 0.2, method="nearest").values[-1:])
    assert np.linalg.norm(reached[0] - scenario.reference["points"][-1]) < 1e-3
    again = tarc.Scenario.parse(scenario.model_dump())
    assert "robot" not in again.reference
