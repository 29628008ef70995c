"""Run a study: integration and engines chosen once, then chunk by chunk into its folder."""

import platform
import sys
import warnings
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tarc.core import validation as check
from tarc.core.allocator import keep_freed_memory
from tarc.core.errors import (
    CompilationError,
    DesignWarning,
    EngineWarning,
    InvalidParameter,
    JointLimitWarning,
    MissingTool,
    UnsupportedLaw,
)
from tarc.core.progress import Progress
from tarc.core.types import Array
from tarc.plants.symbolic import SymbolicPlant
from tarc.simulation.integration import Integration
from tarc.simulation.sampled_inputs import initial_conditions
from tarc.simulation.simulator import PILOT_PERIODS, min_substeps
from tarc.study.cases import Cases
from tarc.study.compiled_engine import COMPILED, LANES, CompiledEngine
from tarc.study.draws import Draws, run_seeds
from tarc.study.engines import MUJOCO, VIRTUAL_MACHINE, Engine, SideBySide, Simulator
from tarc.study.scheduling import check_place, run_chunks
from tarc.study.store import TRACES, Store, open_store
from tarc.study.study_result import StudyResult

if TYPE_CHECKING:
    from tarc.study.specification import Study

ENGINES = ("auto", VIRTUAL_MACHINE, COMPILED, LANES, MUJOCO)
"""Names of engines."""

SHORT_STUDY = 2e5
"""Control periods of all runs below which ``auto`` takes the virtual machine, since compiling takes as long."""

LONG_REMAINDER = 1e7
"""Control periods that are left from which a study that the virtual machine has begun is worth another folder."""

REFUSALS = (UnsupportedLaw, MissingTool, CompilationError)
"""Why a law does not run in machine code."""

FIRST_DRAWS = 3
"""First draws with which the integration is chosen, beside the least and the greatest value of each key."""


def run_study(
    study: "Study",
    folder: str | Path | None = None,
    *,
    engine: str = "auto",
    jobs: int | None = None,
    scheduler: str = "",
    progress: bool | None = None,
) -> StudyResult:
    """Run what is left of a study into a folder; the parameters are those of `Study.run`."""
    check_engine(engine)
    check_place(jobs, scheduler)
    place = Path("runs") / f"{study.name}.study" if folder is None else Path(folder)
    draws = study.draw()
    with open_store(place, study) as store, warnings.catch_warnings():
        warnings.simplefilter("ignore", DesignWarning)  # the results show it
        warnings.simplefilter("ignore", JointLimitWarning)
        integration = stored_integration(store, study, draws)
        if store.n_pending(draws):
            bar = Progress(f"running {study.name}", store.runs, progress, unit="runs")
            if bar.show:
                print("preparing: a loop that is new here is compiled first, which takes some seconds", file=sys.stderr)
            built = _engine_to_go_on(store, study, integration, engine)
            recipe = EngineRecipe(study, integration, compiled_laws(built), 1 if engine == COMPILED else None)
            _run_pending(store, draws, built, recipe, jobs, scheduler, bar)
        store.consolidate()
        write_traces(study, draws, integration, store)
    return StudyResult.open(place)


def _run_pending(
    store: Store,
    draws: Draws,
    engine: Engine,
    recipe: "EngineRecipe",
    jobs: int | None,
    scheduler: str,
    progress: Progress,
) -> None:
    """Run what is not finished, and store each chunk as it is complete."""
    finished = store.n_finished
    with progress as bar:
        bar.advance(finished)
        pending, left = store.pending(draws), store.n_pending(draws)
        results = run_chunks(engine, recipe, pending, left, jobs=jobs, scheduler=scheduler, advance=bar.advance)
        with closing(results):
            for chunk, result in results:
                store.write(chunk, draws, result)


