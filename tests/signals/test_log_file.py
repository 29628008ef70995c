"""Logs of robots: text, folders, MATLAB and bags give what was written."""

from pathlib import Path

import numpy as np
import pytest

from tarc.core.errors import InvalidParameter
from tarc.signals import LogColumns, RobotLog, read_log

TIMES = 0.001 * np.arange(8)
POSITION = np.column_stack([np.sin(9 * TIMES), np.cos(9 * TIMES)])
TORQUE = 3.0 * POSITION + 1.0


def write_text(path: Path, header: str, columns: list[np.ndarray]) -> Path:
    rows = [",".join("" if np.isnan(x) else repr(float(x)) for x in row) for row in np.column_stack(columns)]
    path.write_text("\n".join([header, *rows]), encoding="utf-8")
    return path


def test_names_of_joints_and_numbers_are_known(tmp_path):
    file = write_text(tmp_path / "a.csv", "time,tau1,tau2,q1,q2", [TIMES, *TORQUE.T, *POSITION.T])
    log = read_log(file)
    assert np.array_equal(log.times, TIMES)
    assert np.array_equal(log.position, POSITION)
    assert log.torque is not None
    assert np.array_equal(log.torque, TORQUE)
    assert log.velocity is None
    header = "stamp,arm/position,arm/effort,hand/position,hand/effort"
    columns = [TIMES, POSITION[:, 0], TORQUE[:, 0], POSITION[:, 1], TORQUE[:, 1]]
    named = read_log(write_text(tmp_path / "b.csv", header, columns))
    assert named.joint_names == ("arm", "hand")
    assert named.torque is not None
    assert np.array_equal(named.torque, TORQUE)
    turned = read_log(tmp_path / "b.csv", {"joints": ["hand", "arm"]})
    assert np.array_equal(turned.position, POSITION[:, ::-1])


def test_units_in_brackets_or_columns_are_converted(tmp_path):
    file = write_text(tmp_path / "a.csv", "t [ms],q1 [deg],q2 [deg]", [1e3 * TIMES, *np.degrees(POSITION).T])
    log = read_log(file)
    assert log.times == pytest.approx(TIMES)
    assert log.position == pytest.approx(POSITION)
    other = write_text(tmp_path / "b.csv", "ms;a;b".replace(";", ","), [1e3 * TIMES, *np.degrees(POSITION).T])
    columns = LogColumns(time="ms", position=["a", "b"], units={"time": "ms", "position": "deg"})
    assert read_log(other, columns).position == pytest.approx(POSITION)


def test_an_empty_field_is_a_lost_sample_and_yaml_names_columns(tmp_path):
    gap = POSITION.copy()
    gap[3, 1] = np.nan
    file = write_text(tmp_path / "a.csv", "clock,x,y", [TIMES, *gap.T])
    names = tmp_path / "columns.yaml"
    names.write_text("time: clock\nposition: [x, y]\n", encoding="utf-8")
    log = read_log(file, names)
    assert np.isnan(log.position[3, 1])
    assert np.isfinite(log.position).sum() == gap.size - 1


def test_a_folder_has_one_file_per_quantity(tmp_path):
    np.savetxt(tmp_path / "t.txt", TIMES)
    np.savetxt(tmp_path / "q.txt", POSITION.ravel())
    log = read_log(tmp_path, {"time": "t.txt", "position": "q.txt"})
    assert log.position == pytest.approx(POSITION)


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_matlab_arrays_by_their_paths(tmp_path, version):
    file = tmp_path / "a.mat"
    if version == "5":
        from scipy.io import savemat

        savemat(file, {"rec": {"clock": TIMES, "angle": np.degrees(POSITION).T, "tau": TORQUE.T}})
    else:
        import h5py

        with h5py.File(file, "w", userblock_size=512) as content:  # MATLAB stores a column as a row of HDF5
            content["rec/clock"] = TIMES[None, :]
            content["rec/angle"] = np.degrees(POSITION)
            content["rec/tau"] = TORQUE
        text = b"MATLAB 7.3 MAT-file".ljust(124) + bytes([0, 2]) + b"IM"
        with file.open("r+b") as stream:
            stream.write(text)
    columns = {
        "time": "rec.clock",
        "position": "rec.angle",
        "torque": "rec.tau",
        "units": {"position": "deg"},
    }
    log = read_log(file, columns)
    assert log.position == pytest.approx(POSITION)
    assert log.torque == pytest.approx(TORQUE)


def test_a_bag_of_joint_states(tmp_path):
    pytest.importorskip("mcap_ros2")
    from mcap_ros2.writer import Writer

    parts = [
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort",
        "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id",
        "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec",
    ]
    definition = f"\n{'=' * 80}\n".join(parts)
    file = tmp_path / "a.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", definition)
        for k, (time, q, tau) in enumerate(zip(TIMES, POSITION, TORQUE, strict=True)):
            stamp = {"sec": 7, "nanosec": round(1e9 * time)}
            message = {
                "header": {"stamp": stamp, "frame_id": ""},
                "name": ["elbow", "wrist"] if k % 2 == 0 else ["wrist", "elbow"],
                "position": list(q if k % 2 == 0 else q[::-1]),
                "velocity": [],
                "effort": list(tau if k % 2 == 0 else tau[::-1]),
            }
            writer.write_message("/joint_states", schema, message, log_time=k, publish_time=k)
        writer.finish()
    log = read_log(file)
    assert log.joint_names == ("elbow", "wrist")
    assert log.times == pytest.approx(TIMES, abs=1e-9)
    assert np.array_equal(log.position, POSITION)
    assert log.torque is not None
    assert np.array_equal(log.torque, TORQUE)
    assert log.velocity is None
    with pytest.raises(InvalidParameter, match="/joint_states with joint states; needs the topic /other"):
        read_log(file, {"topic": "/other"})


def test_refusals_say_what_the_file_has(tmp_path):
    file = write_text(tmp_path / "a.csv", "clock,x,y", [TIMES, *POSITION.T])
    with pytest.raises(InvalidParameter, match=r"no position that is known by its name; it has clock, x, y"):
        read_log(file)
    with pytest.raises(InvalidParameter, match=r"no time that is known"):
        read_log(file, {"position": ["x"]})
    with pytest.raises(InvalidParameter, match=r"no column 'xx'"):
        read_log(file, {"time": "clock", "position": ["xx"]})
    with pytest.raises(InvalidParameter, match=r"columns: got 'postion'"):
        read_log(file, {"postion": ["x"]})
    with pytest.raises(InvalidParameter, match="no log"):
        read_log(tmp_path / "none.csv")
    with pytest.raises(InvalidParameter, match="is earlier than"):
        RobotLog(times=TIMES[::-1], position=POSITION)
    assert read_log(file, {"period": 0.002, "position": ["x"]}).times[-1] == pytest.approx(0.014)


def test_rows_between_times():
    log = RobotLog(times=5.0 + TIMES, position=POSITION, torque=TORQUE)
    part = log.between(0.001, 0.0065)
    assert part.times[0] == 5.001
    assert part.torque is not None
    assert len(part.torque) == 6
    with pytest.raises(InvalidParameter, match="at least 6 rows"):
        log.between(0.005, None)
