"""A robot in MuJoCo, in a second process, over shared memory or UDP."""

import json
import shutil
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from tarc.core.optional import require

require("robots", "tarc.runtime.MujocoRobot")

import mujoco
import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.validation import Numbers
from tarc.plants.base import Plant
from tarc.plants.mujoco import MujocoPlant
from tarc.plants.rigid_body import RigidBody
from tarc.runtime.packet_robot import PacketRobot
from tarc.runtime.shared_memory import shared_memory_folder
from tarc.runtime.transports import Mailbox, Transport, UdpTransport

START_TIME = 20.0
"""Time that the process has to start [s]."""


class MujocoRobot(PacketRobot):
    """A robot from a file, simulated in real time by MuJoCo in a process of its own.

    It keeps its own clock and moves on whether or not commands come, as a machine does. Its brakes hold it until the
    loop releases them, after a safe stop, and where commands fail to come for the time of its watchdog.

    Parameters
    ----------
    plant
        A robot of `tarc.plants.load_robot`.
    period
        Time between two states [s].
    position
        Coordinates at the start [rad or m], shape (m,) or that of the joints, (n,); None for the robot's home.
    udp
        Port of UDP to speak by, 0 for any that is free; None for shared memory.
    watchdog
        Time without a command after which the brakes are engaged [s].
    substeps
        Steps of MuJoCo per period.
    step_size, noise
        Step of the encoders, and standard deviation of white noise before it [rad or m].
    in_step
        Let the robot move by a period for each command instead of by its clock. Then a run is the same every time.
    seed
        Seed of the noise.
    priority
        Of SCHED_FIFO for the process, 1 to 99, where it is allowed; 0 for the ordinary scheduler.

    Attributes
    ----------
    process
        The process.

    Raises
    ------
    InvalidParameter
        For a robot that is not from a file, and a port in use.
    """

    def __init__(
        self,
        plant: Plant,
        period: float,
        *,
        position: Numbers | None = None,
        udp: int | None = None,
        watchdog: float = 0.1,
        substeps: int = 1,
        step_size: Numbers = 0.0,
        noise: Numbers = 0.0,
        in_step: bool = False,
        seed: int = 0,
        priority: int = 80,
    ):
        source = plant.mujoco if isinstance(plant, RigidBody) else plant
        if not isinstance(source, MujocoPlant):
            raise InvalidParameter(
                f"robot: MuJoCo cannot run {plant.label}, which is not from a file; give a robot of "
                "tarc.plants.load_robot without a gearbox, or a robot of your own"
            )
        n = source.n_joints
        if position is None:
            position = source.home
        coordinates = check.array("position", position)
        if coordinates.shape != (source.n_coordinates,):
            coordinates = source.coordinates(check.vector("position", coordinates, n))
        settings = {
            "period": check.number("period", period, 0, strict=True),
            "substeps": check.integer("substeps", substeps, 1),
            "watchdog": check.number("watchdog", watchdog, 0, strict=True),
            "echoes": bool(in_step),
            "driven": list(source.driven),
            "measured": list(source.measured),
            "joint_names": source.joint_names,
            "commanded": _commanded(source),
            "position": coordinates.tolist(),
            "step_size": check.vector("step_size", step_size, n, 0).tolist(),
            "noise": check.vector("noise", noise, n, 0).tolist(),
            "seed": check.integer("seed", seed),
            "priority": check.integer("priority", priority, 0, 99),
            "host": "127.0.0.1",
            "port": udp,
        }
        with ExitStack() as on_error:
            self._folder = Path(tempfile.mkdtemp(prefix="tarc-robot-", dir=shared_memory_folder()))
            on_error.callback(shutil.rmtree, self._folder, ignore_errors=True)
            transport = self._start(source, settings, on_error)
            self.joint_names = tuple(source.joint_names)
            super().__init__(transport, timeout=START_TIME, echoes=in_step)
            self._timeout = 1.0
            on_error.pop_all()

    def _start(self, source: MujocoPlant, settings: dict[str, Any], on_error: ExitStack) -> Transport:
        """Start the process and return the way to it."""
        mujoco.mj_saveModel(source.copy_model(), str(self._folder / "model.mjb"))
        (self._folder / "peer.json").write_text(json.dumps(settings), encoding="utf-8")
        Mailbox.create(self._folder / "mailbox")
        command = [sys.executable, "-m", "tarc.runtime.mujoco_peer", str(self._folder)]
        self._errors = (self._folder / "errors").open("wb")
        self.process = subprocess.Popen(command, start_new_session=True, stdin=subprocess.DEVNULL, stderr=self._errors)
        on_error.callback(self._end_process)
        transport: Transport
        if settings["port"] is None:
            transport = Mailbox(self._folder / "mailbox", 0)
        else:
            transport = UdpTransport(("127.0.0.1", self._port()))
        on_error.callback(transport.close)
        return transport

    def _port(self) -> int:
        """Return the port that the process says it listens at."""
        end = time.monotonic() + START_TIME
        while time.monotonic() < end and self.process.poll() is None:
            if (self._folder / "port").exists():
                return int((self._folder / "port").read_text(encoding="utf-8"))
            time.sleep(0.01)
        lines = (self._folder / "errors").read_text(encoding="utf-8").strip().splitlines() or ["it says nothing"]
        raise InvalidParameter(f"robot: the process of MuJoCo did not start: {lines[-1]}")

    def _end_process(self) -> None:
        self.process.kill()
        self.process.wait()
        self._errors.close()

    def release_port(self) -> int:
        """Give up the connection by UDP, so that another program may take the robot a second later; return its port."""
        assert isinstance(self._transport, UdpTransport)
        self._transport.close()
        return self._port()

    def close(self) -> None:
        """End the process."""
        super().close()
        self._end_process()
        shutil.rmtree(self._folder, ignore_errors=True)


def _commanded(source: MujocoPlant) -> list[tuple[int, int, float]]:
    """Return joint, actuator and control input per unit, for joints that take positions."""
    if source.servo is None:
        return []
    scale = np.asarray(source.servo.scale, dtype=float)
    return [
        (joint, int(source.model.actuator(name).id), float(scale[joint]))
        for joint, name in enumerate(source.servo.names)
        if name
    ]
