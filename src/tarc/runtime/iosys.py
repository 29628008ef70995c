"""Laws and robots as systems of python-control."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from tarc.control.controller import Controller
from tarc.core.errors import InvalidParameter
from tarc.core.optional import require
from tarc.core.types import Array
from tarc.laws.base import Law
from tarc.plants.base import Plant
from tarc.runtime.sampled_plant import SampledPlant
from tarc.signals.torque_limits import TorqueLimits

if TYPE_CHECKING:
    from control import NonlinearIOSystem

LAW_INPUTS = ("position", "reference", "velocity_reference", "acceleration_reference")
"""Inputs of a law, each with one signal per joint: ``position[0]`` and so on."""


def to_iosys(
    part: Law | Plant,
    *,
    period: float | None = None,
    substeps: int = 2,
    torque_limits: TorqueLimits | None = None,
    name: str | None = None,
) -> "NonlinearIOSystem":
    """Return a law or a robot as a discrete-time `NonlinearIOSystem` of python-control.

    The names of their signals fit: `control.interconnect([law, robot], …)` closes the loop by itself. A law has the
    inputs ``position``, ``reference``, ``velocity_reference`` and ``acceleration_reference``, and the output
    ``torque``. A robot has the input ``torque``, and the outputs ``position`` and ``velocity``. Each has one signal per
    joint, such as ``torque[0]``.

    Parameters
    ----------
    part
        A law, or a robot in symbols.
    period
        T of a robot [s]; a law has its own.
    substeps
        Runge–Kutta steps of a robot per period.
    torque_limits
        Limits of the robot's interface, as for `Controller`.
    name
        Name of the system; None for ``law`` or ``robot``.

    Returns
    -------
    control.NonlinearIOSystem
        With the period as its time base. The state of a law is that of `Controller.state_at_start`, that of a robot
        position and velocity. With as many substeps the numbers are those of `tarc.simulate`.

    Raises
    ------
    InvalidParameter
        For anything else, a robot without a period, and a law that `Controller` refuses.
    MissingTool
        Without the extra ``control``.

    Examples
    --------
    >>> import control, tarc
    >>> law = tarc.laws.TDC(inertia=[0.1], natural_frequency=10.0, period=1e-3,
    ...                     estimator=tarc.estimators.Algebraic(window=0.010))
    >>> system = tarc.runtime.to_iosys(law)
    >>> system.dt, system.ninputs, system.noutputs
    (0.001, 4, 1)
    """
    require("control", "to_iosys")
    if isinstance(part, Law):
        controller = Controller(part, torque_limits=torque_limits)
        n = part.n_joints
        inputs = [f"{signal}[{i}]" for signal in LAW_INPUTS for i in range(n)]
        return _system(controller.function, n, inputs, _labels("torque", n), part.period, name or "law")
    if not isinstance(part, Plant) or period is None:
        raise InvalidParameter(
            f"part: got {part!r} with a period of {period}; needs a law, or a robot with a period", "part"
        )
    n = part.n_joints
    sampled = SampledPlant.from_robot(part, period, substeps)
    outputs = [*_labels("position", n), *_labels("velocity", n)]
    return _robot(sampled.function(), n, outputs, period, name or "robot")


def _labels(signal: str, n: int) -> list[str]:
    return [f"{signal}[{i}]" for i in range(n)]


def _numbers(function: ca.Function, place: int) -> Callable[[Array, Array], Array]:
    """Return one result of a function of two vectors, as an array."""
    return lambda state, value: np.asarray(function(state, value)[place]).ravel()


def _system(
    function: ca.Function, n_outputs: int, inputs: list[str], outputs: list[str], period: float, name: str
) -> "NonlinearIOSystem":
    """Return a system whose output has the first numbers of a function's second result."""
    from control import NonlinearIOSystem

    following, output = _numbers(function, 0), _numbers(function, 1)
    return NonlinearIOSystem(
        lambda t, x, u, params: following(x, u),
        lambda t, x, u, params: output(x, u)[:n_outputs],
        inputs=inputs,
        outputs=outputs,
        states=[f"{name}_x[{i}]" for i in range(function.nnz_in(0))],
        dt=period,
        name=name,
    )


def _robot(function: ca.Function, n: int, outputs: list[str], period: float, name: str) -> "NonlinearIOSystem":
    """Return a robot, whose outputs are its state, so that a law which needs them at once can be connected."""
    from control import NonlinearIOSystem

    following = _numbers(function, 0)
    return NonlinearIOSystem(
        lambda t, x, u, params: following(x, u),
        lambda t, x, u, params: x,
        inputs=_labels("torque", n),
        outputs=outputs,
        states=[f"{name}_x[{i}]" for i in range(2 * n)],
        dt=period,
        name=name,
    )
