"""End-to-end protection of one message: a CRC over payload and data ID, and an alive counter.

What we send is AUTOSAR E2E profile 11 with the data ID in the CRC only (variant A, "BOTH"): byte 0 is a CRC-8 over the
data ID, low byte first, and bytes 1 onward; the low nibble of byte 1 is a counter, 0 to 14 (AUTOSAR FO R20-11,
Specification of E2E Protocol, profile 11). The CRC is SAE J1850's polynomial 0x1D with start value and final XOR 0,
which catalogues list as CRC-8/GSM-A. What we receive may be protected in any way a `Profile` can say.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol

from fastcrc import crc8

CRC_WRONG = -1
COUNTER_WRONG = -2

Check = Callable[[bytes], bool]
Count = Callable[[bytes], int]

_crc = crc8.gsm_a
_MODULO = 15
_LONGEST = 64  # bytes in a frame


class Agreed(Protocol):
    """What both ends of one message agree on."""

    @property
    def modulo(self) -> int: ...

    @property
    def max_delta(self) -> int: ...

    @property
    def timeout_ns(self) -> int: ...

    def check(self) -> Check | None:
        """The function that tells whether a payload's CRC is right; None: there is no CRC."""

    def count(self) -> Count | None:
        """The function that reads a payload's counter, 0 to modulo - 1; None: there is none."""


@dataclass(frozen=True, slots=True)
class Profile11A:
    """The protection of our own messages."""

    data_id: int  # 16 bit, unique in the network: a frame that arrives under another message's id fails its CRC
    max_delta: int = 7  # 1..14; half the counter's range, as what is further ahead may as well be behind
    timeout_ns: int = 500_000_000  # without an accepted frame for longer than this, the old counter says nothing
    modulo: ClassVar[int] = _MODULO

    @property
    def seed(self) -> int:
        """The CRC of the data ID, from which that of the frame goes on."""
        return _crc(self.data_id.to_bytes(2, "little"))

    def check(self) -> Check:
        seed = self.seed
        return lambda data: _crc(data[1:], seed) == data[0]

    def count(self) -> Count:
        return _low_nibble_of_byte_1

    def recounted(self, data: bytes, counter: int) -> bytes:
        """A payload with another counter, and the CRC that then belongs to it."""
        body = bytes([data[1] & 0xF0 | counter]) + data[2:]
        return _crc(body, self.seed).to_bytes() + body


@dataclass(frozen=True, slots=True)
class Crc:
    """A CRC as catalogues give it, with input and output both reflected or neither."""

    width: Literal[8, 16, 32]
    polynomial: int
    initial: int = 0
    xor_out: int = 0
    reflect: bool = False

    def register(self) -> Callable[[bytes, int], int]:
        """The function from bytes and the register before them to the register after them, without the final XOR."""
        table = [self._of_byte(byte) for byte in range(256)]
        top, mask = self.width - 8, (1 << self.width) - 1

        def short(data: bytes, register: int) -> int:
            for byte in data:
                register = table[register ^ byte]
            return register

        def reflected(data: bytes, register: int) -> int:
            for byte in data:
                register = register >> 8 ^ table[(register ^ byte) & 0xFF]
            return register

        def long(data: bytes, register: int) -> int:
            for byte in data:
                register = register << 8 & mask ^ table[register >> top ^ byte]
            return register

        return reflected if self.reflect else short if self.width == 8 else long

    def start(self) -> int:
        """The register before the first byte."""
        return _mirrored(self.initial, self.width) if self.reflect else self.initial

    def _of_byte(self, byte: int) -> int:
        """The register after one byte alone (the long division of textbooks)."""
        top = 1 << (self.width - 1)
        register = (_mirrored(byte, 8) if self.reflect else byte) << (self.width - 8)
        for _ in range(8):
            register = (register << 1 ^ (self.polynomial if register & top else 0)) & (2 * top - 1)
        return _mirrored(register, self.width) if self.reflect else register


@dataclass(frozen=True, slots=True)
class Profile:
    """A protection in general.

    The CRC is taken over `before`, the bytes `covers` of the payload without its own, and `after`. Where the data ID
    goes with the counter, `before` or `after` has one entry for each value of it.
    """

    crc: Crc | None = None
    crc_byte: int = 0  # where the CRC stands in the payload
    crc_order: Literal["little", "big"] = "little"
    covers: tuple[int, int] | None = None  # first and last byte; None: all
    before: tuple[bytes, ...] = (b"",)
    after: tuple[bytes, ...] = (b"",)
    counter: Count | None = None
    modulo: int = 1
    max_delta: int = 1
    timeout_ns: int = 500_000_000

    def count(self) -> Count | None:
        return self.counter

    def check(self) -> Check | None:
        crc, counter, order, after = self.crc, self.counter, self.crc_order, self.after
        if crc is None:
            return None
        register, xor_out = crc.register(), crc.xor_out
        starts = [register(prefix, crc.start()) for prefix in self.before]
        at, end = self.crc_byte, self.crc_byte + crc.width // 8
        first, last = self.covers or (0, _LONGEST - 1)
        low, high = slice(first, min(at, last + 1)), slice(max(end, first), last + 1)
        values = max(len(starts), len(after))
        start, suffix = starts[0], after[0]

        def check_fixed(data: bytes) -> bool:
            covered = data[low] + data[high] + suffix
            return register(covered, start) ^ xor_out == int.from_bytes(data[at:end], order)

        def check(data: bytes) -> bool:
            n = counter(data) if counter is not None else 0
            if n >= values:
                return False
            covered = data[low] + data[high] + after[n % len(after)]
            return register(covered, starts[n % len(starts)]) ^ xor_out == int.from_bytes(data[at:end], order)

        return check if values > 1 else check_fixed


