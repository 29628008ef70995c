"""What a simulation returns: labelled trajectories, a status, measures and figures."""

import json
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tarc.core import validation as check
from tarc.core.array_ops import HUGE
from tarc.core.errors import TarcError
from tarc.core.version import __version__

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

    from tarc.control.digital_controller import DigitalController
    from tarc.plants.base import Plant
    from tarc.signals.references import Reference
    from tarc.simulation.monitor import Watch
    from tarc.simulation.record import Record
    from tarc.simulation.sampled_inputs import Plan


VARIABLES = {
    "position": ("true position", "rad"),
    "measured_position": ("measured position", "rad"),
    "velocity": ("true velocity", "rad/s"),
    "velocity_estimate": ("estimated velocity", "rad/s"),
    "acceleration": ("true acceleration just after the torque was set", "rad/s²"),
    "reference": ("reference position", "rad"),
    "velocity_reference": ("reference velocity", "rad/s"),
    "acceleration_reference": ("reference acceleration", "rad/s²"),
    "torque": ("torque on the joints", "N m"),
    "auxiliary": ("auxiliary input u, the acceleration asked for", "rad/s²"),
    "tde_error": ("TDE error, true acceleration minus u", "rad/s²"),
    "gain": ("switching gain ĉ", "rad/s²"),
    "rising": ("whether the gain is rising", "1"),
    "sliding": ("noise-free ‖s‖, from the true position", "as s"),
    "missing": ("samples missing in a row", "1"),
    "fault": ("whether the law gave up and applies its safe torque", "1"),
}
"""Long name and unit, for revolute joints, of each recorded variable."""


