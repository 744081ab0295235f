"""The bus between the vehicle and a daemon in this process: memory alone ("direct"), or python-can's virtual bus.

Its far end can be unplugged, which the daemon meets as it meets an interface that was taken down.
"""

from __future__ import annotations

import errno
import itertools
import threading
from collections import deque
from collections.abc import Callable

import can

from bms_ukf.bus import SafeBus, open_bus
from bms_ukf.config import Bus
from bms_ukf.errors import ConfigError
from bms_ukf.frames import Frame

_serial = itertools.count()


class Memory:
    """One end of two queues; what python-can's buses do, as far as a daemon uses it."""

    def __init__(self, inbox: deque[can.Message], outbox: deque[can.Message]) -> None:
        self._inbox, self._outbox = inbox, outbox
        inbox.clear()  # what came before there was anybody to hear it

    def recv(self, timeout: float | None = None) -> can.Message | None:
        return self._inbox.popleft() if self._inbox else None

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._outbox.append(msg)

    def shutdown(self) -> None:
        """Nothing to give back."""


class Cable:
    """Two ends: `vehicle`, and those that `open` gives the daemon. `up` is whether the daemon's interface is."""

    def __init__(self, interface: str, channel: str | None = None) -> None:
        """`interface` is "direct" or "virtual"; `channel` is the virtual bus's (None: one of its own)."""
        self.up = True
        self._open: Callable[[], can.BusABC | Memory]
        if interface == "direct":
            there: deque[can.Message] = deque()
            back: deque[can.Message] = deque()
            self.vehicle: can.BusABC | Memory = Memory(back, there)
            self._open = lambda: Memory(there, back)
        else:
            settings = Bus(interface="virtual", channel=channel or f"bms-ukf-hil-{next(_serial)}")
            self._open = lambda: open_bus(settings, "hil")
            self.vehicle = self._open()

    def open(self) -> Plug:
        """The daemon's end. ConfigError while the interface is down."""
        if not self.up:
            raise ConfigError("hil", expected="an interface that is up")
        return Plug(self, self._open())

    def send(self, frame: Frame, stamp_s: float) -> None:
        """From the vehicle to the daemon. What is sent while the interface is down is lost."""
        if self.up:
            identifier, extended, data = frame
            self.vehicle.send(can.Message(stamp_s, identifier, extended, data=data))

    def close(self) -> None:
        self.vehicle.shutdown()


class Plug:
    """The daemon's end of a cable: a bus that fails while the interface is down."""

    def __init__(self, cable: Cable, bus: can.BusABC | Memory) -> None:
        self._cable, self._bus = cable, bus

    def recv(self, timeout: float | None = None) -> can.Message | None:
        self._require_up()
        return self._bus.recv(timeout)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._require_up()
        self._bus.send(msg)

    def shutdown(self) -> None:
        self._bus.shutdown()

    def _require_up(self) -> None:
        if not self._cable.up:
            raise OSError(errno.ENETDOWN, "the interface is down")


class LockstepBus(SafeBus):
    """Never waits: in lockstep a frame that is not there now never will be. `idle` is set when there is none."""

    def __init__(self, cable: Cable, monotonic: Callable[[], float]) -> None:
        super().__init__(cable.open, monotonic=monotonic)  # type: ignore[arg-type]
        self.idle = threading.Event()

    def recv(self, timeout_s: float) -> can.Message | None:
        message = super().recv(0.0)
        if message is None:
            self.idle.set()
        return message
