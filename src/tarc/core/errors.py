"""The errors that the package raises, and its warnings."""

from collections.abc import Sequence
from dataclasses import dataclass


class TarcError(Exception):
    """Base of all errors: the message says what came, what is allowed and what to do."""


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
    """A law lacks the structure that a method needs."""


class NotLinearisable(TarcError):
    """A law has no linearisation at rest, or an estimator has no transfer function."""


class NoStableRatio(TarcError):
    """A loop is stable for no inertia ratio."""


class NotConverged(TarcError):
    """A numerical search ended before it reached its tolerance."""


class NotIdentifiable(TarcError):
    """A record does not determine the inertia."""


@dataclass(frozen=True)
class Relaxation:
    """A change of one requirement that admits a design.

    Attributes
    ----------
    requirement
        The parameter to change.
    value
        Its new value, in its own unit.
    text
        The change in words.
    """

    requirement: str
    value: object
    text: str


class InfeasibleDesign(TarcError):
    """No candidate meets the requirements.

    Attributes
    ----------
    relaxations
        Changes of single requirements, each of which admits a design.
    """

    def __init__(self, message: str, relaxations: Sequence[Relaxation] = ()):
        super().__init__(message)
        self.relaxations = tuple(relaxations)


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


class ClusterError(TarcError, ConnectionError):
    """A Dask cluster cannot be reached, or was lost: the message has its address and says how to go on."""


class CompilationError(TarcError, RuntimeError):
    """A C compiler fails, or its output cannot be written."""


class ControllerNotReset(TarcError, RuntimeError):
    """A controller is stepped before its first reset."""


class DesignWarning(UserWarning):
    """A run begins with a design that is shown to be unstable: the message says where, how fast, and what to do."""


class JointLimitWarning(UserWarning):
    """A reference or a start exceeds the limits of a joint: the message has joint, limit, value and time."""


class RobotFileWarning(UserWarning):
    """A robot is not as its file has it: the message says what was replaced, or taken as unknown."""


class EngineWarning(UserWarning):
    """A law of a study runs in a slower engine than the others: the message says which, and why."""
