"""The controller in CasADi and the robot in MuJoCo, step by step."""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import casadi as ca
import mujoco
import numpy as np

from tarc.control.digital_controller import ControllerInput, ControllerOutput, ControllerState, DigitalController
from tarc.core.codegen import compiled
from tarc.core.tracing import BUFFER_PERIODS, PeriodBuffer, trace
from tarc.core.trees import pack
from tarc.core.types import Vector
from tarc.estimators.oracle import TrueDerivatives
from tarc.plants.mujoco import MujocoPlant
from tarc.plants.mujoco_gearbox import MujocoGearbox
from tarc.plants.robot_file import without_log_file
from tarc.signals.drive import Drive
from tarc.simulation.closed_loop import LoopOutput
from tarc.simulation.monitor import DIVERGENCE_CHECK_INTERVAL, DivergenceMonitor
from tarc.simulation.mujoco_gears import Gears
from tarc.simulation.record import Record
from tarc.simulation.sampled_inputs import InitialConditions, SampledInputs


class _Measurement(NamedTuple):
    """True acceleration (n,), and the inputs of the controller."""

    acceleration: Vector
    value: ControllerInput


class _MujocoLoop:
    """A MuJoCo model and the traced controller, which share their arrays.

    The controller reads position, velocity and acceleration from the simulator's arrays and writes the torque there.
    """

    def __init__(
        self,
        plant: MujocoPlant | MujocoGearbox,
        controller: DigitalController,
        initial: InitialConditions,
        inputs: SampledInputs,
        native: bool,
        drive: Drive | None,
    ):
        n, m = plant.n_joints, plant.n_coordinates
        self.plant = plant
        self.model = plant.copy_model()
        self.model.opt.timestep = controller.law.period / inputs.disturbance.shape[2]
        self.data = mujoco.MjData(self.model)
        self.gears: Gears | None = None
        if isinstance(plant, MujocoGearbox):
            self.gears = Gears(plant, self.model, self.data, initial.position, initial.velocity)
        else:
            self.data.qpos[:] = initial.position
            self.data.qvel[:] = initial.velocity
        self.inputs = inputs
        # Runge–Kutta leaves the acceleration of its last stage behind, so the one at the start is computed beforehand
        self.is_runge_kutta = self.model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
        self.is_oracle = isinstance(controller.law.estimator, TrueDerivatives)
        self.is_segmented = drive is not None or inputs.periods is not None or self.gears is not None
        is_one_step = inputs.disturbance.shape[2] == 1 and not self.is_segmented
        self.is_plain = is_one_step and not self.is_runge_kutta and not self.is_oracle
        self.acceleration = self.data.qacc if self.is_plain else np.zeros(m)
        self.final_acceleration = np.zeros(m)
        changes = np.diff(inputs.disturbance, axis=2).transpose(1, 2, 0)
        self.substep_torques = np.zeros((*changes.shape[:2], m))
        self.substep_torques[:, :, list(plant.driven)] = changes

        state = controller.init(initial.position[list(plant.measured)], initial.torque, inputs.noise[:, 0])
        zero = np.zeros(n)
        age = np.zeros(0 if inputs.age is None else 1)
        value = _Measurement(zero, ControllerInput(*[zero] * 6)._replace(age=age))
        function, self.example = trace(_step_with_true_derivatives(controller), state, value, name="controller")
        self._set_up_servo()
        function = _with_simulator_arrays(function, plant, () if self.is_segmented else self._commanded)
        shared = {
            "q": self.data.qpos if self.gears is None else self.gears.position,
            "v": self.data.qvel if self.gears is None else self.gears.velocity,
            "a": self.acceleration,
            "last": self.final_acceleration,
            "torque": self.data.qfrc_applied,
            "control": self.data.ctrl,
        }
        if self.is_segmented:
            shared["torque"] = self._command = np.zeros(m)
            self._period = controller.law.period
            self._drive = drive or Drive()
            self._drive_state = self._drive.init(state.torque_delay_line[:, -1])
            self._segments = self._drive.segments(inputs.disturbance.shape[2], self._period)
            self.drive_torques = np.zeros((len(inputs.times), n))
        self.buffer = PeriodBuffer(compiled(function) if native else function, pack(state), BUFFER_PERIODS, shared)
        if self.is_oracle:
            self._apply(state.torque_delay_line[:, -1], zero)
            self._update_final_acceleration()

    def _set_up_servo(self) -> None:
        """Find the actuators that take the commands of the joints, with their control input per unit."""
        servo = self.plant.servo
        names = () if servo is None else servo.names
        self._commanded = [
            (joint, self.model.actuator(name).id, float(servo.scale[joint]))
            for joint, name in enumerate(names)
            if servo is not None and name
        ]

    def _apply(self, command: np.ndarray, disturbance: np.ndarray) -> None:
        """Set what acts on the joints: outputs of the law and disturbances, each (n,)."""
        torque = np.array(command, dtype=float)
        for joint, actuator, scale in self._commanded:
            self.data.ctrl[actuator] = scale * torque[joint]
            torque[joint] = 0.0
        if self.gears is not None:
            self.gears.torque[:] = torque + disturbance
        else:
            self.data.qfrc_applied[list(self.plant.driven)] = torque + disturbance

    def _update_final_acceleration(self) -> None:
        """Compute the acceleration under the present torque, which the oracle reads before the torque changes."""
        self.final_acceleration[:] = self._present_acceleration()

    def _present_acceleration(self) -> np.ndarray:
        if self.gears is not None:
            self.gears.update_acceleration()
            return self.gears.acceleration
        mujoco.mj_forward(self.model, self.data)
        return self.data.qacc

    def _step_and_accelerate(self) -> np.ndarray:
        """Step once; return the acceleration at the start of the step."""
        if self.gears is not None:
            self.gears.step()
            return self.gears.acceleration
        mujoco.mj_step(self.model, self.data)
        return self.data.qacc

    def set_parameters(self, values: dict[str, np.ndarray]) -> None:
        """Change parameters of the robot."""
        self.plant.set_parameters(self.model, values)
        if self.gears is not None:
            self.gears.set_parameters(values)

    def advance(self, start: int, stop: int, input_rows: np.ndarray) -> np.ndarray:
        """Simulate the periods from ``start`` to ``stop``, which lie in one buffer; return their rows."""
        step, model, data = mujoco.mj_step, self.model, self.data
        place = slice(start % BUFFER_PERIODS, start % BUFFER_PERIODS + stop - start)
        self.buffer.rows["outside"][place] = input_rows
        if self.is_plain:
            for call in self.buffer.calls[place]:
                call()
                step(model, data)
        elif self.is_segmented:
            for k, call in enumerate(self.buffer.calls[place], start):
                call()
                self._advance_in_segments(k)
        else:
            for call, torques in zip(self.buffer.calls[place], self.substep_torques[start:stop], strict=True):
                call()
                if self.is_runge_kutta:
                    mujoco.mj_forward(model, data)
                    self.acceleration[:] = data.qacc
                step(model, data)
                if not self.is_runge_kutta:
                    self.acceleration[:] = data.qacc
                for torque in torques:
                    data.qfrc_applied += torque
                    step(model, data)
                if self.is_oracle:
                    self._update_final_acceleration()
        return self.buffer.rows["row"][place]

    def _advance_in_segments(self, k: int) -> None:
        """Simulate the period k, with a drive or a length of its own, in parts with a constant torque each."""
        period = self._period if self.inputs.periods is None else self.inputs.periods[k]
        # the command contains the disturbance of the first substep
        disturbance = self.inputs.disturbance[:, k]
        command = self._command[list(self.plant.driven)] - disturbance[:, 0]
        self._drive_state, torques = self._drive.step(self._drive_state, command, period, self._segments)
        for number, (segment, torque) in enumerate(zip(self._segments, torques, strict=True)):
            self._apply(torque, disturbance[:, segment.substep])
            self.model.opt.timestep = (segment.stop - segment.start) * period
            if number == 0 and self.is_runge_kutta:
                self.acceleration[:] = self._present_acceleration()
            acceleration = self._step_and_accelerate()
            if number == 0 and not self.is_runge_kutta:
                self.acceleration[:] = acceleration
            self.drive_torques[k] += (segment.stop - segment.start) * torque
        if self.is_oracle:
            self._update_final_acceleration()


