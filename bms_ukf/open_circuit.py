"""When no current can flow, and the sensor shows nothing but its offset: behind contactors open for a while."""

from __future__ import annotations

from bms_ukf.records import PerCell

SETTLE_NS = 2_000_000_000  # open for so long, and no current of a snubber or a discharging link is left
HEARD_NS = 5_000_000_000  # a state of the contactors older than this says nothing


class OpenCircuit:
    """Follows the contactors, and tells when nothing flows. `contradictions`: how often a current was shown then.

    Of several strings it takes contactors that part each from the others: strings that stay joined behind a main
    contactor charge each other.
    """

    def __init__(self, limit_A: float) -> None:
        """A reading beyond `limit_A` is no offset: sensor or contactor is wrong, and which is not known here."""
        self.contradictions = 0
        self._limit_A = limit_A
        self._open_ns: int | None = None
        self._contradicting = set[int]()  # strings

    def nothing_flows(self, current_A: PerCell, t_ns: int, is_open: bool, heard_ns: int | None) -> bool:
        """Whether a reading at `t_ns`, NaN if there is none, is one of no current; of strings it is all of theirs.

        `heard_ns` is when the contactors said what they are.
        """
        if heard_ns is None or t_ns - heard_ns > HEARD_NS or not is_open:
            self._open_ns = None
            self._contradicting.clear()
        elif self._open_ns is None:
            self._open_ns = t_ns
        elif t_ns - self._open_ns >= SETTLE_NS:
            before = len(self._contradicting)
            for string, shown_A in enumerate((current_A,) if isinstance(current_A, float) else current_A.tolist()):
                if abs(shown_A) > self._limit_A:
                    self._contradicting.add(string)
                elif shown_A == shown_A:  # noqa: PLR0124 - not NaN
                    self._contradicting.discard(string)
            self.contradictions += not before and bool(self._contradicting)
            return not self._contradicting
        return False
