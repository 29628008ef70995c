"""Robots in this process for the tests of the loop, and runs on them."""

from typing import Any

import numpy as np

import tarc
from tarc.core.types import Array
from tarc.runtime import LiveRun, Robot, SafetyLimits, SimulatedClock, StartUp, run_live
from tarc.runtime.log import Log
from tarc.runtime.log_format import LogLayout

PERIOD = 1e-3
INERTIA = np.array([0.5, 0.2])
WEIGHT = np.array([3.0, -1.0])
"""Torque of the load [N m]."""


ARM_FILE = """
<mujoco>
  <option timestep="0.001"> <flag contact="disable"/> </option>
  <worldbody>
    <body>
      <joint name="shoulder" axis="0 -1 0" damping="0.5" armature="0.02"/>
      <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.03" mass="2"/>
      <body pos="0.4 0 0">
        <joint name="elbow" axis="0 -1 0" damping="0.5" armature="0.02"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="1"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
"""Two links in MJCF, without contacts."""


class SlidingMasses(Robot):
    """Two joints with a constant load each, which move by a period for each command.

    Attributes
    ----------
    written
        Every torque, in order.
    is_braked
        Whether the brakes are closed.
    torque_constant
        Torque that acts, per torque that is written.
    """

    joint_names = ("first", "second")

    def __init__(self, position: Array | None = None) -> None:
        self.position = np.array([0.3, -0.2]) if position is None else np.array(position, dtype=float)
        self.velocity = np.zeros(2)
        self.is_braked = True
        self.written: list[Array] = []
        self.torque_constant = np.ones(2)
        self.applied_torque = WEIGHT.copy()

    def read(self) -> Array:
        return self.position.copy()

    def write(self, torque: Array) -> None:
        self.written.append(np.array(torque))
        if self.is_braked:
            return
        acceleration = (self.torque_constant * torque - WEIGHT) / INERTIA
        self.position += PERIOD * self.velocity + PERIOD**2 / 2 * acceleration
        self.velocity += PERIOD * acceleration

    def release_brakes(self) -> None:
        self.is_braked = False

    def engage_brakes(self) -> None:
        self.is_braked = True
        self.velocity[:] = 0.0


def example_law(**changes: Any) -> tarc.laws.TDC:
    parameters: dict[str, Any] = {
        "inertia": 0.1 * INERTIA,
        "natural_frequency": 20.0,
        "period": PERIOD,
        "estimator": tarc.estimators.Algebraic(window=0.010, degree=2),
        "torque_limit": [20.0, 10.0],
    }
    return tarc.laws.TDC(**(parameters | changes))


REFERENCE = tarc.signals.Sinusoid(amplitude=0.2, frequency=[3.0, 4.0], phase=np.pi / 2)
QUICK = StartUp(hold_time=0.05, ramp_time=0.2, brake_time=0.02, stop_time=0.1)


def rows_of(
    robot: Robot, law: tarc.laws.TDC | None = None, duration: float = 0.3, **options: Any
) -> tuple[LiveRun, dict[str, Array]]:
    """Run on a simulated clock; return the result, and every row by the name of its variable."""
    law = law or example_law()
    logs: list[Log] = []
    options = {"start_up": QUICK, "clock": SimulatedClock(), "native": False, "limits": SafetyLimits()} | options
    result = run_live(law, robot, REFERENCE, duration, on_log=logs.append, **options)
    rows = logs[0].ring.read()
    layout = LogLayout.of(law)
    return result, {c.name: np.squeeze(rows[:, c.start : c.start + c.size]) for c in layout.columns}
