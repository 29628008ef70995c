"""Packets between loop and robot, and the ways that they take."""

import socket
import struct
import time
import zlib
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tarc.core.errors import InvalidParameter
from tarc.runtime import packet_robot
from tarc.runtime.packet_robot import HELLO_PAUSE, PacketRobot, udp_robot
from tarc.runtime.packets import HEADER, Flag, Kind, decode, encode, is_newer
from tarc.runtime.transports import Mailbox, UdpTransport, udp_address

numbers = st.lists(st.floats(allow_nan=False), min_size=1, max_size=64)


@given(numbers, st.integers(0, 2**32 - 1), st.floats(allow_nan=False))
def test_packets_come_back_as_they_were(values, sequence, time):
    row = np.array(values)
    state = decode(encode(Kind.STATE, sequence, time, [row, -row]))
    assert state is not None
    assert (state.kind, state.sequence, state.time) == (Kind.STATE, sequence, time)
    np.testing.assert_array_equal(state.values, [row, -row])


def test_the_bytes_are_as_documented():
    data = encode(Kind.COMMAND, 7, 1.5, [np.array([1.0, -2.0])], flags=Flag.RELEASE)
    content = b"TARC" + bytes([1, 2, 2, 1]) + struct.pack("<Id2d", 7, 1.5, 1.0, -2.0)
    assert data == content + struct.pack("<I", zlib.crc32(content))
    assert HEADER.size == 20


def test_names_and_hello():
    packet = decode(encode(Kind.NAMES, 1, 0.0, names=["Schulter", "Ellbögen"]))
    assert packet is not None
    assert packet.names == ("Schulter", "Ellbögen")
    hello = decode(encode(Kind.COMMAND, 1, 0.0, flags=Flag.HELLO))
    assert hello is not None
    assert hello.values.size == 0


@given(st.binary(max_size=300))
def test_no_bytes_are_a_packet_by_chance(data):
    assert decode(data) is None


@given(st.integers(0, 59), st.integers(1, 255))
def test_a_changed_byte_is_found(place, change):
    data = bytearray(encode(Kind.STATE, 3, 0.5, [np.ones(1), np.zeros(1)]))
    data[place % len(data)] ^= change
    assert decode(bytes(data)) is None


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_command_has_finite_torques(value):
    assert decode(encode(Kind.COMMAND, 1, 0.0, [np.array([value])])) is None
    assert decode(encode(Kind.STATE, 1, 0.0, [np.array([value])] * 2)) is not None  # a lost sample


def test_sequence_numbers_wrap():
    assert is_newer(1, 0)
    assert is_newer(0, 2**32 - 1)
    assert not is_newer(5, 5)
    assert not is_newer(4, 5)


def test_a_mailbox_has_the_newest_packet(tmp_path):
    Mailbox.create(tmp_path / "box")
    loop, robot = Mailbox(tmp_path / "box", 0), Mailbox(tmp_path / "box", 1)
    assert loop.receive() == []
    robot.send(b"first")
    robot.send(b"second")
    assert loop.receive() == [b"second"]
    assert loop.receive() == []
    loop.send(b"answer")
    assert robot.receive() == [b"answer"]


@pytest.mark.parametrize(
    "url", ["udp://host", "http://host:1", "host:1", "udp://:5", "udp://a:1?local=x", "udp://a:99999", "udp://a:1/b"]
)
def test_addresses_that_are_none(url):
    with pytest.raises(InvalidParameter, match="needs udp://host:port"):
        udp_address(url)


def test_addresses():
    assert udp_address("udp://10.0.0.2:5000") == (("10.0.0.2", 5000), 0)
    assert udp_address("udp://[::1]:5000?local=6000") == (("::1", 5000), 6000)


def test_a_port_in_use_is_refused():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("", 0))
        port = other.getsockname()[1]
        with pytest.raises(InvalidParameter, match=f"cannot listen at .*:{port}"):
            udp_robot(f"udp://127.0.0.1:9?local={port}", timeout=0.05)


