"""Laws side by side: the same robot, reference, sensor, disturbances and seed for all."""

import csv
import io
import os
import warnings
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import DesignWarning, InvalidParameter, ScenarioError
from tarc.core.files import make_folder, writing
from tarc.core.progress import Progress
from tarc.core.units import unit_for_joints
from tarc.design.noise import measurement_deviation
from tarc.scenario.model import Scenario
from tarc.scenario.yaml_text import read_yaml
from tarc.simulation.quantities import JOINT_KINDS, MEASURES
from tarc.simulation.run import Run
from tarc.study.scaling import rescale

if TYPE_CHECKING:
    from matplotlib.figure import Figure


MEASURES_WITHOUT_COLUMN = ("peak_torque_rate", "rms_tde_error", "mean_gain", "peak_gain")
COLUMNS = {
    key: (measure.short_label, measure.scale, measure.unit)
    for key, measure in MEASURES.items()
    if key not in MEASURES_WITHOUT_COLUMN and not key.endswith(tuple(JOINT_KINDS.values()))
}
"""Label, scale and unit of each measure of a comparison."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """Runs of several laws in one scenario, with their measures.

    Attributes
    ----------
    scenario
        Their scenario.
    runs
        Runs by law, completed or diverged.
    failures
        Reasons by law where there is no run: a law that does not suit the robot, or a process that was killed.
    """

    scenario: Scenario
    runs: dict[str, Run]
    failures: dict[str, str]

    @property
    def measures(self) -> dict[str, dict[str, float]]:
        """Measures of `COLUMNS` by law; empty for a run that ended before they begin."""
        result = {}
        for name, run in self.runs.items():
            long_enough = float(run.data["time"].values[-1]) > self.scenario.metrics_start + self.scenario.period
            measures = (
                run.metrics(start_time=self.scenario.metrics_start) if run.status.completed and long_enough else {}
            )
            result[name] = {key: measures[key] for key in COLUMNS if key in measures}
        return result

    @property
    def columns(self) -> dict[str, tuple[str, float, str]]:
        """`COLUMNS` in the units of the robot's joints."""
        if {run.joint_units for run in self.runs.values()} != {("m",)}:
            return COLUMNS
        return {key: (label, scale, unit_for_joints(unit, ("m",))) for key, (label, scale, unit) in COLUMNS.items()}

    @property
    def unstable(self) -> dict[str, str]:
        """Laws that are unstable at rest in a posture of the reference, each with that posture and the remedy.

        A law with a model of the robot, or with gains that differ between the joints, is checked in eight postures.
        The check leaves out robots with passive joints, and laws that have no slope at rest.
        """
        return {name: run.instability for name, run in self.runs.items() if run.instability}

    @property
    def front(self) -> list[str]:
        """Laws that no other beats in both RMS error and torque variation, by error; none that is unstable at rest."""
        points = {
            name: (measures["rms_error"], measures["torque_variation"])
            for name, measures in self.measures.items()
            if measures and name not in self.unstable
        }
        best = [
            name
            for name, (error, variation) in points.items()
            if not any(e <= error and v <= variation and (e, v) != (error, variation) for e, v in points.values())
        ]
        return sorted(best, key=lambda name: points[name])

    def status_in_words(self, name: str) -> str:
        """Return how the run of a law ended, and whether its loop is unstable at rest."""
        return f"{self.runs[name].status}{', unstable at rest' if name in self.unstable else ''}"

    def __repr__(self) -> str:
        failed = f", failed: {', '.join(self.failures)}" if self.failures else ""
        failed += f", unstable at rest: {', '.join(self.unstable)}" if self.unstable else ""
        return f"<Comparison in {self.scenario.name}: {', '.join(self.runs)}{failed}; front: {', '.join(self.front)}>"

    def _repr_html_(self) -> str:
        heads = "".join(f"<th>{escape(label)} [{escape(unit)}]</th>" for label, _, unit in self.columns.values())
        rows = []
        for name, measures in self.measures.items():
            cells = [
                f"{scale * measures[key]:.4g}" if key in measures else "–" for key, (_, scale, _) in COLUMNS.items()
            ]
            rows.append(f"<tr><td>{escape(name)}</td>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>")
        return f"<table><tr><th>law</th>{heads}</tr>{''.join(rows)}</table>"

    def to_csv(self) -> str:
        """Return a table with one line per law, in SI units, header first."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["law", "status", *COLUMNS])
        for name, measures in self.measures.items():
            writer.writerow([name, self.status_in_words(name), *(measures.get(key, "") for key in COLUMNS)])
        for name, reason in self.failures.items():
            writer.writerow([name, f"failed: {reason}", *("" for _ in COLUMNS)])
        return text.getvalue()

    def to_latex(self) -> str:
        """Return a table in LaTeX, for a paper; it needs the package booktabs."""
        heads = " & ".join(["law", *(f"{label} [{unit}]" for label, _, unit in self.columns.values())])
        rules = [r"\begin{tabular}{l" + "r" * len(COLUMNS) + "}", r"\toprule"]
        lines = [*rules, heads.replace("%", r"\%") + r" \\", r"\midrule"]
        for name, measures in self.measures.items():
            cells = [
                f"{scale * measures[key]:.4g}" if key in measures else "--" for key, (_, scale, _) in COLUMNS.items()
            ]
            lines.append(" & ".join([name, *cells]).replace("_", r"\_") + r" \\")
        return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])

    def plot(self, style: str = "plane") -> "Figure":
        """Return a figure.

        Parameters
        ----------
        style
            ``plane``: RMS error against torque variation, with the Pareto front. ``side``: error and torque of every
            law. ``gain``: gain and ‖s‖ of the laws that adapt one.

        Raises
        ------
        InvalidParameter
            For an unknown style.
        """
        from tarc.plotting.comparison import FIGURES

        return FIGURES[check.one_of("style", style, FIGURES)](self)

    def save(self, folder: str | Path, figures: bool = True) -> list[Path]:
        """Write trajectories (netCDF), table (CSV, LaTeX) and figures into a folder; return the files.

        Raises
        ------
        InvalidParameter
            For a folder that cannot be written.
        """
        place = make_folder("save", folder)
        written = [place / "comparison.csv", place / "comparison.tex"]
        with writing("save", place):
            written[0].write_text(self.to_csv(), encoding="utf-8")
            written[1].write_text(self.to_latex(), encoding="utf-8")
        written += [run.save(place / f"{name}.nc") for name, run in self.runs.items()]
        if figures and any(self.measures.values()):
            from tarc.plotting.comparison import FIGURES

            for kind in FIGURES:
                picture = place / f"{kind}.png"
                self.plot(kind).savefig(picture, dpi=110)
                written.append(picture)
        return written


TUNED_PERIOD = 1e-3
"""Control period [s] of the scenarios for which the gains were tuned."""

TUNED_NOISE = 5e-5
"""Standard deviation of their measured positions [rad or m]: that of an encoder with 15 bits."""


def tuned_laws(period: float = TUNED_PERIOD, noise: float = TUNED_NOISE) -> dict[str, dict[str, Any]]:
    """Return laws by name, as a scenario writes them, with the gains that `tune` found under equal conditions.

    Parameters
    ----------
    period, noise
        Control period [s], and standard deviation of the measured position [rad or m]. The gains were found for 1 ms
        and an encoder of 15 bits. For others they are the same in units of period and noise, see `rescale`.
    """
    text = files("tarc.study").joinpath("gains.yaml").read_text(encoding="utf-8")
    laws = read_yaml(text, "gains.yaml")["laws"]
    return {name: rescale(law, TUNED_PERIOD, period, noise / TUNED_NOISE) for name, law in laws.items()}


def laws_for(scenario: Scenario) -> dict[str, dict[str, Any]]:
    """Return the tuned laws as they are at a period of 1 ms, else in units of the scenario's period and noise."""
    if abs(scenario.period - TUNED_PERIOD) < 1e-9:
        return tuned_laws()
    deviation = measurement_deviation(scenario.sections.sensor.build(), scenario.build_plant().n_joints)
    noise = float(np.max(deviation))
    return tuned_laws(scenario.period, noise or TUNED_NOISE)


