"""The way in: received frames to samples, with signs, units and scales as the DBC and the signal map say."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from cantools.database.can import Message
from numpy.typing import NDArray

from bms_ukf.dbc import Extract, Field, Matrix, own_matrix
from bms_ukf.errors import ConfigError
from bms_ukf.frames import Inbox, Read
from bms_ukf.records import NAN, PerCell, Sample
from bms_ukf.signals import Bound, SignalMap, bind
from bms_ukf.units import BASE


class Balancing:
    """What was last heard of the balancing of `cells` cells."""

    HEARD_NS = 5_000_000_000  # what is older than this says nothing

    def __init__(self, cells: int) -> None:
        self._bleed_A, self._heard_ns = np.full(cells, NAN), np.zeros(cells, np.int64)

    def hear(self, index: int, bleed_A: float, t_ns: int) -> None:
        """Take what a frame received at `t_ns` says of one cell; what is not finite says nothing."""
        self._bleed_A[index], self._heard_ns[index] = bleed_A if math.isfinite(bleed_A) else NAN, t_ns

    def at(self, t_ns: int) -> NDArray[np.float64]:
        """(cells,) what is taken from each cell at `t_ns`, A, positive = discharge; NaN: not known."""
        return np.where(t_ns - self._heard_ns <= self.HEARD_NS, self._bleed_A, NAN)


@dataclass(slots=True)
class Contactor:
    """What was last heard of the contactors."""

    is_open: bool = False
    t_ns: int | None = None  # when that was; None: never, or the signal said that it does not know


class Decoder(Inbox[Sample]):
    """Turns received frames into samples; see `Inbox.decode`.

    Every accepted frame with mapped signals gives a `Sample` of what it carries, the rest NaN. The sample and its
    arrays are the decoder's own: read them before the next `decode`, or copy them. The arrays are not to be written to,
    nor what the frame does not carry.
    """

    def __init__(
        self,
        signals: SignalMap | None = None,
        matrix: Matrix | None = None,
        *,
        cells: int = 1,
        wired: bool = False,
        source: str | Path = "signals",
    ) -> None:
        """`wired` is as in `signals.bind`. `source` is the file to be named in a ConfigError.

        That is raised if the map does not fit the DBC or the cells.
        """
        signals = signals or SignalMap.default(cells)
        self.bound = bound = bind(signals, matrix or own_matrix(), cells, source, wired=wired)
        self.contactor = Contactor()
        self.balancing = Balancing(cells) if signals.balancing else None
        counts = _Counts(cells, max(len(signals.temperature), 1), len(signals.currents))
        reads: dict[Message, Read[Sample]] = {}
        for message in dict.fromkeys(b.message for b in bound):
            here = [b for b in bound if b.message is message]
            states = self.contactor, self.balancing
            reads[message] = _reader(message, here, states, counts, source)
        super().__init__(reads, signals.e2e)


States = tuple[Contactor, Balancing | None]


class _Counts(NamedTuple):
    """How many of each there are."""

    cells: int
    sensors: int
    strings: int


def _reader(message: Message, bound: list[Bound], states: States, counts: _Counts, source: str | Path) -> Read[Sample]:
    """The function from a payload of `message` to a sample, by way of its multiplexer if it has one."""

    def page_reader(bound: list[Bound]) -> Read[Sample]:
        return _page_reader(bound, states, counts)

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


def _page_reader(bound: list[Bound], states: States, counts: _Counts) -> Read[Sample]:
    """The function from a payload to a sample made once, in which only what the page carries is ever set."""
    contactor, balancing = states
    bleeds = [(b.index, b.extract) for b in bound if b.role == "balancing"]
    measured = any(b.role in BASE for b in bound)
    switch = next((b.extract for b in bound if b.role == "contactor"), None)
    one = counts.strings == 1
    current = next((b.extract for b in bound if b.role == "current" and one), None)
    strings = _gather({b.index: b.extract for b in bound if b.role == "current" and not one}, counts.strings)
    voltage = _gather({b.index: b.extract for b in bound if b.role == "voltage"}, counts.cells)
    temperature = _gather({b.index: b.extract for b in bound if b.role == "temperature"}, counts.sensors)
    sample = Sample(0)

    def read(data: bytes, t_ns: int) -> Sample:
        sample.t_ns = t_ns
        if current is not None:
            sample.current_A = current(data)
        if voltage is not None:
            sample.voltage_V = voltage(data)
        if temperature is not None:
            sample.temperature_degC = temperature(data)
        return sample

    def read_strings(data: bytes, t_ns: int) -> Sample:
        if strings is not None:
            sample.string_current_A = np.asarray(strings(data))
        return read(data, t_ns)

    read_measured = read if strings is None else read_strings

    def read_states(data: bytes, t_ns: int) -> Sample | None:
        if balancing is not None:
            for index, bleed in bleeds:
                balancing.hear(index, bleed(data), t_ns)
        if switch is not None:
            state = switch(data)
            contactor.is_open, contactor.t_ns = state == 1.0, None if math.isnan(state) else t_ns
        return read_measured(data, t_ns) if measured else None

    return read_states if bleeds or switch is not None else read_measured


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


def _nothing(_: bytes, __: int) -> Sample | None:
    return None
