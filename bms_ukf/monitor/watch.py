"""What the frames on the bus say, kept for whoever looks: the last values, the way SoC went, rates and protection."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from typing import TypeVar

import numpy as np
from cantools.database.can import Message
from numpy.typing import NDArray

from bms_ukf.dbc import Extract, Field, own_matrix
from bms_ukf.decoder import Decoder
from bms_ukf.encoder import HEALTH
from bms_ukf.fault_bits import FaultBits
from bms_ukf.frames import Inbox, Read
from bms_ukf.records import NAN, Fault, Source, Status, Stored

PUBLISHED = ("SocEstimate", "SocInterval", "SocQuality", "BmsState", "SocDetail", "BusHealth")
# Sent of packs, or unless the configuration switches them off.
OPTIONAL = (
    *(
        "PackState",
        "PackEnergy",
        "PackCurrents",
        "PackPowers",
        "PackTimes",
        "CellSoc",
        "CellSigma",
        "CellLow",
        "CellHigh",
    ),
    *("CapacityHealth", "ResistanceHealth", "CellHealth", "StringBias"),
)
RATE_NS = 5_000_000_000  # rates are those of so long
SILENT_NS = 1_500_000_000  # since the last frame of a message that comes once a second; of a slower one, as much more
COLUMN_NS = 10_000_000_000  # of the history
COLUMNS = 60
CELLS, STRINGS = 402, 48  # as many as the DBC has

W = TypeVar("W", bound=IntEnum)


class Protection(Enum):
    """What CRC and alive counter of a message say of it."""

    NONE = "–"  # never heard
    OK = "ok"
    STANDS_STILL = "stands still"  # the sender lives, and what it sends is not new
    WRONG_CRC = "wrong CRC"
    SHORT = "too short"
    SILENT = "silent"


@dataclass(slots=True)
class Track:
    """One message: how often it comes, and what its protection says."""

    name: str
    frame_id: int
    inbox: Inbox[bool] | Decoder
    stamps_ns: deque[int] = field(default_factory=lambda: deque(maxlen=4096))
    state: Protection = Protection.NONE
    silent_ns: int = SILENT_NS

    def take(self, extended: bool, data: bytes, t_ns: int) -> bool:
        """Read a frame; False if it was refused."""
        self.stamps_ns.append(t_ns)
        counters = self.inbox.counters
        before = counters.accepted, counters.crc, counters.counter
        self.inbox.decode(self.frame_id, extended, data, t_ns)
        after = counters.accepted, counters.crc, counters.counter
        accepted, crc, counter = (b > a for a, b in zip(before, after, strict=True))
        self.state = (
            Protection.OK
            if accepted
            else Protection.WRONG_CRC
            if crc
            else Protection.STANDS_STILL
            if counter
            else Protection.SHORT
        )
        return accepted

    def rate_hz(self, now_ns: int) -> float:
        """Frames a second, of the last RATE_NS."""
        while self.stamps_ns and self.stamps_ns[0] < now_ns - RATE_NS:
            self.stamps_ns.popleft()
        if len(self.stamps_ns) < 2:
            return 0.0
        span_ns = now_ns - self.stamps_ns[0]
        return len(self.stamps_ns) / (span_ns * 1e-9) if span_ns else 0.0

    def seen(self, now_ns: int) -> Protection:
        """What is to be said of it now."""
        if self.state is Protection.NONE:
            return self.state
        last_ns = self.stamps_ns[-1] if self.stamps_ns else 0
        return Protection.SILENT if now_ns - last_ns > self.silent_ns else self.state


class Watch:
    """Takes frames, of the daemon and of the vehicle if its decoder is given; everything else is there to be read.

    What is refused, or not said, is NaN; SoC and sigma are those of frames whose protection held.
    """

    def __init__(self, vehicle: Decoder | None = None) -> None:
        self.status, self.faults = Status.INITIALISING, Fault.NONE
        self.source, self.stored = Source.NONE, Stored.NONE
        self.values: dict[str, float] = {}  # by signal, as the DBC names them and in its units
        self.of_cells_pct = {name: np.full(CELLS, NAN) for name in ("CellSoc", "CellSigma", "CellLow", "CellHigh")}
        self.cells = 1  # as many as were heard of
        self.biases_A = np.full(STRINGS, NAN)  # of the strings' current sensors
        self.history_pct: deque[float] = deque([NAN] * COLUMNS, maxlen=COLUMNS)
        self.tracks: dict[tuple[int, bool], Track] = {}
        self.last_ns: int | None = None  # of a SocEstimate that was accepted
        self._column_ns: int | None = None
        self._column: list[float] = []
        matrix = own_matrix()
        for name in PUBLISHED + OPTIONAL:
            message = matrix.message(name)
            self._track(message, Inbox({message: self._reader(message)}))
        if vehicle is not None:
            for bound in vehicle.bound:
                key = (bound.message.frame_id, bound.message.is_extended_frame)
                if key not in self.tracks:
                    self._track(bound.message, vehicle)

    def take(self, arbitration_id: int, extended: bool, data: bytes, t_ns: int) -> None:
        """A frame, whatever it is."""
        track = self.tracks.get((arbitration_id, extended))
        if track is not None and track.take(extended, data, t_ns) and track.name == "SocEstimate":
            self.last_ns = t_ns
            self._note(t_ns)

    def silent_s(self, now_ns: int) -> float | None:
        """How long no SocEstimate was accepted; None: there was none yet."""
        return None if self.last_ns is None else (now_ns - self.last_ns) * 1e-9

    def _track(self, message: Message, inbox: Inbox[bool] | Decoder) -> None:
        silent_ns = max(SILENT_NS, SILENT_NS * (message.cycle_time or 0) // 1000)
        track = Track(message.name, message.frame_id, inbox, silent_ns=silent_ns)
        self.tracks[message.frame_id, message.is_extended_frame] = track

    def _reader(self, message: Message) -> Read[bool]:
        if message.name in self.of_cells_pct:
            return _cell_reader(self, message)
        if message.name == "StringBias":
            return _page_reader(message, [f"String{k + 1}" for k in range(STRINGS)], self.biases_A)
        skipped = {"Crc", "AliveCounter"}
        values: dict[str, Extract] = {}
        words: dict[str, Field] = {}
        for signal in message.signals:
            if signal.name in {"Status", "Source", "StoredState"} or signal.name in HEALTH:
                words[signal.name] = Field(message, signal)
            elif signal.name not in skipped and not signal.name.startswith("Fault"):
                values[signal.name] = Field(message, signal).extract()
        raws = {name: found.raw() for name, found in words.items()}
        faults = FaultBits()

        def read(data: bytes, _: int) -> bool:
            for name, extract in values.items():
                self.values[name] = extract(data)
            for name, raw in raws.items():
                self.values[name] = float(raw(data))
            if message.name == "SocEstimate":
                self.status = _member(Status, self.values["Status"], Status.INVALID)
            elif message.name == "SocDetail":
                self.source = _member(Source, self.values["Source"], Source.NONE)
            elif message.name == "BmsState":
                self.stored = _member(Stored, self.values["StoredState"], Stored.NONE)
                self.faults = faults.extract(data)
            return True

        return read

    def _note(self, t_ns: int) -> None:
        """Add the SoC to the history, a column of COLUMN_NS at a time."""
        self._column_ns = t_ns if self._column_ns is None else self._column_ns
        while t_ns - self._column_ns >= COLUMN_NS:
            self.history_pct.append(NAN)
            self._column_ns += COLUMN_NS
            self._column = []
        soc_pct = self.values.get("Soc", NAN)
        if not math.isnan(soc_pct):
            self._column.append(soc_pct)
            self.history_pct[-1] = sum(self._column) / len(self._column)


def _cell_reader(watch: Watch, message: Message) -> Read[bool]:
    kept = watch.of_cells_pct[message.name]
    read_page = _page_reader(message, [f"Cell{k + 1}" for k in range(CELLS)], kept)

    def read(data: bytes, t_ns: int) -> bool:
        read_page(data, t_ns)
        known = np.flatnonzero(~np.isnan(kept))
        watch.cells = max(watch.cells, int(known[-1]) + 1 if known.size else 1)
        return True

    return read


def _page_reader(message: Message, names: Sequence[str], kept: NDArray[np.float64]) -> Read[bool]:
    """Keeps what the pages of a message say of its numbered signals."""
    page = Field(message, message.get_signal_by_name("Page")).raw()
    signals = [message.get_signal_by_name(name) for name in names]
    extracts = [Field(message, signal).extract() for signal in signals]
    on_a_page = sum(signal.multiplexer_ids == [0] for signal in signals)

    def read(data: bytes, _: int) -> bool:
        first = on_a_page * page(data)
        for k in range(first, min(first + on_a_page, len(extracts))):
            kept[k] = extracts[k](data)
        return True

    return read


def _member(words: type[W], value: float, otherwise: W) -> W:
    return words(int(value)) if int(value) in set(words) else otherwise
