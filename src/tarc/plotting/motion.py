"""Motion of the robot that is drawn for a run."""

from typing import TYPE_CHECKING

import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.plants.base import Plant
from tarc.plants.drawn import drawn_plant

if TYPE_CHECKING:
    from tarc.simulation.run import Run


def robot_of(run: "Run", plant: Plant | None) -> Plant:
    """Return the robot of a run: the given one, or the one that was simulated.

    Raises
    ------
    InvalidParameter
        For a run that was loaded and has no robot, and for a robot with other joints.
    """
    robot = run.plant if plant is None else plant
    if robot is None:
        raise InvalidParameter("plant: a run that was loaded has no robot; give the robot that was simulated")
    joints = run.data["joint"].values.tolist()
    if joints != robot.joint_names:
        raise InvalidParameter(
            f"plant: {robot.label} has the joints {', '.join(robot.joint_names)}, and the run has "
            f"{', '.join(joints)}; give the robot that was simulated"
        )
    return robot


def drawn_coordinates(run: "Run", plant: Plant, name: str, times: Array) -> Array:
    """Return the coordinates of the drawn robot at times (k,), shape (k, m).

    Parameters
    ----------
    run, plant
        The run and its robot.
    name
        ``position`` or ``reference``: where the joints are.
    times
        [s]; past the end of the run, the robot stays.
    """
    recorded = run.data["time"].values
    joints = _at_times(times, recorded, run.data[name].values)
    coordinates = np.zeros((len(times), plant.n_coordinates))
    if plant.constraints and name == "reference":
        return np.array([plant.coordinates(row) for row in joints])
    coordinates[:, list(plant.measured)] = joints
    if plant.unmeasured:
        is_elastic = plant.n_coordinates > drawn_plant(plant).n_coordinates
        other = joints if is_elastic and name == "reference" else None
        passive = _at_times(times, recorded, run.data["passive_position"].values) if other is None else other
        coordinates[:, list(plant.unmeasured)] = passive
    return coordinates[:, : drawn_plant(plant).n_coordinates]


def _at_times(times: Array, recorded: Array, values: Array) -> Array:
    """Interpolate the columns of values (k, n) at other times."""
    return np.column_stack([np.interp(times, recorded, column) for column in values.T])
