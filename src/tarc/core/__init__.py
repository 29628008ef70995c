"""Foundations: errors, validation, array operations, systems and their tracing."""
