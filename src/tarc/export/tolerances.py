"""What counts as rounding in the tests that are written in C."""

TOLERANCES = {"double": "1e-9", "float": "1e-4"}
"""Largest difference, relative to one more than the number, that is rounding: in C."""
