"""What the daemon takes for granted about SocketCAN and python-can, on a real kernel with candump as witness."""

from __future__ import annotations

import errno
import gc
import subprocess
import time

import pytest
from can import CanOperationError, Message

pytestmark = pytest.mark.socketcan

FRAMES = [
    Message(arbitration_id=0x123, data=b"\x01\x02\x03\x04\x05\x06\x07\x08", is_extended_id=False),
    Message(arbitration_id=0x000, data=b"", is_extended_id=False),
    Message(arbitration_id=0x7FF, data=b"\xff", is_extended_id=False),
    Message(arbitration_id=0x123, data=b"\x00\xff", is_extended_id=True),
    Message(arbitration_id=0x1FFFFFFF, data=b"\x80" * 8, is_extended_id=True),
]


def test_candump_sees_every_byte_python_can_sends(vcan, candump):
    with vcan.bus() as bus:
        for frame in FRAMES:
            bus.send(frame)
    seen = [(frame.arbitration_id, frame.is_extended, frame.data) for frame in candump.frames(len(FRAMES))]
    assert seen == [(frame.arbitration_id, frame.is_extended_id, bytes(frame.data)) for frame in FRAMES]


def test_python_can_receives_every_byte_cansend_sends(vcan):
    with vcan.bus() as bus:
        subprocess.run(["cansend", vcan.channel, "18FF50E5#DEADBEEF00112233"], check=True)
        frame = bus.recv(20.0)
    assert frame is not None
    assert (frame.arbitration_id, frame.is_extended_id) == (0x18FF50E5, True)
    assert bytes(frame.data) == bytes.fromhex("DEADBEEF00112233")


def test_timestamp_is_the_kernels_and_equals_the_one_candump_saw(vcan, candump):
    with vcan.bus() as sender, vcan.bus() as receiver:
        for frame in FRAMES:
            sender.send(frame)
        received = [receiver.recv(20.0) for _ in FRAMES]
    for message, logged in zip(received, candump.frames(len(FRAMES)), strict=True):
        assert message is not None
        assert abs(message.timestamp * 1e6 - logged.timestamp_us) <= 1.0


def test_timestamp_is_when_the_frame_arrived_not_when_it_was_read(vcan):
    with vcan.bus() as sender, vcan.bus() as receiver:
        sent = time.time()
        sender.send(FRAMES[0])
        time.sleep(0.5)
        frame = receiver.recv(20.0)
    assert frame is not None
    assert frame.timestamp - sent < 0.25


def test_a_bus_does_not_hear_its_own_frames(vcan):
    with vcan.bus() as sender, vcan.bus() as other:
        sender.send(FRAMES[0])
        assert other.recv(20.0) is not None
        assert sender.recv(0.0) is None


def test_filters_act_before_the_frame_reaches_the_process(vcan):
    with vcan.bus() as sender, vcan.bus(can_filters=[{"can_id": 0x7FF, "can_mask": 0x7FF}]) as receiver:
        for frame in FRAMES[:3]:
            sender.send(frame)
        frame = receiver.recv(20.0)
        assert frame is not None
        assert frame.arbitration_id == 0x7FF
        assert receiver.recv(0.0) is None


def test_interface_down_fails_send_and_recv_and_the_same_bus_works_again_after_up(vcan):
    with vcan.bus() as sender, vcan.bus() as receiver:
        vcan.down()
        with pytest.raises(CanOperationError) as sending:
            sender.send(FRAMES[0])
        assert sending.value.error_code == errno.ENETDOWN
        with pytest.raises(CanOperationError) as receiving:
            receiver.recv(5.0)
        assert receiving.value.error_code == errno.ENETDOWN
        assert receiver.recv(0.1) is None, "the error is reported once, then it is silence"

        vcan.up()
        sender.send(FRAMES[0])
        frame = receiver.recv(20.0)
        assert frame is not None
        assert frame.arbitration_id == FRAMES[0].arbitration_id


def test_a_bus_opened_on_an_interface_that_is_down_works_after_up(vcan):
    vcan.down()
    with vcan.bus() as receiver:
        with pytest.raises(CanOperationError) as receiving:
            receiver.recv(5.0)
        assert receiving.value.error_code == errno.ENETDOWN
        vcan.up()
        with vcan.bus() as sender:
            sender.send(FRAMES[0])
        assert receiver.recv(20.0) is not None


def test_a_bus_stays_deaf_after_its_interface_was_removed_and_made_again(vcan):
    with vcan.bus() as old:
        vcan.remove()
        with pytest.raises(CanOperationError) as receiving:
            old.recv(5.0)
        assert receiving.value.error_code == errno.ENODEV
        vcan.create()
        with vcan.bus() as sender, vcan.bus() as new:
            sender.send(FRAMES[0])
            assert new.recv(20.0) is not None
            assert old.recv(0.0) is None
        with pytest.raises(CanOperationError):
            old.send(FRAMES[0])


@pytest.mark.filterwarnings("ignore:unclosed <socket:ResourceWarning")  # python-can drops it unclosed
def test_opening_an_interface_that_does_not_exist_is_a_plain_os_error(vcan):
    vcan.remove()
    with pytest.raises(OSError, match="No such device") as opening, vcan.bus():
        pass
    assert opening.value.errno == errno.ENODEV
    del opening
    gc.collect()  # here, where the dropped socket may be complained of
