"""A failing bus is counted, closed and opened again, and never raises."""

from __future__ import annotations

import errno
from typing import Any

import pytest
from can import CanOperationError, Message

from bms_ukf import bus as bus_module
from bms_ukf import seldom
from bms_ukf.bus import BACKOFF_S, SafeBus, open_bus
from bms_ukf.config import Bus
from bms_ukf.errors import ConfigError

FRAME = (0x220, False, b"\x01\x02")
MESSAGE = Message(arbitration_id=0x123, is_extended_id=False, data=b"\x07")
NETWORK_DOWN = CanOperationError("down", errno.ENETDOWN)
QUEUE_FULL = CanOperationError("queue full", errno.ENOBUFS)
BUFFER_FULL = CanOperationError("Transmit buffer full")  # as python-can's socketcan interface has it: without a code


class Clock:
    """The module `time` as the bus under test sees it: sleeping takes no time, but is told."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds


class Interface:
    """An interface whose next calls do what `script` says: raise it, or return it."""

    def __init__(self, *script: Any) -> None:
        self.script = list(script)
        self.sent: list[Message] = []
        self.closed = 0

    def recv(self, timeout: float) -> Message | None:
        return self._next()

    def send(self, message: Message) -> None:
        self._next()
        self.sent.append(message)

    def shutdown(self) -> None:
        self.closed += 1
        self._next()

    def _next(self) -> Any:
        then = self.script.pop(0) if self.script else None
        if isinstance(then, Exception):
            raise then
        return then


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(bus_module, "time", clock)
    return clock


def safe_bus(*openings: Interface | Exception) -> SafeBus:
    """A bus that finds these when it opens the interface, one after the other."""
    waiting = list(openings)

    def opener() -> Any:
        opened = waiting.pop(0)
        if isinstance(opened, Exception):
            raise opened
        return opened

    return SafeBus(opener)


def test_a_received_frame_and_silence_are_passed_on(clock):
    bus = safe_bus(Interface(MESSAGE, None))
    assert bus.recv(0.1) is MESSAGE
    assert bus.recv(0.1) is None
    assert bus.failures == 0


@pytest.mark.parametrize("error", [NETWORK_DOWN, CanOperationError("no code"), OSError(errno.ENODEV, "gone")])
def test_a_failed_receive_is_counted_and_the_interface_opened_again(clock, error):
    first, second = Interface(error), Interface(MESSAGE)
    bus = safe_bus(first, second)
    assert bus.recv(0.1) is None
    assert (first.closed, bus.counters.receive_failed) == (1, 1)
    assert bus.recv(1.0) is None, "it pauses first"
    assert bus.recv(1.0) is MESSAGE
    assert bus.counters.reopened == 1


def test_pauses_between_attempts_grow_and_start_over_after_success(clock):
    still_down = ConfigError("c.toml", expected="a CAN interface that is up")
    bus = safe_bus(Interface(NETWORK_DOWN), *[still_down] * 6, Interface(None, NETWORK_DOWN), Interface(MESSAGE))
    bus.recv(0.0)
    pauses = []
    while bus.counters.reopened == 0:
        started = clock.now_s
        assert bus.recv(60.0) is None  # the pause
        pauses.append(round(clock.now_s - started, 3))
        assert bus.recv(60.0) is None  # the attempt; after the last one, a first silent receive
    assert pauses == [*BACKOFF_S, BACKOFF_S[-1], BACKOFF_S[-1]]
    bus.recv(0.0)
    started = clock.now_s
    bus.recv(60.0)
    assert round(clock.now_s - started, 3) == BACKOFF_S[0]


def test_waiting_for_the_interface_takes_no_longer_than_the_caller_allows(clock):
    bus = safe_bus(Interface(NETWORK_DOWN), Interface())
    bus.recv(0.0)
    assert bus.recv(0.01) is None
    assert clock.now_s == 0.01


@pytest.mark.parametrize("error", [QUEUE_FULL, BUFFER_FULL, CanOperationError("again", errno.EAGAIN)])
def test_a_full_queue_drops_the_frame_and_keeps_the_interface(clock, error):
    interface = Interface(error)
    bus = safe_bus(interface)
    assert not bus.send(FRAME, 0)
    assert bus.send(FRAME, 0)
    assert (bus.counters.send_failed, bus.counters.reopened, interface.closed) == (1, 0, 0)


@pytest.mark.parametrize("error", [NETWORK_DOWN, OSError(errno.ENXIO, "gone")])
def test_a_dead_interface_that_only_a_sender_hears_of_is_opened_again(clock, error):
    first, second = Interface(error), Interface(MESSAGE)
    bus = safe_bus(first, second)
    assert not bus.send(FRAME, 0)
    assert first.closed == 1
    assert not bus.send(FRAME, 0), "nothing to send it with"
    assert bus.counters.send_failed == bus.failures == 2
    clock.sleep(BACKOFF_S[0])
    assert bus.recv(0.0) is MESSAGE


def test_a_full_queue_is_told_of_seldom(clock, monkeypatch, caplog):
    monkeypatch.setattr(seldom, "time", clock)
    bus = safe_bus(Interface(*[QUEUE_FULL] * 1000))
    for _ in range(1000):
        bus.send(FRAME, 0)
        clock.sleep(0.021)
    lines = [record.getMessage() for record in caplog.records]
    assert lines[0] == "bus: frame 0x220 not sent: queue full [Error Code 105]"
    assert len(lines) == 3, "one in ten seconds"
    assert "476 more since the last such line" in lines[1]
    assert bus.counters.send_failed == 1000


def test_bus_off_of_the_controller_is_counted_and_told(clock, caplog):
    bus_off = Message(arbitration_id=0x40, is_extended_id=True, is_error_frame=True)
    other = Message(arbitration_id=0x04, is_extended_id=True, is_error_frame=True)
    bus = safe_bus(Interface(other, bus_off, MESSAGE))
    assert [bus.recv(0.0) for _ in range(3)][-1] is MESSAGE
    assert (bus.counters.bus_off, bus.failures) == (1, 1)
    assert "bus-off" in caplog.text


def test_frames_the_kernel_dropped_are_counted_over_all_sockets(clock):
    first, second = Interface(MESSAGE, NETWORK_DOWN), Interface(MESSAGE)
    first.dropped, second.dropped = 3, 4
    bus = safe_bus(first, second)
    bus.recv(0.0)
    assert bus.counters.dropped == 3
    bus.recv(0.0)
    clock.sleep(BACKOFF_S[0])
    bus.recv(0.0)
    assert bus.counters.dropped == 7


def test_an_interface_that_fails_even_to_close_is_let_go(clock):
    bus = safe_bus(Interface(NETWORK_DOWN, OSError(errno.EBADF, "closed already")), Interface(MESSAGE))
    assert bus.recv(0.0) is None
    clock.sleep(BACKOFF_S[0])
    assert bus.recv(0.0) is MESSAGE


def test_a_frame_goes_out_as_it_is_with_the_time_it_was_given(clock):
    interface = Interface()
    bus = safe_bus(interface)
    assert bus.send((0x18FF50E5, True, b"\x01"), 1_500_000_000)
    (message,) = interface.sent
    assert (message.arbitration_id, message.is_extended_id, bytes(message.data)) == (0x18FF50E5, True, b"\x01")
    assert message.timestamp == 1.5
    assert not message.is_fd


def test_close_may_be_called_again_and_on_a_failed_bus(clock):
    interface = Interface()
    bus = safe_bus(interface)
    bus.close()
    bus.close()
    assert interface.closed == 1


@pytest.mark.parametrize(
    ("settings", "key", "told"),
    [
        (Bus(interface="nonsense", channel="can0"), "bus.interface", "nonsense"),
        (Bus(interface="socketcan", channel="nocan7"), "bus.channel", "socketcan:nocan7"),
        (Bus(interface="socketcan", channel="a\0b"), "bus.channel", "socketcan"),
        (Bus(interface="socketcan", channel="a-name-far-too-long-for-linux"), "bus.channel", "socketcan:a-name"),
        (Bus(interface="serial", channel="/dev/nowhere"), "bus.", "serial"),
    ],
)
def test_what_cannot_be_opened_is_named_in_one_line(settings, key, told):
    with pytest.raises(ConfigError) as refused:
        open_bus(settings, "can.toml")
    text = str(refused.value)
    assert text.startswith(f"can.toml: {key}")
    assert told in text
    assert "\n" not in text


def test_only_frames_with_the_ids_asked_for_come_through():
    settings = Bus(interface="virtual", channel="test-filters")
    sent = [
        Message(arbitration_id=k, is_extended_id=wide) for k, wide in [(0x120, True), (0x121, False), (0x120, False)]
    ]
    with open_bus(settings, "test") as sender, open_bus(settings, "test", [(0x120, False), (0x121, True)]) as receiver:
        for message in sent:
            sender.send(message)
        got = receiver.recv(1.0)
        assert got is not None
        assert (got.arbitration_id, got.is_extended_id) == (0x120, False)
        assert receiver.recv(0.0) is None
