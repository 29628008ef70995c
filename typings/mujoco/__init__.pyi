"""MuJoCo ships no types for most of its compiled names."""

from typing import Any

def __getattr__(name: str) -> Any: ...
