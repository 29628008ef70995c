"""`replay`: a log of a real robot held against estimators, model, law and design."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.files import writing
from tarc.laws.base import Law
from tarc.laws.pole_placement import PolePlacement
from tarc.logs.even_record import EvenRecord
from tarc.logs.model_check import (
    DelayEstimationCheck,
    ModelCheck,
    check_delay_estimation,
    check_model,
    mean_inertia,
)
from tarc.logs.shadow import ShadowCheck, check_shadow, laws_over_time
from tarc.logs.time_repair import LogTiming, repair_time
from tarc.logs.window_check import VelocityCheck, WindowCheck, check_velocity, check_window
from tarc.plants.base import Plant
from tarc.plants.load import load_robot
from tarc.scenario.model import Scenario
from tarc.signals.log_columns import LogColumns
from tarc.signals.log_file import read_log
from tarc.signals.robot_log import RobotLog
from tarc.signals.sensors import Encoder

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DEFAULT_WINDOW = 0.010
"""Window without a law [s]."""
MIN_PERIODS = 5
"""Fewest periods of the default window."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Replay:
    """What a log shows.

    Attributes
    ----------
    log
        The rows that were used.
    record
        The log on the ticks of its clock.
    timing
        Rate, jitter, stale and missing samples, and the repair of time.
    windows
        Delay and error of each window's acceleration.
    velocity
        The recorded velocity; None without one.
    model
        The torque of a robot's model; None without a robot or recorded torque.
    delay_estimation
        What time-delay estimation leaves over; None without M̂ or recorded torque.
    shadow
        What a law would have commanded; None without a law or recorded torque.
    """

    log: RobotLog
    record: EvenRecord
    timing: LogTiming
    windows: tuple[WindowCheck, ...]
    velocity: VelocityCheck | None
    model: ModelCheck | None
    delay_estimation: DelayEstimationCheck | None
    shadow: ShadowCheck | None

    def summary(self) -> dict[str, Any]:
        """Return all results as numbers and lists, without the arrays over time."""
        parts = {
            "timing": self.timing,
            "velocity": self.velocity,
            "model": self.model,
            "delay_estimation": self.delay_estimation,
            "shadow": self.shadow,
        }
        result: dict[str, Any] = {"log": self.log.label, "joints": list(self.log.joint_names)}
        result |= {name: _plain(part, len(self.record.times)) for name, part in parts.items() if part is not None}
        result["timing"]["rate"] = self.timing.rate
        result["windows"] = [_plain(part, len(self.record.times)) for part in self.windows]
        return result

    def plot(self) -> "Figure":
        """Plot steps of time, what is left of the positions, accelerations and torques."""
        from tarc.plotting.replay import replay_figure

        return replay_figure(self)

    def save_report(self, path: str | Path) -> Path:
        """Write figure and tables as one HTML file without links to others, and return its path.

        Raises
        ------
        InvalidParameter
            For a file that cannot be written.
        """
        from tarc.plotting.replay import replay_page

        file = Path(path)
        with writing("path", file):
            file.write_text(replay_page(self), encoding="utf-8")
        return file


