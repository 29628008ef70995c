"""Readers of logs: text, MATLAB and bags."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.signals.log_bag import read_bag
from tarc.signals.log_columns import QUANTITIES, TIME_NAMES, LogColumns, columns_from, place_of, split_unit
from tarc.signals.log_run import read_run
from tarc.signals.robot_log import RobotLog


def read_log(path: str | Path, columns: LogColumns | Mapping[str, Any] | str | Path | None = None) -> RobotLog:
    """Read recorded motion of a robot.

    Parameters
    ----------
    path
        The suffix ``.mat`` means MATLAB of any version, and ``.mcap`` a ROS 2 bag with ``sensor_msgs/JointState``.
        With ``.nc`` it is the log of `tarc.runtime.run_live`, or a saved run. Everything else is text with a header,
        where an empty field is a lost sample. A folder has one text file per quantity, named by ``columns``. Known
        names of columns are ``time``, ``q1``, ``dq1``, ``tau1``, ``q_ref1``, and the joint's name with ``/position``,
        ``/velocity``, ``/effort``, ``/reference``. Units in brackets, such as ``q1 [deg]``, are converted.
    columns
        Other names: a `LogColumns`, a mapping of its fields, or a YAML file with them.

    Raises
    ------
    InvalidParameter
        For a file that is missing or does not read, and where times or positions are missing.
    MissingTool
        For a bag, netCDF or YAML without the library that reads it.
    """
    file = Path(path)
    names = columns_from(columns)
    if file.is_dir():
        return _from_folder(file, names)
    if not file.is_file():
        raise InvalidParameter(f"path: no log {str(path)!r}; looked for {file.resolve()}", "path")
    if file.suffix.lower() == ".mcap":
        return read_bag(file, names)
    if file.suffix.lower() == ".nc":
        return read_run(file)
    if file.suffix.lower() == ".mat":
        return _from_matlab(file, names)
    return _from_text(file, names)


def _from_text(file: Path, columns: LogColumns) -> RobotLog:
    """Return the log of a table with a header."""
    labels, table = read_table(file)
    units = [split_unit(label) for label in labels]
    named = dict(zip([name for name, _ in units], zip(table.T, [unit for _, unit in units], strict=True), strict=True))

    def column(name: str, quantity: str) -> Array:
        if name not in named:
            hint = check.did_you_mean(name, named)
            raise InvalidParameter(
                f"columns.{quantity}: {file} has no column {name!r}.{hint} It has {', '.join(named)}", "columns"
            )
        values, unit = named[name]
        return values * (columns.scale(quantity) if unit is None else unit)

    tables: dict[str, Array] = {}
    joints: Sequence[str] | None = columns.joints
    for quantity in QUANTITIES:
        wanted = columns.names(quantity)
        if wanted is None:
            places = {place.joint: name for name in named if (place := place_of(name)) and place.quantity == quantity}
            order = list(places) if quantity == "position" or joints is None else [j for j in joints if j in places]
            if quantity == "position" and places:
                joints = joints or order
                order = [joint for joint in joints if joint in places] or order
            wanted = [places[joint] for joint in order] or None
        if wanted:
            tables[quantity] = np.column_stack([column(name, quantity) for name in wanted])
    time = columns.time or next((name for name in named if name.lower() in TIME_NAMES), None)
    if time is not None:
        tables["time"] = column(time, "time")
    return _assembled(file, tables, columns, joints, list(named))


def read_table(file: Path) -> tuple[list[str], Array]:
    """Return the header of a text file and its numbers, NaN for an empty field; no header gives no names.

    Raises
    ------
    InvalidParameter
        For a file without numbers, and for rows of different lengths.
    """
    try:
        lines = [line for line in file.read_text(encoding="utf-8-sig").splitlines() if line.strip()]
    except UnicodeDecodeError as error:
        raise InvalidParameter(f"path: {file} is no text ({error.reason})", "path") from None
    start = next((k for k, line in enumerate(lines) if not line.lstrip().startswith("#") and not _has_words(line)), -1)
    if start < 0:
        raise InvalidParameter(f"path: {file} has no row of numbers", "path")
    delimiter = next((mark for mark in ",;\t" if mark in lines[start]), None)
    try:
        table = np.loadtxt(lines[start:], delimiter=delimiter, ndmin=2)
    except ValueError:
        table = _with_gaps(file, lines[start:], delimiter)
    header = lines[start - 1].lstrip("# ") if start else ""
    labels = [part.strip(" \t\"'") for part in header.split(delimiter)] if header else []
    if labels and len(labels) != table.shape[1]:
        raise InvalidParameter(
            f"path: the header of {file} has {len(labels)} names, its rows {table.shape[1]} numbers; needs one name "
            "per column",
            "path",
        )
    return labels or [f"column {i + 1}" for i in range(table.shape[1])], table


def _with_gaps(file: Path, lines: list[str], delimiter: str | None) -> Array:
    """Return a table with NaN for what is no number."""
    try:
        return np.genfromtxt(lines, delimiter=delimiter, ndmin=2)
    except ValueError as error:
        raise InvalidParameter(
            f"path: {file} does not read as a table ({' '.join(str(error).split())[:80]})", "path"
        ) from None


def _has_words(line: str) -> bool:
    """Return whether a line has letters other than those of numbers and of NaN."""
    lower = line.lower().replace("nan", "").replace("inf", "")
    return any(letter.isalpha() and letter != "e" for letter in lower)


def _from_folder(folder: Path, columns: LogColumns) -> RobotLog:
    """Return the log of a folder with one file per quantity, each number by number or row by row."""
    if columns.position is None or (columns.time is None and columns.period is None):
        raise InvalidParameter(
            f"path: {folder} is a folder; name its files by columns, such as time: time.txt, position: q.txt", "columns"
        )
    numbers: dict[str, Array] = {}
    for quantity in ("time", *QUANTITIES):
        name = getattr(columns, quantity)
        if name is None:
            continue
        if not isinstance(name, str) or not (folder / name).is_file():
            raise InvalidParameter(f"columns.{quantity}: no file {name!r} in {folder}", "columns")
        numbers[quantity] = read_table(folder / name)[1] * columns.scale(quantity)
    if "time" in numbers:
        n_rows = numbers["time"].size
        for quantity, values in numbers.items():
            if values.size % n_rows:
                raise InvalidParameter(
                    f"columns.{quantity}: it has {values.size} numbers, which {n_rows} rows do not share evenly",
                    "columns",
                )
        numbers = {quantity: values.reshape(n_rows, -1) for quantity, values in numbers.items()}
        numbers["time"] = numbers["time"][:, 0]
    return _assembled(folder, numbers, columns, columns.joints, list(numbers))


def _from_matlab(file: Path, columns: LogColumns) -> RobotLog:
    """Return the log of arrays in a MATLAB file, by their paths."""
    arrays = dict(_matlab_arrays(file))

    def array(path: str, quantity: str) -> Array:
        if path not in arrays:
            raise InvalidParameter(
                f"columns.{quantity}: {file} has no array {path!r}.{check.did_you_mean(path, arrays)} It has "
                f"{', '.join(arrays)}",
                "columns",
            )
        return arrays[path] * columns.scale(quantity)

    time = columns.time or next((name for name in arrays if name.lower() in TIME_NAMES), None)
    tables = {} if time is None else {"time": np.ravel(array(time, "time"))}
    n_rows = len(tables["time"]) if tables else None
    for quantity in QUANTITIES:
        words = [quantity, *_words_of_arrays(quantity, arrays)]
        wanted = columns.names(quantity) or [name for name in words if name in arrays][:1]
        if wanted:
            parts = [_time_down(array(name, quantity), n_rows) for name in wanted]
            tables[quantity] = np.hstack(parts)
    return _assembled(file, tables, columns, columns.joints, list(arrays))


def _words_of_arrays(quantity: str, arrays: Mapping[str, Array]) -> Iterator[str]:
    """Yield the arrays whose name alone says a quantity, such as ``tau``."""
    for name in arrays:
        place = place_of(f"{name}1")
        if place is not None and place.quantity == quantity:
            yield name


def _time_down(values: Array, n_rows: int | None) -> Array:
    """Return an array with time along its rows."""
    table = values.reshape(len(values), -1)
    is_across = table.shape[1] == n_rows and table.shape[0] != n_rows
    return table.T if is_across or (n_rows is None and table.shape[0] < table.shape[1]) else table


def _matlab_arrays(file: Path) -> Iterator[tuple[str, Array]]:
    """Yield path and numbers of each array of a MATLAB file, structures opened."""
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    try:
        content = loadmat(file, squeeze_me=True, struct_as_record=False)
    except NotImplementedError:  # version 7.3, which is HDF5
        yield from _hdf5_arrays(file)
        return
    except (ValueError, TypeError, OSError, MatReadError) as error:
        raise InvalidParameter(f"path: {file} does not read as a MATLAB file ({error})", "path") from None
    for name, value in content.items():
        if not name.startswith("__"):
            yield from _opened(name, value)


def _opened(name: str, value: Any) -> Iterator[tuple[str, Array]]:
    if hasattr(value, "_fieldnames"):
        for field in value._fieldnames:
            yield from _opened(f"{name}.{field}", getattr(value, field))
    elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.size > 1:
        yield name, value.astype(float)


def _hdf5_arrays(file: Path) -> Iterator[tuple[str, Array]]:
    """Yield the arrays of a MATLAB file of version 7.3."""
    import h5py

    found: list[tuple[str, Array]] = []

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "biuf":
            values = np.squeeze(np.asarray(item, dtype=float))
            if values.size > 1 and values.ndim <= 2:
                found.append((name.replace("/", "."), values))

    with h5py.File(file, "r") as content:
        content.visititems(visit)
    yield from found


def _assembled(
    file: Path, tables: dict[str, Array], columns: LogColumns, joints: Sequence[str] | None, available: list[str]
) -> RobotLog:
    """Return the log of tables by quantity."""
    if "position" not in tables:
        raise InvalidParameter(
            f"path: {file} has no position that is known by its name; it has {', '.join(available)}. Name them by "
            "columns: position: [a, b]",
            "path",
        )
    times = tables.get("time")
    if times is None and columns.period is None:
        raise InvalidParameter(
            f"path: {file} has no time that is known by its name; it has {', '.join(available)}. Give columns.time or "
            "columns.period",
            "path",
        )
    if times is None:
        times = np.arange(len(tables["position"])) * float(columns.period or 0)
    n_joints = tables["position"].shape[1]
    names = [str(name) for name in joints or ()]
    if all(name.isdigit() for name in names):
        names = []
    return RobotLog(
        times=np.asarray(times),
        position=tables["position"],
        velocity=tables.get("velocity"),
        torque=tables.get("torque"),
        reference=tables.get("reference"),
        joint_names=tuple(names) if len(names) == n_joints else (),
        label=file.stem,
    )
