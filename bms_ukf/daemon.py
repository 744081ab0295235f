"""The daemon: frames in, frames out, one line in between.

    bus.recv -> intake.take -> Sample -> Estimator.step -> Estimate -> encoder.encode -> bus.send

It does not end because of a frame, a full queue or a failing interface: it degrades, says so in what it publishes, and
goes on when it can.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from bms_ukf.bus import SafeBus
from bms_ukf.clock import StampClock
from bms_ukf.commissioning import Commissioning
from bms_ukf.encoder import Encoder
from bms_ukf.estimator import Estimator
from bms_ukf.intake import Intake
from bms_ukf.pace import Pace
from bms_ukf.publication import Publication
from bms_ukf.records import Detail, Estimate, Fault, Sample, Source, Stored
from bms_ukf.scan import Scan

FAULT_HOLD_NS = 1_000_000_000
HEALTH_NS = 1_000_000_000
CHORES_NS = 100_000_000
IMPLAUSIBLE = Fault.CURRENT_IMPLAUSIBLE | Fault.VOLTAGE_IMPLAUSIBLE
POLL_S = 0.1  # how long a request to stop may wait


class Clock(Protocol):
    """The time of received frames; see `clock`."""

    @property
    def steps(self) -> int: ...

    def at(self, stamp_s: float) -> int: ...

    def now(self) -> int: ...

    def advance(self) -> int: ...


class Witness(Protocol):
    """Who is told of all that happens, in the daemon's own loop. What it is given is overwritten later."""

    def stepped(self, sample: Sample, estimate: Estimate) -> None: ...

    def coasted(self, t_ns: int, estimate: Estimate) -> None: ...

    def published(self, t_ns: int, estimate: Estimate, detail: Detail) -> None: ...


