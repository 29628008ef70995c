"""Trajectories in text files and NumPy arrays, with the names of their columns."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.signals.log_bag import read_bag
from tarc.signals.log_columns import LogColumns


class Record(NamedTuple):
    """Times and positions of a file, shape (k, 1 + n), and the names of its position columns, if it has any."""

    table: np.ndarray
    columns: list[str] | None


def read_record(given: str | Path, min_rows: int = 6) -> Record:
    """Read a trajectory file with at least ``min_rows`` rows.

    Raises
    ------
    InvalidParameter
        For a file that is not there, has no numbers, too few of them, or times that do not increase.
    """
    path = Path(given)
    if not path.is_file():
        raise InvalidParameter(f"path: no trajectory file {str(given)!r}; looked in {path.resolve().parent}")
    if path.suffix.lower() == ".mcap":
        return _read_states(path, min_rows)
    try:
        table, header = (np.load(path), "") if path.suffix == ".npy" else _read_text(path)
    except (ValueError, EOFError, OSError) as error:
        raise InvalidParameter(
            f"path: {path} does not read as numbers ({error}); needs columns time, q1, q2, …"
        ) from None
    table = check.array(f"path ({path})", table)
    if table.ndim != 2 or table.shape[0] < min_rows or table.shape[1] < 2:
        raise InvalidParameter(
            f"path: {path} has shape {table.shape}; needs {min_rows} rows or more, columns time, q1, q2, …"
        )
    if np.any(np.diff(table[:, 0]) <= 0):
        raise InvalidParameter(f"path: the times in {path} do not increase")
    names = _column_names(header)
    if len(names) == table.shape[1]:
        return Record(table, names[1:])
    if names and not header.lstrip().startswith("#"):  # a comment need not be a header
        raise InvalidParameter(
            f"path: the header of {path} has {len(names)} names ({', '.join(names)}), its rows {table.shape[1]} "
            "numbers; needs one name per column, or no header"
        )
    return Record(table, None)


def check_overlap(path: str | Path, first: float, last: float, duration: float) -> None:
    """Refuse a record from a first to a last time [s] that lies outside a run of a duration [s]."""
    if last <= 0 or first >= duration:
        raise InvalidParameter(
            f"reference: the record {path} lasts from {first:g} s to {last:g} s, the run from 0 to {duration:g} s; "
            "they do not overlap. Use starts_at_zero: true, which counts from the first stamp",
            "reference",
        )


def _read_states(path: Path, min_rows: int) -> Record:
    """Return the positions of the joint states in a bag, without messages of a repeated stamp."""
    log = read_bag(path, LogColumns())
    is_new = np.concatenate([[True], np.diff(log.times) > 0])
    table = np.column_stack([log.times, log.position])[is_new]
    if len(table) < min_rows or not np.all(np.isfinite(table)):
        raise InvalidParameter(
            f"path: {path} has {len(table)} joint states with different stamps; needs {min_rows} or more, all finite"
        )
    return Record(table, list(log.joint_names))


def _read_text(path: Path) -> tuple[np.ndarray, str]:
    """Return the numbers of a text file, and the line before them, empty for none."""
    lines = [line for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip()]
    start = next((k for k, line in enumerate(lines) if not line.lstrip().startswith("#")), len(lines))
    if start < len(lines) and any(c.isalpha() and c not in "eE" for c in lines[start]):
        start += 1
    header = lines[start - 1] if start else ""
    delimiter = "," if "," in "".join(lines[start : start + 1]) else None
    return np.loadtxt(lines[start:], delimiter=delimiter, ndmin=2), header


def _column_names(header: str) -> list[str]:
    """Return the names in a header, without their units."""
    text = re.sub(r"[\[(]\s*(rad|m|s)(/s(\^2|²|2)?)?\s*[\])]", "", header.lstrip(" #"))
    return [name.strip(" \t\"'") for name in (text.split(",") if "," in text else text.split())]


def are_numbered(names: Sequence[str]) -> bool:
    """Return whether names are one word with increasing numbers from 0 or 1 on, such as q1, q2, …"""
    parts = [re.fullmatch(r"(\D*)(\d+)[\])]?", name) for name in names]
    numbers = [int(part[2]) for part in parts if part]
    is_one_word = len({part[1] for part in parts if part}) == 1
    return is_one_word and numbers in (list(range(len(names))), list(range(1, len(names) + 1)))
