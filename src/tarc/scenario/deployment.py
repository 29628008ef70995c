"""A law of a scenario with all that its machine needs."""

from dataclasses import replace
from typing import Any

from tarc.core.errors import InvalidParameter
from tarc.scenario.model import Scenario


def law_of(scenario: Scenario, name: str = "") -> tuple[str, Any, Any, tuple[str, ...]]:
    """Return name, law, torque limits and joint names of a law in a scenario; the first without a name.

    A law without torque limits gets those of the robot.

    Raises
    ------
    InvalidParameter
        For a name that is not there.
    """
    setup = scenario.build()
    chosen = name or next(iter(setup.laws))
    if chosen not in setup.laws:
        raise InvalidParameter(f"--law: got {name!r}; the scenario has {', '.join(setup.laws)}")
    law = setup.laws[chosen]
    if law.torque_limit is None and setup.plant.torque_limits is not None:
        law = replace(law, torque_limit=setup.plant.torque_limits)
    return chosen, law, setup.torque_limits, tuple(setup.plant.joint_names)
