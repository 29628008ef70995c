"""Files of an upload: names that stay in a folder, zip archives unpacked within limits."""

import lzma
import stat
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO

from tarc.core.errors import RobotFileError

ROBOT_SUFFIXES = (".urdf", ".xml", ".mjcf")
MESH_SUFFIXES = (".stl", ".obj", ".dae")
KEPT_SUFFIXES = (*ROBOT_SUFFIXES, *MESH_SUFFIXES, ".msh", ".png")
"""Files that a robot can need; others in an archive are left out."""
MAX_DEPTH = 12
"""Largest number of folders above a file of an archive."""
CHUNK = 1 << 20


@dataclass(frozen=True)
class UploadLimits:
    """Limits of an upload.

    Attributes
    ----------
    size
        Of all files together as they arrive [B].
    unpacked_size
        Of all files together once they are unpacked [B].
    n_files
        Largest number of files.
    time
        In which they must be read [s].
    memory
        That reading them may take, beside that of the libraries [B]; kept on Linux alone.
    """

    size: int = 32 << 20
    unpacked_size: int = 128 << 20
    n_files: int = 500
    time: float = 30.0
    memory: int = 1 << 30


def relative_path(name: str) -> PurePosixPath:
    """Return a name as a path that stays in its folder.

    Raises
    ------
    RobotFileError
        For an absolute path, a drive, ``..``, a backslash, a character that is not printed, and too many folders.
    """
    path = PurePosixPath(name)
    is_plain = name.isprintable() and not set(name) & set('\\:*?"<>|')
    is_inside = not path.is_absolute() and path.parts and ".." not in path.parts
    if not (is_plain and is_inside and len(path.parts) <= MAX_DEPTH and all(len(part) <= 200 for part in path.parts)):
        raise RobotFileError(
            f"upload: got a file named {name[:200]!r}; needs a plain relative path without '..', at most {MAX_DEPTH} "
            "folders deep. Rename it"
        )
    return path


def unpack(files: Mapping[str, Path], folder: Path, limits: UploadLimits) -> list[PurePosixPath]:
    """Write the files of an upload, and those in its zip archives, into a folder; return their paths in it.

    Parameters
    ----------
    files
        Where each file is, by the name under which it was uploaded.
    folder
        An empty folder.
    limits
        Those of the upload.

    Raises
    ------
    RobotFileError
        For a name that leaves the folder, a symbolic link, two files of the same name, and a broken archive. Also for
        more files or bytes than the limits allow.
    """
    written: list[PurePosixPath] = []
    left = limits.unpacked_size
    for path, stream in _open_files(files, limits):
        if path in written:
            raise RobotFileError(f"upload: two files are named {str(path)!r}; keep one of them")
        if len(written) == limits.n_files:
            raise RobotFileError(
                f"upload: has more than {limits.n_files} files; leave out those the robot does not need"
            )
        target = folder / path
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            left = _copy(stream, target, left, limits)
        except OSError as error:
            raise RobotFileError(f"upload: cannot write {str(path)!r}: {error.strerror}; rename the file") from None
        written.append(path)
    return written


def _copy(stream: IO[bytes], target: Path, left: int, limits: UploadLimits) -> int:
    """Copy a stream to a new file of at most ``left`` bytes, and return how many of these remain."""
    with target.open("xb") as out:
        while chunk := stream.read(CHUNK):
            left -= len(chunk)
            if left < 0:
                raise RobotFileError(
                    f"upload: takes more than {limits.unpacked_size >> 20} MB once it is unpacked; simplify the meshes"
                )
            out.write(chunk)
    return left


def _open_files(files: Mapping[str, Path], limits: UploadLimits) -> Iterator[tuple[PurePosixPath, IO[bytes]]]:
    """Yield path and content of each file to keep."""
    for name, file in files.items():
        path = relative_path(name)
        if path.suffix.lower() == ".zip":
            yield from _open_archive(path, file, limits)
        elif path.suffix.lower() in KEPT_SUFFIXES:
            with file.open("rb") as stream:
                yield path, stream
        else:
            raise RobotFileError(
                f"upload: got {name!r}; needs a robot ({', '.join(ROBOT_SUFFIXES)}), its meshes "
                f"({', '.join(MESH_SUFFIXES)}), or a zip archive of them"
            )


def _open_archive(name: PurePosixPath, file: Path, limits: UploadLimits) -> Iterator[tuple[PurePosixPath, IO[bytes]]]:
    """Yield path and content of each file to keep of an archive."""
    try:
        with zipfile.ZipFile(file) as archive:
            entries = archive.infolist()
            if len(entries) > 20 * limits.n_files:
                raise RobotFileError(f"upload: {name} has {len(entries)} entries; leave out those not needed")
            for entry in entries:
                if stat.S_ISLNK(entry.external_attr >> 16):
                    raise RobotFileError(
                        f"upload: {entry.filename!r} in {name} is a symbolic link; put the file itself into the archive"
                    )
                path = relative_path(entry.filename)
                if entry.is_dir() or path.suffix.lower() not in KEPT_SUFFIXES:
                    continue
                with archive.open(entry) as stream:
                    yield path, stream
    except (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, OSError) as error:
        raise RobotFileError(f"upload: {name} is no zip archive that reads ({error}); make it again") from None
    except (NotImplementedError, RuntimeError) as error:
        raise RobotFileError(f"upload: {name} cannot be unpacked ({error}); make it without encryption") from None
