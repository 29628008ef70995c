"""The storage of a search of gains: a file that several processes append to, and from which a search goes on.

Optuna comes with the extra ``study``.
"""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import optuna
from optuna.storages import BaseStorage, InMemoryStorage, JournalStorage
from optuna.storages.journal import BaseJournalBackend, JournalFileBackend
from optuna.study import StudyDirection

from tarc.core.errors import InvalidParameter
from tarc.core.files import file_in_folder, writing

if os.name == "posix":
    import fcntl


def open_study(
    name: str,
    problem: dict[str, Any],
    sampler: optuna.samplers.BaseSampler,
    n_objectives: int,
    storage: BaseStorage,
) -> optuna.Study:
    """Return the study of a law in a storage, a new one or the one that is there for the same problem.

    Raises
    ------
    InvalidParameter
        For a study of another problem.
    """
    directions = [StudyDirection.MINIMIZE] * n_objectives
    study = optuna.create_study(
        study_name=name, storage=storage, sampler=sampler, directions=directions, load_if_exists=True
    )
    stored = study.user_attrs.get("problem")
    if stored is None:
        study.set_user_attr("problem", problem)
        return study
    problem = json.loads(json.dumps(problem))
    differing = [key for key in {**problem, **stored} if problem.get(key) != stored.get(key)]
    if differing:
        old, new = (json.dumps(content.get(differing[0])) for content in (stored, problem))
        raise InvalidParameter(
            f"storage: it has a search of {name} with other {', '.join(differing)} ({differing[0]}: {_short(old)} "
            f"there, {_short(new)} here); repeat the former call, or give another file"
        )
    return study


def _short(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}…"


def open_storage(path: str | Path | None) -> BaseStorage:
    """Return a storage in a file, for several processes at a time, or one in memory without a path.

    Raises
    ------
    InvalidParameter
        For a folder that does not exist, a file that cannot be written, and one that is no storage of a search.
    """
    if path is None:
        return InMemoryStorage()
    file = file_in_folder("storage", path)
    _check_journal(file)
    with writing("storage", file):
        file.touch()
        return JournalStorage(Journal(file) if os.name == "posix" else JournalFileBackend(str(file)))


class Journal(BaseJournalBackend):
    """A file of one line per change, which processes append to under a lock.

    Optuna's own waits for the disk at each line, which takes longer than a trial. Here a process that is killed loses
    nothing that it wrote, and a machine without power the last seconds. A line that was cut off is passed over.

    Parameters
    ----------
    file
        The file, which exists.
    """

    def __init__(self, file: Path):
        self._file = file
        self._ends = [0]

    def read_logs(self, log_number_from: int) -> Iterator[dict[str, Any]]:
        """Return the changes from a number on."""
        last = min(log_number_from, len(self._ends) - 1)
        with self._file.open("rb") as handle:
            end = handle.seek(self._ends[last])
            number = last
            for line in handle:
                if not line.endswith(b"\n"):
                    return
                end += len(line)
                try:
                    change = json.loads(line)
                except ValueError:
                    continue
                number += 1
                if number == len(self._ends):
                    self._ends.append(end)
                if number > log_number_from:
                    yield change

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        """Append changes."""
        lines = "".join(json.dumps(log, separators=(",", ":")) + "\n" for log in logs).encode()
        with writing("storage", self._file), self._file.open("ab+") as handle:
            fcntl.flock(handle, fcntl.LOCK_EX)
            if handle.seek(0, os.SEEK_END):
                handle.seek(-1, os.SEEK_END)
                lines = lines if handle.read(1) == b"\n" else b"\n" + lines
            handle.write(lines)


def _check_journal(file: Path) -> None:
    """Refuse a file that Optuna did not write, before anything is added to it."""
    if not file.exists() or file.stat().st_size == 0:
        return
    with file.open("rb") as handle:
        first = handle.readline()
    try:
        is_journal = "op_code" in json.loads(first)
    except (ValueError, TypeError):
        is_journal = False
    if not is_journal:
        raise InvalidParameter(f"storage: {file} is no storage of tarc tune; give another file, such as search.journal")


class Workers:
    """Whether other processes search the same law in the same storage.

    The system ends the claim of a process that is killed. Without POSIX locks there always may be others.

    Parameters
    ----------
    path
        The storage; None for one in memory.
    study_name
        The law.
    """

    def __init__(self, path: str | Path | None, study_name: str):
        self._handle: IO[str] | None = None
        self._in_memory = path is None
        if path is not None and os.name == "posix":
            name = "".join(letter if letter.isalnum() or letter in "-_" else "_" for letter in study_name)
            lock = file_in_folder("storage", f"{path}.{name}.lock-of-workers")
            with writing("storage", lock):
                self._handle = lock.open("a")

    def claim(self) -> bool:
        """Return whether there is no other process, and claim the search for this one."""
        if self._handle is None:
            return self._in_memory
        try:
            fcntl.flock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return False
        return True

    def join(self) -> None:
        """Let other processes join, and show them this one."""
        if self._handle is not None:
            fcntl.flock(self._handle, fcntl.LOCK_SH)

    def leave(self) -> None:
        """Show that this process has no trial under way."""
        if self._handle is not None:
            fcntl.flock(self._handle, fcntl.LOCK_UN)

    def __enter__(self) -> "Workers":
        return self

    def __exit__(self, *_: object) -> None:
        if self._handle is not None:
            self._handle.close()
