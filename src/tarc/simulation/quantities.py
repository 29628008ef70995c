"""Names, labels and units of the recorded variables and of the measures of a run."""

from collections.abc import Iterable
from typing import NamedTuple

from tarc.core.units import unit_for_joints

VARIABLES = {
    "position": ("true position", "rad"),
    "measured_position": ("measured position", "rad"),
    "velocity": ("true velocity", "rad/s"),
    "velocity_estimate": ("estimated velocity", "rad/s"),
    "acceleration": ("true acceleration just after the torque was set", "rad/s²"),
    "passive_position": ("true position of what no encoder reads", "rad"),
    "passive_velocity": ("true velocity of what no encoder reads", "rad/s"),
    "reference": ("reference position", "rad"),
    "velocity_reference": ("reference velocity", "rad/s"),
    "acceleration_reference": ("reference acceleration", "rad/s²"),
    "torque": ("torque on the joints", "N m"),
    "drive_torque": ("mean torque of the drive over the period", "N m"),
    "auxiliary": ("auxiliary input u, the commanded acceleration", "rad/s²"),
    "tde_error": ("TDE error, true acceleration minus u", "rad/s²"),
    "gain": ("switching gain ĉ", "rad/s²"),
    "constant_gain": ("constant part K̂0 of the switching gain", "rad/s²"),
    "state_gain": ("part K̂1 of the switching gain per unit of ‖ξ‖", "1/s"),
    "outside_limits": ("number of joints whose error or error rate is outside its limits", "1"),
    "rising": ("whether the gain is rising", "1"),
    "sliding": ("noise-free ‖s‖, from the true position", "as s"),
    "missing": ("consecutive missing samples", "1"),
    "fault": ("whether the law gave up and applies its safe torque", "1"),
}
"""Long name and unit, for revolute joints, of each recorded variable."""


class Measure(NamedTuple):
    """How a measure is shown: label, short label, factor from SI units, and unit for revolute joints."""

    label: str
    short_label: str
    scale: float
    unit: str


_MEASURES = {
    "rms_error": Measure("RMS error", "RMS error", 1e3, "mrad"),
    "peak_error": Measure("peak error", "peak error", 1e3, "mrad"),
    "torque_variation": Measure("torque variation", "torque variation", 1.0, "N m/s"),
    "high_frequency_share": Measure("torque energy above 50 Hz", "above 50 Hz", 100.0, "%"),
    "peak_torque": Measure("peak torque", "peak torque", 1.0, "N m"),
    "peak_torque_rate": Measure("peak torque rate", "torque rate", 1.0, "N m/s"),
    "saturated": Measure("saturated", "saturated", 100.0, "%"),
    "rms_tde_error": Measure("RMS TDE error", "RMS TDE error", 1.0, "rad/s²"),
    "mean_gain": Measure("mean gain", "mean gain", 1.0, "rad/s²"),
    "peak_gain": Measure("peak gain", "peak gain", 1.0, "rad/s²"),
    "overestimation": Measure("gain rises while ‖s‖ falls", "overestimation", 100.0, "%"),
    "underestimation": Measure("gain falls while ‖s‖ rises", "underestimation", 100.0, "%"),
}

SUMMED_OVER_JOINTS = (
    "rms_error",
    "peak_error",
    "torque_variation",
    "high_frequency_share",
    "peak_torque",
    "peak_torque_rate",
    "rms_tde_error",
)
"""Measures that join several joints, and so have no meaning where revolute and prismatic joints mix."""

JOINT_KINDS = {"rad": "revolute", "m": "prismatic"}
"""Kind of a joint by the unit of its position."""


def _all_measures() -> dict[str, Measure]:
    measures = {}
    for key, measure in _MEASURES.items():
        measures[key] = measure
        if key in SUMMED_OVER_JOINTS:
            for unit, kind in JOINT_KINDS.items():
                measures[f"{key}_{kind}"] = Measure(
                    f"{measure.label}, {kind}",
                    f"{measure.short_label}, {kind}",
                    measure.scale,
                    unit_for_joints(measure.unit, [unit]),
                )
    return measures


MEASURES = _all_measures()
"""Every measure of `Run.metrics`, in the order of the tables.

Those of `SUMMED_OVER_JOINTS` end in ``_revolute`` and ``_prismatic`` for a robot with joints of both kinds.
"""


def measure_unit(key: str, joint_units: Iterable[str], command_unit: str = "") -> str:
    """Return the unit in which a measure is shown, for joints of these units.

    Parameters
    ----------
    key
        Name of the measure.
    joint_units
        Unit of each joint's position, ``rad`` or ``m``.
    command_unit
        Unit of what the law outputs where that is no torque, such as ``rad`` for commanded positions.
    """
    torque = _MEASURES[key.removesuffix("_revolute").removesuffix("_prismatic")].unit
    if command_unit and torque.startswith("N m"):
        return torque.replace("N m", command_unit).replace("/s/s", "/s²")
    unit = MEASURES[key].unit
    return unit if key.endswith(tuple(JOINT_KINDS.values())) else unit_for_joints(unit, joint_units)
