"""XML of an upload: no entities, no path outside the upload; written again as it was checked."""

import posixpath
import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from tarc.core.errors import RobotFileError
from tarc.studio.upload_files import MESH_SUFFIXES

MAX_NESTING = 200
"""Largest depth of elements; links of a chain are nested in MJCF."""
FOLDER_ATTRIBUTES = ("assetdir", "meshdir", "texturedir")
_FILE_ATTRIBUTE = re.compile(r"file\w*")


class _PlainTree(ET.TreeBuilder):
    """Builder of a tree that refuses document types, and with them every entity, before the first element."""

    def __init__(self, name: str):
        super().__init__()
        self._name = name
        self._depth = 0

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        """Refuse a document type."""
        raise RobotFileError(
            f"robot file: {self._name} has a document type (<!DOCTYPE>), which may define entities; remove it"
        )

    def start(self, tag: Any, attrs: dict[Any, Any], /) -> ET.Element:
        """Open an element."""
        self._depth += 1
        if self._depth > MAX_NESTING:
            raise RobotFileError(
                f"robot file: the elements of {self._name} are nested more than {MAX_NESTING} deep; simplify it"
            )
        return super().start(tag, attrs)

    def end(self, tag: str, /) -> ET.Element:
        """Close an element."""
        self._depth -= 1
        return super().end(tag)


def parse_plain(content: bytes, name: str) -> ET.Element:
    """Return the root of an XML file in UTF-8 without a document type.

    Raises
    ------
    RobotFileError
        For another encoding, a document type, elements that are nested too deep, and what is no XML.
    """
    parser = ET.XMLParser(target=_PlainTree(name), encoding="utf-8")
    try:
        content.decode("utf-8")
        parser.feed(content)
        return parser.close()
    except UnicodeDecodeError:
        raise RobotFileError(f"robot file: {name} is not in UTF-8; save it in that encoding") from None
    except ET.ParseError as error:
        raise RobotFileError(f"robot file: {name} is no XML file ({error}); needs MJCF or URDF") from None


def check_robot_files(folder: Path, files: Sequence[PurePosixPath]) -> list[PurePosixPath]:
    """Check all XML of an upload, write it again, and return the robots: MJCF and URDF that no other file includes.

    What is read later is the tree that was checked, whatever its bytes were.

    Raises
    ------
    RobotFileError
        For XML with a document type, and a path outside the upload: absolute, with a scheme, or through ``..``. Also
        for an included file that is not in the upload.
    """
    trees = {
        path: parse_plain((folder / path).read_bytes(), str(path))
        for path in files
        if path.suffix.lower() in (".urdf", ".xml", ".mjcf", ".dae")
    }
    models = {path: root for path, root in trees.items() if root.tag in ("mujoco", "mujocoinclude")}
    included = _check_models(models, files)
    for path, root in trees.items():
        if root.tag == "robot":
            _check_urdf(path, root, files)
        elif path not in models:
            _check_collada(path, root)
        (folder / path).write_bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))
    return [path for path, root in trees.items() if root.tag in ("robot", "mujoco") and path not in included]


def inside(base: PurePosixPath, name: str, file: PurePosixPath) -> PurePosixPath:
    """Return a path of a file in the upload, from the upload's folder.

    Parameters
    ----------
    base
        Folder that it is relative to, in the upload.
    name
        The path, as the file has it.
    file
        The file, for the message.

    Raises
    ------
    RobotFileError
        For a path outside the upload.
    """
    parts = posixpath.normpath(posixpath.join(str(base), name)).split("/")
    if name.startswith("/") or "\\" in name or ":" in name or not name.isprintable() or parts[0] in ("..", ""):
        raise RobotFileError(
            f"robot file: {file} names {name[:200]!r}, which is outside the upload; upload that file too, and name it "
            "by a relative path"
        )
    return PurePosixPath(*parts)


def _check_models(models: dict[PurePosixPath, ET.Element], files: Sequence[PurePosixPath]) -> set[PurePosixPath]:
    """Check the paths in MJCF, and return the files that others include.

    Folders and files combine across included files, so every path must stay inside from every folder.
    """
    bases = {path.parent for path in models}
    for path, root in models.items():
        for element in root.iter():
            for name in FOLDER_ATTRIBUTES:
                if name in element.attrib:
                    bases |= {inside(model.parent, element.attrib[name], path) for model in models}
    included: set[PurePosixPath] = set()
    for path, root in models.items():
        for element in root.iter():
            for name, value in element.attrib.items():
                if _FILE_ATTRIBUTE.fullmatch(name):
                    places = {inside(base, value, path) for base in bases}
                    if element.tag in ("include", "model"):
                        included |= _included(path, value, places, files)
    return included


def _included(
    path: PurePosixPath, value: str, places: set[PurePosixPath], files: Sequence[PurePosixPath]
) -> set[PurePosixPath]:
    """Return which files of the upload an include may mean."""
    present = places & set(files)
    if not present:
        raise RobotFileError(f"robot file: {path} includes {value!r}, which is not in the upload; add that file")
    return present


def _check_urdf(path: PurePosixPath, root: ET.Element, files: Sequence[PurePosixPath]) -> None:
    """Check the paths in a URDF; its meshes then name files of the upload, or none."""
    for element in root.iter():
        for name in FOLDER_ATTRIBUTES:
            if name in element.attrib:
                inside(path.parent, element.attrib[name], path)
        if element.tag == "include":
            raise RobotFileError(f"robot file: {path} has an <include>, which URDF does not know; remove it")
        value = element.get("filename")
        if element.tag in ("mesh", "texture") and value is not None:
            element.set("filename", _uploaded_mesh(path, value, files))


def _uploaded_mesh(path: PurePosixPath, name: str, files: Sequence[PurePosixPath]) -> str:
    """Return the path, from the URDF, of the uploaded file whose path agrees with a name from the end on longest."""
    scheme, _, rest = name.rpartition("://")
    if scheme not in ("", "package") or (scheme and ".." in rest):
        raise RobotFileError(
            f"robot file: {path} names {name[:200]!r}, which is outside the upload; upload that file too, and name it "
            "by a relative path or by package://"
        )
    wanted = inside(PurePosixPath() if scheme else path.parent, rest, path)
    meshes = [file for file in files if file.suffix.lower() in MESH_SUFFIXES]
    found = max(meshes, key=lambda file: _common_end(file, wanted), default=None)
    if found is None or _common_end(found, wanted) == 0:
        return wanted.name
    return posixpath.relpath(str(found), str(path.parent))


def _common_end(first: PurePosixPath, second: PurePosixPath) -> int:
    """Return how many parts of two paths agree from the end on."""
    pairs = list(zip(reversed(first.parts), reversed(second.parts), strict=False))
    return next((number for number, (a, b) in enumerate(pairs) if a != b), len(pairs))


def _check_collada(path: PurePosixPath, root: ET.Element) -> None:
    """Check the images that a mesh in COLLADA names."""
    for element in root.iter():
        if str(element.tag).rpartition("}")[2] == "init_from" and element.text:
            inside(path.parent, element.text.strip(), path)