def compare(
    scenario: Scenario,
    laws: Iterable[str] | dict[str, dict[str, Any]] | None = None,
    *,
    jobs: int | None = None,
    progress: bool | None = None,
) -> Comparison:
    """Run several laws in one scenario, one after the other or in several processes.

    Parameters
    ----------
    scenario
        Robot, reference, sensor, disturbances, seed.
    laws
        Names out of `tuned_laws`, or laws by name, as a scenario writes them; None for the scenario's.
    jobs
        Number of processes; None for one per core, 1 for this process alone.
    progress
        Show a progress bar when it takes more than two seconds; None for when standard error is a terminal.

    Returns
    -------
    Comparison
        The laws that could run; the reasons of the others are in its ``failures``.

    Raises
    ------
    InvalidParameter
        For an unknown law, and for an empty list.
    """
    check_comparable(scenario)
    parts = _chosen(scenario, laws)
    count = check.integer("jobs", min(os.cpu_count() or 1, len(parts)) if jobs is None else jobs, 1)
    tasks = {name: (scenario.model_dump(), name, part) for name, part in parts.items()}
    results: dict[str, Run | str] = {}
    with Progress(f"comparing {len(tasks)} laws", len(tasks), progress) as bar:
        if count == 1:
            for name, task in tasks.items():
                results[name] = run_one(*task)
                bar.advance()
        else:
            with ProcessPoolExecutor(count, mp_context=get_context("spawn")) as pool:
                futures = {pool.submit(run_one, *task): name for name, task in tasks.items()}
                for future in as_completed(futures):
                    try:
                        results[futures[future]] = future.result()
                    except BrokenProcessPool:
                        results[futures[future]] = "its process was killed, perhaps for lack of memory; use fewer jobs"
                    bar.advance()
    runs = {name: run for name in parts if isinstance(run := results[name], Run)}
    return Comparison(scenario, runs, {name: why for name in parts if isinstance(why := results[name], str)})


