"""References, sensors and disturbances."""

from tarc.signals.disturbances import BandNoise, Disturbance, Impulse, Payload, Schedule, Sine, Step
from tarc.signals.references import Chirp, Multisine, Quintic, Recorded, Reference, Sinusoid
from tarc.signals.sensors import Encoder

__all__ = [
    "BandNoise",
    "Chirp",
    "Disturbance",
    "Encoder",
    "Impulse",
    "Multisine",
    "Payload",
    "Quintic",
    "Recorded",
    "Reference",
    "Schedule",
    "Sine",
    "Sinusoid",
    "Step",
]
