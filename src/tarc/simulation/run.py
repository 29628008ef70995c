"""Result of a simulation: labelled trajectories, status, measures and figures."""

from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.files import file_in_folder, writing
from tarc.core.units import unit_for_joints
from tarc.plants.base import Plant
from tarc.signals.trajectory_message import BAG
from tarc.simulation.measures import SIGNALS, compute_measures, saturated_share
from tarc.simulation.quantities import MEASURES, measure_unit
from tarc.simulation.run_bag import write_bag

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Status:
    """How a run ended.

    Attributes
    ----------
    completed
        Whether it ran to its end.
    divergence_time
        Time at which the error exceeded the divergence threshold [s], or None.
    saturated
        Share of the samples, over all joints, in which the torque was at its limit.
    fault_time
        Time at which the law gave up for missing samples [s], or None.
    """

    completed: bool
    divergence_time: float | None
    saturated: float
    fault_time: float | None

    def __str__(self) -> str:
        text = "completed" if self.completed else f"diverged at {self.divergence_time:.3f} s"
        if self.fault_time is not None:
            text += f", safe torque from {self.fault_time:.3f} s on"
        return text + (f", {self.saturated:.2%} saturated" if self.saturated > 0 else "")


@dataclass(frozen=True, eq=False)
class Run:
    """A simulated run.

    Attributes
    ----------
    data
        ``xarray.Dataset`` over time [s] and joint; `tarc.simulation.quantities.VARIABLES` lists what it may contain.
        Its attributes describe how the run was made.
    plant
        The robot as simulated; None for a run that was loaded or comes from another process.
    """

    data: xr.Dataset
    plant: Plant | None = None

    def __reduce__(self) -> tuple[type["Run"], tuple[xr.Dataset]]:
        """Return how to pickle a run: without the robot, whose symbols belong to one process."""
        return Run, (self.data,)

    @property
    def status(self) -> Status:
        """Return how the run ended."""
        divergence_time = float(self.data.attrs["divergence_time"])
        faults = np.flatnonzero(self.data["fault"].values > 0) if "fault" in self.data else []
        return Status(
            completed=np.isnan(divergence_time),
            divergence_time=None if np.isnan(divergence_time) else divergence_time,
            saturated=saturated_share(self.data["torque"].values, self.data["torque_limit"].values),
            fault_time=float(self.data["time"].values[faults[0]]) if len(faults) else None,
        )

    @property
    def instability(self) -> str:
        """Return in words the posture in which the loop is unstable at rest, and the remedy; empty where none is."""
        return str(self.data.attrs.get("unstable_at_rest", ""))

    def with_attributes(self, **attributes: object) -> "Run":
        """Return the same run with more attributes of its dataset."""
        return Run(self.data.assign_attrs(attributes), self.plant)

    @property
    def title(self) -> str:
        """Return law and robot, such as ``TARC on ur5e.xml``."""
        return str(self.data.attrs.get("title", "run"))

    @property
    def joint_units(self) -> tuple[str, ...]:
        """Return the different units of the joints: ``("rad",)``, ``("m",)`` or both."""
        return tuple(dict.fromkeys(self._unit_of_each_joint))

    @property
    def command_unit(self) -> str:
        """Return the unit of what the law outputs where that is no torque, such as ``rad``; empty for torques."""
        unit = str(self.data["torque"].attrs.get("units", ""))
        return "" if unit == unit_for_joints("N m", self.joint_units) else unit

    @property
    def _unit_of_each_joint(self) -> list[str]:
        """Units in the order of the joints; that of the position where the data has no unit per joint."""
        if "joint_unit" in self.data.coords:
            return self.data["joint_unit"].values.tolist()
        return [str(self.data["position"].attrs.get("units", "rad"))] * self.data.sizes["joint"]

    def metrics(
        self, start_time: float = 0.0, frequency: float = 50.0, averaging_time: float = 0.0
    ) -> dict[str, float]:
        """Compute measures of the run after a start time.

        Parameters
        ----------
        start_time
            Earliest time that counts [s].
        frequency
            Frequency above which torque counts as high-frequency [Hz].
        averaging_time
            Length of the moving average of gain and ‖s‖ [s], a whole multiple of the period, whose changes are counted;
            0 counts from sample to sample. It removes changes that encoder noise reverses. Take an even number of
            periods: then a gain that chatters at its minimum from period to period counts as constant.

        Returns
        -------
        dict
            ``rms_error`` and ``peak_error`` are over all joints [rad or m]. Where revolute and prismatic joints mix,
            each measure over joints is there twice: ``rms_error_revolute``, ``rms_error_prismatic`` and so on.
            ``torque_variation`` is Σ|Δτ| of all joints per second [N m/s], and ``high_frequency_share`` a share of the
            torque's energy about its mean. The others are ``peak_torque`` [N m], the ``saturated`` share of samples,
            and ``rms_tde_error`` [rad/s²]. With a limit of the rate, ``peak_torque_rate`` is the largest change of a
            torque in a period, over the period [N m/s]. Laws with a gain have ``mean_gain`` and ``peak_gain`` [rad/s²]
            too. ``overestimation`` is the share of time in which the gain rises while ‖s‖ falls. ``underestimation`` is
            that in which the gain falls while ‖s‖ rises. Both use the noise-free ‖s‖.

        Raises
        ------
        InvalidParameter
            For a start time after the run's end, and an averaging time that is no multiple of the period or longer
            than the run.
        """
        data = self._after(start_time)
        period = float(self.data.attrs["period"])
        check.number("frequency", frequency, 0)
        n_averaged = self._averaged_samples(averaging_time, period, data.sizes["time"])
        return compute_measures(
            {name: data[name].values for name in SIGNALS if name in data},
            period,
            data["torque_limit"].values,
            self._unit_of_each_joint,
            has_rate_limit="torque_rate_limit" in data,
            frequency=frequency,
            n_averaged=n_averaged,
        )

    def metrics_or_none(self, start_time: float = 0.0) -> dict[str, float]:
        """Compute `metrics`; return an empty dictionary for a run that ended before the start time."""
        if self.data.sizes["time"] < 2 or float(self.data["time"].values[-2]) < start_time:
            return {}
        return self.metrics(start_time=start_time)

    def joint_errors(self, start_time: float = 0.0) -> dict[str, float]:
        """Compute the RMS error of each joint after a start time [rad or m], by the joint's name."""
        data = self.data.sel(time=slice(start_time - 1e-9, None))
        rms = np.sqrt(np.mean((data["position"] - data["reference"]).values ** 2, axis=0))
        return dict(zip(data["joint"].values.tolist(), rms.tolist(), strict=True))

    def plot(self, style: str = "screen", *, others: Mapping[str, "Run"] | None = None) -> "Figure":
        """Draw tracking, error, torque and gain.

        Parameters
        ----------
        style
            ``screen`` shows every joint; ``column`` is 3.5 inches wide, for a paper.
        others
            Further runs of the same robot to draw beside this one, by name: ``run.plot(others={"TDC": run_of_tdc})``.
        """
        from tarc.plotting.runs import run_figure

        return run_figure({self.title.split()[0]: self, **(others or {})}, style)

    def animate(
        self,
        path: str | Path,
        *,
        others: Mapping[str, "Run"] | None = None,
        plant: Plant | None = None,
        frame_rate: float = 30.0,
    ) -> Path:
        """Write the robot in three dimensions, with its reference as a translucent ghost, in one file of HTML.

        The file needs no network and no server: a browser opens it from the disk. It has a slider of the time and a
        button to play. Robots from files have the shapes of the file, and capsules between the joints where it has
        none. Planar arms and the pendulum are capsules.

        Parameters
        ----------
        path
            File to write, such as ``run.html``.
        others
            Further runs of the same robot to show beside this one, by name.
        plant
            The robot; None for the one that was simulated. A run that was loaded needs it.
        frame_rate
            Postures per second of the run [1/s]; at most 3000 postures in all.

        Raises
        ------
        InvalidParameter
            For a robot without bodies in space, one that was not simulated here, and a file that cannot be written.
        MissingTool
            Without the extra ``view``.
        """
        from tarc.plotting.animation import animate

        return animate({self.title.split()[0]: self, **(others or {})}, plant, path, frame_rate)

    def view(self, *, plant: Plant | None = None, speed: float = 1.0) -> None:
        """Play the run in MuJoCo's viewer, with the reference as a ghost, until the window is closed.

        Parameters
        ----------
        plant
            The robot, from a file; None for the one that was simulated. A run that was loaded needs it.
        speed
            Time of the run per time on the clock.

        Raises
        ------
        InvalidParameter
            For a robot that is not from a file, or that was not simulated here.
        MissingTool
            Where there is no display; `animate` needs none.
        """
        from tarc.plotting.viewer import view

        view(self, plant, speed)

    def save(self, path: str | Path) -> Path:
        """Write the dataset as netCDF, or as a ROS 2 bag with the suffix ``.mcap``; it appears once it is complete.

        Raises
        ------
        InvalidParameter
            For a folder that does not exist, and a file that cannot be written.
        MissingTool
            For a bag without the libraries that write it, the extra ``logs``.
        """
        target = file_in_folder("save", path)
        part = target.with_name(f".{target.name}.part")
        try:
            with writing("save", target):
                if target.suffix.lower() == BAG:
                    write_bag(self.data, part)
                else:
                    self.data.to_netcdf(part, engine="h5netcdf")
                part.replace(target)
        finally:
            part.unlink(missing_ok=True)
        return target

    @classmethod
    def load(cls, path: str | Path) -> "Run":
        """Read what `save` wrote.

        Raises
        ------
        InvalidParameter
            For a file that does not exist, or is no netCDF file of a run.
        """
        if not Path(path).is_file():
            raise InvalidParameter(f"load: no file {str(path)!r}; looked for {Path(path).resolve()}")
        try:
            return cls(xr.load_dataset(path, engine="h5netcdf"))
        except (OSError, ValueError) as error:
            raise InvalidParameter(f"load: {path} is no netCDF file of a run ({error})") from None

    def __repr__(self) -> str:
        measures = self.metrics_or_none()
        text = f"<Run of {self.title}: {self.data.sizes['time']} samples, {self.status}"
        for key in measures:
            if key.startswith("rms_error"):
                unit = measure_unit(key, self.joint_units, self.command_unit)
                text += f", {MEASURES[key].label} {MEASURES[key].scale * measures[key]:.4g} {unit}"
        return f"{text}>"

    def _repr_html_(self) -> str:
        output = "command" if self.command_unit else "torque"
        labels = {key: measure.label.replace("torque", output) for key, measure in MEASURES.items()}
        rows = [
            f"<tr><td>{escape(labels[key])}</td><td>{MEASURES[key].scale * value:.4g}</td>"
            f"<td>{escape(measure_unit(key, self.joint_units, self.command_unit))}</td></tr>"
            for key, value in self.metrics_or_none().items()
        ]
        heading = f"<b>{escape(self.title)}</b>, {self.data.sizes['time']} samples, {escape(str(self.status))}"
        return f"<p>{heading}</p><table>{''.join(rows)}</table>"

    def _after(self, start_time: float) -> xr.Dataset:
        """Return the data from a start time on, at least two samples."""
        check.number("start_time", start_time, 0)
        data = self.data.sel(time=slice(start_time - 1e-9, None))
        if data.sizes["time"] < 2:
            end = float(self.data["time"].values[-1])
            raise InvalidParameter(f"start_time: got {start_time:g} s; the run ends at {end:g} s ({self.status})")
        return data

    @staticmethod
    def _averaged_samples(averaging_time: float, period: float, n_samples: int) -> int:
        """Return the number of samples of the moving average, below the number of samples."""
        if not check.number("averaging_time", averaging_time, 0):
            return 1
        n_averaged = check.whole_periods("averaging_time", averaging_time, period)
        if n_averaged >= n_samples:
            raise InvalidParameter(
                f"averaging_time: got {averaging_time:g} s; the measured part of the run lasts "
                f"{n_samples * period:g} s, use less"
            )
        return n_averaged
