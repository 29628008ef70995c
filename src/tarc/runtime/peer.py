"""A simulated robot at the other end of packets, which keeps its own clock."""

import os
import shutil
import time
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

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


class Body(ABC):
    """What moves: a robot of n joints."""

    @abstractmethod
    def position(self) -> Array:
        """Return the positions of the joints [rad or m], shape (n,)."""

    @abstractmethod
    def holding_torque(self) -> Array:
        """Return the torque of brakes that hold it at rest where it is [N m or N], shape (n,)."""

    @abstractmethod
    def hold(self) -> None:
        """Stay at rest for a period."""

    @abstractmethod
    def advance(self, torque: Array) -> None:
        """Move by a period under a torque [N m or N], shape (n,)."""


class Peer:
    """The robot: takes commands, moves, sends states.

    The brakes hold it at rest until a command releases them, and after a safe stop. They do so too where none came
    for the time of its watchdog.

    Parameters
    ----------
    body
        What moves.
    settings
        As `tarc.runtime.peer_robot.PeerRobot` writes them.
    transport
        How packets come and go.
    """

    def __init__(self, body: Body, settings: dict[str, Any], transport: Transport):
        self._body, self._transport = body, transport
        self._names = tuple(settings["joint_names"])
        self._n = len(self._names)
        self._period = float(settings["period"])
        self._watchdog, self._echoes = float(settings["watchdog"]), bool(settings["echoes"])
        self._step_size, self._noise = np.array(settings["step_size"]), np.array(settings["noise"])
        self._rng = np.random.default_rng(settings["seed"])
        self._torque = np.zeros(self._n)
        self._last_sequence: int | None = None
        self._last_command = -np.inf
        self._is_released = self._is_stopped = False
        self._sent = 0
        self.malformed = 0
        self._parent = os.getppid()

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
        if packet.values.shape[1] != self._n:
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
            self._body.hold()
        else:
            self._body.advance(self._torque.copy())

    def _send(self, now: float) -> None:
        """Send position and torque, that of the brakes where they hold."""
        self._sent += 1
        position = self._body.position() + self._noise * self._rng.standard_normal(self._n)
        steps = np.where(self._step_size > 0, self._step_size, 1.0)
        position = np.where(self._step_size > 0, steps * np.round(position / steps), position)
        is_free = self._is_released and not self._is_stopped
        torque = self._torque if is_free else self._body.holding_torque()
        self._transport.send(encode(Kind.STATE, self._sequence, now, [position, torque]))


def run_peer(folder: Path, settings: dict[str, Any], body: Body) -> None:
    """Run the robot of a folder, over its mailbox or the port that it writes there; remove the folder at the end."""
    port = settings["port"]
    transport: Transport
    if port is None:
        transport = Mailbox(folder / "mailbox", 1)
    else:
        transport = UdpTransport(None, (settings["host"], port))
        (folder / "port.part").write_text(str(transport.port), encoding="utf-8")
        (folder / "port.part").rename(folder / "port")
    with real_time(settings["priority"]):
        Peer(body, settings, transport).run()
    shutil.rmtree(folder, ignore_errors=True)
