"""A vehicle, the daemon and a witness on one virtual bus, in lockstep, and what is published read by cantools."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import can

from bms_ukf import CellParams, Estimate, Estimator, Sample, Status
from bms_ukf.bus import SafeBus, open_bus
from bms_ukf.clock import LockstepClock
from bms_ukf.config import Bus
from bms_ukf.daemon import Daemon
from bms_ukf.dbc import own_matrix
from bms_ukf.decoder import Decoder
from bms_ukf.intake import Intake
from bms_ukf.node import EstimateDecoder, SampleEncoder
from bms_ukf.pace import Pace

SECOND_NS = 1_000_000_000
SILENCE_S = 2.5  # between two and three of the samples below, one a second
COUNTERS = 15  # an alive counter is 0..14
SOC_BIT, SIGMA_BIT = 0.0025e-2, 0.0025e-2  # what a bit of the DBC is worth
VOLTAGE_BIT, INNOVATION_BIT, NIS_BIT, AGE_BIT = 0.0002, 0.0001, 0.01, 0.01
PACK, CELLS, TEMPERATURES, SOC, QUALITY, STATE = 0x120, 0x121, 0x122, 0x220, 0x221, 0x222
DETAIL, HEALTH, INTERVAL = 0x224, 0x225, 0x230
CELL_SOC, PACK_STATE, CELL_SIGMA = 0x223, 0x226, 0x22B

_channels = (f"test-daemon-{k}" for k in itertools.count())


def load_A(k: int) -> float:
    """A drive of sorts, in whole milliampere: rests, discharge, and a little charge."""
    return round(5.0 * math.sin(0.05 * k) + 2.5, 3) if k % 60 > 5 else 0.0


def charge(drive: list[Sample], cell: CellParams) -> float:
    """What a second's drive per sample takes from SoC."""
    return sum(sample.current_A for sample in drive) / 3600 / cell.cell.capacity_Ah


def read(frames: list[can.Message]) -> dict[str, dict[str, Any]]:
    """The last of each message, as cantools reads it."""
    by_id = {m.frame_id: m for m in own_matrix().sound()}
    return {by_id[m.arbitration_id].name: by_id[m.arbitration_id].decode(bytes(m.data)) for m in frames}  # type: ignore[misc]


class Published(NamedTuple):
    """One SocEstimate and the BmsState before it, as cantools reads them."""

    status: Status
    soc: float  # NaN if not available
    sigma: float
    counter: int
    faults: set[str]


class Rig:
    """A vehicle, the daemon and a witness of what it publishes, on one bus; the test sets the time."""

    def __init__(self, cell: CellParams, cells: int = 1, **options: Any) -> None:
        settings = Bus(interface="virtual", channel=next(_channels))
        self.clock = LockstepClock()
        self.vehicle = open_bus(settings, "vehicle")
        self.bus = SafeBus(lambda: open_bus(settings, "daemon"))
        self.estimator = Estimator(cell, cells, options.pop("tuning", None))
        self.decoder = Decoder(cells=cells)
        options = {"clock": self.clock, "pace": Pace(SILENCE_S)} | options
        self.daemon = Daemon(self.bus, self.estimator, Intake(self.decoder), **options)
        self.encoder = SampleEncoder(cells)

    def close(self) -> None:
        self.bus.close()
        self.vehicle.shutdown()

    def send(self, *messages: can.Message) -> None:
        """Let the daemon handle these."""
        for message in messages:
            self.vehicle.send(message)
        while self.daemon.poll(0.0):
            pass

    def feed(self, sample: Sample) -> None:
        self.clock.set(sample.t_ns)
        self.send(*(message(*frame, stamp_s=sample.t_ns * 1e-9) for frame in self.encoder.encode(sample)))

    def silence(self, t_ns: int) -> None:
        """Nothing on the bus until `t_ns`."""
        self.clock.set(t_ns)
        self.daemon.run(Once())  # type: ignore[arg-type]

    def frames(self) -> list[can.Message]:
        """What was published since the last call, without what only displays and logs want."""
        return [message for message in self.all_frames() if message.arbitration_id not in {DETAIL, HEALTH, INTERVAL}]

    def all_frames(self) -> list[can.Message]:
        return list(iter(lambda: self.vehicle.recv(0.0), None))

    def published(self) -> list[Published]:
        """The same, read by cantools: a row for every set of frames."""
        return [_published(state, soc) for state, _, soc in sets(self.frames())]

    def estimates(self) -> list[Estimate]:
        """The same, read as a monitor would."""
        monitor = EstimateDecoder()
        read = [monitor.decode(m.arbitration_id, False, bytes(m.data), 0) for m in self.all_frames()]
        return [estimate for estimate in read if estimate is not None]


class Once:
    """A request to stop that comes after one turn of the daemon's loop."""

    def __init__(self) -> None:
        self._asked = 0

    def is_set(self) -> bool:
        self._asked += 1
        return self._asked > 1


def message(arbitration_id: int, extended: bool, data: bytes, *, stamp_s: float = 0.0, **kind: bool) -> can.Message:
    return can.Message(stamp_s, arbitration_id, extended, data=data, **kind)


def sets(frames: list[can.Message]) -> list[tuple[can.Message, ...]]:
    """Published frames of a single cell in sets of BmsState, SocQuality, SocEstimate."""
    rows = list(zip(*[iter(frames)] * 3, strict=True))
    assert all([m.arbitration_id for m in row] == [STATE, QUALITY, SOC] for row in rows)
    return rows


def _published(state: can.Message, soc: can.Message) -> Published:
    matrix = own_matrix()
    signals: dict[str, Any] = matrix.message("SocEstimate").decode(bytes(soc.data), decode_choices=False)  # type: ignore[assignment]
    bits: dict[str, Any] = matrix.message("BmsState").decode(bytes(state.data), decode_choices=False)  # type: ignore[assignment]
    missing = bytes(soc.data)[2:4] == b"\xff\xff"
    return Published(
        Status(signals["Status"]),
        math.nan if missing else signals["Soc"] / 100,
        math.nan if missing else signals["SocSigma"] / 100,
        signals["AliveCounter"],
        {name.removeprefix("Fault") for name, bit in bits.items() if name.startswith("Fault") and bit},
    )


@contextmanager
def rig_of(cell: CellParams, cells: int = 1, **options: Any) -> Iterator[Rig]:
    rig = Rig(cell, cells, **options)
    yield rig
    rig.close()


class Flaky:
    """A python-can bus in front of another one, which fails with `error` while that is set."""

    def __init__(self, inner: can.BusABC) -> None:
        self.inner = inner
        self.error: Exception | None = None

    def recv(self, timeout: float) -> can.Message | None:
        self._fail()
        return self.inner.recv(timeout)

    def send(self, frame: can.Message) -> None:
        self._fail()
        self.inner.send(frame)

    def shutdown(self) -> None:
        """The inner bus is opened once and kept."""

    def _fail(self) -> None:
        if self.error is not None:
            raise self.error
