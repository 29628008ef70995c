"""Folder of a study's results: a dataset in Zarr that is written chunk by chunk, and marks of what is finished."""

from tarc.core.optional import require

require("study", "a study", "zarr")

import errno
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
import zarr

from tarc.core.errors import InvalidParameter
from tarc.core.files import make_folder
from tarc.core.types import Array
from tarc.core.version import __version__
from tarc.simulation.quantities import MEASURES
from tarc.study.chunks import Chunk
from tarc.study.draws import Draws, run_seeds

try:
    import fcntl
except ImportError:  # on Windows
    fcntl = None

if TYPE_CHECKING:
    from tarc.study.engines import ChunkResult
    from tarc.study.specification import Study

RESULTS = "results.zarr"
CONTENT = "study.yaml"
LAYOUT = 2
"""Number of the way in which arrays and marks are stored, one more with each change of it."""
MARKS = "done"
TRACES = "traces"
LOCK = ".lock"
PARTIAL = f".{RESULTS}.part"
"""Dataset that is not complete yet."""
FORMER = f".{RESULTS}.old"
"""Dataset with smaller chunks, until the one with larger chunks has taken its place."""

FEWEST_ROWS = 8
"""Rows of the smallest chunk."""

MAX_CHUNKS = 64
"""Largest number of chunks; chunks grow with the runs, so that the number of files stays small."""


def rows_per_chunk(runs: int) -> int:
    """Return the rows of a chunk: eight times a power of two, so that there are at most `MAX_CHUNKS` chunks."""
    rows = FEWEST_ROWS
    while runs > MAX_CHUNKS * rows:
        rows *= 2
    return rows