def check_comparable(scenario: Scenario) -> None:
    """Check that one error and one torque variation stand for all joints.

    Raises
    ------
    InvalidParameter
        For a robot with revolute and prismatic joints, whose errors have no sum.
    """
    plant = scenario.build_plant()
    kinds = {
        unit: [name for name, own in zip(plant.joint_names, plant.units, strict=True) if own == unit]
        for unit in plant.units
    }
    if len(kinds) > 1:
        listing = " and ".join(f"{', '.join(names)} in {unit}" for unit, names in kinds.items())
        raise InvalidParameter(
            f"robot: its joints are {listing}, so that their errors have no sum to rank laws by; drive joints of one "
            "kind (joints), or compare the measures of each kind by tarc run",
            "robot",
        )


def choose_laws(
    scenario: Scenario, names: list[str] | None, gains: dict[str, dict[str, Any]]
) -> dict[str, dict[str, Any]]:
    """Return laws by name from a file of gains, the scenario and the tuned laws, in this order.

    Parameters
    ----------
    scenario
        The scenario that they run in.
    names
        Their names; None for all, and none for those of the file, else those of the scenario.
    gains
        Laws by name of the file; empty for none.

    Raises
    ------
    InvalidParameter
        For an unknown name.
    """
    if names is not None and not names:
        return gains or scenario.laws
    tuned = laws_for(scenario)
    if names is None:
        return {**tuned, **gains}
    return _named(names, {**tuned, **scenario.laws, **gains})


def _chosen(scenario: Scenario, laws: Iterable[str] | dict[str, dict[str, Any]] | None) -> dict[str, dict[str, Any]]:
    if laws is None:
        return scenario.laws
    if isinstance(laws, dict):
        return laws
    return _named(laws, {**laws_for(scenario), **scenario.laws})


def _named(laws: Iterable[str], laws_by_name: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return laws by name in the order of the names."""
    names = list(dict.fromkeys(laws))
    for name in names:
        check.one_of("laws", name, laws_by_name)
    if not names:
        raise InvalidParameter(f"laws: got none; known are {', '.join(laws_by_name)}")
    return {name: laws_by_name[name] for name in names}


def run_one(content: dict[str, Any], name: str, part: dict[str, Any]) -> Run | str:
    """Return the run of one law in a scenario, or the reason why there is none."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore", DesignWarning)  # the table shows the result
        try:
            scenario = Scenario.parse({**content, "law": {**part, "label": name}})
            return next(iter(scenario.run(progress=False).values()))
        except (InvalidParameter, ScenarioError) as error:
            return str(error).splitlines()[0]
