"""What the loop needs of a robot: positions in, torques out."""

from abc import ABC, abstractmethod
from typing import Self

import numpy as np

from tarc.core.types import Array


class Robot(ABC):
    """A robot as `run_live` drives it: one `read` and one `write` per period.

    Write your own with `read` and `write`; all else has a default that does nothing.

    Attributes
    ----------
    joint_names
        Names of the joints in the order of `read` and `write`. Empty where unknown; then no order is checked.
    sample_time
        The robot's own stamp [s] of the position that was read last; NaN where unknown.
    applied_torque
        Torque that the robot reports [N m or N], shape (n,), that of its brakes too; None where it reports none.
    counts
        Events since the start, by name, such as packets that were malformed.
    """

    joint_names: tuple[str, ...] = ()
    sample_time: float = np.nan
    applied_torque: Array | None = None

    @property
    def counts(self) -> dict[str, int]:
        """Return events since the start, by name."""
        return {}

    @abstractmethod
    def read(self) -> Array:
        """Return the newest position [rad or m], shape (n,), NaN where no new sample came since the call before.

        It must not wait, and must not raise an error for bad input from the robot.
        """

    @abstractmethod
    def write(self, torque: Array) -> None:
        """Apply a torque [N m or N], shape (n,), until the next one. Copy it, and do not wait."""

    def release_brakes(self) -> None:  # noqa: B027 - some robots have none
        """Release the brakes, after the torque that they carried was written."""

    def engage_brakes(self) -> None:  # noqa: B027 - some robots have none
        """Engage the brakes. It may be called from another thread, and more than once."""

    def close(self) -> None:  # noqa: B027 - some need nothing
        """Give up the connection."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