def run_mujoco(
    plant: MujocoPlant | MujocoGearbox,
    controller: DigitalController,
    initial: InitialConditions,
    inputs: SampledInputs,
    monitor: DivergenceMonitor,
    native: bool = False,
    drive: Drive | None = None,
) -> Record:
    """Step the plant in MuJoCo; call the controller between the steps over fixed memory."""
    n, n_periods = plant.n_joints, len(inputs.times)
    changes = _parameter_changes(inputs)
    ages = [] if inputs.age is None else [inputs.age[None]]
    input_rows = np.concatenate([*inputs.reference, inputs.noise, *ages, inputs.disturbance[:, :, 0]]).T
    stop = 0
    n_checked = 0
    with monitor.progress, without_log_file():
        loop = _MujocoLoop(plant, controller, initial, inputs, native, drive)
        rows = np.empty((n_periods, loop.buffer.rows["row"].shape[1]))
        stops = sorted({*range(0, n_periods, BUFFER_PERIODS), *changes, n_periods})
        for start, stop in pairwise(stops):
            if start in changes:
                loop.set_parameters(changes[start])
            rows[start:stop] = loop.advance(start, stop, input_rows[start:stop])
            if stop - n_checked >= DIVERGENCE_CHECK_INTERVAL or stop == n_periods:
                if not monitor.update(n_checked, rows[n_checked:stop, :n]):
                    break
                n_checked = stop
    acceleration = rows[:stop, 2 * n : 3 * n]  # each row has the acceleration of the step before
    acceleration[:-1] = acceleration[1:].copy()
    acceleration[-1] = loop.acceleration[list(plant.measured)]
    zero, others = np.zeros(n), np.zeros(len(plant.unmeasured))
    passive = {"passive_position": others, "passive_velocity": others} if plant.unmeasured else {}
    n_valid = monitor.valid_rows(stop)
    record = Record.from_rows(LoopOutput(zero, zero, zero, loop.example, passive), rows[:n_valid])
    if drive is not None:
        record.arrays["drive_torque"] = loop.drive_torques[:n_valid]
    return record


