"""Files to read and write, with one message where that fails."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tarc.core.errors import InvalidParameter


@contextmanager
def writing(name: str, path: Path) -> Iterator[None]:
    """Name the file where the block below cannot write it.

    Parameters
    ----------
    name
        The parameter that holds the path, for the message.
    path
        The file or folder.

    Raises
    ------
    InvalidParameter
        For an `OSError` in the block: a full disk, a missing permission, a file where a folder is needed.
    """
    try:
        yield
    except OSError as error:
        raise InvalidParameter(
            f"{name}: cannot write {path}: {error.strerror or error}; free space or choose another path"
        ) from None


def make_folder(name: str, path: str | Path) -> Path:
    """Make a folder and those above it, where they do not exist, and return it.

    Raises
    ------
    InvalidParameter
        For a folder that cannot be made.
    """
    folder = Path(path).expanduser()
    with writing(name, folder):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def file_in_folder(name: str, path: str | Path) -> Path:
    """Return the file to write.

    Raises
    ------
    InvalidParameter
        For a folder that does not exist.
    """
    file = Path(path)
    if not file.parent.is_dir():
        raise InvalidParameter(f"{name}: got {str(path)!r}; the folder {file.parent} does not exist, create it first")
    return file


def save_text(name: str, path: str | Path, text: str) -> Path:
    """Write a text in UTF-8 and return its file.

    Raises
    ------
    InvalidParameter
        For a folder that does not exist, and a file that cannot be written.
    """
    file = file_in_folder(name, path)
    with writing(name, file):
        file.write_text(text, encoding="utf-8")
    return file


def read_text(name: str, path: str | Path) -> str:
    """Return the text of a file.

    Raises
    ------
    InvalidParameter
        For a file that is not there, cannot be read, or is no text in UTF-8.
    """
    try:
        return Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is no text in UTF-8"
        raise InvalidParameter(f"{name}: cannot read {path}: {reason}; give a file that can be read") from None
