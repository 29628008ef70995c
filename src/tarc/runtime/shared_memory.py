"""Where files are memory."""

from pathlib import Path


def shared_memory_folder() -> str | None:
    """Return a folder whose files are memory, where the system has one."""
    folder = Path("/dev/shm")
    return str(folder) if folder.is_dir() else None
