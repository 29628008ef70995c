"""Uploads read in a process of their own: robots that are kept, and attacks on time, memory and the reader."""

import time
from pathlib import Path

import pytest

import urdf_text
from tarc.core.errors import RobotFileError
from tarc.plants import find_robot, load_robot
from tarc.studio import upload
from tarc.studio.upload import read_upload
from tarc.studio.upload_files import UploadLimits
from tarc.studio.upload_worker import read_robot

ARM = urdf_text.arm().encode()
JOINT = "<body><joint/><geom size='1'/></body>"


def mjcf(inside: str, before: str = "") -> dict[str, bytes]:
    """Return an upload of one file."""
    return {"a.xml": f"<mujoco>{before}<worldbody>{JOINT}{inside}</worldbody></mujoco>".encode()}


def test_uploads_that_are_too_large_start_no_process(tmp_path: Path) -> None:
    for files in ({}, {"a.urdf": bytes(101)}, {f"{number}.stl": b"" for number in range(11)}):
        with pytest.raises(RobotFileError, match=r"at most 0 MB"):
            read_upload(files, tmp_path, limits=UploadLimits(size=100, n_files=10))
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_robots_are_kept_in_the_folder_of_the_session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(upload, "MAX_KEPT", 1)
    for armature in (0.1, 0.2):
        robot = read_upload({"ur5e.xml": find_robot("ur5e").read_bytes()}, tmp_path, options={"armature": armature})
        assert robot.file.is_relative_to(tmp_path)
        assert list(robot.joint_names) == load_robot(robot.file).joint_names
        assert list(tmp_path.iterdir()) == [robot.file.parent]


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({"arm.urdf": ARM[:300]}, "arm.urdf is no XML file .unclosed token: line 1"),
        ({"arm.urdf": b"<robot name='a'/>"}, "arm.urdf"),
        ({"arm.stl": b""}, "has no robot; needs a file with root"),
        ({"a.urdf": ARM, "b.urdf": ARM}, "has the robots a.urdf, b.urdf; upload one"),
        (mjcf("", '<asset><mesh name="m" vertex="0 0 0 nan 0 0 0 1 0 0 0 1"/></asset>'), "a.xml"),
    ],
)
def test_what_cannot_be_read_is_named(tmp_path: Path, files: dict[str, bytes], message: str) -> None:
    paths = {}
    for name, content in files.items():
        paths[name] = str(tmp_path / f"in-{name}")
        Path(paths[name]).write_bytes(content)
    folder = tmp_path / "out"
    folder.mkdir()
    request = {"files": paths, "folder": str(folder), "file": None, "options": {}}
    with pytest.raises(RobotFileError, match=message):
        read_robot(request, UploadLimits())


@pytest.mark.slow
def test_an_error_names_no_folder_of_the_server_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(RobotFileError, match="there is no such link") as caught:
        read_upload({"arm.urdf": ARM.replace(b'"upper"', b'"uper"', 1)}, tmp_path)
    assert str(tmp_path) not in str(caught.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_reader_ends_when_its_time_is_over(tmp_path: Path) -> None:
    endless = mjcf(f'<replicate count="100000000" offset="1 0 0">{JOINT}</replicate>')
    started = time.monotonic()
    with pytest.raises(RobotFileError, match="takes more than 5 s"):
        read_upload(endless, tmp_path, limits=UploadLimits(time=5.0))
    assert time.monotonic() - started < 15
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_reader_ends_when_its_memory_is_used_up(tmp_path: Path) -> None:
    large = mjcf("", '<size memory="100G"/>')
    with pytest.raises(RobotFileError, match="Could not allocate memory"):
        read_upload(large, tmp_path)
    assert not list(tmp_path.iterdir())
