"""Figures, drawn from data that is handed over."""

from tarc.core.optional import require

require("plot", "tarc.plotting")