@dataclass(frozen=True)
class Status:
    """How a run ended.

    Attributes
    ----------
    completed
        It ran to its end.
    divergence_time
        When the error left all bounds [s], or None.
    saturated
        Share of the samples, over all joints, in which the torque was at its limit.
    fault_time
        When the law gave up for missing samples [s], or None.
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
        ``xarray.Dataset`` over time [s] and joint; ``VARIABLES`` lists what may be in it. Its attributes tell how it
        was made.
    """

    data: "xr.Dataset"

    @classmethod
    def from_record(
        cls,
        plant: "Plant",
        drive: "DigitalController",
        reference: "Reference",
        plan: "Plan",
        record: "Record",
        watch: "Watch",
        seed: int,
    ) -> "Run":
        """Label an engine's record."""
        import xarray as xr

        arrays = dict(record.arrays)
        count = len(arrays["position"])
        for name, values in zip(
            ("reference", "velocity_reference", "acceleration_reference"), plan.reference, strict=True
        ):
            arrays[name] = values[:, :count].T
        if "auxiliary" in arrays:
            working = np.reshape(arrays["fault"] == 0, (-1, 1))  # after that u is not what is applied
            arrays["tde_error"] = np.where(working, arrays["acceleration"] - arrays["auxiliary"], np.nan)
        sliding = getattr(drive.law, "sliding", None)
        if sliding is not None:
            error, rate = arrays["position"] - arrays["reference"], arrays["velocity"] - arrays["velocity_reference"]
            arrays["sliding"] = np.linalg.norm(sliding(error.T, rate.T), axis=0)
        kinds = set(plant.joint_units)
        names = {"rad": "rad", "N m": "N m"} if kinds == {"rad"} else {"rad": "m", "N m": "N"}
        if len(kinds) > 1:
            names = {"rad": "(rad or m)", "N m": "N m or N"}
        variables = {}
        for name in sorted(arrays, key=lambda name: list(VARIABLES).index(name) if name in VARIABLES else 99):
            label, unit = VARIABLES.get(name, (name.replace("_", " "), "1"))
            for revolute, shown in names.items():
                unit = unit.replace(revolute, shown)
            values = arrays[name]
            dims = ("time",) if values.ndim == 1 else ("time", "joint")
            variables[name] = (dims, values, {"long_name": label, "units": unit})
        limit = np.where(drive.law.torque_limits < HUGE, drive.law.torque_limits, np.inf)
        label = {"long_name": "largest torque that the law applies", "units": names["N m"]}
        variables["torque_limit"] = ("joint", limit, label)
        attributes = {
            "title": f"{type(drive.law).__name__} on {getattr(plant, 'label', type(plant).__name__)}",
            "source": f"tarc-control {__version__}",
            "plant": _json(_describe(plant)),
            "law": _json(_describe(drive.law)),
            "reference_signal": _json(_describe(reference)),
            "sensor": _json(_describe(drive.sensor)),
            "disturbance": _json([_describe(event) for event in plan.events]),
            "period": drive.law.period,
            "substeps": plan.disturbance.shape[2],
            "computation_delay": drive.computation_delay,
            "seed": seed,
            "duration": len(plan.times) * drive.law.period,
            "divergence_time": np.nan if watch.divergence_time is None else plan.times[watch.divergence_time],
        }
        times = ("time", plan.times[:count], {"units": "s", "long_name": "time"})
        coordinates = {"time": times, "joint": ("joint", plant.joint_names)}
        return cls(xr.Dataset(variables, coords=coordinates, attrs=attributes))

    @property
    def status(self) -> Status:
        """How it ended."""
        diverged = float(self.data.attrs["divergence_time"])
        fault = np.flatnonzero(self.data["fault"].values > 0) if "fault" in self.data else []
        return Status(
            completed=np.isnan(diverged),
            divergence_time=None if np.isnan(diverged) else diverged,
            saturated=_saturated(self.data),
            fault_time=float(self.data["time"].values[fault[0]]) if len(fault) else None,
        )

    def metrics(
        self, start_time: float = 0.0, frequency: float = 50.0, averaging_time: float = 0.0
    ) -> dict[str, float]:
        """Measures of the run after a start time.

        Parameters
        ----------
        start
            Leave out what came before [s].
        frequency
            Above which torque counts as high-frequency [Hz].
        smooth
            Average the gain and ‖s‖ over this long [s], a whole multiple of the period, before their changes are
            counted; 0 counts from sample to sample. It takes out what encoder noise moves back and forth. Take an even
            number of periods: then a gain that chatters at its floor from period to period counts as still.

        Returns
        -------
        dict
            ``rms_error`` and ``peak_error`` over all joints [rad or m]; ``torque_variation`` Σ|Δτ| over all joints a
            second [N m/s]; ``high_frequency_share`` of the energy of torque about its mean; ``peak_torque`` [N m];
            ``saturated`` share of samples; ``rms_tde_error`` [rad/s²]; for laws with a gain ``mean_gain`` and
            ``peak_gain`` [rad/s²], ``overestimation`` the share of time in which the gain rises while ‖s‖ falls and
            ``underestimation`` the share in which it falls while ‖s‖ rises, both by the noise-free ‖s‖.

        Raises
        ------
        TarcError
            For a start after the run's end, and a ``smooth`` that is no multiple of the period or longer than the run.
        """
        check.number("start", start_time, 0)
        check.number("frequency", frequency, 0)
        data = self.data.sel(time=slice(start_time - 1e-9, None))
        if data.sizes["time"] < 2:
            end = float(self.data["time"].values[-1])
            raise TarcError(f"start_time: got {start_time:g} s; the run ends at {end:g} s ({self.status})")
        period = float(self.data.attrs["period"])
        over = (
            check.whole_periods("averaging_time", averaging_time, period)
            if check.number("averaging_time", averaging_time, 0)
            else 1
        )
        if over >= data.sizes["time"]:
            lasts = data.sizes["time"] * period
            raise TarcError(
                f"averaging_time: got {averaging_time:g} s, and what is measured lasts {lasts:g} s; use less"
            )
        error = (data["position"] - data["reference"]).values
        torque = data["torque"].values
        result = {
            "rms_error": float(np.sqrt(np.mean(error**2))),
            "peak_error": float(np.max(np.abs(error))),
            "torque_variation": float(np.sum(np.abs(np.diff(torque, axis=0))) / (period * (len(torque) - 1))),
            "high_frequency_share": _share_above(torque, period, frequency),
            "peak_torque": float(np.max(np.abs(torque))),
            "saturated": _saturated(data),
        }
        if "tde_error" in data:
            known = data["tde_error"].values[~np.isnan(data["tde_error"].values)]
            result["rms_tde_error"] = float(np.sqrt(np.mean(known**2))) if known.size else np.nan
        if "gain" in data:
            gain = data["gain"].values
            result |= {"mean_gain": float(np.mean(gain)), "peak_gain": float(np.max(gain))}
            if "sliding" in data:
                # an average over m samples changes by what the m-th sample has changed, divided by m
                growth, change = (x[over:] - x[:-over] for x in (data["sliding"].values, gain))
                result["overestimation"] = float(np.mean((change > 0) & (growth < 0)))
                result["underestimation"] = float(np.mean((change < 0) & (growth > 0)))
        return result

    def joint_errors(self, start_time: float = 0.0) -> dict[str, float]:
        """RMS error of each joint after a start time [rad or m], by the joint's name."""
        data = self.data.sel(time=slice(start_time - 1e-9, None))
        rms = np.sqrt(np.mean((data["position"] - data["reference"]).values ** 2, axis=0))
        return dict(zip(data["joint"].values.tolist(), rms.tolist(), strict=True))

    def plot(self, kind: str = "screen", **others: "Run") -> "Figure":
        """Figure of tracking, error, torque and gain.

        Parameters
        ----------
        kind
            ``screen`` for a wide one with every joint, ``column`` for the column of a paper.
        others
            Further runs to draw beside this one, by name: ``run.plot(TDC=other)``.
        """
        from tarc.plotting.runs import run_figure

        return run_figure({str(self.data.attrs["title"]).split()[0]: self, **others}, kind)

    def save(self, path: str | Path) -> Path:
        """Write the dataset as netCDF; whole or not at all."""
        target = Path(path)
        part = target.with_name(f".{target.name}.part")
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            self.data.to_netcdf(part, engine="h5netcdf")
            part.replace(target)
        except OSError as error:
            part.unlink(missing_ok=True)
            raise TarcError(
                f"save: cannot write {target}: {error.strerror or error}; free space or choose another path"
            ) from None
        return target

    @classmethod
    def load(cls, path: str | Path) -> "Run":
        """Read what `save` wrote."""
        import xarray as xr

        if not Path(path).is_file():
            raise TarcError(f"load: no file {str(path)!r}; looked for {Path(path).resolve()}")
        try:
            return cls(xr.load_dataset(path, engine="h5netcdf"))
        except (OSError, ValueError) as error:
            raise TarcError(f"load: {path} is no netCDF file of a run ({error})") from None


