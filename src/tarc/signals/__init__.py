"""References, sensors, disturbances and limits of the torque."""

from tarc.signals.disturbances import (
    BandLimitedNoise,
    Disturbance,
    ImpulseDisturbance,
    ParameterSchedule,
    Payload,
    SineDisturbance,
    StepDisturbance,
)
from tarc.signals.drive import Drive
from tarc.signals.joint_trajectory import JointTrajectory
from tarc.signals.log_columns import LogColumns
from tarc.signals.log_file import read_log
from tarc.signals.references import Chirp, Multisine, Quintic, RecordedReference, Reference, Sinusoid
from tarc.signals.robot_log import RobotLog
from tarc.signals.sensors import Encoder
from tarc.signals.torque_limits import TorqueLimits

__all__ = [
    "BandLimitedNoise",
    "Chirp",
    "Disturbance",
    "Drive",
    "Encoder",
    "ImpulseDisturbance",
    "JointTrajectory",
    "LogColumns",
    "Multisine",
    "ParameterSchedule",
    "Payload",
    "Quintic",
    "RecordedReference",
    "Reference",
    "RobotLog",
    "SineDisturbance",
    "Sinusoid",
    "StepDisturbance",
    "TorqueLimits",
    "read_log",
]
