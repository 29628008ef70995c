"""Ways of a packet to the other process: UDP, and a mailbox in shared memory."""

import mmap
import socket
import struct
from abc import ABC, abstractmethod
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

from tarc.core.errors import InvalidParameter
from tarc.runtime.packets import MAGIC, MAX_SIZE

MAX_PACKETS = 64
"""Packets that one call of `receive` takes, so that a flood cannot hold the loop up."""
SLOT = 64 + MAX_SIZE
ATTEMPTS = 8
"""Attempts at reading a slot that is being written."""


class Transport(ABC):
    """Sends packets and gets them without waiting.

    Attributes
    ----------
    strangers
        Packets from another address than the peer's, which were ignored.
    unsent
        Packets that the system refused to send.
    """

    strangers: int = 0
    unsent: int = 0

    @abstractmethod
    def send(self, data: bytes) -> None:
        """Send a packet; one that cannot be sent is counted."""

    @abstractmethod
    def receive(self) -> list[bytes]:
        """Return what came since the call before, oldest first."""

    @abstractmethod
    def close(self) -> None:
        """Give up the connection."""


class UdpTransport(Transport):
    """Datagrams to and from one peer.

    Parameters
    ----------
    peer
        Host and port of the peer; None for a robot, whose peer is who sends the first packet.
    local
        Host and port to listen at; port 0 for any that is free.

    Raises
    ------
    InvalidParameter
        For a host without an address, and a port that is in use.
    """

    def __init__(self, peer: tuple[str, int] | None, local: tuple[str, int] = ("", 0)):
        family, self._peer = socket.AF_INET, None
        if peer is not None:
            family, self._peer = _address(*peer)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind(local)
        except OSError as error:
            self._socket.close()
            raise InvalidParameter(
                f"port: cannot listen at {local[0] or '*'}:{local[1]} ({error.strerror or error}); another program may "
                "use it: stop that, or choose another port"
            ) from None

    @property
    def port(self) -> int:
        """Return the port that it listens at."""
        return int(self._socket.getsockname()[1])

    def forget_peer(self) -> None:
        """Take whoever sends the next packet as the peer."""
        self._peer = None

    def send(self, data: bytes) -> None:
        """Send a packet; one that cannot be sent is counted."""
        if self._peer is None:
            return
        try:
            self._socket.sendto(data, self._peer)
        except OSError:  # a full buffer, a network that is down
            self.unsent += 1

    def receive(self) -> list[bytes]:
        """Return what the peer sent since the call before, oldest first."""
        packets = []
        for _ in range(MAX_PACKETS):
            try:
                data, address = self._socket.recvfrom(MAX_SIZE + 1)
            except OSError:  # nothing more, or the network reports an error
                break
            if self._peer is None and data.startswith(MAGIC):
                self._peer = address
            if self._peer is not None and address[:2] == self._peer[:2]:
                packets.append(data)
            else:
                self.strangers += 1
        return packets

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class Mailbox(Transport):
    """The newest packet in each direction, in a file that two processes map into their memory.

    A number before the packet is odd while it is written and changes with it, so that no torn packet is read.

    Parameters
    ----------
    file
        The file; `create` makes it.
    side
        0 for the loop, 1 for the robot.
    """

    def __init__(self, file: Path, side: int):
        with file.open("r+b") as stream:
            self._memory = mmap.mmap(stream.fileno(), 2 * SLOT)
        self._own, self._other = side * SLOT, (1 - side) * SLOT
        self._sent = 0
        self._seen = 0

    @staticmethod
    def create(file: Path) -> None:
        """Make the file of a mailbox."""
        file.write_bytes(bytes(2 * SLOT))

    def send(self, data: bytes) -> None:
        """Replace the packet in the own slot."""
        place = self._own
        struct.pack_into("<Q", self._memory, place, self._sent + 1)
        struct.pack_into("<I", self._memory, place + 8, len(data))
        self._memory[place + 64 : place + 64 + len(data)] = data
        self._sent += 2
        struct.pack_into("<Q", self._memory, place, self._sent)

    def receive(self) -> list[bytes]:
        """Return the packet in the peer's slot, if it is new."""
        place = self._other
        for _ in range(ATTEMPTS):
            number, length = struct.unpack_from("<QI", self._memory, place)
            if number == self._seen:
                return []
            data = self._memory[place + 64 : place + 64 + min(length, MAX_SIZE)]
            if number % 2 == 0 and struct.unpack_from("<Q", self._memory, place)[0] == number:
                self._seen = number
                return [data]
        return []

    def close(self) -> None:
        """Unmap the file."""
        self._memory.close()


def udp_address(url: str) -> tuple[tuple[str, int], int]:
    """Return host and port of ``udp://host:port``, and the local port that ``?local=port`` names, else 0.

    Raises
    ------
    InvalidParameter
        For another text.
    """
    try:
        parts = urlsplit(url)
        local = int(parse_qs(parts.query).get("local", ["0"])[0])
        if parts.scheme == "udp" and parts.hostname and parts.port and not parts.path.strip("/") and 0 <= local < 65536:
            return (parts.hostname, parts.port), local
    except ValueError:
        pass
    raise InvalidParameter(f"robot: got {url!r}; needs udp://host:port, or udp://host:port?local=port")


def _address(host: str, port: int) -> tuple[socket.AddressFamily, tuple]:
    """Return family and address of a host."""
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    except (OSError, UnicodeError) as error:
        raise InvalidParameter(f"robot: no address for {host!r} ({error}); check the name") from None
    return family, address
