"""The daemon: frames in, frames out, one line in between.

    bus.recv -> intake.take -> Sample -> Estimator.step -> Estimate -> codec.encode -> bus.send

It does not end because of a frame, a full queue or a failing interface: it degrades, says so in what it publishes, and
goes on when it can.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from bms_ukf.bus import SafeBus
from bms_ukf.clock import StampClock
from bms_ukf.codec import Encoder
from bms_ukf.estimator import Estimator
from bms_ukf.intake import Intake
from bms_ukf.records import Fault, Sample, Status

FAULT_HOLD_NS = 1_000_000_000
POLL_S = 0.1  # how long a request to stop may wait

# Wrong with one sample, and no longer with the next: a scan is many samples, and what it publishes tells of them all.
PASSING = (
    Fault.CURRENT_MISSING
    | Fault.CURRENT_IMPLAUSIBLE
    | Fault.VOLTAGE_IMPLAUSIBLE
    | Fault.TEMPERATURE_IMPLAUSIBLE
    | Fault.INNOVATION_REJECTED
    | Fault.TIME_REVERSED
    | Fault.NUMERIC
)


class Clock(Protocol):
    """The time of received frames; see `clock`."""

    def at(self, stamp_s: float) -> int: ...

    def advance(self) -> int: ...


class Daemon:
    """One estimator on one bus. `poll` handles one frame, `run` does so until told to stop."""

    def __init__(
        self,
        bus: SafeBus,
        estimator: Estimator,
        intake: Intake,
        *,
        clock: Clock | None = None,
        silence_s: float = 2.0,
    ) -> None:
        """`clock` times the frames (None: a `StampClock`); `silence_s` after the last answer a prediction is sent."""
        self.bus, self.estimator, self.intake = bus, estimator, intake
        self.encoder = Encoder(estimator.cells)
        self.estimate = estimator.coast(0)  # the latest; its arrays and fields are overwritten by every frame
        self.published = 0  # sets of frames
        self._clock = clock or StampClock()
        self._silence_ns = silence_s * 1e9
        self._published_ns = 0
        self._passed = Fault.NONE  # of PASSING, since the last set
        self._refused = _Recent(Fault.E2E)
        self._failed = _Recent(Fault.BUS)

    def run(self, stop: threading.Event) -> None:
        """Serve the bus until `stop` is set."""
        while not stop.is_set():
            if not self.poll(POLL_S):
                self._break_silence(self._clock.advance())

    def poll(self, timeout_s: float) -> bool:
        """Wait for one frame and handle it; False if none came. A scan that is complete is answered by publishing."""
        message = self.bus.recv(timeout_s)
        if message is None:
            return False
        t_ns = self._clock.at(message.timestamp)
        classic = not (message.is_remote_frame or message.is_error_frame or message.is_fd)
        data = bytes(message.data)
        self._handle(self.intake.take(message.arbitration_id, message.is_extended_id, data, t_ns, classic=classic))
        self._break_silence(t_ns)
        return True

    def _handle(self, samples: Sequence[Sample]) -> None:
        for sample in samples:
            self.estimator.step(sample, out=self.estimate)
            self._passed |= self.estimate.faults & PASSING
            if _closes_scan(sample):
                self._publish(sample.t_ns + self.intake.behind_ns)

    def _break_silence(self, t_ns: int) -> None:
        """Publish a prediction if nothing has been published for too long: silence must not look like a steady SoC."""
        if t_ns - self._published_ns >= self._silence_ns:
            self._handle(self.intake.due(t_ns))
            self.estimator.coast(t_ns - self.intake.behind_ns, out=self.estimate)
            self._publish(t_ns)

    def _publish(self, t_ns: int) -> None:
        estimate = self.estimate
        received = self.intake.counters
        shown = self._refused.at(t_ns, received.refused) | self._failed.at(t_ns, self.bus.failures + received.lost)
        shown |= self._passed
        self._passed = Fault.NONE
        if shown:
            estimate.faults |= shown
            if estimate.status is Status.OK:
                estimate.status = Status.DEGRADED
        for frame in self.encoder.encode(estimate, self.estimator.accepted):
            self.bus.send(frame, t_ns)
        self.published += 1
        self._published_ns = t_ns


class _Recent:
    """A fault that is shown for FAULT_HOLD_NS after its counter moved."""

    def __init__(self, fault: Fault) -> None:
        self._fault, self._count, self._until_ns = fault, 0, -1

    def at(self, t_ns: int, count: int) -> Fault:
        if count != self._count:
            self._count, self._until_ns = count, t_ns + FAULT_HOLD_NS
        return self._fault if t_ns < self._until_ns else Fault.NONE


def _closes_scan(sample: Sample) -> bool:
    """Whether the last cell's voltage is in the sample: cells are read in order."""
    voltage = sample.voltage_V if isinstance(sample.voltage_V, float) else sample.voltage_V[-1]
    return not np.isnan(voltage)
