"""A simulated robot in a second process, over shared memory or UDP."""

import json
import shutil
import subprocess
import sys
import tempfile
import time
from abc import abstractmethod
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter
from tarc.core.validation import Numbers
from tarc.runtime.packet_robot import PacketRobot
from tarc.runtime.shared_memory import shared_memory_folder
from tarc.runtime.transports import Mailbox, Transport, UdpTransport

START_TIME = 20.0
"""Time that the process has to start [s]."""


class PeerRobot(PacketRobot):
    """A robot that another process simulates in real time: the base of `MujocoRobot` and `PlantRobot`.

    Attributes
    ----------
    module
        What the process runs; its argument is a folder with ``peer.json``, the mailbox, and what `save` writes.
    process
        The process.
    """

    module = ""

    def __init__(
        self,
        settings: dict[str, Any],
        *,
        period: float,
        udp: int | None,
        watchdog: float,
        substeps: int,
        step_size: Numbers,
        noise: Numbers,
        in_step: bool,
        seed: int,
        priority: int,
    ):
        self.joint_names = tuple(settings["joint_names"])
        n = len(self.joint_names)
        settings = settings | {
            "period": check.number("period", period, 0, strict=True),
            "substeps": check.integer("substeps", substeps, 1),
            "watchdog": check.number("watchdog", watchdog, 0, strict=True),
            "echoes": bool(in_step),
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
            transport = self._start(settings, on_error)
            super().__init__(transport, timeout=START_TIME, echoes=in_step)
            self._timeout = 1.0
            on_error.pop_all()

    @abstractmethod
    def save(self, folder: Path) -> None:
        """Write what moves into the folder of the process."""

    def _start(self, settings: dict[str, Any], on_error: ExitStack) -> Transport:
        """Start the process and return the way to it."""
        self.save(self._folder)
        (self._folder / "peer.json").write_text(json.dumps(settings), encoding="utf-8")
        Mailbox.create(self._folder / "mailbox")
        command = [sys.executable, "-m", self.module, str(self._folder)]
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
        raise InvalidParameter(f"robot: the process that simulates it did not start: {lines[-1]}")

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
