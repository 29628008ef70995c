"""`diagnose`: what a log of a control loop says about encoders, delay, torque limits and the certificate."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.design.noise import measurement_deviation
from tarc.laws.base import Law
from tarc.logs.command_delay import CommandDelay, command_delay
from tarc.logs.encoder_check import EncoderCheck, check_encoders
from tarc.logs.findings import Finding, findings_of
from tarc.logs.limit_cycles import LimitCycle, find_limit_cycles
from tarc.logs.loop_checks import Assumption, LoopTiming, TorqueUse, check_assumptions, loop_timing, torque_use
from tarc.logs.loop_log import LoopLog
from tarc.scenario.model import Scenario
from tarc.scenario.parts import Setup
from tarc.simulation.run import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, kw_only=True, eq=False)
class Diagnosis:
    """What a log shows.

    Attributes
    ----------
    log
        The rows that were used.
    encoders
        Step, noise, gaps and jitter.
    assumed_noise
        Deviation of the position in the design [rad or m], shape (n,); None without a scenario.
    delay
        From the law's torque to the measured motion; None without a scenario, and where nothing moves.
    assumed_delay
        Delay that the certificate covers [periods]; None without a scenario.
    torque
        Shares of saturation.
    timing
        Deadlines on a machine; None for a simulated run.
    limit_cycles
        Sustained oscillations.
    assumptions
        The certificate's, each with the share of the periods in which it was left.
    findings
        What is wrong and what to change; empty where nothing is.
    """

    log: LoopLog
    encoders: EncoderCheck
    assumed_noise: Array | None
    delay: CommandDelay | None
    assumed_delay: float | None
    torque: TorqueUse
    timing: LoopTiming | None
    limit_cycles: tuple[LimitCycle, ...]
    assumptions: tuple[Assumption, ...]
    findings: tuple[Finding, ...]

    @property
    def is_clean(self) -> bool:
        """Return whether nothing was found."""
        return not self.findings

    def summary(self) -> dict[str, Any]:
        """Return all numbers as lists and dictionaries, None for what is not finite."""
        parts = {
            "encoders": self.encoders,
            "delay": self.delay,
            "torque": self.torque,
            "timing": self.timing,
        }
        result: dict[str, Any] = {name: None if part is None else _plain(vars(part)) for name, part in parts.items()}
        result |= {"assumed_noise": _plain(self.assumed_noise), "assumed_delay": self.assumed_delay}
        result["limit_cycles"] = [_plain(vars(cycle)) for cycle in self.limit_cycles]
        result["assumptions"] = [_plain(vars(part)) | {"holds": part.holds} for part in self.assumptions]
        result["findings"] = [_plain(vars(finding)) for finding in self.findings]
        return {"joints": self.log.joint_names, "duration": float(np.ptp(self.log.times)), **result}

    def plot(self) -> "Figure":
        """Plot errors, torques over their limits, the spectrum of the torques, and the delay by joint."""
        from tarc.plotting.diagnosis import diagnosis_figure

        return diagnosis_figure(self)


def diagnose(
    log: Run | str | Path,
    scenario: Scenario | str | Path | None = None,
    *,
    law: str = "",
    start_time: float | None = None,
    tube: float = 0.01,
) -> Diagnosis:
    """Diagnose a log of a control loop.

    Parameters
    ----------
    log
        A run, or the netCDF file of ``tarc run`` or of a loop on a machine.
    scenario
        The scenario of the design, against which encoders and delay are held. None for the one in the log, else for
        ``scenario.yaml`` beside the file, else for none.
    law
        Name of the law in the scenario; empty for the one of the log's class, else the first.
    start_time
        First time to use [s]; None for the time at which the machine's loop began to track, else for all.
    tube
        Largest distance from the reference that was certified [rad or m].

    Returns
    -------
    Diagnosis
        What was measured, and what to change.

    Raises
    ------
    InvalidParameter
        For a log that cannot be read or is too short, and a scenario of another number of joints or another period.
    ScenarioError
        For a scenario that cannot be read.

    Examples
    --------
    >>> import tarc
    >>> scenario = tarc.Scenario.load("two_link_payload", ["duration=3.0"])
    >>> run = scenario.run(progress=False)["TDC"]
    >>> found = tarc.diagnose(run, scenario, start_time=0.5)
    >>> found.is_clean, round(1e5 * found.encoders.resolution[0], 2)
    (True, 9.59)
    """
    run = log if isinstance(log, Run) else Run.load(log)
    rows = LoopLog.from_run(run, start_time)
    check.number("tube", tube, 0, strict=True)
    design = _scenario(scenario, log, rows)
    setup = None if design is None else design.build()
    own_law = None if design is None or setup is None else _law(setup, rows, law, design)
    encoders = check_encoders(rows)
    rounding = np.nan_to_num(encoders.resolution) / np.sqrt(12)  # a joint at rest shows less
    noise = np.fmax(np.nan_to_num(encoders.noise), rounding)
    assumed_noise, assumed_delay, delay = None, None, None
    if design is not None and setup is not None:
        assumed_noise = measurement_deviation(setup.sensor, rows.n_joints)
        assumed_delay = float(design.computation_delay)
        delay = command_delay(rows, setup.plant)
    measured = {
        "encoders": encoders,
        "assumed_noise": assumed_noise,
        "delay": delay,
        "assumed_delay": assumed_delay,
        "torque": torque_use(rows),
        "timing": loop_timing(rows),
        "limit_cycles": find_limit_cycles(rows, noise),
        "assumptions": check_assumptions(rows, noise, tube),
    }
    return Diagnosis(log=rows, findings=findings_of(rows, own_law, **measured), **measured)


def _scenario(given: Scenario | str | Path | None, log: Run | str | Path, rows: LoopLog) -> Scenario | None:
    """Return the scenario that was given, that in the log, that beside its file, or None."""
    if isinstance(given, Scenario):
        return given
    if given is not None:
        return Scenario.load(given)
    inside = rows.json_attribute("scenario").get("content")
    if isinstance(inside, dict):
        return Scenario.parse(inside)
    beside = None if isinstance(log, Run) else Path(log).with_name("scenario.yaml")
    return Scenario.load(beside) if beside is not None and beside.is_file() else None


def _law(setup: Setup, rows: LoopLog, name: str, design: Scenario) -> Law:
    """Return the law of a scenario that fits the log, which must have its joints and period."""
    if setup.plant.n_joints != rows.n_joints:
        raise InvalidParameter(
            f"scenario: its robot has {setup.plant.n_joints} joints, the log {rows.n_joints} "
            f"({', '.join(rows.joint_names)}); give the scenario of this log",
            "scenario",
        )
    if abs(design.period - rows.period) > 1e-6 * rows.period:
        raise InvalidParameter(
            f"scenario: its period is {design.period:g} s, that of the log {rows.period:g} s; give the scenario of "
            "this log",
            "scenario",
        )
    if name and name not in setup.laws:
        raise InvalidParameter(f"law: got {name!r}; the scenario has {', '.join(setup.laws)}", "law")
    kind = rows.json_attribute("law").get("kind")
    fitting = [part for part in setup.laws.values() if type(part).__name__ == kind]
    return setup.laws[name] if name else (fitting or list(setup.laws.values()))[0]


def _plain(value: Any) -> Any:
    """Return arrays as lists, and None for what is not finite."""
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(part) for part in (value.tolist() if isinstance(value, np.ndarray) else value)]
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