class Daemon:
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
    ) -> None:
        """`clock` times the frames (None: a `StampClock`). `fd`: CAN FD frames are read."""
        self.estimator = estimator
        self.encoder = Encoder(estimator.cells)
        self.publication = Publication(estimator.cell.cell.capacity_Ah)
        self.commissioning = Commissioning(estimator.cell)
        self.estimate = estimator.coast(0)  # the latest; its arrays and fields are overwritten by every frame
        self.published = 0  # sets of frames
        self.witness: Witness | None = None
        self._clock: Clock = clock or StampClock()
        self._scan = Scan(estimator.cells)
        self._published_ns = self._health_ns = 0
        self._stepped = False  # since the last set
        self.reconfigure(bus, intake, pace=pace, fd=fd)

    def reconfigure(self, bus: SafeBus, intake: Intake, *, pace: Pace, fd: bool) -> None:
        """Go on with another bus, way in and pace. What the estimator knows, the time and the counters stay."""
        self.bus, self.intake, self._fd = bus, intake, fd
        self.publication.slew_per_s = pace.soc_slew_per_s
        self._periodic = pace.period_s is not None
        due_after_s = pace.silence_s if pace.period_s is None else pace.period_s
        self._due_after_ns = round(1e9 * due_after_s) if due_after_s < math.inf else None
        self._refused = _Recent(Fault.E2E, intake.counters.refused)
        self._failed = _Recent(Fault.BUS, bus.failures + intake.counters.lost)

    def now_ns(self) -> int:
        """The time the next frame would be given."""
        return self._clock.advance()

    def resumed(self, stored: Stored) -> None:
        """Tell on the bus what became of a belief that was stored, now that the estimator has it or not."""
        self.publication.detail.stored = stored
        if stored is Stored.USED:
            self.publication.detail.source = Source.STORED

    def run(self, stop: threading.Event, chores: Callable[[], None] | None = None) -> None:
        """Serve the bus until `stop` is set. `chores` are done in between, every CHORES_NS or so."""
        due_ns = 0
        while not stop.is_set():
            if not self.poll(self._patience_s()):
                self._publish_if_due(self._clock.advance())
            if chores is not None and self._clock.now() >= due_ns:
                chores()
                due_ns = self._clock.now() + CHORES_NS

    def poll(self, timeout_s: float) -> bool:
        """Wait for one frame and handle it; False if none came. A scan that is complete is answered by publishing."""
        message = self.bus.recv(timeout_s)
        if message is None:
            return False
        t_ns = self._clock.at(message.timestamp)
        data_frame = not (message.is_remote_frame or message.is_error_frame or (message.is_fd and not self._fd))
        self._handle(
            self.intake.take(
                message.arbitration_id, message.is_extended_id, bytes(message.data), t_ns, classic=data_frame
            )
        )
        self._publish_if_due(t_ns)
        return True

    def _handle(self, samples: Sequence[Sample]) -> None:
        for sample in samples:
            if _is_empty(sample):  # its sender lives, and knows nothing: no reason to look alive
                self._coast(sample.t_ns)
                self.publication.follow(sample, self.estimate)
                continue
            self.estimator.step(sample, out=self.estimate)
            if self.witness is not None:
                self.witness.stepped(sample, self.estimate)
            self.publication.follow(sample, self.estimate)
            if not self.estimate.faults & IMPLAUSIBLE:
                self.commissioning.see(sample)
            self._stepped = True
            if self._scan.ends_with(sample) and not self._periodic:
                self._publish(sample.t_ns + self.intake.behind_ns)

    def _coast(self, t_ns: int) -> None:
        self.estimator.coast(t_ns, out=self.estimate)
        if self.witness is not None:
            self.witness.coasted(t_ns, self.estimate)

    def _publish_if_due(self, t_ns: int) -> None:
        """Publish every period, or a prediction after too long a silence: it must not look like a steady SoC."""
        if self._due_after_ns is None or t_ns - self._published_ns < self._due_after_ns:
            return
        self._handle(self.intake.due(t_ns))
        if not (self._periodic and self._stepped):
            self._coast(t_ns - self.intake.behind_ns)
        self._publish(t_ns)

    def _publish(self, t_ns: int) -> None:
        received, counters = self.intake.counters, self.bus.counters
        shown = self._refused.at(t_ns, received.refused) | self._failed.at(t_ns, self.bus.failures + received.lost)
        detail = self.publication.complete(self.estimate, t_ns, shown | self.commissioning.fault)
        detail.current_bias_A = float(np.mean(self.estimate.current_bias_A))
        accepted = self.estimator.accepted
        if t_ns - self._health_ns >= HEALTH_NS:
            counts = (counters.dropped, received.refused, counters.send_failed, self._clock.steps, counters.reopened)
            self.bus.send(self.encoder.health(counts, accepted), t_ns)
            self._health_ns = t_ns
        for frame in self.encoder.encode(self.estimate, detail, accepted):
            self.bus.send(frame, t_ns)
        self.published += 1
        if self.witness is not None:
            self.witness.published(t_ns, self.estimate, detail)
        self._stepped = False
        # A period that is late once is made up for, one that is late by more is not.
        on_time = self._periodic and self._due_after_ns and t_ns - self._published_ns < 2 * self._due_after_ns
        self._published_ns = self._published_ns + self._due_after_ns if on_time and self._due_after_ns else t_ns

    def _patience_s(self) -> float:
        if not self._periodic or self._due_after_ns is None:
            return POLL_S
        left_ns = self._published_ns + self._due_after_ns - self._clock.now()
        return min(max(left_ns * 1e-9, 0.0), POLL_S)


class _Recent:
    """A fault that is shown for FAULT_HOLD_NS after its counter moved."""

    def __init__(self, fault: Fault, count: int) -> None:
        self._fault, self._count, self._until_ns = fault, count, -1

    def at(self, t_ns: int, count: int) -> Fault:
        if count != self._count:
            self._count, self._until_ns = count, t_ns + FAULT_HOLD_NS
        return self._fault if t_ns < self._until_ns else Fault.NONE


def _is_empty(sample: Sample) -> bool:
    """Whether nothing was measured."""
    if not math.isnan(sample.current_A):
        return False
    return bool(np.all(np.isnan(sample.voltage_V)) and np.all(np.isnan(sample.temperature_degC)))
