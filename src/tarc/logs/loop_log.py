"""Log of a control loop, from a simulated run or from a machine, as arrays for its diagnosis."""

import json
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.simulation.run import Run

NEEDED = ("measured_position", "torque", "reference", "velocity_reference", "acceleration_reference")
"""Variables without which nothing can be diagnosed."""
MIN_ROWS = 200
"""Fewest rows of a log."""
MOTION_SHARE = 0.999
"""Share of the energy of the reference's acceleration below the frequency of its motion."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopLog:
    """One row per period of a loop.

    Attributes
    ----------
    run
        The rows that are used, labelled.
    period
        T [s].
    times
        [s], shape (k,).
    measured
        Measured positions [rad or m], NaN where a sample is missing, shape (k, n).
    torque
        Torque that the law commanded in each period [N m or N], shape (k, n).
    reference
        Reference and its two derivatives, each of shape (k, n).
    """

    run: Run
    period: float
    times: Array
    measured: Array
    torque: Array
    reference: tuple[Array, Array, Array]

    @classmethod
    def from_run(cls, run: Run, start_time: float | None = None) -> "LoopLog":
        """Take the rows of a run from a start time on.

        In a simulated run the torque is that on the joints. It is moved ahead by the computation delay, so that each
        row has what the law commanded then, as in a log of a machine.

        Parameters
        ----------
        run
            The run.
        start_time
            [s]; None for the time at which a machine's loop began to track, else for all rows.

        Raises
        ------
        InvalidParameter
            For a run without these variables, and for too few rows.
        """
        data = run.data
        lacking = [name for name in NEEDED if name not in data]
        if lacking:
            raise InvalidParameter(
                f"log: it lacks {', '.join(lacking)}; needs the netCDF of tarc run, or that of a loop of tarc.runtime"
            )
        if start_time is None:
            tracking = float(data.attrs.get("tracking_start", np.nan))
            start_time = tracking if np.isfinite(tracking) else 0.0
        first = int(np.searchsorted(data["time"].values, start_time - 1e-9))
        delay = int(data.attrs.get("computation_delay", 0))
        last = data.sizes["time"] - delay
        if last - first < MIN_ROWS:
            raise InvalidParameter(
                f"log: {max(last - first, 0)} rows lie after {start_time:g} s; needs {MIN_ROWS}, so start earlier or "
                "record for longer",
                "start_time",
            )
        rows = slice(first, last)
        reference, velocity, acceleration = (data[name].values[rows] for name in NEEDED[2:])
        return cls(
            run=Run(data.isel(time=rows), run.plant),
            period=float(data.attrs["period"]),
            times=data["time"].values[rows],
            measured=data["measured_position"].values[rows],
            torque=data["torque"].values[first + delay : last + delay],
            reference=(reference, velocity, acceleration),
        )

    @property
    def joint_names(self) -> list[str]:
        """Return the names of the joints."""
        return [str(name) for name in self.run.data["joint"].values]

    def position_unit(self, joint: int) -> str:
        """Return ``mrad`` or ``mm``, for a thousandth of a joint's position."""
        units = self.run.data.coords.get("joint_unit")
        return "mm" if units is not None and str(units.values[joint]) == "m" else "mrad"

    def torque_unit(self, joint: int) -> str:
        """Return ``N m`` or ``N``."""
        return "N" if self.position_unit(joint) == "mm" else "N m"

    @property
    def n_joints(self) -> int:
        """Return the number of joints n."""
        return self.measured.shape[1]

    @cached_property
    def position(self) -> Array:
        """Measured positions with straight lines through missing samples, shape (k, n).

        Raises
        ------
        InvalidParameter
            For a joint without two samples.
        """
        rows = np.arange(len(self.times))
        columns = []
        for name, column in zip(self.joint_names, self.measured.T, strict=True):
            is_valid = np.isfinite(column)
            if np.count_nonzero(is_valid) < 2:
                raise InvalidParameter(f"log: {name} has fewer than two valid samples, so that nothing can be said")
            columns.append(np.interp(rows, rows[is_valid], column[is_valid]))
        return np.column_stack(columns)

    @cached_property
    def motion_frequency(self) -> float:
        """Frequency below which the reference's acceleration has nearly all of its energy [Hz]; 0 at rest."""
        acceleration = self.reference[2] - np.mean(self.reference[2], axis=0)
        scale = np.maximum(np.std(acceleration, axis=0), 1e-300)
        if not np.any(scale > 1e-9):
            return 0.0
        window = np.hanning(len(acceleration))[:, None]
        energy = np.sum(np.abs(np.fft.rfft(window * acceleration / scale, axis=0)) ** 2, axis=1)
        share = np.cumsum(energy) / np.sum(energy)
        frequencies = np.fft.rfftfreq(len(acceleration), self.period)
        return float(frequencies[int(np.searchsorted(share, MOTION_SHARE))])

    def json_attribute(self, name: str) -> dict[str, object]:
        """Return an attribute that is a dictionary in JSON; empty where it is missing or no such text."""
        try:
            content = json.loads(str(self.run.data.attrs.get(name, "")))
        except ValueError:
            return {}
        return content if isinstance(content, dict) else {}
