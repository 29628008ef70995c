"""Certificates of stability, each of which can be checked again from the matrices that it carries."""

from tarc.certificates.base import Certificate
from tarc.certificates.loop import loop, stable_interval, stable_intervals
from tarc.certificates.norms import h2_norm, hinf_norm

__all__ = ["Certificate", "h2_norm", "hinf_norm", "loop", "stable_interval", "stable_intervals"]
