"""Names, labels and units of the recorded variables and of the measures of a run."""

from typing import NamedTuple

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
    "auxiliary": ("auxiliary input u, the commanded acceleration", "rad/s²"),
    "tde_error": ("TDE error, true acceleration minus u", "rad/s²"),
    "gain": ("switching gain ĉ", "rad/s²"),
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


MEASURES = {
    "rms_error": Measure("RMS error", "RMS error", 1e3, "mrad"),
    "peak_error": Measure("peak error", "peak error", 1e3, "mrad"),
    "torque_variation": Measure("torque variation", "torque variation", 1.0, "N m/s"),
    "high_frequency_share": Measure("torque energy above 50 Hz", "above 50 Hz", 100.0, "%"),
    "peak_torque": Measure("peak torque", "peak torque", 1.0, "N m"),
    "saturated": Measure("saturated", "saturated", 100.0, "%"),
    "rms_tde_error": Measure("RMS TDE error", "RMS TDE error", 1.0, "rad/s²"),
    "mean_gain": Measure("mean gain", "mean gain", 1.0, "rad/s²"),
    "peak_gain": Measure("peak gain", "peak gain", 1.0, "rad/s²"),
    "overestimation": Measure("gain rises while ‖s‖ falls", "overestimation", 100.0, "%"),
    "underestimation": Measure("gain falls while ‖s‖ rises", "underestimation", 100.0, "%"),
}
"""Every measure of `Run.metrics`, in the order of the tables."""
