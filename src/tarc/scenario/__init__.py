"""Scenarios: the YAML that describes a run."""