def replay(
    log: RobotLog | str | Path,
    robot: Plant | str | Path | None = None,
    *,
    law: Law | Scenario | str | Path | None = None,
    columns: LogColumns | Mapping[str, Any] | str | Path | None = None,
    window: float | Sequence[float] | None = None,
    inertia_fraction: float = 0.1,
    period: float | None = None,
    start_time: float | None = None,
    stop_time: float | None = None,
    cutoff: float = 25.0,
) -> Replay:
    """Hold a log of a real robot against estimators, model, law and design.

    Parameters
    ----------
    log
        The log, or its file as `tarc.signals.read_log` takes it.
    robot
        A plant, or a robot file or shipped name as `tarc.plants.load_robot` takes it, for the torque of its model.
        None for the robot of a scenario in ``law``, else no model.
    law
        A law for shadow mode, or a scenario, such as `tarc design` writes, whose first law, sensor and robot are used.
        Where it is the law that ran, its gains change as they did in the log.
    columns
        Names of the log's columns, where they are not known.
    window
        ς of the acceleration [s], one or several; None for that of the law, else 10 ms or five periods.
    inertia_fraction
        M̂ of time-delay estimation over the diagonal of the mean of M(q), where no law gives M̂.
    period
        T of the robot's clock [s]; None for the one that stamps and motion agree on.
    start_time, stop_time
        Part of the log to use, counted from its first stamp [s].
    cutoff
        Frequency up to which motion and torque are taken as true [Hz]. Above it they count as noise.

    Returns
    -------
    Replay
        Timing and its repair, delay and error of the windows, the torque that the model explains, what time-delay
        estimation leaves over, and the law's commands.

    Raises
    ------
    InvalidParameter
        For a log that does not read or move, and for a robot or a law with another number of joints or period.
    RobotFileError, ScenarioError
        For a robot or a scenario that does not read.

    Examples
    --------
    >>> import numpy as np, tarc
    >>> times = 0.001 * np.arange(4000)
    >>> log = tarc.signals.RobotLog(times=times, position=np.sin(5 * times)[:, None])
    >>> found = tarc.replay(log)
    >>> print(f"{found.timing.rate:.0f} Hz, delay {1e3 * found.windows[0].delay[0]:.2f} ms")
    1000 Hz, delay 5.00 ms
    """
    rows = log if isinstance(log, RobotLog) else read_log(log, columns)
    rows = rows.between(start_time, stop_time)
    plant = load_robot(robot) if isinstance(robot, str | Path) else robot
    sensor = Encoder()
    if law is None or isinstance(law, Law):
        own_law = law
    else:
        setup = (law if isinstance(law, Scenario) else Scenario.load(law)).build()
        own_law, sensor = next(iter(setup.laws.values())), setup.sensor
        plant = setup.plant if plant is None else plant
    if plant is not None and plant.n_joints != rows.n_joints:
        raise InvalidParameter(
            f"robot: {plant.label} has {plant.n_joints} joints ({', '.join(plant.joint_names)}), the log "
            f"{rows.n_joints} ({', '.join(rows.joint_names)}); lock the others in a scenario, or name other columns",
            "robot",
        )
    timing = repair_time(rows, period=period, cutoff=cutoff)
    record = EvenRecord.from_log(rows, timing, cutoff)
    sizes = _windows(window, own_law, timing.period)
    inertia = _inertia(own_law, plant, record, inertia_fraction)
    return Replay(
        log=rows,
        record=record,
        timing=timing,
        windows=tuple(check_window(rows, timing, record, size, cutoff) for size in sizes),
        velocity=check_velocity(record, cutoff),
        model=None if plant is None else check_model(record, plant, cutoff),
        delay_estimation=None if inertia is None else check_delay_estimation(record, inertia, sizes[0], cutoff),
        shadow=None
        if own_law is None
        else check_shadow(record, own_law, sensor, plant, cutoff, laws_over_time(rows, timing, own_law)),
    )


def _windows(window: float | Sequence[float] | None, law: Law | None, period: float) -> list[float]:
    """Return the windows to check [s]."""
    if window is not None:
        return [check.number("window", size, 0, strict=True) for size in np.atleast_1d(window).tolist()]
    own = getattr(law.estimator, "window", None) if law is not None else None
    return [float(own) if own else period * max(round(DEFAULT_WINDOW / period), MIN_PERIODS)]


def _inertia(law: Law | None, plant: Plant | None, record: EvenRecord, fraction: float) -> np.ndarray | None:
    """Return M̂: the law's, or a fraction of the robot's."""
    if isinstance(law, PolePlacement):
        return law.M
    if plant is None:
        return None
    return check.number("inertia_fraction", fraction, 0, strict=True) * mean_inertia(record, plant)


def _finite(values: Any) -> Any:
    """Return nested lists with None for what is not finite."""
    if isinstance(values, list):
        return [_finite(value) for value in values]
    return values if np.isfinite(values) else None


def _plain(part: object, n_rows: int) -> dict[str, Any]:
    """Return the fields of a result that are no rows over time: arrays as lists, what is not finite as None."""
    result: dict[str, Any] = {}
    for name, value in vars(part).items():
        if isinstance(value, np.ndarray):
            if name not in ("times", "is_new") and len(value) != n_rows:
                result[name] = _finite(value.tolist())
        elif value is not None:
            result[name] = value
    return result
