"""Laws whose output is a command of inner loops, seen as laws of torques."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.laws.pole_placement import PolePlacement
from tarc.plants.base import Plant

L = TypeVar("L", bound=PolePlacement)
"""A law with an inertia."""


def in_torque_units(law: L, plants: Sequence[Plant]) -> tuple[L, list[Plant]]:
    """Return a law and robots of the same loop, in which the output of the law is a torque.

    Joints with inner loops of the gains G take commands c, with G⁻¹M as their inertia. That matrix is not symmetric
    where the gains differ. A law with the inertia M̂ is then one of torques with the inertia G M̂. All ratios are the
    same. Without inner loops, and with equal gains, law and robots are returned as they are.

    Parameters
    ----------
    law
        The law of commands.
    plants
        The robots that it drives.

    Raises
    ------
    InvalidParameter
        For an M̂ for which G M̂ is not symmetric.
    """
    if has_torque_units(law, plants[0]):
        return law, list(plants)
    inertia = plants[0].command_gain[:, None] * law.M
    if not is_symmetric(inertia):
        raise InvalidParameter(
            f"inertia: the inner loops of the joints of {plants[0].label} have different gains, so that a certificate "
            "needs a diagonal inertia; give one number per joint, or diagonal: true beside a fraction",
            "law.inertia",
        )
    return replace(law, inertia=(inertia + inertia.T) / 2), [plant.in_torque_units() for plant in plants]


def has_torque_units(law: PolePlacement, plant: Plant) -> bool:
    """Return whether the output of a law is a torque, or a torque by the same factor for all joints."""
    gain = plant.command_gain
    return bool(np.all(gain == gain[0])) or len(gain) != law.n_joints


def is_symmetric(matrix: Array) -> bool:
    """Return whether a matrix is symmetric to rounding."""
    return np.allclose(matrix, matrix.T, rtol=1e-12, atol=0)
