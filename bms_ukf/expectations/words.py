"""Expectations of what is said on the bus beside the SoC."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from bms_ukf.expectations.base import Expectation, Windowed
from bms_ukf.expectations.record import WORDS, Record

Word = Literal["initialising", "ok", "degraded", "invalid", "silent"]


class StatusSequence(Windowed):
    """The status goes through these, and no others, in this order; `silent` is none for some seconds."""

    kind: Literal["status_sequence"]
    sequence: Annotated[list[Word], Field(min_length=1)]

    def wanted(self) -> str:
        return f"{', '.join(self.sequence)} {self.where()}"

    def judge(self, record: Record) -> tuple[bool, str]:
        states = record.states()[record.within(*self.window)]
        starts = np.flatnonzero(np.diff(states, prepend=-1))
        found = [WORDS[states[k]] for k in starts.tolist()]
        return found == self.sequence, ", ".join(found) or "nothing"


class StoredState(Expectation):
    """What the last start of the daemon made of its state file."""

    kind: Literal["stored_state"]
    word: Literal["none", "used", "foreign", "corrupt", "future", "stale", "unreadable"]

    def wanted(self) -> str:
        return self.word

    def judge(self, record: Record) -> tuple[bool, str]:
        return record.stored.word == self.word, record.stored.word


class PlantFailure(Expectation):
    """The plant fails, and in this way."""

    kind: Literal["plant_failure"]
    failure: Literal["hang", "crash", "nan", "refused", "memory"]

    def wanted(self) -> str:
        return self.failure

    def judge(self, record: Record) -> tuple[bool, str]:
        return record.plant_failure == self.failure, record.plant_failure or "none"