class Store:
    """Results of a study on the disk; made by `open_store`.

    Attributes
    ----------
    folder
        Its folder.
    group
        The Zarr group of the dataset.
    runs
        Number of runs of the study.
    rows
        Runs per chunk.
    """

    def __init__(self, folder: Path, group: zarr.Group):
        self.folder = folder
        self.group = group
        self.runs = int(_attribute(group, "runs"))
        self.rows = int(_attribute(group, "chunk"))
        self._lock = ExitStack()
        self._arrays: dict[str, zarr.Array[Any]] = {}

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, *_: object) -> None:
        self._lock.close()

    def lock(self) -> None:
        """Keep other processes from writing, until the store is left as a context manager.

        Raises
        ------
        InvalidParameter
            Where another process writes.
        """
        file = self._lock.enter_context((self.folder / LOCK).open("w"))
        if fcntl is None:
            return
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._lock.close()
            raise InvalidParameter(
                f"--out: another process runs the study in {self.folder}; wait for it, or choose another folder", "out"
            ) from None
        except OSError:  # a file system without locks
            return

    def is_finished(self) -> Array:
        """Return whether each run is finished, (runs,)."""
        finished = np.zeros(self.runs, dtype=bool)
        for mark in (self.folder / MARKS).glob("*-*"):
            start, _, stop = mark.name.partition("-")
            if start.isdigit() and stop.isdigit():
                finished[int(start) : int(stop)] = True
        return finished

    @property
    def n_finished(self) -> int:
        """Number of finished runs."""
        return int(np.sum(self.is_finished()))

    def n_pending(self, draws: Draws) -> int:
        """Return the number of runs of `pending`."""
        return int(np.sum(~self.is_finished()[: len(draws.values)]))

    def pending(self, draws: Draws) -> Iterator[Chunk]:
        """Return what is left to run, chunk by chunk; of a study of fewer runs than are stored, its own runs."""
        is_left = ~self.is_finished()[: len(draws.values)]
        number = 0
        for first in range(0, len(is_left), self.rows):
            places = first + np.flatnonzero(is_left[first : first + self.rows])
            for indices in np.split(places, 1 + np.flatnonzero(np.diff(places) > 1)):
                if len(indices):
                    yield Chunk(number, indices, draws.values[indices], run_seeds(draws.seed, indices))
                    number += 1

    def write(self, chunk: Chunk, draws: Draws, result: "ChunkResult") -> None:
        """Store the results of a chunk, and mark it as finished.

        Raises
        ------
        InvalidParameter
            For a full disk and the like; what was stored before is kept.
        """
        region = slice(int(chunk.indices[0]), int(chunk.indices[-1]) + 1)
        with self._writing():
            for name, block in result.measures.items():
                self._array(name, 2)[region] = block
            self._array("completed", 2)[region] = result.completed
            self._array("end_time", 2)[region] = result.end_time
            self._array("seed", 1)[region] = chunk.seeds
            for column, key in enumerate(draws.keys):
                self._write_values(f"drawn:{key}", region, draws.shown(key, chunk.values[:, column]))
            for key, block in result.applied.items():
                self._write_values(f"applied:{key}", region, draws.shown(key, block))
            self._mark(region.start, region.stop)

    def _write_values(self, name: str, region: slice, values: Array) -> None:
        """Store values of a key: numbers, or texts of one width."""
        text_type = str(values.dtype) if values.dtype.kind == "U" else None
        self._array(name, values.ndim, text_type)[region] = values

    def set_attributes(self, **attributes: object) -> None:
        """Store attributes of the dataset."""
        with self._writing():
            self.group.attrs.update(cast(dict[str, Any], attributes))

    def attribute(self, name: str) -> Any:
        """Return an attribute of the dataset; None where there is none."""
        return self.group.attrs.get(name)

    def extend(self, runs: int) -> None:
        """Make place for more runs, in larger chunks where they are many more."""
        with self._writing():
            if rows_per_chunk(runs) == self.rows:
                for name, array in self.group.arrays():
                    if name not in ("run", "law"):
                        array.resize((runs, *array.shape[1:]))
                self.group.attrs["runs"] = runs
                _write_index(self.group, runs)
            else:
                _copied(self, runs)
                _swap(self.folder)
        self.group = _opened_group(self.folder, "r+")
        self.runs = runs
        self.rows = int(_attribute(self.group, "chunk"))
        self._arrays.clear()
        self.consolidate()

    def consolidate(self) -> None:
        """Put the description of all arrays into one file, from which readers of Zarr open the dataset at once."""
        with self._writing():
            zarr.consolidate_metadata(str(self.folder / RESULTS), zarr_format=2)

    def _array(self, name: str, n_dimensions: int, text_type: str | None = None) -> zarr.Array[Any]:
        """Return the array of a variable, made where there is none."""
        if name not in self._arrays:
            is_there = name in self.group
            self._arrays[name] = self._opened(name) if is_there else self._made(name, n_dimensions, text_type)
        return self._arrays[name]

    def _opened(self, name: str) -> zarr.Array[Any]:
        array = self.group[name]
        assert isinstance(array, zarr.Array)
        return array

    def _made(self, name: str, n_dimensions: int, text_type: str | None) -> zarr.Array[Any]:
        """Make the array of a variable."""
        n_laws = len(_attribute(self.group, "laws"))
        # without a fill value, since xarray would read it as a missing value
        usual = (text_type, None) if text_type else ("float64", np.nan)
        kind = {"completed": ("bool", None), "seed": ("int64", None)}.get(name, usual)
        return self.group.create_array(
            name,
            shape=(self.runs, n_laws)[:n_dimensions],
            chunks=(self.rows, n_laws)[:n_dimensions],
            dtype=kind[0],
            fill_value=kind[1],
            attributes={**_description(name), "_ARRAY_DIMENSIONS": ["run", "law"][:n_dimensions]},
        )

    def _mark(self, start: int, stop: int) -> None:
        """Mark runs as finished."""
        (self.folder / MARKS / f"{start:08d}-{stop:08d}").touch()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Say how to go on where the block below cannot write."""
        try:
            yield
        except OSError as error:
            full = error.errno in (errno.ENOSPC, errno.EDQUOT)
            what = "free space on the disk" if full else "make the folder writable"
            raise InvalidParameter(
                f"--out: cannot write {self.folder}: {error.strerror or error}; {self.n_finished} of {self.runs} runs "
                f"are kept. To go on, {what} and give the same command again",
                "out",
            ) from None


def open_store(folder: Path, study: "Study") -> Store:
    """Return the store of a study, locked: a new one, or the one in the folder, of the same study and version.

    Raises
    ------
    InvalidParameter
        For a folder of another study or version, and one that cannot be written.
    """
    _recover(folder)
    if (folder / RESULTS).exists():
        store = Store(folder, _opened_group(folder, "r+"))
        _check_same_study(store, study)
        store.lock()
        for part in (folder / MARKS, folder / TRACES):
            make_folder("--out", part)
        if study.runs > store.runs:
            store.extend(study.runs)
            study.save(folder / CONTENT)
        return store
    partial = folder / PARTIAL
    if folder.is_dir() and any(folder.iterdir()) and not partial.exists():
        raise InvalidParameter(
            f"--out: {folder} has files in it and no study; choose a folder that is empty or does not exist", "out"
        )
    for part in (folder, folder / MARKS, folder / TRACES):
        make_folder("--out", part)
    try:
        group = zarr.open_group(partial, mode="w", zarr_format=2)
        group.attrs.update(
            {
                "title": f"study {study.name}",
                "source": f"tarc-control {__version__}",
                "layout": LAYOUT,
                "study": study.to_yaml(folder),
                "content_hash": study.content_hash,
                "laws": study.law_names,
                "runs": study.runs,
                "chunk": rows_per_chunk(study.runs),
            }
        )
        _write_index(group, study.runs)
        empty = Store(folder, group)
        for name, n_dimensions in (("completed", 2), ("end_time", 2), ("seed", 1)):
            empty._array(name, n_dimensions)
        study.save(folder / CONTENT)
        partial.rename(folder / RESULTS)
    except OSError as error:
        raise InvalidParameter(
            f"--out: cannot write {folder}: {error.strerror or error}; choose another", "out"
        ) from None
    store = Store(folder, _opened_group(folder, "r+"))
    store.lock()
    return store


def read_store(folder: Path) -> Store:
    """Return the store in a folder, to read it.

    Raises
    ------
    InvalidParameter
        For a folder that has no study in it.
    """
    if not (folder / RESULTS).is_dir():
        raise InvalidParameter(f"study: {folder} has no {RESULTS}; needs the folder that `tarc study` wrote", "folder")
    return Store(folder, _opened_group(folder, "r"))


def _opened_group(folder: Path, mode: Literal["r", "r+"]) -> zarr.Group:
    """Open the dataset of a study, or refuse one that is damaged."""
    path = folder / RESULTS
    try:
        group = zarr.open_group(path, mode=mode, use_consolidated=False)
    except (OSError, ValueError, KeyError) as error:
        raise InvalidParameter(
            f"study: {path} cannot be read ({error}); remove {folder} and begin anew", "out"
        ) from None
    missing = [name for name in ("runs", "chunk", "laws", "content_hash", "source") if name not in group.attrs]
    if missing:
        raise InvalidParameter(
            f"study: {path} lacks the attributes {', '.join(missing)}, so that it is no study of `tarc study`, or "
            f"damaged; remove {folder} and begin anew",
            "out",
        )
    layout = group.attrs.get("layout")
    if layout != LAYOUT:
        raise InvalidParameter(
            f"study: {path} has the layout {layout}, and this version reads {LAYOUT}; choose another folder, or "
            f"continue with {group.attrs['source']} as it was",
            "out",
        )
    return group


def _check_same_study(store: Store, study: "Study") -> None:
    """Refuse the store of another study or version."""
    folder = store.folder
    source = str(store.attribute("source"))
    if source != f"tarc-control {__version__}":
        raise InvalidParameter(
            f"--out: {folder} was written by {source}, and this is tarc-control {__version__}, whose results may "
            "differ; choose another folder, or continue with that version",
            "out",
        )
    if store.attribute("content_hash") == study.content_hash:
        return
    if not study.is_extendable and study.model_copy(update={"runs": store.runs}).content_hash == store.attribute(
        "content_hash"
    ):
        raise InvalidParameter(
            f"--out: {folder} has this study with {store.runs} runs, and a Latin hypercube of {study.runs} has other "
            "draws; choose another folder, or the sampling sobol or independent, which more runs extend",
            "out",
        )
    raise InvalidParameter(
        f"--out: {folder} has another study in it (see its {CONTENT}), or a file that the study names has "
        "changed; choose another folder, or remove that one",
        "out",
    )


def _copied(store: Store, runs: int) -> None:
    """Write a dataset for more runs, in chunks for them, with all that a store has."""
    group = zarr.open_group(store.folder / PARTIAL, mode="w", zarr_format=2)
    group.attrs.update({**dict(store.group.attrs), "runs": runs, "chunk": rows_per_chunk(runs)})
    _write_index(group, runs)
    copy = Store(store.folder, group)
    for name, array in store.group.arrays():
        if name not in ("run", "law"):
            copy._array(name, array.ndim)[: store.runs] = array[:]


def _swap(folder: Path) -> None:
    """Put the new dataset in the place of the former one."""
    (folder / RESULTS).rename(folder / FORMER)
    (folder / PARTIAL).rename(folder / RESULTS)
    shutil.rmtree(folder / FORMER)


def _recover(folder: Path) -> None:
    """Finish what a kill between the steps of `_swap` has left."""
    if not (folder / FORMER).exists():
        return
    if (folder / RESULTS).exists():
        shutil.rmtree(folder / FORMER)
    else:
        (folder / FORMER).rename(folder / RESULTS)


def _write_index(group: zarr.Group, runs: int) -> None:
    """Write the coordinates."""
    laws = list(_attribute(group, "laws"))
    names = np.array(laws, dtype=f"<U{max(map(len, laws))}")
    for name, values in (("run", np.arange(runs)), ("law", names)):
        group.create_array(
            name,
            data=values,
            chunks=values.shape,
            fill_value=None,
            overwrite=True,
            attributes={"_ARRAY_DIMENSIONS": [name]},
        )


def _description(name: str) -> dict[str, str]:
    """Return label and unit of a variable."""
    if name in MEASURES:
        return {"long_name": MEASURES[name].label}
    labels = {
        "completed": {"long_name": "whether the run came to its end"},
        "end_time": {"long_name": "time of divergence, or the duration", "units": "s"},
        "seed": {"long_name": "seed of the run's noise"},
    }
    return labels.get(name, {"long_name": name.replace(":", " value of ")})


def _attribute(group: zarr.Group, name: str) -> Any:
    return group.attrs[name]
