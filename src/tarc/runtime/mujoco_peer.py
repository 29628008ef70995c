"""A robot in MuJoCo, in a process of its own that keeps its own clock.

Run as ``python -m tarc.runtime.mujoco_peer FOLDER``; `tarc.runtime.MujocoRobot` writes the folder and starts it.
"""

import json
import os
import shutil
import signal
import sys
import time
from pathlib import Path
from typing import Any

from tarc.core.optional import require

require("robots", "tarc.runtime.MujocoRobot")

import mujoco
import numpy as np

from tarc.core.types import Array
from tarc.runtime.clock import Clock
from tarc.runtime.packets import Flag, Kind, Packet, decode, encode, is_newer
from tarc.runtime.real_time import real_time
from tarc.runtime.transports import Mailbox, Transport, UdpTransport

MAX_LAG = 0.1
"""Lag behind its clock after which the robot leaves time out, rather than to catch up [s]."""
ORPHAN_CHECK = 200
"""Periods between two looks whether the parent process lives."""
SILENCE = 1.0
"""Time without a command after which another program may take over [s]."""


class MujocoPeer:
    """The robot: takes commands, integrates, sends states.

    The brakes hold it at rest until a command releases them, and after a safe stop. They do so too where none came
    for the time of its watchdog.

    Parameters
    ----------
    model
        The robot.
    settings
        As `tarc.runtime.MujocoRobot` writes them.
    transport
        How packets come and go.
    """

    def __init__(self, model: mujoco.MjModel, settings: dict[str, Any], transport: Transport):
        self._model, self._data, self._transport = model, mujoco.MjData(model), transport
        self._driven, self._measured = list(settings["driven"]), list(settings["measured"])
        self._names = tuple(settings["joint_names"])
        self._commanded = [tuple(entry) for entry in settings["commanded"]]
        self._period, self._substeps = float(settings["period"]), int(settings["substeps"])
        self._watchdog, self._echoes = float(settings["watchdog"]), bool(settings["echoes"])
        self._step_size, self._noise = np.array(settings["step_size"]), np.array(settings["noise"])
        self._rng = np.random.default_rng(settings["seed"])
        model.opt.timestep = self._period / self._substeps
        self._data.qpos[:] = settings["position"]
        self._torque = np.zeros(len(self._driven))
        self._last_sequence: int | None = None
        self._last_command = -np.inf
        self._is_released = self._is_stopped = False
        self._sent = 0
        self.malformed = 0
        self._parent = os.getppid()
        mujoco.mj_forward(model, self._data)

    def run(self) -> None:
        """Go on until the parent process ends."""
        clock = Clock()
        deadline = clock.now()
        count = 0
        while count % ORPHAN_CHECK or os.getppid() == self._parent:
            count += 1
            had_command = self._take_commands(clock.now())
            if not self._echoes or had_command:
                self._advance(clock.now())
                self._send(clock.now())
            if self._echoes:
                time.sleep(self._period / 20)
                continue
            deadline += self._period
            if clock.now() - deadline > MAX_LAG:
                deadline = clock.now()
            clock.sleep_until(deadline)

    def _take_commands(self, now: float) -> bool:
        """Take what came; return whether it was a command."""
        had_command = False
        for data in self._transport.receive():
            packet = decode(data)
            if packet is None or packet.kind != Kind.COMMAND:
                self.malformed += 1
                continue
            if self._last_sequence is not None and not is_newer(packet.sequence, self._last_sequence):
                continue
            had_command |= self._take(packet, now)
        silence = now - self._last_command
        if silence > SILENCE and np.isfinite(silence) and isinstance(self._transport, UdpTransport):
            self._transport.forget_peer()
            self._last_sequence, self._last_command = None, -np.inf
            self._is_stopped = self._is_released = False
        return had_command

    def _take(self, packet: Packet, now: float) -> bool:
        self._last_command = now
        if packet.flags & Flag.HELLO:
            self._last_sequence = packet.sequence
            self._transport.send(encode(Kind.NAMES, packet.sequence, now, names=self._names))
            return True
        if packet.values.shape[1] != len(self._driven):
            self.malformed += 1
            return False
        self._last_sequence = packet.sequence
        self._torque[:] = packet.values[0]
        self._is_stopped |= bool(packet.flags & Flag.STOP)
        self._is_released = bool(packet.flags & Flag.RELEASE)
        return True

    @property
    def _sequence(self) -> int:
        return (self._last_sequence or 0) if self._echoes else self._sent

    def _advance(self, now: float) -> None:
        """Move by a period, or hold still by the brakes."""
        in_time = self._echoes or now - self._last_command < self._watchdog
        if not self._is_released or self._is_stopped or not in_time:
            self._data.qvel[:] = 0
            mujoco.mj_forward(self._model, self._data)
            return
        torque = self._torque.copy()
        for joint, actuator, scale in self._commanded:
            self._data.ctrl[actuator] = scale * torque[joint]
            torque[joint] = 0
        self._data.qfrc_applied[self._driven] = torque
        for _ in range(self._substeps):
            mujoco.mj_step(self._model, self._data)

    def _send(self, now: float) -> None:
        """Send position and torque, that of the brakes where they hold."""
        self._sent += 1
        position = self._data.qpos[self._measured] + self._noise * self._rng.standard_normal(len(self._measured))
        steps = np.where(self._step_size > 0, self._step_size, 1.0)
        position = np.where(self._step_size > 0, steps * np.round(position / steps), position)
        self._transport.send(encode(Kind.STATE, self._sequence, now, [position, self._joint_torque()]))

    def _joint_torque(self) -> Array:
        if self._is_released and not self._is_stopped:
            return self._torque
        return (self._data.qfrc_bias - self._data.qfrc_passive)[self._driven]


def main(folder: Path) -> None:
    """Run the robot of a folder."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    settings = json.loads((folder / "peer.json").read_text(encoding="utf-8"))
    model = mujoco.MjModel.from_binary_path(str(folder / "model.mjb"))
    port = settings["port"]
    transport: Transport
    if port is None:
        transport = Mailbox(folder / "mailbox", 1)
    else:
        transport = UdpTransport(None, (settings["host"], port))
        (folder / "port.part").write_text(str(transport.port), encoding="utf-8")
        (folder / "port.part").rename(folder / "port")
    with real_time(settings["priority"]):
        MujocoPeer(model, settings, transport).run()
    shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
