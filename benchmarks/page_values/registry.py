"""Sources of values, and the runs that they share."""

import contextlib
import functools
import io
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from tarc import Scenario

ROOT = Path(__file__).resolve().parents[2]
CODE = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)
YAML = re.compile(r"^```yaml\n(.*?)^```$", re.DOTALL | re.MULTILINE)
TYPED = re.compile(
    r"^Save this as `(?P<name>[\w.-]+)`:\n\n```\w+\n(?P<file>.*?)^```$|^```console\n(?P<commands>.*?)^```$",
    re.DOTALL | re.MULTILINE,
)
"""A file that a page tells to save, or commands that it tells to type."""
ERRORS = {"rms_error", "peak_error"}
SHARES = {"high_frequency_share", "overestimation", "underestimation", "saturated"}
NO_VALUE = "–"
Value: TypeAlias = float | str


class DataMissingError(Exception):
    """Records that a source needs are not on this computer."""


class Source(NamedTuple):
    """A function that returns values by key, and whether it takes minutes."""

    function: Callable[[], dict[str, Value]]
    long: bool


class PageRun(NamedTuple):
    """What the Python blocks of a page left: their names, what they printed, the folder with their files."""

    names: dict[str, Any]
    printed: str
    folder: Path

    def columns(self, pattern: str) -> list[tuple[str, ...]]:
        """Return the groups of a pattern in each printed line that has it."""
        return [match.groups() for match in re.finditer(pattern, self.printed, re.MULTILINE)]


SOURCES: dict[str, Source] = {}
FOLDERS: list[tempfile.TemporaryDirectory[str]] = []
"""Folders of pages that ran; they go with the process."""


def source(function: Callable[[], dict[str, Value]]) -> Callable[[], dict[str, Value]]:
    """Register a function whose name is that of the source."""
    SOURCES[function.__name__] = Source(function, long=False)
    return function


def long_source(function: Callable[[], dict[str, Value]]) -> Callable[[], dict[str, Value]]:
    """Register a function that takes minutes."""
    SOURCES[function.__name__] = Source(function, long=True)
    return function


@functools.cache
def metrics(scenario: str, *settings: str) -> dict[str, dict[str, float]]:
    """Return the metrics of every law of a scenario, in SI units, without the time before its measures begin."""
    described = Scenario.load(scenario, list(settings))
    runs = described.run(progress=False)
    return {law: run.metrics(start_time=described.metrics_start) for law, run in runs.items()}


@functools.cache
def run_page(page: str) -> PageRun:
    """Execute the Python blocks of a page, as its test does, in a folder of their own."""
    blocks = CODE.findall((ROOT / "docs" / page).read_text(encoding="utf-8"))
    names: dict[str, Any] = {"__name__": page}
    printed = io.StringIO()
    before = Path.cwd()
    temporary = tempfile.TemporaryDirectory()
    FOLDERS.append(temporary)
    os.chdir(temporary.name)
    try:
        with contextlib.redirect_stdout(printed):
            for block in blocks:
                exec(block, names)
    finally:
        os.chdir(before)
    return PageRun(names, printed.getvalue(), Path(temporary.name))


def yaml_block(page: str, containing: str) -> str:
    """Return the first YAML block of a page that contains a text."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    return next(block for block in YAML.findall(text) if containing in block)


def flat(measured: dict[str, dict[str, float]], prefix: str = "") -> dict[str, Value]:
    """Return metrics by law and name, errors in mrad or mm and shares in per cent."""
    return {
        f"{prefix}{law}.{name}": value * (1e3 if name in ERRORS else 100.0 if name in SHARES else 1.0)
        for law, part in measured.items()
        for name, value in part.items()
    }


def command(line: str, folder: Path | None = None, fails: bool = False, status: int = 0) -> str:
    """Return what a command prints on a terminal of 100 columns; one that is to fail prints its error.

    ``python`` and ``tarc`` are those that run this. `RuntimeError` where the exit status is another than expected: for
    one that fails any but zero.
    """
    words = line.split()
    program = {"tarc": [sys.executable, "-m", "tarc"], "python": [sys.executable]}[words[0]]
    with tempfile.TemporaryDirectory() as temporary:
        done = subprocess.run(
            [*program, *words[1:]],
            cwd=folder or temporary,
            env=os.environ | {"COLUMNS": "100"},
            capture_output=True,
            text=True,
            check=False,
        )
    if done.returncode == 0 if fails else done.returncode != status:
        raise RuntimeError(f"{line}: exit status {done.returncode}\n{done.stderr}")
    return (done.stderr if fails else done.stdout).rstrip()


def type_page(page: str, folder: Path, skip: Sequence[str] = ()) -> dict[str, str]:
    """Save the files of a page and run its commands in a shell, as a reader does; return what each printed.

    Parameters
    ----------
    page
        Path below ``docs``.
    folder
        Where to work.
    skip
        Programs whose commands are left out.

    Raises
    ------
    RuntimeError
        Where a command fails.
    """
    environment = os.environ | {"COLUMNS": "100", "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    printed = {}
    for match in TYPED.finditer((ROOT / "docs" / page).read_text(encoding="utf-8")):
        if match["name"]:
            (folder / match["name"]).write_text(match["file"], encoding="utf-8")
            continue
        for line in re.findall(r"^\$ (.*(?:\\\n.*)*)$", match["commands"], re.MULTILINE):
            if line.split()[0] in skip:
                continue
            done = subprocess.run(
                ["bash", "-c", line], cwd=folder, env=environment, capture_output=True, text=True, check=False
            )
            expected = (0, 1) if line.startswith("tarc diagnose") else (0,)  # 1 says that there are findings
            if done.returncode not in expected:
                raise RuntimeError(f"{line}: exit status {done.returncode}\n{done.stdout}{done.stderr}")
            printed[line] = done.stdout.rstrip()
    return printed


def text_block(text: str) -> str:
    """Return text as a block of code, without spaces at the ends of lines and without the list of files."""
    lines = [line.rstrip() for line in text.splitlines() if not line.startswith("written: ")]
    return "\n".join(["```text", *lines, "```"])


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
