"""A python-can bus that may fail: opening it is checked once, and from then on it degrades, counts and comes back."""

from __future__ import annotations

import errno
import fcntl
import logging
import socket
import struct
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import can
from can.typechecking import CanFilter

from bms_ukf.config import Bus
from bms_ukf.errors import ConfigError
from bms_ukf.framelog import FrameLog
from bms_ukf.frames import Frame
from bms_ukf.seldom import Seldom
from bms_ukf.socketcan import SocketCan

log = logging.getLogger(__name__)

BACKOFF_S = (0.1, 0.2, 0.5, 1.0, 2.0)
_FAILURES = (can.CanError, OSError)  # python-can lets the operating system's own errors through
_QUEUE_FULL = (errno.ENOBUFS, errno.EAGAIN, None)  # None: python-can found the socket's buffer full before it tried
_SIOCGIFFLAGS = 0x8913  # netdevice(7)
_IFF_UP = 0x1
_CAN_ERR_BUSOFF = 0x40  # linux/can/error.h


def open_bus(settings: Bus, source: str, ids: Iterable[tuple[int, bool]] | None = None) -> can.BusABC:
    """Open the interface for the frames with these ids, each with whether it is an extended one (None: for all).

    Raises ConfigError naming interface and channel if it is unknown, missing or down.
    """
    named = f"{settings.interface}:{settings.channel}"
    options = {"can_filters": _filters(ids)} | dict(settings.options)
    if settings.interface == "virtual":
        options["preserve_timestamps"] = True
    if settings.bitrate is not None and settings.interface != "socketcan":
        options["bitrate"] = settings.bitrate
    if settings.fd:
        options["fd"] = True
    try:
        if settings.interface == "socketcan":
            _require_up(settings.channel)
            return _socketcan(settings, options)
        return can.Bus(channel=settings.channel, interface=settings.interface, **options)
    except can.CanInterfaceNotImplementedError as error:
        expected = f"an interface python-can knows ({error})"
        raise ConfigError(source, key="bus.interface", value=settings.interface, expected=expected) from None
    except (*_FAILURES, TypeError, ValueError) as error:
        expected = f"a CAN interface that exists and is up ({error})"
        raise ConfigError(source, key="bus.channel", value=named, expected=expected) from None


def _socketcan(settings: Bus, options: dict[str, Any]) -> can.BusABC:
    bus = SocketCan(settings.channel, receive_buffer_bytes=settings.receive_buffer_bytes, **options)
    if bus.receive_buffer_bytes < settings.receive_buffer_bytes:
        granted, asked = bus.receive_buffer_bytes, settings.receive_buffer_bytes
        told = {"granted": granted, "asked": asked}
        log.info("bus: the kernel grants %(granted)d of %(asked)d bytes to receive into (net.core.rmem_max)", told)
    return bus


def _filters(ids: Iterable[tuple[int, bool]] | None) -> list[CanFilter] | None:
    """python-can's filters, which the kernel applies where it can: other traffic then does not wake the process."""
    if ids is None:
        return None
    return [CanFilter(can_id=number, can_mask=0x1FFFFFFF if wide else 0x7FF, extended=wide) for number, wide in ids]


def _require_up(channel: str) -> None:
    """OSError if there is no such network interface, or it is down: a CAN socket opens all the same, and is deaf."""
    socket.if_nametoindex(channel)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        request = struct.pack("16sH14x", channel.encode(), 0)
        (flags,) = struct.unpack_from("16xH", fcntl.ioctl(any_socket, _SIOCGIFFLAGS, request))
    if not flags & _IFF_UP:
        raise OSError(errno.ENETDOWN, f"{channel} is down; ip link set {channel} up")


@dataclass(slots=True)
class BusCounters:
    """What has gone wrong on the bus since the start."""

    send_failed: int = 0  # frames dropped because the interface would not take them
    receive_failed: int = 0
    reopened: int = 0
    bus_off: int = 0  # how often the controller gave up: nobody acknowledged, or the wiring is bad
    dropped: int = 0  # received frames the kernel had no room for; of SocketCAN only, others do not say