def test_a_robot_that_does_not_answer_is_refused():
    with pytest.raises(InvalidParameter, match=r"no state came within 0\.05 s \(nothing at all\)"):
        udp_robot("udp://127.0.0.1:9", timeout=0.05)


class Pair:
    """A robot's socket, and the transport of a loop that talks to it."""

    def __init__(self) -> None:
        self.robot = UdpTransport(None, ("127.0.0.1", 0))
        self.loop = UdpTransport(("127.0.0.1", self.robot.port), ("127.0.0.1", 0))
        self.stranger = UdpTransport(("127.0.0.1", self.loop.port), ("127.0.0.1", 0))

    def close(self) -> None:
        for transport in (self.robot, self.loop, self.stranger):
            transport.close()


@pytest.fixture
def pair():
    result = Pair()
    yield result
    result.close()


def state(sequence: int, position: float) -> bytes:
    return encode(Kind.STATE, sequence, 0.001 * sequence, [np.array([position]), np.zeros(1)])


def connected(pair: Pair) -> PacketRobot:
    pair.loop.send(encode(Kind.COMMAND, 0, 0.0, flags=Flag.HELLO))
    assert pair.robot.receive()
    pair.robot.send(encode(Kind.NAMES, 1, 0.0, names=["joint"]))
    pair.robot.send(state(1, 0.1))
    return PacketRobot(pair.loop, timeout=5.0)


def test_a_robot_reads_the_newest_state_once(pair):
    robot = connected(pair)
    assert robot.joint_names == ("joint",)
    np.testing.assert_array_equal(robot.read(), [0.1])
    assert np.isnan(robot.read()).all()
    for sequence, position in ((2, 0.2), (5, 0.5), (4, 0.4)):
        pair.robot.send(state(sequence, position))
    np.testing.assert_array_equal(robot.read(), [0.5])
    assert robot.sample_time == pytest.approx(0.005)
    assert robot.counts["stale"] == 1
    assert robot.counts["lost"] == 2


def test_a_silent_robot_is_greeted_until_the_brakes_are_released(pair, monkeypatch):
    robot = connected(pair)
    robot.read()
    pair.robot.receive()
    now = time.monotonic() + 2 * HELLO_PAUSE
    monkeypatch.setattr(packet_robot, "time", SimpleNamespace(monotonic=lambda: now))
    robot.read()
    robot.read()
    (packet,) = [decode(data) for data in pair.robot.receive()]
    assert packet is not None
    assert packet.flags == Flag.HELLO
    pair.robot.send(state(2, 0.2))
    np.testing.assert_array_equal(robot.read(), [0.2])
    robot.release_brakes()
    now += 2 * HELLO_PAUSE
    robot.read()
    assert pair.robot.receive() == []


def test_strangers_are_ignored_and_counted(pair):
    robot = connected(pair)
    robot.read()
    pair.stranger.send(state(9, 9.0))
    assert np.isnan(robot.read()).all()
    assert robot.counts["strangers"] == 1


def test_malformed_packets_are_counted(pair):
    robot = connected(pair)
    robot.read()
    good = state(3, 0.3)
    two = encode(Kind.STATE, 4, 0.0, [np.zeros(2)] * 2)
    for data in (b"", b"nonsense", good[:-1], good + b"0", two, encode(Kind.COMMAND, 9, 0.0, [np.zeros(1)])):
        pair.robot.send(data)
    assert np.isnan(robot.read()).all()
    assert robot.counts["malformed"] == 6
    pair.robot.send(good)
    np.testing.assert_array_equal(robot.read(), [0.3])


def test_commands_say_when_the_brakes_open_and_close(pair):
    robot = connected(pair)
    pair.robot.receive()
    robot.write(np.array([1.5]))
    robot.release_brakes()
    robot.write(np.array([1.5]))
    robot.engage_brakes()
    packets = [decode(data) for data in pair.robot.receive()]
    flags = [packet.flags for packet in packets if packet is not None and not packet.flags & Flag.HELLO]
    assert flags == [Flag(0), Flag.RELEASE, Flag.STOP, Flag.STOP, Flag.STOP]
    assert packets[-1] is not None
    np.testing.assert_array_equal(packets[-1].values, [[1.5]])
