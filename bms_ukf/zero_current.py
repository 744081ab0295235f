"""What a current sensor shows while the contactors are open is its offset: learnt then, taken off ever after."""

from __future__ import annotations

import math

SETTLE_NS = 2_000_000_000  # open for so long, and no current of a snubber or a discharging link is left
HEARD_NS = 5_000_000_000  # a state of the contactors older than this says nothing
MEMORY = 1000  # readings: the offset drifts with temperature, and the newer ones count


class ZeroCurrent:
    """Learns the offset of the current sensor. `offset_A` is 0 before the first reading with open contactors."""

    def __init__(self, limit_A: float) -> None:
        """A reading beyond `limit_A` is no offset: sensor or contactor is wrong, and which is not known here."""
        self.offset_A = 0.0
        self.contradicted = 0  # readings beyond the limit with open contactors
        self._limit_A, self._readings = limit_A, 0
        self._open_ns: int | None = None

    @property
    def known(self) -> bool:
        """Whether there was a reading with open contactors."""
        return self._readings > 0

    def corrected(self, current_A: float, t_ns: int, is_open: bool, heard_ns: int | None) -> float:
        """The current without the offset, in the sign of `current_A`; `heard_ns` is when the contactors said so."""
        if heard_ns is None or t_ns - heard_ns > HEARD_NS or not is_open:
            self._open_ns = None
        elif self._open_ns is None:
            self._open_ns = t_ns
        elif t_ns - self._open_ns >= SETTLE_NS and math.isfinite(current_A):
            if abs(current_A) > self._limit_A:
                self.contradicted += 1
            else:
                self._readings = min(self._readings + 1, MEMORY)
                self.offset_A += (current_A - self.offset_A) / self._readings
        return current_A - self.offset_A
