"""Fault bits of BmsState: which bit of the message carries which `records.Fault`."""

from __future__ import annotations

from bms_ukf.dbc import Field, own_matrix
from bms_ukf.records import Fault

LATER = int(Fault.UNCERTAIN)  # from here on the bits follow those of StoredState


class FaultBits:
    """The two runs of bits in the message."""

    def __init__(self) -> None:
        matrix = own_matrix()
        self._first = Field(*matrix.find("BmsState.FaultCurrentMissing")).shift
        self._later = Field(*matrix.find("BmsState.FaultUncertain")).shift - LATER.bit_length() + 1

    def insert(self, faults: Fault) -> int:
        """Return the faults as a part of the message's 64-bit word."""
        bits = int(faults)
        return (bits & LATER - 1) << self._first | (bits & -LATER) << self._later

    def extract(self, data: bytes) -> Fault:
        """Return the faults of a received message."""
        word = int.from_bytes(data, "little")
        return Fault((word >> self._first & LATER - 1) | (word >> self._later & _ALL & -LATER))


_ALL = sum(Fault)
