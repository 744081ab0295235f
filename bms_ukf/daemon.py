"""The daemon: frames in, frames out, one line in between.

    bus.recv -> Core -> encoder.encode -> bus.send

It does not end because of a frame, a full queue or a failing interface: it degrades, says so in what it publishes, and
goes on when it can.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Protocol

from bms_ukf.bus import SafeBus
from bms_ukf.clock import StampClock
from bms_ukf.core import Core
from bms_ukf.encoder import Encoder
from bms_ukf.estimator import Estimator
from bms_ukf.health_encoder import HealthEncoder
from bms_ukf.intake import Intake
from bms_ukf.pace import Pace
from bms_ukf.pack import Health
from bms_ukf.pack_output import PackOutput
from bms_ukf.records import Detail

HEALTH_NS = 1_000_000_000
CHORES_NS = 100_000_000


class Clock(Protocol):
    """The time of received frames; see `clock`."""

    @property
    def steps(self) -> int: ...

    def at(self, stamp_s: float) -> int: ...

    def now(self) -> int: ...

    def advance(self) -> int: ...


class Daemon(Core):
    """One estimator on one bus. `poll` handles one frame, `run` does so until told to stop."""

    def __init__(
        self,
        bus: SafeBus,
        estimator: Estimator,
        intake: Intake,
        *,
        clock: Clock | None = None,
        pace: Pace = Pace(),  # noqa: B008 - a tuple
        fd: bool = False,
        pack: PackOutput | None = None,
        health: Health | None = None,
    ) -> None:
        """`clock` times the frames (None: a `StampClock`). `fd`: CAN FD frames are read. `pack`: what is published of
        it; None: of several cells by the defaults, of a single one nothing. `health`: followed and published.
        """
        self.bus, self._fd = bus, fd
        self.encoder = Encoder()
        self.pack = pack or (PackOutput(estimator) if estimator.cells > 1 else None)
        self._clock: Clock = clock or StampClock()
        self._health_ns = 0
        self._ageing = None if health is None else HealthEncoder(health)
        super().__init__(estimator, intake, pace, health)

    def reconfigure(self, bus: SafeBus, intake: Intake, *, pace: Pace, fd: bool, pack: PackOutput | None) -> None:
        """Go on with another bus, way in and pace. What the estimator knows, the time and the counters stay."""
        self.bus, self._fd, self.pack = bus, fd, pack
        self._adopt(intake, pace)

    def now_ns(self) -> int:
        """The time the next frame would be given."""
        return self._clock.advance()

    def run(self, stop: threading.Event, chores: Callable[[], None] | None = None) -> None:
        """Serve the bus until `stop` is set. `chores` are done in between, every CHORES_NS or so."""
        due_ns = 0
        while not stop.is_set():
            if not self.poll(self.patience_ns(self._clock.now()) * 1e-9):
                self.idle(self._clock.advance())
            if chores is not None and self._clock.now() >= due_ns:
                chores()
                due_ns = self._clock.now() + CHORES_NS

    def poll(self, timeout_s: float) -> bool:
        """Wait for one frame and handle it; False if none came. A scan that is complete is answered by publishing."""
        message = self.bus.recv(timeout_s)
        if message is None:
            return False
        data_frame = not (message.is_remote_frame or message.is_error_frame or (message.is_fd and not self._fd))
        self.hear(
            message.arbitration_id,
            message.is_extended_id,
            bytes(message.data),
            self._clock.at(message.timestamp),
            classic=data_frame,
        )
        return True

    def _failures(self) -> int:
        return self.bus.failures

    def _send(self, t_ns: int, detail: Detail) -> None:
        accepted, bus = self.estimator.accepted, self.bus
        if t_ns - self._health_ns >= HEALTH_NS:
            counters = bus.counters
            counts = (
                counters.dropped,
                self.intake.counters.refused,
                counters.send_failed,
                self._clock.steps,
                counters.reopened,
                self.intake.contradictions,
            )
            bus.send(self.encoder.health(counts, accepted), t_ns)
            self._health_ns = t_ns
        frames = self.encoder.encode(self.estimate, detail, accepted)
        if self.pack is not None:
            whole = self.publication.whole(self.estimate, t_ns)
            frames = self.pack.frames(whole, self.estimate, accepted) + frames
        if self._ageing is not None:
            frames = self._ageing.encode(t_ns, accepted) + frames
        for frame in frames:
            bus.send(frame, t_ns)