def _step_with_true_derivatives(
    controller: DigitalController,
) -> Callable[[ControllerState, _Measurement], tuple[ControllerState, ControllerOutput]]:
    """Return the controller's step, with the true derivatives for the oracle among its inputs."""

    def step(state: ControllerState, value: _Measurement) -> tuple[ControllerState, ControllerOutput]:
        state = controller.with_true_derivatives(state, value.value.velocity, value.acceleration)
        return controller.step(state, value.value)

    return step


def _with_simulator_arrays(
    controller: ca.Function, plant: MujocoPlant | MujocoGearbox, commanded: Sequence[tuple[int, int, float]]
) -> ca.Function:
    """Split the controller's input by the simulator's arrays; join its outputs, and what is recorded, in one row.

    The simulator's arrays have all joints that move. The controller has the driven ones. What is commanded by an
    actuator goes to the simulator's control inputs, not to its torques.
    """
    n, m = plant.n_joints, plant.n_coordinates
    joints, others = list(plant.measured), list(plant.unmeasured)
    x, outside = ca.SX.sym("x", controller.nnz_in(0)), ca.SX.sym("outside", controller.nnz_in(1) - 2 * n)
    q, v, a, last = (ca.SX.sym(name, m) for name in ("q", "v", "a", "last"))
    x_next, y = controller(x, ca.vertcat(last[joints], q[joints], v[joints], outside[:-n]))
    output, control = y[n : 2 * n], ca.SX.zeros(plant.model.nu)
    for joint, actuator, scale in commanded:
        control[actuator] = scale * output[joint]
        output[joint] = 0
    torque = ca.SX.zeros(m)
    torque[list(plant.driven)] = output + outside[-n:]
    row = ca.vertcat(q[joints], v[joints], a[joints], y, q[others], v[others])
    names = ["x", "q", "v", "a", "last", "outside"], ["x_next", "torque", "row"]
    outputs = [x_next, torque, row]
    if plant.model.nu:
        names[1].append("control")
        outputs.append(control)
    return ca.Function("controller", [x, q, v, a, last, outside], outputs, *names)


def _parameter_changes(inputs: SampledInputs) -> dict[int, dict[str, np.ndarray]]:
    """Return the scheduled parameters that change, by the period in which they do."""
    changes: dict[int, dict[str, np.ndarray]] = {}
    for name, values in inputs.schedules.items():
        is_change = np.any(np.diff(values, axis=1) != 0, axis=0)
        for k in [0, *(1 + np.flatnonzero(is_change))]:
            changes.setdefault(int(k), {})[name] = values[:, k]
    return changes
