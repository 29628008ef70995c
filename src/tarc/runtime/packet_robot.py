"""A robot at the other end of packets."""

import time
from contextlib import ExitStack

import numpy as np

from tarc.core.errors import InvalidParameter
from tarc.core.types import Array
from tarc.runtime.packets import Flag, Kind, Packet, decode, encode, is_newer
from tarc.runtime.robot import Robot
from tarc.runtime.transports import Transport, UdpTransport, udp_address

POLL = 1e-3
"""Time between two looks for the first packets [s]."""
PATIENCE = 0.5
"""Time to wait for the names of the joints after the first state [s]."""
HELLO_PAUSE = 0.05
"""Time without a state, before the brakes were released, after which the robot is greeted again [s]."""
STOP_REPEATS = 3
"""Commands that a safe stop sends, in case one is lost."""


class PacketRobot(Robot):
    """A robot that sends states and takes commands as packets, as `udp_robot` connects it.

    Parameters
    ----------
    transport
        How the packets go.
    timeout
        How long to wait for the first state [s].
    echoes
        Whether each state answers a command, with the command's sequence number; `read` then waits for that answer.

    Raises
    ------
    InvalidParameter
        When no state comes in time.
    """

    def __init__(self, transport: Transport, *, timeout: float = 2.0, echoes: bool = False):
        self._transport = transport
        self._echoes = echoes
        self._timeout = timeout
        self._flags = Flag(0)
        self._heard = -np.inf
        self._sent = 0
        self._last: Packet | None = None
        self._is_read = True
        self._malformed = self._stale = self._lost = 0
        self._n = 0
        self._connect(timeout)
        self._nothing = np.full(self._n, np.nan)
        self._torque = np.zeros(self._n)

    @property
    def n_joints(self) -> int:
        """Return the number of joints n."""
        return self._n

    @property
    def counts(self) -> dict[str, int]:
        """Return packets malformed, of strangers, stale, not sent, and since the brakes opened lost or overtaken."""
        return {
            "malformed": self._malformed,
            "strangers": self._transport.strangers,
            "stale": self._stale,
            "lost": self._lost,
            "unsent": self._transport.unsent,
        }

    def _connect(self, timeout: float) -> None:
        """Say hello until a state and the names are there."""
        end = time.monotonic() + timeout
        while time.monotonic() < end and not (self._n and self.joint_names):
            self._greet()
            time.sleep(POLL)
            had_state = bool(self._n)
            self._take_all()
            if self._n and not had_state:
                end = min(end, time.monotonic() + PATIENCE)
        if not self._n:
            packets = ", ".join(f"{number} {name}" for name, number in self.counts.items() if number)
            raise InvalidParameter(
                f"robot: no state came within {timeout:g} s ({packets or 'nothing at all'}); check address and port, "
                "and that the robot's program runs"
            )

    def _greet(self) -> None:
        """Say hello; a robot answers with its names and sends states from then on."""
        self._heard = time.monotonic()
        self._transport.send(encode(Kind.COMMAND, self._next(), self._heard, flags=Flag.HELLO))

    def read(self) -> Array:
        """Return the position of the newest state (n,), NaN where none came since the call before.

        A state that answers a command stays new until the next command. Before the brakes were released, a robot that
        has fallen silent is greeted again: it may have forgotten a loop that took long to prepare.
        """
        self._take_all()
        is_new = self._await_echo() if self._echoes else not self._is_read
        if self._last is None or not is_new:
            if not self._flags and time.monotonic() - self._heard > HELLO_PAUSE:
                self._greet()
            return self._nothing
        self._is_read = True
        return self._last.values[0]

    def _await_echo(self) -> bool:
        """Wait for the state that answers the last command; return whether it came."""
        end = time.monotonic() + self._timeout
        while self._last is None or self._last.sequence != self._sent & 0xFFFFFFFF:
            if time.monotonic() > end:
                return False
            time.sleep(POLL / 20)
            self._take_all()
        return True

    def write(self, torque: Array) -> None:
        """Send a torque (n,)."""
        self._torque[:] = torque
        self._send()

    def release_brakes(self) -> None:
        """Let every later command release the brakes; states that were lost before do not count."""
        self._lost = 0
        self._flags |= Flag.RELEASE

    def engage_brakes(self) -> None:
        """Send the safe stop at once, and with every later command."""
        self._flags = Flag.STOP
        for _ in range(STOP_REPEATS):
            self._send()

    def close(self) -> None:
        """Give up the connection."""
        self._transport.close()

    def _next(self) -> int:
        self._sent += 1
        return self._sent

    def _send(self) -> None:
        packet = encode(Kind.COMMAND, self._next(), time.monotonic(), [self._torque], flags=self._flags)
        self._transport.send(packet)

    def _take_all(self) -> None:
        for data in self._transport.receive():
            packet = decode(data)
            if packet is None:
                self._malformed += 1
            elif packet.kind == Kind.NAMES:
                self._take_names(packet)
            else:
                self._take_state(packet)

    def _take_names(self, packet: Packet) -> None:
        if self.joint_names or (self._n and len(packet.names) != self._n):
            return
        self.joint_names = packet.names

    def _take_state(self, packet: Packet) -> None:
        n = packet.values.shape[-1]
        if packet.kind != Kind.STATE or (self._n and n != self._n):
            self._malformed += 1
            return
        if self._last is not None:
            if not is_newer(packet.sequence, self._last.sequence):
                self._stale += 1
                return
            self._lost += 0 if self._echoes else (packet.sequence - self._last.sequence - 1) & 0xFFFFFFFF
        self._last, self._is_read = packet, False
        self._heard = time.monotonic()
        self._n = n
        self.sample_time = packet.time
        self.applied_torque = packet.values[1]


def udp_robot(url: str, *, timeout: float = 2.0) -> PacketRobot:
    """Connect to a robot that speaks `tarc.runtime.packets` over UDP.

    Parameters
    ----------
    url
        ``udp://host:port``, or ``udp://host:port?local=port`` to listen at a port of your choice.
    timeout
        How long to wait for the first state [s].

    Raises
    ------
    InvalidParameter
        For another text, a port in use, and a robot that does not answer.
    """
    peer, local = udp_address(url)
    with ExitStack() as on_error:
        transport = UdpTransport(peer, ("", local))
        on_error.callback(transport.close)
        robot = PacketRobot(transport, timeout=timeout)
        on_error.pop_all()
    return robot