def _engine_to_go_on(store: Store, study: "Study", integration: Integration, engine: str) -> Engine:
    """Return the engine of a study, and store its name for each law; ``auto`` keeps the one that has begun."""
    begun: dict[str, str] = store.attribute("engines") or {}
    if engine != "auto" or not begun or not store.n_finished:
        built = build_engine(study, integration, engine)
    else:
        compiled = tuple(law for law, name in begun.items() if name.split(", ")[0] in (COMPILED, LANES))
        lanes = 1 if COMPILED in begun.values() else None
        try:
            built = EngineRecipe(study, integration, compiled, lanes)()
        except REFUSALS as error:
            raise InvalidParameter(
                f"engine: {store.n_finished} runs are finished, by {', '.join(dict.fromkeys(begun.values()))}, which "
                f"does not work now: {error}. --engine '{VIRTUAL_MACHINE}' goes on, with results that may differ in "
                "the last digits",
                "engine",
            ) from None
        scenario = study.undrawn_scenario
        left = (store.runs - store.n_finished) * scenario.duration / scenario.period
        if VIRTUAL_MACHINE in begun.values() and left > LONG_REMAINDER:
            warnings.warn(
                f"{store.folder} goes on in the virtual machine, which has begun it; if that takes too long, run the "
                "study into a new folder, in machine code",
                EngineWarning,
                stacklevel=2,
            )
    engines = engine_names(built, study.law_names)
    if store.n_finished:
        engines = {law: ", ".join(dict.fromkeys([begun.get(law, name), name])) for law, name in engines.items()}
    store.set_attributes(engines=engines)
    return built


def engine_names(engine: Engine, laws: Sequence[str]) -> dict[str, str]:
    """Return the name of the engine of each law."""
    if not isinstance(engine, SideBySide):
        return dict.fromkeys(laws, engine.name)
    return {laws[place]: part.name for part, places in engine.engines for place in places}


def check_engine(engine: str) -> None:
    """Refuse an unknown engine."""
    check.one_of("engine", engine, ENGINES)


def build_engine(study: "Study", integration: Integration, engine: str) -> Engine:
    """Return the engine of all laws of a study; workers make theirs by an `EngineRecipe`.

    Raises
    ------
    InvalidParameter
        For an engine that does not simulate the robot.
    """
    cases = Cases(study)
    simulator = Simulator(cases, integration)
    scenario = cases.scenario
    is_short = study.runs * scenario.duration / scenario.period < SHORT_STUDY
    if engine == simulator.name or (engine == "auto" and (is_short or simulator.name == MUJOCO)):
        return simulator
    if engine in (VIRTUAL_MACHINE, MUJOCO):
        raise InvalidParameter(f"engine: got {engine!r}; the robot is simulated by {simulator.name}", "engine")
    lanes = 1 if engine == COMPILED else None
    if engine != "auto":
        return CompiledEngine(cases, integration, cases.law_names, lanes)
    return _fastest(cases, integration, lanes)


@dataclass(frozen=True)
class EngineRecipe:
    """Makes the engine of a study in a worker, with the kind of engine that was chosen for each law.

    A worker that cannot compile raises an error: it does not choose another engine, since the results would differ.

    Attributes
    ----------
    study, integration
        The study, and its method and steps.
    compiled
        Names of the laws in machine code.
    lanes
        Runs side by side; None for as many as a vector of the worker's processor holds.
    """

    study: "Study"
    integration: Integration
    compiled: tuple[str, ...] = ()
    lanes: int | None = None

    def __call__(self) -> Engine:
        """Return the engine."""
        cases = Cases(self.study)
        if not self.compiled:
            return Simulator(cases, self.integration)
        keep_freed_memory()
        return _joined(cases, self.integration, CompiledEngine(cases, self.integration, self.compiled, self.lanes))


def compiled_laws(engine: Engine) -> tuple[str, ...]:
    """Return the names of the laws that an engine runs in machine code."""
    parts = [part for part, _ in engine.engines] if isinstance(engine, SideBySide) else [engine]
    return tuple(law for part in parts if isinstance(part, CompiledEngine) for law in part.laws)


def _joined(cases: Cases, integration: Integration, fast: CompiledEngine) -> Engine:
    """Return an engine in machine code beside the virtual machine for the laws that it does not run."""
    places = {law: number for number, law in enumerate(cases.law_names)}
    slow = [law for law in places if law not in fast.laws]
    if not slow:
        return fast
    parts: list[tuple[Engine, list[int]]] = [
        (fast, [places[law] for law in fast.laws]),
        (Simulator(cases, integration, slow), [places[law] for law in slow]),
    ]
    return SideBySide(parts, len(places))


