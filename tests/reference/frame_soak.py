"""Frames without end through the daemon in this process, and the memory it holds: `python -m frame_soak 1e7`."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from itertools import cycle
from pathlib import Path

import can

from bms_ukf import CellParams, Estimator, Sample, Status
from bms_ukf.bus import SafeBus
from bms_ukf.clock import LockstepClock
from bms_ukf.daemon import Daemon
from bms_ukf.decoder import Decoder
from bms_ukf.intake import Intake
from bms_ukf.node import SampleEncoder

STEP_NS = 10_000_000  # currents at 100 Hz, a voltage at 10 Hz, a temperature at 1 Hz
FIRST = 100_000  # frames, after which nothing more is set up


class Vehicle:
    """A bus with the frames of a vehicle that does not move; what is sent is counted."""

    def __init__(self) -> None:
        encoder, sample = SampleEncoder(), Sample(0, 0.1, 3.7, 25.0)
        frames = []
        for tick in range(15 * 100):  # the alive counters have come round
            frames.append(encoder.pack(sample))
            frames += encoder.voltages(sample) if tick % 10 == 9 else []
            frames += encoder.temperatures(sample) if tick % 100 == 99 else []
        self._frames: Iterator[can.Message] = cycle(can.Message(0.0, i, wide, data=data) for i, wide, data in frames)
        self.sent = 0

    def recv(self, _: float) -> can.Message:
        return next(self._frames)

    def send(self, _: can.Message) -> None:
        self.sent += 1

    def shutdown(self) -> None:
        """Nothing to close."""


def resident_MB() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def run(frames: int) -> dict[int, float]:
    """Resident MB at FIRST and every ten times as many frames. AssertionError if one was not accepted."""
    vehicle, clock, decoder = Vehicle(), LockstepClock(), Decoder()
    bus = SafeBus(lambda: vehicle)  # type: ignore[arg-type, return-value]
    daemon = Daemon(bus, Estimator(CellParams.load("lgm50_chen2020")), Intake(decoder), clock=clock)
    sizes, began_s, at = {}, time.monotonic(), FIRST
    for k in range(1, frames + 1):
        clock.set(k * STEP_NS)
        daemon.poll(0.0)
        if k == at:
            sizes[k], at = resident_MB(), 10 * at
            print(f"{k:.0e} frames: {sizes[k]:.1f} MB, {k / (time.monotonic() - began_s):.0f} frames/s", flush=True)  # noqa: T201
    assert decoder.counters.accepted == frames, decoder.counters
    assert daemon.estimate.status is Status.OK
    assert vehicle.sent > 4 * daemon.published > frames // 20
    return sizes


if __name__ == "__main__":
    found = run(int(float(sys.argv[1])))
    sys.exit(max(found.values()) > found[FIRST] + 1.0)
