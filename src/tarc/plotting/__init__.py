"""Figures, drawn from data that is handed over."""
