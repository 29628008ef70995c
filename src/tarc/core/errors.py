"""The errors that the package raises, and the one warning."""

from collections.abc import Mapping
from typing import Any


class TarcError(Exception):
    """Bad input: the message says what came, what is allowed and what to do."""


class InvalidParameter(TarcError, ValueError):
    """A value is not allowed.

    Attributes
    ----------
    path
        Place of the value in a file, such as ``law.natural_frequency``; empty where it came from Python.
    """

    def __init__(self, message: str, path: str = ""):
        super().__init__(message)
        self.path = path


class UnsupportedLaw(TarcError, TypeError):
    """A law has not the structure that a method needs."""


class NotLinearisable(TarcError):
    """A law has no linearisation at rest."""


class NoStableRatio(TarcError):
    """A loop is stable for no inertia ratio."""


class InfeasibleDesign(TarcError):
    """No candidate meets the requirements.

    Attributes
    ----------
    relaxations
        Changes of single requirements that admit a design, by the name of the requirement.
    """

    def __init__(self, message: str, relaxations: Mapping[str, Any] | None = None):
        super().__init__(message)
        self.relaxations = dict(relaxations or {})


class RobotFileError(TarcError, ValueError):
    """A robot file cannot be read, or describes a robot that the package does not support."""


class ScenarioError(TarcError, ValueError):
    """A scenario file cannot be read, or has wrong contents.

    Attributes
    ----------
    path
        Place of the first fault in the scenario, such as ``law.1.natural_frequency``; empty for a whole file.
    """

    def __init__(self, message: str, path: str = ""):
        super().__init__(message)
        self.path = path


class MissingTool(TarcError, ImportError):
    """A library or a compiler is not installed: the message says what needs it and how to install it."""


class DesignWarning(UserWarning):
    """A run begins with a design that is shown to be unstable: the message says where, how fast, and what to do."""
