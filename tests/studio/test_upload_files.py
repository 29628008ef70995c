"""Names, archives and XML of uploads: what stays inside is kept, every attack is refused."""

import io
import stat
import zipfile
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

import pytest
from hypothesis import given
from hypothesis import strategies as st

import urdf_text
from tarc.core.errors import RobotFileError
from tarc.studio.upload_files import UploadLimits, relative_path, unpack
from tarc.studio.upload_xml import check_robot_files, inside, parse_plain

LIMITS = UploadLimits()
ARM = urdf_text.arm().encode()
MESH = '<visual><geometry><mesh filename="{}"/></geometry></visual></link>'
TRIANGLE = (
    b"solid t\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid"
)


def archive(files: Mapping[str, bytes], modes: Mapping[str, int] | None = None) -> bytes:
    """Return a zip archive, with the modes of files that are given."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as target:
        for name, content in files.items():
            entry = zipfile.ZipInfo(name)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = (modes or {}).get(name, 0o644) << 16
            target.writestr(entry, content)
    return out.getvalue()


def robots_in(tmp_path: Path, files: Mapping[str, bytes], limits: UploadLimits = LIMITS) -> list[str]:
    """Unpack and check an upload; return its robots."""
    paths = {}
    for number, (name, content) in enumerate(files.items()):
        paths[name] = tmp_path / f"in{number}"
        paths[name].write_bytes(content)
    folder = tmp_path / "out" / "session"
    folder.mkdir(parents=True)
    try:
        return [str(path) for path in check_robot_files(folder, unpack(paths, folder, limits))]
    finally:
        assert {path.name for path in tmp_path.iterdir()} == {"out", *(path.name for path in paths.values())}
        assert [path.name for path in (tmp_path / "out").iterdir()] == ["session"]


def refused(tmp_path: Path, files: Mapping[str, bytes], message: str, limits: UploadLimits = LIMITS) -> None:
    with pytest.raises(RobotFileError, match=message):
        robots_in(tmp_path, files, limits)


@given(st.text(alphabet="ab./\\:~ \n\0é", max_size=12))
def test_a_name_stays_inside_or_is_refused(name: str) -> None:
    try:
        path = relative_path(name)
    except RobotFileError:
        return
    root = Path("/session/folder")
    assert (root / path).resolve().is_relative_to(root)
    assert (root / path).resolve() != root


@given(st.text(alphabet="ab./\\:", max_size=12), st.sampled_from([".", "a", "a/b"]))
def test_a_path_in_a_file_stays_inside_or_is_refused(name: str, base: str) -> None:
    try:
        path = inside(PurePosixPath(base), name, PurePosixPath("robot.xml"))
    except RobotFileError:
        return
    root = Path("/session/folder")
    assert (root / path).resolve().is_relative_to(root)
    assert (root / base / name).resolve() == (root / path).resolve()


@pytest.mark.parametrize(
    "name", ["../a.urdf", "/tmp/a.urdf", "C:\\a.urdf", "x/../../a.urdf", "a\0.urdf", "d/" * 13 + "a"]
)
def test_names_outside_are_refused(tmp_path: Path, name: str) -> None:
    refused(tmp_path, {name: ARM}, "needs a plain relative path")


@pytest.mark.parametrize("name", ["../a.urdf", "/tmp/a.urdf", "x/../../a.urdf"])
def test_names_outside_are_refused_in_archives(tmp_path: Path, name: str) -> None:
    refused(tmp_path, {"a.zip": archive({name: ARM})}, "needs a plain relative path")


def test_symbolic_links_in_archives_are_refused(tmp_path: Path) -> None:
    content = archive({"a.urdf": b"/etc/passwd"}, {"a.urdf": stat.S_IFLNK | 0o777})
    refused(tmp_path, {"a.zip": content}, "symbolic link")


def test_archives_that_unpack_to_too_much_are_refused(tmp_path: Path) -> None:
    bomb = archive({f"{number}.stl": bytes(1 << 20) for number in range(5)})
    assert len(bomb) < 10_000
    refused(tmp_path, {"a.zip": bomb}, "more than 4 MB once", UploadLimits(unpacked_size=4 << 20))
    assert sum(path.stat().st_size for path in (tmp_path / "out" / "session").iterdir()) <= 4 << 20


def test_too_many_files_are_refused(tmp_path: Path) -> None:
    many = archive({f"{number}.stl": b"" for number in range(11)})
    refused(tmp_path, {"a.zip": many}, "more than 10 files", UploadLimits(n_files=10))


@pytest.mark.parametrize("content", [b"PK", b"", archive({"a.urdf": ARM})[:-40], archive({"a.urdf": ARM})[20:]])
def test_broken_archives_are_refused(tmp_path: Path, content: bytes) -> None:
    refused(tmp_path, {"a.zip": content}, "no zip archive that reads|cannot be unpacked")


def test_encrypted_archives_are_refused(tmp_path: Path) -> None:
    content = bytearray(archive({"a.urdf": ARM}))
    content[6] |= 1
    content[content.rindex(b"PK\1\2") + 8] |= 1
    refused(tmp_path, {"a.zip": bytes(content)}, "without encryption")


def test_two_files_of_one_name_are_refused(tmp_path: Path) -> None:
    refused(tmp_path, {"a.urdf": ARM, "b.zip": archive({"a.urdf": ARM})}, "two files are named 'a.urdf'")


def test_a_file_where_a_folder_is_needed_is_refused(tmp_path: Path) -> None:
    refused(tmp_path, {"b.zip": archive({"a.stl": b"", "a.stl/b.stl": b""})}, "cannot write")


def test_other_kinds_of_files_are_refused_or_left_out(tmp_path: Path) -> None:
    package = archive({"arm/numpy.py": b"raise SystemExit", "arm/package.xml": b"<package/>", "arm/a.urdf": ARM})
    assert robots_in(tmp_path, {"a.zip": package}) == ["arm/a.urdf"]
    assert not list((tmp_path / "out").rglob("*.py"))
    with pytest.raises(RobotFileError, match="got 'numpy.py'; needs a robot"):
        unpack({"numpy.py": tmp_path}, tmp_path, LIMITS)


BILLION = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 10))


@pytest.mark.parametrize(
    "document_type",
    [
        f'<!DOCTYPE robot [<!ENTITY l0 "lol">{BILLION}]>',
        '<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/passwd">]>',
        '<!DOCTYPE robot [<!ENTITY % x SYSTEM "http://127.0.0.1:1/x.dtd"> %x;]>',
        '<!DOCTYPE robot SYSTEM "http://127.0.0.1:1/x.dtd">',
        "<!DOCTYPE robot>",
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_entities_are_refused_before_parsing(document_type: str, encoding: str) -> None:
    text = f'<?xml version="1.0" encoding="{encoding}"?>{document_type}<robot name="&l9;&x;"/>'
    with pytest.raises(RobotFileError, match="document type|not in UTF-8|no XML"):
        parse_plain(text.encode(encoding), "a.urdf")


def test_what_is_read_is_what_was_checked(tmp_path: Path) -> None:
    """Bytes that another reader takes for an include are an attribute's text here; they are written as that."""
    hidden = '<mujoco model="&lt;include file=&quot;/etc/passwd&quot;/&gt;"><!-- <include file="/etc/x"/> --></mujoco>'
    encoded = f'<?xml version="1.0" encoding="cp037"?>{hidden}'
    assert robots_in(tmp_path, {"a.xml": encoded.encode()}) == ["a.xml"]
    written = (tmp_path / "out" / "session" / "a.xml").read_text(encoding="utf-8")
    assert "<include" not in written
    assert "cp037" not in written


