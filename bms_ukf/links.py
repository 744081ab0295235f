"""Two ways from a sample to an estimate: straight into the estimator, or as frames over a CAN bus to the daemon."""

from __future__ import annotations

import math
import time
from typing import Protocol

import can

from bms_ukf.bus import SafeBus, open_bus
from bms_ukf.clock import LockstepClock
from bms_ukf.config import Bus
from bms_ukf.daemon import Daemon
from bms_ukf.decoder import Decoder
from bms_ukf.errors import ConfigError
from bms_ukf.estimator import Estimator
from bms_ukf.intake import Intake
from bms_ukf.node import EstimateDecoder, SampleEncoder
from bms_ukf.pace import Pace
from bms_ukf.records import Estimate, Sample, Status

ANSWER_TIMEOUT_S = 1.0  # of wall time, on a real interface


class Link(Protocol):
    """Lockstep: what is measured at one step is answered before the next."""

    frames_in: int  # frames the estimator was sent, and has sent
    frames_out: int

    def exchange(self, sample: Sample) -> Estimate: ...

    def close(self) -> None: ...


class DirectLink:
    """No bus: the sample as it is."""

    def __init__(self, estimator: Estimator) -> None:
        self._estimator = estimator
        self._estimate = Estimate()
        self.frames_in = self.frames_out = 0

    def exchange(self, sample: Sample) -> Estimate:
        return self._estimator.step(sample, out=self._estimate)

    def close(self) -> None:
        """Nothing to close."""


class BusLink:
    """The sample as the vehicle's frames, the daemon in this process, and its frames back as an estimate."""

    def __init__(self, estimator: Estimator, settings: Bus, source: str) -> None:
        """Raises ConfigError if the interface cannot be opened."""
        in_process = settings.interface == "virtual"  # there a frame that is not in the queue now never will be
        self._patience_s, self._wait_s = (0.0, 0.0) if in_process else (ANSWER_TIMEOUT_S, 0.001)
        self._clock = LockstepClock()
        self._vehicle = SafeBus(lambda: open_bus(settings, source))
        try:
            bus = SafeBus(lambda: open_bus(settings, source))
        except ConfigError:  # an interface that can be opened once only
            self._vehicle.close()
            raise
        self._daemon = Daemon(
            bus,
            estimator,
            Intake(Decoder(cells=estimator.cells)),
            clock=self._clock,
            pace=Pace(silence_s=math.inf),
        )
        self._encoder = SampleEncoder(estimator.cells)
        self._decoder = EstimateDecoder()
        self.frames_in = self.frames_out = 0

    def exchange(self, sample: Sample) -> Estimate:
        """An estimate with status INVALID if no answer comes: lost frames are part of what a bus is."""
        while self._vehicle.recv(0.0) is not None:  # an answer that came too late is not this step's
            self.frames_out += 1
        self._clock.set(sample.t_ns)
        for frame in self._encoder.encode(sample):
            self.frames_in += self._vehicle.send(frame, sample.t_ns)
        deadline = time.monotonic() + self._patience_s
        while True:
            served = self._daemon.poll(self._wait_s)
            estimate = self._answer(sample.t_ns)
            if estimate is not None:
                return estimate
            if not served and time.monotonic() > deadline:
                return Estimate(sample.t_ns, status=Status.INVALID)

    def close(self) -> None:
        self._daemon.bus.close()
        self._vehicle.close()

    def _answer(self, t_ns: int) -> Estimate | None:
        """The next estimate on the bus, if one is there."""
        while (message := self._vehicle.recv(0.0)) is not None:
            self.frames_out += 1
            estimate = self._read(message, t_ns)
            if estimate is not None:
                return estimate
        return None

    def _read(self, message: can.Message, t_ns: int) -> Estimate | None:
        return self._decoder.decode(message.arbitration_id, message.is_extended_id, bytes(message.data), t_ns)