def _fastest(cases: Cases, integration: Integration, lanes: int | None) -> Engine:
    """Return an engine in machine code for the laws that have one, beside the virtual machine for the others."""
    slow: dict[str, str] = {}
    fast: CompiledEngine | None = None
    try:
        fast = CompiledEngine(cases, integration, [], lanes)
        for law in cases.law_names:
            try:
                fast.add(law)
            except REFUSALS as error:
                slow[law] = str(error)
    except REFUSALS as error:
        slow = dict.fromkeys(cases.law_names, str(error))
    for reason in dict.fromkeys(slow.values()):
        names = ", ".join(law for law, why in slow.items() if why == reason)
        warnings.warn(f"{names}: simulated in the virtual machine ({reason})", EngineWarning, stacklevel=2)
    if fast is None or not fast.laws:
        return Simulator(cases, integration)
    return _joined(cases, integration, fast)


def stored_integration(store: Store, study: "Study", draws: Draws) -> Integration:
    """Return the integration of the study: the stored one, or one that is chosen now and stored."""
    present = store.attribute("integration")
    if present is not None:
        return Integration(str(present["integrator"]), int(present["substeps"]))
    cases = Cases(study)
    for run in pilot_runs(draws):
        cases.build(draws.values[run])  # a part refuses its least or greatest value now, and not after hours
    chosen = choose_study_integration(cases, draws)
    plant = cases.nominal.simulated
    command = {unit for unit in plant.torque_units if not unit.startswith("N")}
    store.set_attributes(
        integration={"integrator": chosen.integrator, "substeps": chosen.substeps},
        joint_units=list(dict.fromkeys(plant.units)),
        command_unit=command.pop() if len(command) == 1 else "",
        host=platform.platform(),
    )
    return chosen


def choose_study_integration(cases: Cases, draws: Draws) -> Integration:
    """Return the method and steps of all runs of a study.

    It is the finest of those that `simulate` would choose in some pilots. The first law has the first draws, and those
    with the least and the greatest value of each key. The other laws have the first draw.
    """
    scenario, nominal = cases.scenario, cases.nominal.simulated
    if not isinstance(nominal, SymbolicPlant):
        return Integration(MUJOCO, scenario.substeps or min_substeps(nominal, scenario.period))
    if scenario.substeps is not None:
        return Integration("Runge–Kutta", scenario.substeps)
    simulator = Simulator(cases, Integration("midpoint", 1))
    pilots = [(int(run), cases.law_names[0]) for run in pilot_runs(draws)]
    pilots += [(0, law) for law in cases.law_names[1:]]
    chosen = Integration("midpoint", 1)
    for run, law in pilots:
        candidate = _pilot(simulator, draws.values[run], int(run), law)
        chosen = max(chosen, candidate, key=lambda method: (method.integrator != "midpoint", method.substeps))
    return chosen


def pilot_runs(draws: Draws) -> Array:
    """Return the numbers of the runs with which the integration is chosen; each text is in one of them."""
    values = draws.values
    first = np.arange(min(FIRST_DRAWS, len(values)))
    columns = [draws.keys.index(key) for key in draws.texts]
    texts = [np.unique(values[:, column], return_index=True)[1] for column in columns]
    return np.unique(np.concatenate([first, np.argmin(values, axis=0), np.argmax(values, axis=0), *texts]))


def _pilot(simulator: Simulator, row: Array, seed: int, law: str) -> Integration:
    """Return the integration that `simulate` would choose for one run."""
    case = simulator.cases.build(row)
    scenario = simulator.cases.scenario
    simulation = simulator.prepared(case, case.setup.laws[law], seed)
    duration = min(scenario.duration, PILOT_PERIODS * scenario.period)
    inputs = simulation.sample(1, duration)
    plant = simulation.plant
    assert isinstance(plant, SymbolicPlant)
    initial = initial_conditions(plant, inputs, case.initial_position, case.initial_velocity, case.initial_torque)
    return simulation.choose_method(plant, initial, duration)


def write_traces(study: "Study", draws: Draws, integration: Integration, store: Store) -> None:
    """Write the trajectories of the chosen runs that are not there yet, law by law."""
    missing = [
        (run, number, law)
        for run in study.traced_runs
        for number, law in enumerate(study.law_names)
        if not (store.folder / TRACES / f"{run}-{number}.nc").is_file()
    ]
    simulator = Simulator(Cases(study), integration) if missing else None
    for run, number, law in missing:
        assert simulator is not None
        simulator.trace(draws.values[run], int(run_seeds(draws.seed, np.array([run]))[0]), law).save(
            store.folder / TRACES / f"{run}-{number}.nc"
        )