class SafeBus:
    """`recv` and `send` that never raise. A failing interface is closed and opened again, with growing pauses."""

    def __init__(
        self,
        opener: Callable[[], can.BusABC],
        frame_log: FrameLog | None = None,
        monotonic: Callable[[], float] | None = None,
    ) -> None:
        """`opener` makes the bus; its first failure is the caller's (ConfigError), later ones are counted.

        `monotonic` times the pauses, in seconds (None: this machine's clock).
        """
        self._opener, self._frame_log = opener, frame_log
        self._monotonic = monotonic or time.monotonic
        self._bus: can.BusABC | None = opener()
        self._attempts = 0
        self._retry_at = 0.0
        self._dropped = 0  # by the sockets before this one
        self._not_sent, self._bus_off = Seldom(log), Seldom(log)
        self._lost, self._open_again = Seldom(log, burst=10), Seldom(log, burst=10)
        self.counters = BusCounters()

    def recv(self, timeout_s: float) -> can.Message | None:
        """The next frame, or None after `timeout_s`."""
        bus = self._usable(timeout_s)
        if bus is None:
            return None
        try:
            message = bus.recv(timeout_s)
        except _FAILURES as error:
            self.counters.receive_failed += 1
            self._fail(error)
            return None
        self._attempts = 0
        if message is not None and message.is_error_frame and message.arbitration_id & _CAN_ERR_BUSOFF:
            self.counters.bus_off += 1
            self._bus_off.warning(
                "bus: the controller is bus-off; ip link set … type can restart-ms 100 has it try again"
            )
        self.counters.dropped = self._dropped + getattr(bus, "dropped", 0)
        if self._frame_log is not None and message is not None:
            self._frame_log.received(message)
        return message

    @property
    def failures(self) -> int:
        """How often sending or receiving has failed so far, or frames were lost."""
        counters = self.counters
        return counters.send_failed + counters.receive_failed + counters.bus_off + counters.dropped

    def send(self, frame: Frame, t_ns: int) -> bool:
        """Hand a frame to the interface; False, and it is dropped, if that fails. A full queue is no reason to reopen.

        `t_ns` is the stamp it bears on a bus that lets the sender set one.
        """
        if self._bus is None:
            self.counters.send_failed += 1
            return False
        arbitration_id, is_extended_id, data = frame
        message = can.Message(t_ns * 1e-9, arbitration_id, is_extended_id, data=data)
        try:
            self._bus.send(message)
        except _FAILURES as error:
            self.counters.send_failed += 1
            self._not_sent.warning("bus: frame 0x%(id)X not sent: %(error)s", id=arbitration_id, error=error)
            # The kernel reports a dead interface once, to whichever call comes first: a receiver may never hear of it.
            if _errno(error) not in _QUEUE_FULL:
                self._fail(error)
            return False
        if self._frame_log is not None:
            self._frame_log.sent(message)
        return True

    def close(self) -> None:
        if self._bus is not None:
            self._dropped += getattr(self._bus, "dropped", 0)
            try:
                self._bus.shutdown()
            except _FAILURES as error:
                log.debug("bus: closing it failed: %s", error)
            self._bus = None

    def _usable(self, timeout_s: float) -> can.BusABC | None:
        if self._bus is not None:
            return self._bus
        pause = self._retry_at - self._monotonic()
        if pause > 0:
            time.sleep(min(pause, timeout_s))
            return None
        try:
            self._bus = self._opener()
        except ConfigError as error:
            self._fail(error)
            return None
        self.counters.reopened += 1
        self._open_again.warning("bus: open again")
        return self._bus

    def _fail(self, error: Exception) -> None:
        if self._attempts == 0:
            self._lost.warning("bus: %(error)s; trying to open it again", error=error)
        self.close()
        self._retry_at = self._monotonic() + BACKOFF_S[min(self._attempts, len(BACKOFF_S) - 1)]
        self._attempts += 1


def _errno(error: Exception) -> int | None:
    return getattr(error, "error_code", None) or getattr(error, "errno", None)