def _saturated(data: "xr.Dataset") -> float:
    """Share of the samples, over all joints, in which the torque is at its limit."""
    return float(np.mean(np.abs(data["torque"].values) >= data["torque_limit"].values * (1 - 1e-12)))


def _share_above(torque: np.ndarray, period: float, frequency: float) -> float:
    """Share of the energy of the torque about its mean that lies above a frequency [Hz]."""
    spectrum = np.abs(np.fft.rfft(torque - torque.mean(axis=0), axis=0)) ** 2
    spectrum[1 : (len(torque) + 1) // 2] *= 2  # each stands for its negative frequency too; Nyquist's is alone
    high = np.fft.rfftfreq(len(torque), period) > frequency
    total = spectrum.sum()
    return float(spectrum[high].sum() / total) if total > 0 else 0.0


def _json(content: Any) -> str:
    """JSON of a description; numbers and arrays of NumPy as plain ones, infinities as text."""

    def plain(value: Any) -> Any:
        if isinstance(value, np.ndarray | np.generic):
            return plain(value.tolist())
        if isinstance(value, dict):
            return {key: plain(one) for key, one in value.items()}
        if isinstance(value, list | tuple | range):
            return [plain(one) for one in value]
        if isinstance(value, float) and not np.isfinite(value):
            return str(value)
        return value if value is None or isinstance(value, int | float | str) else str(value)

    return json.dumps(plain(content))


def _describe(part: Any) -> dict[str, Any]:
    """Kind and parameters of a component, ready for JSON."""
    result: dict[str, Any] = {"kind": type(part).__name__}
    if is_dataclass(part):
        for field in fields(part):
            value = getattr(part, field.name)
            if is_dataclass(value):
                value = _describe(value)
            if value is not None:
                result[field.name] = value
    else:
        result |= {"file": part.label, **{name: value.tolist() for name, value in part.parameters.items()}}
    return result
