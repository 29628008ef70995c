"""Trajectories of ROS messages: knots, closed forms, names, and files as ROS prints them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tarc
from tarc.core.errors import InvalidParameter
from tarc.signals import JointTrajectory

ECHO = """\
header:
  stamp:
    sec: 1732845600
    nanosec: 120000000
  frame_id: ''
joint_names:
- elbow
- shoulder
points:
- positions:
  - 0.0
  - 1.0
  velocities:
  - 0.0
  - 0.1
  accelerations:
  - 0.2
  - 0.0
  effort: []
  time_from_start:
    sec: 1
    nanosec: 500000000
- positions:
  - 0.5
  - 0.8
  velocities:
  - -1e-05
  - -0.3
  accelerations:
  - 0.0
  - 0.4
  effort: []
  time_from_start:
    sec: 3
    nanosec: 0
---
"""
"""As `ros2 topic echo --once --full-length` prints it."""

KEYS = ("positions", "velocities", "accelerations")
KNOTS = [0.0, 0.7, 1.0, 2.5]


def message(states: dict[str, Any], times: list[float], names: list[str]) -> str:
    """Return a message as JSON, which is YAML."""
    points = []
    for number, time in enumerate(times):
        point = {key: np.asarray(values[number]).tolist() for key, values in states.items()}
        points.append({**point, "time_from_start": {"sec": int(time), "nanosec": round((time - int(time)) * 1e9)}})
    return json.dumps({"joint_names": names, "points": points})


def trajectory(folder: Path, states: dict[str, Any], times: list[float] = KNOTS, **options: Any) -> JointTrajectory:
    path = folder / "move.yaml"
    path.write_text(message(states, times, ["a", "b"]))
    return JointTrajectory(path=path, **options)


def random_states(seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {key: rng.standard_normal((len(KNOTS), 2)) for key in KEYS}


def test_a_file_as_ros_prints_it(tmp_path):
    path = tmp_path / "move.yaml"
    path.write_text(ECHO)
    reference = JointTrajectory(path=path).for_run(["shoulder", "elbow"], 2.0)
    assert reference.n_joints == 2
    position, velocity, acceleration = reference.sample([0.0, 1.5])
    assert np.allclose(position, [[1.0, 0.8], [0.0, 0.5]], rtol=0, atol=1e-14)
    assert np.allclose(velocity, [[0.1, -0.3], [0.0, -1e-5]], rtol=0, atol=1e-14)
    assert np.allclose(acceleration, [[0.0, 0.4], [0.2, 0.0]], rtol=0, atol=1e-13)
    delayed = JointTrajectory(path=path, starts_at_zero=False)
    assert np.array_equal(delayed.sample([1.0, 1.5])[0], [[0.0, 0.0], [1.0, 1.0]])
    assert not delayed.sample([1.0])[1].any()


@pytest.mark.parametrize("key", ["joint_trajectory", "trajectory"])
def test_a_message_inside_another_one(key, tmp_path):
    states = random_states()
    path = tmp_path / "plan.json"
    path.write_text(json.dumps({"goal_time_tolerance": {}, key: json.loads(message(states, KNOTS, ["a", "b"]))}))
    assert np.allclose(JointTrajectory(path=path).sample(KNOTS)[1].T, states["velocities"], rtol=0, atol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_given_states_are_met_exactly_at_the_knots_from_both_sides(count, tmp_path):
    states = {key: values for key, values in random_states().items() if key in KEYS[:count]}
    reference = trajectory(tmp_path, states)
    for key, found in zip(list(states), reference.sample(KNOTS), strict=False):
        assert np.allclose(found.T, states[key], rtol=0, atol=1e-12), key
    before = reference.sample(np.array(KNOTS[1:]) - 1e-9)
    for key, found in zip(list(states), before, strict=False):
        assert np.allclose(found.T, states[key][1:], rtol=0, atol=1e-5), key


@pytest.mark.parametrize(("count", "degree"), [(1, 1), (2, 3), (3, 5)])
def test_pieces_reproduce_polynomials_of_their_degree(count, degree, tmp_path):
    curve = np.polynomial.Polynomial(np.random.default_rng(1).standard_normal(degree + 1))
    derivatives = [curve, curve.deriv(1), curve.deriv(2)]
    knots = np.array(KNOTS)
    states = {key: np.column_stack([f(knots)] * 2) for key, f in zip(KEYS[:count], derivatives, strict=False)}
    times = np.linspace(0, KNOTS[-1], 50)
    for found, expected in zip(trajectory(tmp_path, states).sample(times), derivatives, strict=True):
        assert np.allclose(found[0], expected(times), rtol=0, atol=1e-11)


def test_quintic_from_rest_to_rest_is_the_minimum_jerk_curve(tmp_path):
    rest = np.zeros((2, 2))
    states = {"positions": [[1.0, 0.0], [3.0, 0.0]], "velocities": rest, "accelerations": rest}
    s = np.linspace(0, 1, 11)
    position, velocity, acceleration = trajectory(tmp_path, states, [0.0, 2.0]).sample(2 * s)
    assert np.allclose(position[0], 1 + 2 * (10 * s**3 - 15 * s**4 + 6 * s**5), rtol=0, atol=1e-13)
    assert np.allclose(velocity[0], 30 * s**2 * (1 - s) ** 2, rtol=0, atol=1e-13)
    assert np.allclose(acceleration[0], 30 * s * (1 - s) * (1 - 2 * s), rtol=0, atol=1e-12)


def test_a_piece_has_the_degree_that_both_its_ends_allow(tmp_path):
    points = [
        {"positions": [0.0], "velocities": [1.0], "time_from_start": 0.0},
        {"positions": [1.0], "velocities": [0.0], "time_from_start": 1.0},
        {"positions": [3.0], "velocities": [], "time_from_start": 2.0},
    ]
    path = tmp_path / "move.yml"
    path.write_text(json.dumps({"joint_names": ["a"], "points": points}))
    _, velocity, acceleration = JointTrajectory(path=path).sample([0.0, 0.5, 1.5])
    assert np.allclose(velocity[0], [1.0, 1.25, 2.0])
    assert acceleration[0, 2] == 0


def test_it_holds_its_ends(tmp_path):
    position, velocity, acceleration = trajectory(tmp_path, random_states()).sample([-1.0, 9.0])
    assert np.allclose(position.T, random_states()["positions"][[0, -1]], rtol=0, atol=1e-12)
    assert not velocity.any()
    assert not acceleration.any()


def test_csv_is_the_same_as_yaml(tmp_path):
    states = random_states()
    header = ["time [s]", "b", "a [rad]", "a/velocity [rad/s]", "b.velocity", "b/acceleration [rad/s^2]"]
    header += ["a/acceleration"]
    (p, v, a) = (states[key].T for key in KEYS)
    table = np.column_stack([1.7e9 + np.array(KNOTS), p[1], p[0], v[0], v[1], a[1], a[0]])
    np.savetxt(tmp_path / "move.csv", table, fmt="%.17g", delimiter=",", header=",".join(header), comments="")
    times = np.linspace(0, 2.5, 33)
    from_csv = JointTrajectory(path=tmp_path / "move.csv").for_run(["a", "b"], 2.5).sample(times)
    for found, expected in zip(from_csv, trajectory(tmp_path, states).sample(times), strict=True):
        assert np.allclose(found, expected, rtol=0, atol=1e-4)  # stamps have steps of 0.24 µs


@pytest.mark.parametrize(
    ("joints", "names", "message"),
    [
        (["a", "c"], None, r"reference: .* the joints a, b, where a, c are needed; missing: c; unknown: b\."),
        (["a"], None, "unknown: b"),
        (["a", "b", "c"], None, "missing: c"),
        (["x", "y"], ["a", "a"], "joint_names: .* unknown: b; twice: a"),
    ],
)
def test_joints_that_do_not_fit_are_named(joints, names, message, tmp_path):
    with pytest.raises(InvalidParameter, match=message):
        trajectory(tmp_path, random_states(), joint_names=names).for_run(joints, 1.0)


def test_given_names_are_the_order_of_the_robot(tmp_path):
    reference = trajectory(tmp_path, random_states(), joint_names=["b", "a"]).for_run(["x", "y"], 1.0)
    assert np.allclose(reference.sample([0.0])[0][:, 0], random_states()["positions"][0, ::-1])


def test_a_trajectory_outside_the_run_is_refused(tmp_path):
    path = tmp_path / "move.yaml"
    path.write_text(ECHO)
    with pytest.raises(InvalidParameter, match="from 1.5 s to 3 s, the run from 0 to 1 s; they do not overlap"):
        JointTrajectory(path=path, starts_at_zero=False).for_run(["elbow", "shoulder"], 1.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (ECHO + ECHO, "has 2 messages; needs one"),
        ("[1, 2", "no valid YAML"),
        ("joint_names: [a]\npoints: []", "has 0 points"),
        ("points: []", "lacks joint_names"),
        ("joint_names: [a, a]\npoints: []", "names a twice"),
        (ECHO.replace("- shoulder", "- '...'"), "joint_names ends in '...': ros2 has cut it; print it with --full"),
        (ECHO.replace("  - 1.0\n", ""), r"points\[0\].positions: got 1 numbers for 2 joints"),
        (ECHO.replace("sec: 3", "sec: 1").replace("nanosec: 0", "nanosec: 5"), "at 1.5 … 1 s; needs two or more"),
        (ECHO.replace("  - 0.8\n", "  - .nan\n"), r"points\[1\].positions: .* not NaN"),
        (ECHO.replace("- 0.8", "- high"), r"points\[1\].positions: .* needs numbers"),
        (ECHO.replace("  velocities:\n  - 0.0\n  - 0.1\n", ""), "accelerations but no velocities"),
    ],
)
def test_a_message_at_fault_is_refused(text, message, tmp_path):
    path = tmp_path / "move.yaml"
    path.write_text(text)
    with pytest.raises(InvalidParameter, match=message):
        JointTrajectory(path=path)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("time,a,a/velocity,b", "position of a, b, and the velocity of a; needs the velocity of all or of none"),
        ("time,a,b,a", "position of a twice"),
        ("time,a,b,c/velocity", "the velocity of c"),
        (None, "has no header"),
    ],
)
def test_columns_at_fault_are_refused(header, message, tmp_path):
    path = tmp_path / "move.csv"
    rows = "0,1,2,3\n1,1,2,3\n"
    path.write_text(rows if header is None else f"{header}\n{rows}")
    with pytest.raises(InvalidParameter, match=message):
        JointTrajectory(path=path)


def test_a_scenario_runs_it_from_its_own_folder(tmp_path):
    (tmp_path / "move.yaml").write_text(ECHO.replace("elbow", "joint2").replace("shoulder", "joint1"))
    (tmp_path / "run.yaml").write_text("""
robot: {kind: TwoLinkArm}
law: {kind: TDC, inertia: {fraction: 0.1}, natural_frequency: 10.0}
estimator: {kind: Algebraic, window: 0.010}
reference: {kind: JointTrajectory, path: move.yaml}
duration: 0.05
""")
    (run,) = tarc.Scenario.load(tmp_path / "run.yaml").run(progress=False).values()
    assert np.allclose(run.data["reference"].values[0], [1.0, 0.0])
