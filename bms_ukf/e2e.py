"""End-to-end protection of one message: AUTOSAR E2E profile 11 with the data ID in the CRC only (variant A, "BOTH").

Byte 0 is a CRC-8 over the data ID, low byte first, and bytes 1 onward; the low nibble of byte 1 is a counter, 0 to 14
(AUTOSAR FO R20-11, Specification of E2E Protocol, profile 11). The CRC is SAE J1850's polynomial 0x1D with start value
and final XOR 0, which catalogues list as CRC-8/GSM-A.
"""

from __future__ import annotations

from dataclasses import dataclass

from fastcrc import crc8

CRC_WRONG = -1
COUNTER_WRONG = -2

_crc = crc8.gsm_a
_MODULO = 15
_REPEATED = _MODULO - 1  # what a repeated counter looks like, counted in frames lost


@dataclass(frozen=True, slots=True)
class Profile11A:
    """What both ends of one message agree on."""

    data_id: int  # 16 bit, unique in the network: a frame that arrives under another message's id fails its CRC
    max_delta: int = 7  # 1..14; half the counter's range, as what is further ahead may as well be behind
    timeout_ns: int = 500_000_000  # without an accepted frame for longer than this, the old counter says nothing

    @property
    def seed(self) -> int:
        """The CRC of the data ID, from which that of the frame goes on."""
        return _crc(self.data_id.to_bytes(2, "little"))


class Sender:
    """Protects the frames of one message."""

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

    __slots__ = ("_accepted_ns", "_counter", "_max_delta", "_seed", "_timeout_ns")

    def __init__(self, profile: Profile11A) -> None:
        self._seed, self._max_delta, self._timeout_ns = profile.seed, profile.max_delta, profile.timeout_ns
        self._counter, self._accepted_ns = -1, 0

    def check(self, data: bytes, t_ns: int) -> int:
        """The number of frames lost before this one (modulo 15), or if it is refused `CRC_WRONG` or `COUNTER_WRONG`.

        A repeated counter is refused however old the last one is: a sender that hangs must not come alive again.
        """
        if _crc(data[1:], self._seed) != data[0]:
            return CRC_WRONG
        counter = data[1] & 0x0F
        lost = (counter - self._counter - 1) % _MODULO
        if self._counter < 0:
            lost = 0
        elif lost >= self._max_delta and (lost == _REPEATED or t_ns - self._accepted_ns <= self._timeout_ns):
            return COUNTER_WRONG
        if counter == _MODULO:
            return COUNTER_WRONG
        self._counter, self._accepted_ns = counter, t_ns
        return lost
