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
from tarc.signals.references import Chirp, Multisine, Quintic, RecordedReference, Reference, Sinusoid
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
    "Multisine",
    "ParameterSchedule",
    "Payload",
    "Quintic",
    "RecordedReference",
    "Reference",
    "SineDisturbance",
    "Sinusoid",
    "StepDisturbance",
    "TorqueLimits",
]
