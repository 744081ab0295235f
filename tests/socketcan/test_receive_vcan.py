"""Our own receive on a real kernel: the same frames and stamps as python-can's, and what the kernel dropped."""

from __future__ import annotations

import time

import pytest
from can import Message

from bms_ukf.bus import SafeBus, open_bus
from bms_ukf.config import Bus
from bms_ukf.socketcan import SocketCan

pytestmark = pytest.mark.socketcan

FRAMES = [
    Message(arbitration_id=0x123, data=bytes(range(8)), is_extended_id=False),
    Message(arbitration_id=0x7FF, data=b"", is_extended_id=False),
    Message(arbitration_id=0x1FFFFFFF, data=b"\x80" * 8, is_extended_id=True),
    Message(arbitration_id=0x123, is_extended_id=False, is_remote_frame=True, dlc=2),
]


def described(message: Message | None) -> tuple[object, ...]:
    assert message is not None
    kind = (message.is_extended_id, message.is_remote_frame, message.is_error_frame, message.is_fd)
    return message.arbitration_id, bytes(message.data), message.dlc, round(message.timestamp * 1e6), *kind


def test_every_frame_is_received_as_python_can_receives_it(vcan):
    with SocketCan(vcan.channel, receive_buffer_bytes=1 << 16) as ours, vcan.bus() as theirs, vcan.bus() as sender:
        for frame in FRAMES:
            sender.send(frame)
        assert [described(ours.recv(5.0)) for _ in FRAMES] == [described(theirs.recv(5.0)) for _ in FRAMES]
        assert ours.recv(0.0) is None
        assert ours.dropped == 0


def test_an_fd_frame_is_received_where_it_is_asked_for(vcan):
    with SocketCan(vcan.channel, receive_buffer_bytes=1 << 16, fd=True) as ours, vcan.bus(fd=True) as sender:
        sender.send(Message(arbitration_id=0x123, is_extended_id=False, is_fd=True, data=bytes(range(64))))
        message = ours.recv(5.0)
        assert message is not None
        assert (message.is_fd, bytes(message.data)) == (True, bytes(range(64)))


def test_what_is_sent_is_what_candump_sees(vcan, candump):
    with SocketCan(vcan.channel, receive_buffer_bytes=1 << 16) as ours:
        for frame in FRAMES[:3]:
            ours.send(frame)
    seen = [(frame.arbitration_id, frame.is_extended, frame.data) for frame in candump.frames(3)]
    assert seen == [(frame.arbitration_id, frame.is_extended_id, bytes(frame.data)) for frame in FRAMES[:3]]


def test_frames_nobody_read_in_time_are_counted_to_the_last_one(vcan):
    sent = 2000
    with SocketCan(vcan.channel, receive_buffer_bytes=16384) as ours, vcan.bus() as sender:
        for _ in range(sent):
            sender.send(FRAMES[0])
        received = 0
        while ours.recv(0.0) is not None:
            received += 1
        assert 0 < received < sent, "the buffer was meant to be too small"
        sender.send(FRAMES[0])  # a frame brings the count of those lost before it
        assert ours.recv(5.0) is not None
        assert ours.dropped == sent - received


def test_the_buffer_that_was_asked_for_holds_a_second_of_a_full_bus(vcan):
    """1 Mbit/s is at most 9000 frames a second without data, some 7000 of eight bytes with few stuff bits."""
    settings = Bus(interface="socketcan", channel=vcan.channel, receive_buffer_bytes=16 << 20)
    bus = SafeBus(lambda: open_bus(settings, "test"))
    with vcan.bus() as sender:
        for _ in range(7000):
            sender.send(FRAMES[0])
        received = 0
        while bus.recv(0.0) is not None:
            received += 1
        assert (received, bus.counters.dropped) == (7000, 0)
    bus.close()


def test_an_interface_that_goes_down_wakes_the_receiver_at_once(vcan):
    bus = SafeBus(lambda: open_bus(Bus(interface="socketcan", channel=vcan.channel), "test"))
    vcan.down()
    started_s = time.monotonic()
    assert bus.recv(5.0) is None
    assert time.monotonic() - started_s < 4.0
    assert bus.counters.receive_failed == 1
    vcan.up()
    deadline_s = time.monotonic() + 5.0
    while bus.counters.reopened == 0:
        assert time.monotonic() < deadline_s
        bus.recv(0.1)
    bus.close()
