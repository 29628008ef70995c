"""One decision of a design and its reason."""

from dataclasses import dataclass


@dataclass(frozen=True)
class DesignChoice:
    """A value that a design settles, with the reason.

    Attributes
    ----------
    key
        Path of the scenario's key that the choice explains, such as ``("law", "inertia")``; empty for none.
    label
        Name for a reader.
    value
        The value in words, with its unit.
    reason
        Why this value.
    """

    key: tuple[str, ...]
    label: str
    value: str
    reason: str
