"""Scenarios: the YAML that describes a run."""

from tarc.core.optional import require

require("cli", "tarc.scenario")
