"""What the browser gets of a robot and its run: poses of the bodies, the ghost of the reference, the payload."""

import base64

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tarc
from tarc.studio import scene

ARM = tarc.plants.TwoLinkArm()
ESTIMATOR = tarc.estimators.Algebraic(window=0.010, degree=2)
LAW = tarc.laws.TDC(inertia=[0.1, 0.05], natural_frequency=10.0, period=1e-3, estimator=ESTIMATOR)
REFERENCE = tarc.signals.Sinusoid(amplitude=[0.2, 0.1], frequency=[3.0, 4.0], offset=[0.3, 1.0])


def numbers(text: str, *shape: int) -> np.ndarray:
    """Decode as the browser does."""
    return np.frombuffer(base64.b64decode(text), np.float32).reshape(*shape)


def test_poses_of_a_planar_arm() -> None:
    """Forward kinematics by hand, of the run and of its reference."""
    run = tarc.simulate(ARM, LAW, REFERENCE, 0.5)
    geometry = scene.run_geometry(run)
    message = scene.run_message(geometry, run)
    frames = len(numbers(message["mass"], -1))
    assert message["step"] * (frames - 1) == pytest.approx(run.data["time"].values[-1])
    for prefix, name in (("", "position"), ("ghost_", "reference")):
        positions = numbers(message[f"{prefix}positions"], frames, 3, 3)
        quaternions = numbers(message[f"{prefix}quaternions"], frames, 3, 4)
        for frame, instant in ((0, 0.0), (frames - 1, message["step"] * (frames - 1))):
            recorded = run.data[name].interp(time=instant).values
            first, second = recorded[0], recorded[0] + recorded[1]
            l1, l2 = np.broadcast_to(ARM.lengths, 2)
            elbow = l1 * np.array([np.cos(first), 0.0, np.sin(first)])
            tip = elbow + l2 * np.array([np.cos(second), 0.0, np.sin(second)])
            assert np.allclose(positions[frame], [np.zeros(3), elbow, tip], atol=1e-6)
            turned = Rotation.from_quat(quaternions[frame, 1]).apply([l2, 0.0, 0.0])
            assert np.allclose(elbow + turned, tip, atol=1e-6)


def test_robots_with_large_meshes_are_drawn_by_boxes(monkeypatch: pytest.MonkeyPatch) -> None:
    run = tarc.simulate(ARM, LAW, REFERENCE, 0.1)
    geometry = scene.run_geometry(run)
    full = scene.robot_message(geometry, run)
    monkeypatch.setattr(scene, "MAX_VERTICES", 10)
    small = scene.robot_message(geometry, run)
    assert len(full["shapes"][0]["vertices"]) > 1000
    for shape, drawn in zip(geometry.shapes, small["shapes"], strict=True):
        corners = numbers(drawn["vertices"], 8, 3)
        assert np.allclose(corners.min(axis=0), shape.vertices.min(axis=0))
        assert np.allclose(corners.max(axis=0), shape.vertices.max(axis=0))


def test_a_box_is_closed() -> None:
    """Every edge belongs to two triangles, in opposite directions."""
    _, triangles = scene.box_around(np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]]))
    edges = {(int(row[i]), int(row[(i + 1) % 3])) for row in triangles for i in range(3)}
    assert len(edges) == 36
    assert all((second, first) in edges for first, second in edges)


def test_long_runs_have_a_limited_number_of_postures() -> None:
    run = tarc.simulate(ARM, LAW, REFERENCE, 0.1)
    geometry = scene.run_geometry(run)
    size = sum(map(len, map(str, scene.run_message(geometry, run).values())))
    assert size < 10_000
