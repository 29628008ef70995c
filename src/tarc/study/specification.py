"""The YAML file that describes a study: a scenario, what is drawn, how many runs."""

import copy
import hashlib
import json
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter, ScenarioError
from tarc.core.files import save_text
from tarc.core.types import Array
from tarc.scenario.loader import find_scenario, read_scenario, relative_files, resolve_files
from tarc.scenario.model import Scenario
from tarc.scenario.schema import scenario_error
from tarc.scenario.yaml_text import write_yaml
from tarc.study.distributions import Distribution, read_distribution
from tarc.study.drawn_keys import find_key
from tarc.study.draws import EXTENDABLE, SAMPLINGS, Draws, checked_correlation, draw, unit_points, values_at
from tarc.study.execution import run_study

if TYPE_CHECKING:
    from tarc.study.study_result import StudyResult

MAX_RUNS = 100_000_000
MAX_TRACES = 1000
MAX_SEED = 2**63 - 1
ROBOT_FILE = "robot.file"
"""Key of the file of a robot."""

LAWS_KNOW = ("robot", "reference")
"""Sections from which laws are built."""


class Study(BaseModel):
    """Many runs of one scenario with drawn values, read from YAML by `load` and from a dictionary by `parse`.

    Attributes
    ----------
    scenario
        Name of a shipped scenario, the path of a file, or the keys of a scenario themselves.
    draws
        Distributions by key. A key is any number of the scenario, such as ``robot.payload``, ``robot.viscous.0`` for
        the first joint, ``disturbance.0.mass`` or ``sensor.noise``. ``law.natural_frequency`` is that of every law that
        has it, ``law.1.natural_frequency`` that of the second law. A distribution is one of
        ``{uniform: [low, high]}``, ``{log_uniform: [low, high]}``,
        ``{normal: {mean: …, deviation: …, low: …, high: …}}`` with optional bounds, and
        ``{choice: [a, b], weights: [1, 3]}`` with optional weights.
    name
        Name of the results' folder.
    laws
        Laws in place of the scenario's, as a list of the scenario's ``law``; all have the same draws.
    runs
        Number of runs per law.
    seed
        Seed of the draws and of the runs.
    sampling
        ``latin_hypercube``, ``sobol`` or ``independent``. A Latin hypercube belongs to its number of runs. With the
        others, more runs keep the first ones.
    correlation
        ``keys``, and the ``matrix`` of the correlations of their normal scores (Gaussian copula).
    known
        Drawn keys of the robot or the reference with which the laws are built. By default laws are those of the
        scenario as written: M̂ is of the robot without draws.
    traces
        Number of runs, from the first on, of which the trajectories are kept, or a list of their numbers.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    scenario: str | dict[str, Any]
    draws: dict[str, Any]
    name: str = "study"
    laws: list[dict[str, Any]] | None = None
    runs: int = 1000
    seed: int = 0
    sampling: str = "latin_hypercube"
    correlation: dict[str, Any] | None = None
    known: list[str] = Field(default_factory=list)
    traces: int | list[int] = 0

    @classmethod
    def parse(cls, content: object, label: str = "study", folder: Path | None = None) -> Self:
        """Check a dictionary and return its study.

        Parameters
        ----------
        content
            Keys and values, as in the attributes.
        label
            Name of the source, for the messages.
        folder
            Folder from which files are named; None for the working directory.

        Raises
        ------
        ScenarioError, InvalidParameter
            For each key at fault: what came and what is allowed. ``path`` is its place.
        """
        if not isinstance(content, dict):
            kind = type(content).__name__
            raise ScenarioError(f"{label}: got {kind}; needs keys and values, such as scenario: and draws:")
        if "scenario" not in content and "robot" in content:
            raise ScenarioError(
                f"{label}: this is a scenario; a study names it under scenario: and what varies under draws:. "
                "`tarc study --example > study.yaml` writes one to start from",
                "scenario",
            )
        place = Path.cwd() if folder is None else folder
        content = {**content, "scenario": _scenario_content(content.get("scenario"), place)}
        if "draws" in content:
            content["draws"] = _with_paths(content["draws"], place)
        if content.get("laws"):
            laws = {"law": copy.deepcopy(content["laws"])}
            resolve_files(laws, place)
            content["laws"] = laws["law"]
        try:
            study = cls(**content)
        except ValidationError as error:
            raise scenario_error(error, cls, "", label) from None
        study._check()
        return study

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a YAML file.

        Raises
        ------
        ScenarioError, InvalidParameter
            For a file that is not there or cannot be read, and as in `parse`.
        """
        file = Path(path).expanduser()
        if not file.is_file():
            raise ScenarioError(
                f"study: {str(path)!r} not found; looked for {file.resolve()}. "
                "`tarc study --example > study.yaml` writes one to start from"
            )
        return cls.parse(read_scenario(file), str(file), file.parent)

    def with_runs(self, runs: int) -> Self:
        """Return the same study with another number of runs.

        Raises
        ------
        InvalidParameter
            For no whole number of at least one, and for less runs than the largest number of ``traces`` needs.
        """
        study = self.model_copy(update={"runs": check.integer("runs", runs, 1, MAX_RUNS)})
        study._check()
        return study

    def model_copy(self, **options: Any) -> Self:
        """Copy the study; what follows from its keys is computed again."""
        copied = super().model_copy(**options)
        for name in ("undrawn_scenario", "distributions", "traced_runs"):
            vars(copied).pop(name, None)
        return copied

    def __getstate__(self) -> dict[Any, Any]:
        """Return what another process needs; it computes what follows again."""
        state = super().__getstate__()
        return {**state, "__dict__": {name: getattr(self, name) for name in type(self).model_fields}}

    @cached_property
    def undrawn_scenario(self) -> Scenario:
        """The scenario as written, with the study's laws."""
        assert isinstance(self.scenario, dict)
        laws = {} if self.laws is None else {"law": self.laws}
        return Scenario.parse({**self.scenario, **laws}, "scenario")

    @cached_property
    def distributions(self) -> dict[str, Distribution]:
        """Distributions by key, checked."""
        return {str(key): read_distribution(f"draws.{key}", given) for key, given in self.draws.items()}

    @property
    def law_names(self) -> list[str]:
        """Names of the laws."""
        return list(self.undrawn_scenario.laws)

    @cached_property
    def traced_runs(self) -> tuple[int, ...]:
        """Numbers of the runs of which trajectories are kept."""
        if isinstance(self.traces, int):
            check.integer("traces", self.traces, 0, MAX_TRACES)
            return tuple(range(min(self.traces, self.runs)))
        for number in self.traces:
            check.integer("traces", number, 0, self.runs - 1)
        return tuple(sorted(set(self.traces)))

    @property
    def is_extendable(self) -> bool:
        """Whether more runs keep the first ones."""
        return self.sampling in EXTENDABLE

    def draw(self) -> Draws:
        """Draw the values and seeds of all runs."""
        return draw(self.distributions, self.runs, self.seed, self.sampling, self._correlation)

    def points(self) -> Array:
        """Return the points of the unit cube from which the values of all runs are made, (runs, keys)."""
        return unit_points(self.runs, len(self.distributions), self.seed, self.sampling)

    def values_at(self, points: Array) -> Array:
        """Return the values of the keys at points of the unit cube, (k, keys).

        Raises
        ------
        InvalidParameter
            For a distribution that gives a value that is no finite number.
        """
        return values_at(self.distributions, points, self._correlation)

    def run(
        self,
        folder: str | Path | None = None,
        *,
        engine: str = "auto",
        jobs: int | None = None,
        scheduler: str = "",
        progress: bool | None = None,
    ) -> "StudyResult":
        """Run the study, or what is left of it, into a folder; results are stored chunk by chunk.

        Parameters
        ----------
        folder
            Folder of the results; None for ``runs/NAME.study``. One with this study in it is continued.
        engine
            ``auto``, ``virtual machine``, ``compiled``, ``lanes`` or ``MuJoCo``.
        jobs
            Number of processes; None for one per core.
        scheduler
            Address of a Dask scheduler, such as ``tcp://10.0.0.1:8786``; empty for this machine.
        progress
            Show rate and time left; None for when standard error is a terminal.

        Raises
        ------
        InvalidParameter
            For a folder that cannot be written or has another study in it, and a draw that does not reach its part.
        KeyboardInterrupt
            For Ctrl-C; what was finished is kept, and the same call continues.
        ClusterError
            When the scheduler does not answer or is lost, and when runs kill one worker after another.
        """
        return run_study(self, folder, engine=engine, jobs=jobs, scheduler=scheduler, progress=progress)

    @property
    def _correlation(self) -> tuple[tuple[str, ...], Array] | None:
        checked = checked_correlation(self.correlation, list(self.distributions))
        for name in checked[0] if checked else ():
            if self.distributions[name].texts:
                raise InvalidParameter(
                    f"correlation.keys: {name} is a choice of texts, which have no order; leave it out",
                    "correlation.keys",
                )
        return checked

    def _check(self) -> None:
        """Refuse what the types of the keys allow and a study does not."""
        check.integer("runs", self.runs, 1, MAX_RUNS)
        check.integer("seed", self.seed, 0, MAX_SEED)
        check.one_of("sampling", self.sampling, SAMPLINGS)
        if self.laws is not None and not self.laws:
            raise InvalidParameter("laws: got an empty list; needs one law or more, or leave it out", "laws")
        if not self.draws:
            raise InvalidParameter(
                "draws: got none; needs at least one key of the scenario, such as robot.payload: {uniform: [0, 3]}",
                "draws",
            )
        scenario = self.undrawn_scenario
        keys = [find_key(scenario, name) for name in self.distributions]
        for number, key in enumerate(keys):
            for other in keys[:number]:
                if key.overlaps(other):
                    raise InvalidParameter(
                        f"draws.{key.name}: it is the same number as {other.name}; draw one of them",
                        f"draws.{key.name}",
                    )
        _ = self._correlation, self.traced_runs
        for name in self.known:
            check.one_of("known", name, self.distributions)
            if name.split(".")[0] not in LAWS_KNOW:
                raise InvalidParameter(
                    f"known: got {name!r}; laws are built from {' and '.join(LAWS_KNOW)} alone", "known"
                )

    def to_dict(self) -> dict[str, Any]:
        """Return the keys and values, without what is at its default."""
        content = self.model_dump(mode="json", exclude_defaults=True)
        return {"name": self.name, **content, "runs": self.runs, "seed": self.seed, "sampling": self.sampling}

    def to_yaml(self, folder: str | Path | None = None) -> str:
        """Return the study as YAML, with the whole scenario in it.

        Parameters
        ----------
        folder
            Folder of the file to be, from which other files are named; None for the working directory.
        """
        content = self.to_dict()
        place = Path.cwd() if folder is None else Path(folder)
        relative_files(content["scenario"], place)
        if self.laws is not None:
            relative_files({"law": content["laws"]}, place)
        return write_yaml(content)

    def save(self, path: str | Path) -> Path:
        """Write the study as a YAML file.

        Raises
        ------
        InvalidParameter
            For a folder that does not exist, and a file that cannot be written.
        """
        return save_text("save", path, self.to_yaml(Path(path).parent))

    @property
    def content_hash(self) -> str:
        """Hash of all that decides the results, the files of robot and laws included.

        The number of runs counts only where more runs change the first ones; name and traces do not count.
        """
        content = self.to_dict()
        for name in ("name", "traces", *(("runs",) if self.is_extendable else ())):
            content.pop(name, None)
        content["scenario"].pop("name", None)
        text = json.dumps(_with_file_contents(content), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


def _scenario_content(given: object, folder: Path) -> Any:
    """Return the keys of a scenario that is given by name, by path or by its keys, with absolute paths of files."""
    if isinstance(given, str):
        beside = folder / given
        file = beside if beside.is_file() else find_scenario(given)
        given, folder = read_scenario(file), file.parent
    if isinstance(given, dict):
        given = copy.deepcopy(given)
        resolve_files(given, folder)
    return given


def _with_paths(draws: Any, folder: Path) -> Any:
    """Return draws with the absolute paths of robots' files beside the study."""
    given = draws.get(ROBOT_FILE) if isinstance(draws, dict) else None
    if not isinstance(given, dict) or not isinstance(given.get("choice"), list):
        return draws
    files = [
        str((folder / name).resolve()) if isinstance(name, str) and (folder / name).is_file() else name
        for name in given["choice"]
    ]
    return {**draws, ROBOT_FILE: {**given, "choice": files}}


def _with_file_contents(node: object) -> object:
    """Return content in which the path of each file is replaced by the hash of what is in it."""
    if isinstance(node, dict):
        return {key: _with_file_contents(child) for key, child in node.items()}
    if isinstance(node, list):
        return [_with_file_contents(child) for child in node]
    if isinstance(node, str) and ("/" in node or "\\" in node):
        path, _, rest = node.partition(".py:")
        file = Path(f"{path}.py" if rest else path)
        if file.is_file():
            return f"{hashlib.sha256(file.read_bytes()).hexdigest()}:{rest}"
    return node
