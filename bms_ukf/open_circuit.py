"""When the current sensor shows nothing but its offset: with contactors that have been open for a while."""

from __future__ import annotations

SETTLE_NS = 2_000_000_000  # open for so long, and no current of a snubber or a discharging link is left
HEARD_NS = 5_000_000_000  # a state of the contactors older than this says nothing


class OpenCircuit:
    """Follows the contactors, and tells which readings of the current are the sensor's offset."""

    def __init__(self, limit_A: float) -> None:
        """A reading beyond `limit_A` is no offset: sensor or contactor is wrong, and which is not known here."""
        self._limit_A = limit_A
        self._open_ns: int | None = None

    def is_offset(self, current_A: float, t_ns: int, is_open: bool, heard_ns: int | None) -> bool:
        """Whether a reading at `t_ns` is one of no current; `heard_ns` is when the contactors said what they are."""
        if heard_ns is None or t_ns - heard_ns > HEARD_NS or not is_open:
            self._open_ns = None
        elif self._open_ns is None:
            self._open_ns = t_ns
        elif t_ns - self._open_ns >= SETTLE_NS:
            return abs(current_A) <= self._limit_A
        return False
