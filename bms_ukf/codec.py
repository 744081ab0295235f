"""The estimator's side of the bus: received frames to `Sample`s, `Estimate`s to frames.

Signs, units and scales are converted here and nowhere else: on the wire as the DBC and the signal map say, inside with
current positive on discharge, SoC from 0 to 1, and NaN for what is not available.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from cantools.database.can import Message

from bms_ukf.dbc import Extract, Field, Matrix, own_matrix
from bms_ukf.errors import ConfigError
from bms_ukf.frames import Frame, Inbox, Outbox, Pages, Read
from bms_ukf.records import NAN, Estimate, PerCell, Sample, Status
from bms_ukf.signals import Bound, SignalMap, bind


@dataclass(slots=True)
class Contactor:
    """What was last heard of the contactors."""

    is_open: bool = False
    t_ns: int | None = None  # when that was; None: never, or the signal said that it does not know


class Decoder(Inbox[Sample]):
    """Turns received frames into samples; see `Inbox.decode`.

    Every accepted frame with mapped signals gives a `Sample` of what it carries, the rest NaN. The sample and its
    arrays are the decoder's own: read them before the next `decode`, or copy them, and do not write to them.
    """

    def __init__(
        self,
        signals: SignalMap | None = None,
        matrix: Matrix | None = None,
        *,
        cells: int = 1,
        source: str | Path = "signals",
    ) -> None:
        """`source` is the file to be named in a ConfigError, raised if the map does not fit the DBC or the cells."""
        signals = signals or SignalMap.default(cells)
        self.bound = bound = bind(signals, matrix or own_matrix(), cells, source)
        self.contactor = Contactor()
        sensors = sum(b.role == "temperature" for b in bound)
        reads: dict[Message, Read[Sample]] = {}
        for message in dict.fromkeys(b.message for b in bound):
            here = [b for b in bound if b.message is message]
            reads[message] = _reader(message, here, self.contactor, cells, max(sensors, 1), source)
        super().__init__(reads, signals.e2e)


class Encoder:
    """Turns estimates into frames.

    `accepted` is how many samples the estimator has accepted so far: the alive counter of a message stands still while
    that number does, so an estimator that has stopped cannot look alive. Values beyond the DBC's limits are sent as the
    limit; SoC and sigma are sent as not available unless the status is `OK` or `DEGRADED`. Nothing here raises.
    """

    def __init__(self, cells: int = 1) -> None:
        matrix = own_matrix()

        def field_of(name: str) -> Field:
            return Field(*matrix.find(name))

        self._soc_box = Outbox(matrix.message("SocEstimate"))
        self._status_shift = field_of("SocEstimate.Status").shift
        self._soc = field_of("SocEstimate.Soc").insert(0.01)
        self._sigma = field_of("SocEstimate.SocSigma").insert(0.01)
        self._age = field_of("SocEstimate.InformationAge").insert()

        self._quality_box = Outbox(matrix.message("SocQuality"))
        self._worst_cell_shift = field_of("SocQuality.WorstCell").shift
        self._voltage_pred = field_of("SocQuality.PredictedVoltage").insert()
        self._innovation = field_of("SocQuality.Innovation").insert()
        self._nis = field_of("SocQuality.Nis").insert()

        self._state_box = Outbox(matrix.message("BmsState"))
        self._faults_shift = field_of("BmsState.FaultCurrentMissing").shift  # the others follow, as in records.Fault
        self._soc_min = field_of("BmsState.SocMin").insert(0.01)
        self._soc_max = field_of("BmsState.SocMax").insert(0.01)

        self._cell_soc = Pages(matrix, "CellSoc", "Cell", cells, 0.01) if cells > 1 else None
        self._next_page = 0

    def encode(self, estimate: Estimate, accepted: int) -> list[Frame]:
        """All that is published after a step: BmsState, SocQuality, SocEstimate; for a pack a page of CellSoc first."""
        frames = [self.state(estimate, accepted), self.quality(estimate, accepted), self.soc(estimate, accepted)]
        if self._cell_soc is not None:
            soc = estimate.soc if estimate.status in _AVAILABLE else NAN
            frames.insert(0, self._cell_soc.frame(self._next_page, soc, accepted))
            self._next_page = (self._next_page + 1) % self._cell_soc.count
        return frames

    def soc(self, estimate: Estimate, accepted: int) -> Frame:
        """SocEstimate: the mean SoC, the largest sigma and the largest age of the cells, and the status."""
        soc, sigma, age = estimate.soc, estimate.soc_sigma, estimate.age_s
        if not (isinstance(soc, float) and isinstance(sigma, float) and isinstance(age, float)):
            soc, sigma, age = float(np.mean(soc)), float(np.max(sigma)), float(np.max(age))
        if estimate.status not in _AVAILABLE:
            soc = sigma = NAN
        word = estimate.status << self._status_shift | self._soc(soc) | self._sigma(sigma) | self._age(age)
        return self._soc_box.frame(word, accepted)

    def quality(self, estimate: Estimate, accepted: int) -> Frame:
        """SocQuality: innovation, NIS and predicted voltage of the cell with the largest NIS."""
        nis = estimate.nis
        worst = 0 if isinstance(nis, float) else int(np.argmax(np.nan_to_num(nis, nan=-1.0)))
        word = (worst + 1) << self._worst_cell_shift
        word |= self._voltage_pred(_of_cell(worst, estimate.voltage_pred_V))
        word |= self._innovation(_of_cell(worst, estimate.innovation_V)) | self._nis(_of_cell(worst, nis))
        return self._quality_box.frame(word, accepted)

    def state(self, estimate: Estimate, accepted: int) -> Frame:
        """BmsState: fault bits, lowest and highest SoC of the cells."""
        soc = estimate.soc if estimate.status in _AVAILABLE else NAN
        lowest, highest = (soc, soc) if isinstance(soc, float) else (float(np.min(soc)), float(np.max(soc)))
        word = int(estimate.faults) << self._faults_shift | self._soc_min(lowest) | self._soc_max(highest)
        return self._state_box.frame(word, accepted)


_AVAILABLE = (Status.OK, Status.DEGRADED)


def _of_cell(k: int, values: PerCell) -> float:
    return values if isinstance(values, float) else float(values[k])


def _reader(
    message: Message, bound: list[Bound], contactor: Contactor, cells: int, sensors: int, source: str | Path
) -> Read[Sample]:
    """The function from a payload of `message` to a sample, by way of its multiplexer if it has one."""

    def page_reader(bound: list[Bound]) -> Read[Sample]:
        return _page_reader(bound, contactor, cells, sensors)

    multiplexers = {b.signal.multiplexer_signal for b in bound} - {None}
    if not multiplexers:
        return page_reader(bound)
    multiplexer = message.get_signal_by_name(str(multiplexers.pop()))
    if multiplexers or multiplexer.multiplexer_signal is not None:
        raise ConfigError(source, key="signals", value=message.name, expected="messages with one level of multiplexing")
    select = Field(message, multiplexer).raw()
    always = [b for b in bound if b.signal.multiplexer_ids is None]
    pages = {
        page: page_reader([b for b in bound if page in (b.signal.multiplexer_ids or (page,))])
        for page in {page for b in bound for page in b.signal.multiplexer_ids or ()}
    }
    other = page_reader(always) if always else _nothing

    def read(data: bytes, t_ns: int) -> Sample | None:
        return pages.get(select(data), other)(data, t_ns)

    return read


def _page_reader(bound: list[Bound], contactor: Contactor, cells: int, sensors: int) -> Read[Sample]:
    """The function from a payload to a sample made once, in which only what the page carries is ever set."""
    measured = [b for b in bound if b.role != "contactor"]
    switch = next((b.extract for b in bound if b.role == "contactor"), None)
    current = next((b.extract for b in bound if b.role == "current"), None)
    voltage = _gather({b.index: b.extract for b in bound if b.role == "voltage"}, cells)
    temperature = _gather({b.index: b.extract for b in bound if b.role == "temperature"}, sensors)
    sample = Sample(0, NAN, _unset(cells), _unset(sensors))

    def read(data: bytes, t_ns: int) -> Sample:
        sample.t_ns = t_ns
        if current is not None:
            sample.current_A = current(data)
        if voltage is not None:
            sample.voltage_V = voltage(data)
        if temperature is not None:
            sample.temperature_degC = temperature(data)
        return sample

    def read_switch(data: bytes, t_ns: int) -> Sample | None:
        if switch is not None:
            state = switch(data)
            contactor.is_open, contactor.t_ns = state == 1.0, None if math.isnan(state) else t_ns
        return read(data, t_ns) if measured else None

    return read if switch is None else read_switch


def _gather(extracts: dict[int, Extract], count: int) -> Callable[[bytes], PerCell] | None:
    """The function from a payload to a number, or for `count` > 1 to an array with NaN where there is no signal."""
    if not extracts:
        return None
    if count == 1:
        return extracts[0]
    values = np.full(count, NAN)

    def gather(data: bytes) -> PerCell:
        for k, extract in extracts.items():
            values[k] = extract(data)
        return values

    return gather


def _unset(count: int) -> PerCell:
    return NAN if count == 1 else np.full(count, NAN)


def _nothing(_: bytes, __: int) -> Sample | None:
    return None
