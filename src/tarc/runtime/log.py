"""The log of a run: the loop writes rows into shared memory, and another process writes them into a file."""

import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tarc.core.errors import InvalidParameter
from tarc.core.files import file_in_folder, writing
from tarc.runtime.ring import Ring
from tarc.runtime.shared_memory import shared_memory_folder

CAPACITY = 8192
"""Rows of the ring: 8 s at 1 kHz."""
PATIENCE = 30.0
"""Time that the writer has to start, and to finish [s]."""


class Log:
    """Rows of a run on their way to a file.

    Parameters
    ----------
    head
        As `tarc.runtime.log_format.header` has it.
    target
        The netCDF file; None for a ring alone, which a display may read.

    Attributes
    ----------
    folder
        Where header and ring are.
    target
        The file.
    error
        Why the file is not complete, after `close`; empty where it is.
    """

    def __init__(self, head: Mapping[str, Any], target: Path | None):
        self.target = None if target is None else file_in_folder("log", target)
        self._period = float(head["period"])
        self.folder = Path(tempfile.mkdtemp(prefix="tarc-log-", dir=shared_memory_folder()))
        (self.folder / "header.json").write_text(json.dumps(head), encoding="utf-8")
        self.ring = Ring.create(self.folder / "ring", CAPACITY, int(head["width"]))
        self._process: subprocess.Popen[bytes] | None = None
        self._changes: list[dict[str, float]] = []
        self.error = ""
        if self.target is not None:
            self._start(self.target)

    def _start(self, target: Path) -> None:
        with writing("log", target):
            target.open("wb").close()
        command = [sys.executable, "-m", "tarc.runtime.log_writer", str(self.folder), str(target.resolve())]
        with (self.folder / "errors").open("wb") as errors:
            self._process = subprocess.Popen(
                command, start_new_session=True, stdin=subprocess.DEVNULL, stderr=errors, stdout=errors
            )
        end = time.monotonic() + PATIENCE
        while not (self.folder / "ready").exists():
            if self._process.poll() is not None or time.monotonic() > end:
                line = self._last_line()
                self.close({})
                raise InvalidParameter(f"log: cannot write {target}: {line}")
            time.sleep(0.01)

    def _last_line(self) -> str:
        """Return the last line that the writer printed."""
        lines = (self.folder / "errors").read_text(encoding="utf-8").strip().splitlines()
        return lines[-1] if lines else "it says nothing"

    def add_change(self, gains: Mapping[str, float]) -> None:
        """Note gains that the loop is about to take; the file has them also where the loop's process is killed."""
        self._changes.append(dict(gains))
        self._write("changes.json", self._changes)

    def _write(self, name: str, content: object) -> None:
        """Write a file of JSON that the other process sees complete or not at all."""
        partial = self.folder / f"{name}.part"
        partial.write_text(json.dumps(content), encoding="utf-8")
        partial.rename(self.folder / name)

    def close(self, attributes: Mapping[str, Any]) -> None:
        """End the ring, and wait until the file is complete.

        Parameters
        ----------
        attributes
            To set in the file.
        """
        self._write("end.json", dict(attributes))
        self.ring.end()
        if self._process is not None:
            try:
                self._process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
            if self._process.returncode:
                self.error = f"its process failed: {self._last_line()}"
        shutil.rmtree(self.folder, ignore_errors=True)
