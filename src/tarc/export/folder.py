"""Folders of written files that never touch what they did not write."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

from tarc.core.errors import InvalidParameter
from tarc.core.files import make_folder, writing

MANIFEST = ".tarc-export.json"
"""File with the hash of each file that was written."""


def write_folder(name: str, folder: str | Path, texts: Mapping[str, str]) -> list[Path]:
    """Write texts by their path in a folder, and return the files.

    A file that is there already is replaced only where an earlier call wrote it and nobody changed it since.

    Parameters
    ----------
    name
        Of the argument that names the folder, for messages.
    folder
        The folder, made where it does not exist.
    texts
        By path.

    Raises
    ------
    InvalidParameter
        For files that are in the way, none of which is touched, and a folder that cannot be written.
    """
    root = make_folder(name, folder)
    earlier = _hashes(root)
    foreign = [
        path
        for path, text in texts.items()
        if (root / path).exists() and not _is_ours(root / path, text, earlier.get(path))
    ]
    if foreign:
        raise InvalidParameter(
            f"{name}: {root} has {', '.join(foreign)}, which this command did not write or which was changed since; "
            "give another folder, or move them away"
        )
    files = []
    for path, text in texts.items():
        file = root / path
        with writing(name, file):
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
        files.append(file)
    hashes = earlier | {path: _hash(text.encode()) for path, text in texts.items()}
    with writing(name, root / MANIFEST):
        (root / MANIFEST).write_text(json.dumps(hashes, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    return files


def _is_ours(file: Path, text: str, digest: str | None) -> bool:
    if not file.is_file():
        return False
    content = file.read_bytes()
    return content == text.encode() or _hash(content) == digest


def _hashes(root: Path) -> dict[str, str]:
    try:
        content = json.loads((root / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return {str(key): str(value) for key, value in content.items()} if isinstance(content, dict) else {}


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
