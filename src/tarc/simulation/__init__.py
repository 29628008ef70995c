"""Simulation of the closed loop."""

from tarc.core.optional import require

require("sim", "tarc.simulation")
