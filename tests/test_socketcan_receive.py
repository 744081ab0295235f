"""What the kernel gives to a receive, read as it is; the kernel itself is in tests/socketcan."""

from __future__ import annotations

import socket
import struct
from typing import Any

import pytest

from bms_ukf.socketcan import SocketCan

STAMP = (socket.SOL_SOCKET, 35, struct.pack("@ll", 1_700_000_000, 250_000_000))


class Kernel:
    """A socket that holds these datagrams, each with its ancillary data."""

    def __init__(self, *datagrams: tuple[bytes, list[tuple[int, int, bytes]]]) -> None:
        self.datagrams = list(datagrams)
        self.asked: list[tuple[int, int, int]] = []

    def recvmsg(self, *asked: int) -> tuple[bytes, list[tuple[int, int, bytes]], int, Any]:
        self.asked.append(asked)  # type: ignore[arg-type]
        if not self.datagrams:
            raise BlockingIOError
        data, ancillary = self.datagrams.pop(0)
        return data, ancillary, 0, None


def bus_of(*datagrams: tuple[bytes, list[tuple[int, int, bytes]]]) -> SocketCan:
    bus = object.__new__(SocketCan)
    bus._is_shutdown = True  # there is nothing to shut down
    bus.dropped, bus.socket = 0, Kernel(*datagrams)  # type: ignore[assignment]
    return bus


@pytest.mark.parametrize(
    ("identifier", "expected"),
    [
        (0x120, (0x120, False, False, False)),
        (0x98FF50E5, (0x18FF50E5, True, False, False)),
        (0x40000120, (0x120, False, True, False)),
        (0x20000040, (0x40, False, False, True)),
    ],
)
def test_identifier_and_kind_of_a_frame_are_read(identifier: int, expected: tuple[int, bool, bool, bool]) -> None:
    bus = bus_of((struct.pack("=IBB2x8s", identifier, 3, 0, b"\x01\x02\x03"), [STAMP]))
    message = bus.recv(0.0)
    assert message is not None
    kind = (message.is_extended_id, message.is_remote_frame, message.is_error_frame)
    assert (message.arbitration_id, *kind) == expected
    assert bytes(message.data) == (b"" if message.is_remote_frame else b"\x01\x02\x03")
    assert message.timestamp == 1_700_000_000.25


def test_an_fd_frame_is_told_from_a_classic_one() -> None:
    bus = bus_of((struct.pack("=IBB2x64s", 0x123, 64, 1, bytes(range(64))), [STAMP]))
    message = bus.recv(0.0)
    assert message is not None
    assert message.is_fd
    assert bytes(message.data) == bytes(range(64))


def test_frames_lost_in_the_kernel_are_counted_and_room_is_asked_for_the_counter() -> None:
    frame = struct.pack("=IBB2x8s", 0x123, 0, 0, b"")
    lost = (socket.SOL_SOCKET, 40, struct.pack("@I", 17))
    bus = bus_of((frame, [STAMP]), (frame, [STAMP, lost]), (frame, [lost, STAMP]))
    seen = []
    for _ in range(3):
        assert bus.recv(0.0) is not None
        seen.append(bus.dropped)
    assert seen == [0, 17, 17]
    assert bus.socket.asked[0][1] >= socket.CMSG_SPACE(16) + socket.CMSG_SPACE(4)  # type: ignore[attr-defined]
