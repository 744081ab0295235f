"""What both directions of the bus share: frames, the checks on a received one, and the protection of a sent one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from cantools.database.can import Message

from bms_ukf.dbc import Field, Matrix, protection
from bms_ukf.e2e import COUNTER_WRONG, CRC_WRONG, Agreed, Receiver, Sender
from bms_ukf.errors import ConfigError
from bms_ukf.records import NAN, PerCell

T = TypeVar("T")
Frame = tuple[int, bool, bytes]  # of classic CAN: arbitration id, whether that is an extended one, data
Read = Callable[[bytes, int], T | None]  # payload and time of receipt to what it says


@dataclass(slots=True)
class Counters:
    """What became of the received frames: each is counted in exactly one of the first six."""

    accepted: int = 0
    unknown_id: int = 0
    not_data: int = 0  # remote, error and FD frames
    short: int = 0  # fewer bytes than the DBC says
    crc: int = 0
    counter: int = 0  # alive counter repeated, rewound or too far ahead
    lost: int = 0  # frames missing between accepted ones, as far as their alive counters can tell

    @property
    def refused(self) -> int:
        """The frames of wanted messages that were not fit to be used."""
        return self.short + self.crc + self.counter


class Inbox(Generic[T]):
    """Checks every frame before it is read. `counters` is its account; only `decode` changes it."""

    def __init__(self, reads: Mapping[Message, Read[T]], e2e: Mapping[str, Agreed] | None = None) -> None:
        """`e2e` is the protection, by name, of messages for which the DBC declares none of its own."""
        self.counters = Counters()
        self._standard: dict[int, tuple[int, Callable[[bytes, int], int] | None, Read[T]]] = {}
        self._extended: dict[int, tuple[int, Callable[[bytes, int], int] | None, Read[T]]] = {}
        for message, read in reads.items():
            profile = (e2e or {}).get(message.name) or protection(message)
            wanted = self._extended if message.is_extended_frame else self._standard
            if message.frame_id in wanted:
                raise ConfigError(
                    message.name, value=hex(message.frame_id), expected="an id no other mapped message has"
                )
            wanted[message.frame_id] = (message.length, Receiver(profile).check if profile else None, read)

    def ids(self) -> list[tuple[int, bool]]:
        """The arbitration ids of interest, each with whether it is an extended one."""
        return [(i, False) for i in self._standard] + [(i, True) for i in self._extended]

    def decode(
        self, arbitration_id: int, is_extended_id: bool, data: bytes, t_ns: int, *, classic: bool = True
    ) -> T | None:
        """What the frame says, or None if it was refused or has nothing of interest; never raises.

        `t_ns` is when the frame was received; `classic` is False for a remote, error or FD frame. Length, CRC and alive
        counter are checked before anything is read. Bytes beyond the DBC's length are ignored.
        """
        counters = self.counters
        if not classic:
            counters.not_data += 1
            return None
        wanted = (self._extended if is_extended_id else self._standard).get(arbitration_id)
        if wanted is None:
            counters.unknown_id += 1
            return None
        length, check, read = wanted
        if len(data) != length:
            if len(data) < length:
                counters.short += 1
                return None
            data = data[:length]
        if check is not None:
            lost = check(data, t_ns)
            if lost:
                if lost == CRC_WRONG:
                    counters.crc += 1
                    return None
                if lost == COUNTER_WRONG:
                    counters.counter += 1
                    return None
                counters.lost += lost
        counters.accepted += 1
        return read(data, t_ns)


class Outbox:
    """Makes the frames of one of our own messages."""

    def __init__(self, message: Message) -> None:
        profile = protection(message)
        if profile is None:
            raise ConfigError(message.name, key="E2EProfile", expected='"P11A", as for every message that is sent')
        self._id, self._extended = message.frame_id, message.is_extended_frame
        self._protect = Sender(profile, message.length).protect

    def frame(self, word: int, tick: int) -> Frame:
        """The frame with the signals' bits `word`; its alive counter moves if `tick` differs from the last one's."""
        return self._id, self._extended, self._protect(word, tick)


class Pages:
    """A multiplexed message of our own with numbered values, as many on each page: `Cell1`, … or `Sensor1`, …

    `factor` is as in `Field.extract`. ConfigError if the DBC has fewer than `count` such values.
    """

    def __init__(self, matrix: Matrix, message: str, prefix: str, count: int, factor: float = 1.0) -> None:
        found = matrix.message(message)
        known = sum(signal.name.startswith(prefix) for signal in found.signals)
        if count > known:
            raise ConfigError(message, value=count, expected=f"at most {known} values, as many as the DBC has")
        self._box = Outbox(found)
        self._on_a_page = sum(signal.multiplexer_ids == [0] for signal in found.signals)
        self.count = -(-count // self._on_a_page)
        self._page_shift = Field(*matrix.find(f"{message}.Page")).shift
        self._inserts = [
            Field(*matrix.find(f"{message}.{prefix}{k + 1}")).insert(factor)
            for k in range(self._on_a_page * self.count)
        ]

    def frame(self, page: int, values: PerCell, tick: int) -> Frame:
        """One page, with its share of the values of all pages; what is beyond `values` is sent as not available."""
        first, end = self._on_a_page * page, self._on_a_page * (page + 1)
        shown = np.atleast_1d(values)[first:end].tolist()
        word = page << self._page_shift
        for k, insert in enumerate(self._inserts[first:end]):
            word |= insert(shown[k] if k < len(shown) else NAN)
        return self._box.frame(word, tick)
