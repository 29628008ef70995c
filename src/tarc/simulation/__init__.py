"""Simulation of the closed loop."""