def test_deep_nesting_is_refused() -> None:
    with pytest.raises(RobotFileError, match="nested more than 200"):
        parse_plain(b"<mujoco>" + b"<body>" * 100_000, "a.xml")


OUTSIDE = [
    "/etc/hosts.stl",
    "../../a.stl",
    "file:///etc/a.stl",
    "http://127.0.0.1:1/a.stl",
    "..\\..\\a.stl",
    "a/../../b.stl",
]


@pytest.mark.parametrize("name", [*OUTSIDE, "package://arm/../../../etc/a.stl", "package:///etc/a.stl"])
def test_meshes_of_a_urdf_outside_the_upload_are_refused(tmp_path: Path, name: str) -> None:
    arm = urdf_text.arm(upper=urdf_text.link("upper").replace("</link>", MESH.format(name)))
    refused(tmp_path, {"a.urdf": arm.encode()}, "outside the upload")


@pytest.mark.parametrize("name", OUTSIDE)
@pytest.mark.parametrize(
    "element",
    [
        '<include file="{}"/>',
        '<compiler meshdir="{}"/>',
        '<compiler texturedir="{}"/>',
        '<compiler assetdir="{}"/>',
        '<asset><mesh file="{}"/></asset>',
        '<asset><texture type="cube" fileright="{}"/></asset>',
        '<asset><hfield file="{}"/></asset>',
        '<asset><model file="{}"/></asset>',
    ],
)
def test_paths_of_an_mjcf_outside_the_upload_are_refused(tmp_path: Path, element: str, name: str) -> None:
    refused(tmp_path, {"a.xml": f"<mujoco>{element.format(name)}</mujoco>".encode()}, "outside the upload")


def test_folders_and_files_do_not_leave_together(tmp_path: Path) -> None:
    """Folder and file each stay inside from the place of their own file, and leave from that of the other."""
    files = {
        "a/b/main.xml": b'<mujoco><include file="part.xml"/><asset><mesh file="../../x.stl"/></asset></mujoco>',
        "a/b/part.xml": b'<mujoco><compiler meshdir="../"/></mujoco>',
    }
    refused(tmp_path, {"a.zip": archive(files)}, "outside the upload")


def test_includes_must_be_in_the_upload(tmp_path: Path) -> None:
    main = b'<mujoco><include file="part.xml"/></mujoco>'
    assert robots_in(tmp_path, {"main.xml": main, "part.xml": b"<mujoco/>"}) == ["main.xml"]
    other = tmp_path / "other"
    other.mkdir()
    refused(other, {"main.xml": main}, "includes 'part.xml', which is not in the upload")


def test_images_of_a_collada_mesh_stay_inside(tmp_path: Path) -> None:
    mesh = b"<COLLADA><library_images><image><init_from>/etc/x.png</init_from></image></library_images></COLLADA>"
    refused(tmp_path, {"a.urdf": ARM, "b.dae": mesh}, "outside the upload")


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("package://arm/meshes/link.stl", "../meshes/link.stl"),
        ("../meshes/link.stl", "../meshes/link.stl"),
        ("package://other/link.stl", "../meshes/link.stl"),
        ("package://usr/share/absent.stl", "absent.stl"),
    ],
)
def test_meshes_of_a_urdf_are_those_of_the_upload(tmp_path: Path, name: str, found: str) -> None:
    arm = urdf_text.arm(upper=urdf_text.link("upper").replace("</link>", MESH.format(name)))
    files = {"urdf/arm.urdf": arm.encode(), "meshes/link.stl": TRIANGLE, "other/link2.stl": TRIANGLE}
    assert robots_in(tmp_path, {"a.zip": archive(files)}) == ["urdf/arm.urdf"]
    written = (tmp_path / "out" / "session" / "urdf" / "arm.urdf").read_text(encoding="utf-8")
    assert f'filename="{found}"' in written
