"""The one error that the package raises for bad input, and the one warning."""


class TarcError(Exception):
    """Bad input: the message says what came, what is allowed and what to do."""


class DesignWarning(UserWarning):
    """A run begins with a design that is shown to be unstable: the message says where, how fast, and what to do."""


class MissingTool(TarcError, ImportError):
    """A library or a compiler is not installed: the message says what needs it and how to install it."""
