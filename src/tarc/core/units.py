"""Units of quantities, by the kinds of the joints."""

from collections.abc import Iterable


def joint_units(units: Iterable[str]) -> str:
    """Return the different units of the joints, joined by "or".

    Examples
    --------
    >>> joint_units(["N m", "N m"]), joint_units(["N", "N m"])
    ('N m', 'N m or N')
    """
    return " or ".join(sorted(set(units), key=lambda unit: (not unit.startswith("N"), -len(unit))))


def unit_for_joints(unit: str, joint_units: Iterable[str]) -> str:
    """Return a unit that is written for revolute joints as it is for joints of these kinds.

    Parameters
    ----------
    unit
        With rad and N m in it, such as ``rad/s`` or ``N m/s``.
    joint_units
        Unit of each joint, ``rad`` or ``m``.

    Examples
    --------
    >>> unit_for_joints("mrad", ["m", "m"]), unit_for_joints("N m/s", ["m"]), unit_for_joints("rad/s", ["rad", "m"])
    ('mm', 'N/s', '(rad or m)/s')
    """
    kinds = set(joint_units)
    if kinds == {"rad"}:
        return unit
    if len(kinds) > 1:
        return unit.replace("rad", "(rad or m)").replace("N m", "N m or N")
    return unit.replace("rad", "m").replace("N m", "N")
