"""The one error that the package raises for bad input."""


class TarcError(Exception):
    """Bad input: the message says what came, what is allowed and what to do."""
