"""When no current can flow, and the sensor shows nothing but its offset: behind contactors open for a while."""

from __future__ import annotations

SETTLE_NS = 2_000_000_000  # open for so long, and no current of a snubber or a discharging link is left
HEARD_NS = 5_000_000_000  # a state of the contactors older than this says nothing


class OpenCircuit:
    """Follows the contactors, and tells when nothing flows. `contradictions`: how often a current was shown then."""

    def __init__(self, limit_A: float) -> None:
        """A reading beyond `limit_A` is no offset: sensor or contactor is wrong, and which is not known here."""
        self.contradictions = 0
        self._limit_A = limit_A
        self._open_ns: int | None = None
        self._contradicted = False

    def nothing_flows(self, current_A: float, t_ns: int, is_open: bool, heard_ns: int | None) -> bool:
        """Whether a reading at `t_ns`, NaN if there is none, is one of no current.

        `heard_ns` is when the contactors said what they are.
        """
        if heard_ns is None or t_ns - heard_ns > HEARD_NS or not is_open:
            self._open_ns, self._contradicted = None, False
        elif self._open_ns is None:
            self._open_ns = t_ns
        elif t_ns - self._open_ns >= SETTLE_NS:
            if abs(current_A) > self._limit_A:
                self.contradictions += not self._contradicted
                self._contradicted = True
            elif current_A == current_A:  # noqa: PLR0124 - not NaN
                self._contradicted = False
            return not self._contradicted
        return False