PresetName = Literal["P01", "P01_LOW", "P01_ALT", "P02", "P05", "P11A"]


def preset(name: PresetName, data_id: Sequence[int]) -> Profile:
    """An AUTOSAR profile, its header at byte 0; `data_id` is one number of 16 bits, or for P02 a list of 16 bytes.

    ValueError if it is not.
    """
    if name == "P02":
        if len(data_id) != 16 or not all(0 <= byte <= 0xFF for byte in data_id):
            raise ValueError("16 bytes, one for each value of the counter")
        after = tuple(bytes([byte]) for byte in data_id)
        return Profile(Crc(8, 0x2F, 0xFF, 0xFF), after=after, counter=_low_nibble_of_byte_1, modulo=16, max_delta=8)
    if len(data_id) != 1 or not 0 <= data_id[0] <= 0xFFFF:
        raise ValueError("one number from 0 to 0xFFFF")
    low, high = data_id[0] & 0xFF, data_id[0] >> 8
    if name == "P05":
        after = (bytes([low, high]),)
        return Profile(Crc(16, 0x1021, 0xFFFF), after=after, counter=_byte_2, modulo=256, max_delta=128)
    before = {
        "P01_LOW": (bytes([low]),),
        "P01_ALT": tuple(bytes([high if n % 2 else low]) for n in range(_MODULO)),
    }.get(name, (bytes([low, high]),))
    return Profile(Crc(8, 0x1D), before=before, counter=_low_nibble_of_byte_1, modulo=_MODULO, max_delta=_MODULO // 2)


class Sender:
    """Protects the frames of one message of our own."""

    __slots__ = ("_body_length", "_counter", "_seed", "_tick")

    def __init__(self, profile: Profile11A, length: int) -> None:
        self._seed, self._body_length = profile.seed, length - 1
        self._counter, self._tick = _MODULO - 1, 0

    def protect(self, word: int, tick: int) -> bytes:
        """The frame whose little-endian integer is `word`, with CRC and counter put into its clear low 12 bits.

        The counter moves by one if `tick` (at first 0) has changed since the last frame, else it is held.
        """
        if tick != self._tick:
            self._tick = tick
            self._counter = (self._counter + 1) % _MODULO
        body = (word >> 8 | self._counter).to_bytes(self._body_length, "little")
        return _crc(body, self._seed).to_bytes() + body


class Receiver:
    """Checks the frames of one message. Only an accepted frame moves its state; a refused one changes nothing."""

    __slots__ = ("_accepted_ns", "_check", "_count", "_counter", "_max_delta", "_modulo", "_timeout_ns")

    def __init__(self, profile: Agreed) -> None:
        self._check, self._count, self._modulo = profile.check(), profile.count(), profile.modulo
        self._max_delta, self._timeout_ns = profile.max_delta, profile.timeout_ns
        self._counter, self._accepted_ns = -1, 0

    def check(self, data: bytes, t_ns: int) -> int:
        """The number of frames lost before this one (modulo the counter's range), or why it is refused.

        Refused is `CRC_WRONG` or `COUNTER_WRONG`. A repeated counter is refused however old the last one is: a sender
        that hangs must not come alive again.
        """
        if self._check is not None and not self._check(data):
            return CRC_WRONG
        if self._count is None:
            return 0
        counter, modulo = self._count(data), self._modulo
        if counter >= modulo:
            return COUNTER_WRONG
        lost = (counter - self._counter - 1) % modulo
        if self._counter < 0:
            lost = 0
        elif lost >= self._max_delta and (lost == modulo - 1 or t_ns - self._accepted_ns <= self._timeout_ns):
            return COUNTER_WRONG
        self._counter, self._accepted_ns = counter, t_ns
        return lost


def _low_nibble_of_byte_1(data: bytes) -> int:
    return data[1] & 0x0F


def _byte_2(data: bytes) -> int:
    return data[2]


def _mirrored(value: int, width: int) -> int:
    """The bits of `value` in reverse order."""
    return int(f"{value:0{width}b}"[::-1], 2)
