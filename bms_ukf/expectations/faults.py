"""Expectations of how faults are met: told of in time, and left behind in time."""

from __future__ import annotations

import math
from typing import Literal, Self

import numpy as np
from pydantic import model_validator

from bms_ukf.expectations.base import Expectation, NonNegative, Soc, pct
from bms_ukf.expectations.record import WORDS, Record
from bms_ukf.records import Fault


class OfFault(Expectation):
    """About the fault of this name."""

    fault: str

    def refers_to(self) -> str | None:
        return self.fault


class Detected(OfFault):
    """A word is told within a time of the start of the fault: a status, a fault as on the bus, or `silent`."""

    kind: Literal["detected"]
    by: str
    within_s: NonNegative

    @model_validator(mode="after")
    def _word_is_known(self) -> Self:
        known = [*WORDS, *(fault.name.lower() for fault in Fault if fault.name)]
        if self.by not in known:
            raise ValueError(f"by: one of {', '.join(known)}")
        return self

    def wanted(self) -> str:
        return f"{self.by} within {self.within_s:g} s of {self.fault}"

    def judge(self, record: Record) -> tuple[bool, str]:
        told, start_s = record.told(self.by), record.fault(self.fault).start_s
        before = np.flatnonzero(record.t_s < start_s)
        if before.size and told[before[-1]]:
            return False, "told before it, too"
        rows = np.flatnonzero(told & (record.t_s >= start_s))
        after_s = float(record.t_s[rows[0]]) - start_s if rows.size else None
        return after_s is not None and after_s <= self.within_s, _after(after_s)


class Recovered(OfFault):
    """Within a time of the end of the fault the status is ok and the error at most `below`, until the next fault."""

    kind: Literal["recovered"]
    within_s: NonNegative
    below: Soc | None = None

    def wanted(self) -> str:
        error = "" if self.below is None else f" and an error of at most {pct(self.below)}"
        return f"ok{error} within {self.within_s:g} s of the end of {self.fault}"

    def judge(self, record: Record) -> tuple[bool, str]:
        after_s = record.settled(record.fault(self.fault).end_s, math.inf if self.below is None else self.below)
        return after_s is not None and after_s <= self.within_s, _after(after_s)


class Quiet(OfFault):
    """Nothing is told of the fault: it is one that does not matter."""

    kind: Literal["not_detected"]

    def wanted(self) -> str:
        return f"nothing told of {self.fault}"

    def judge(self, record: Record) -> tuple[bool, str]:
        found = record.fault(self.fault)
        return found.detected_s is None, f"{found.told} {_after(found.detected_s)}".strip()


def _after(seconds: float | None) -> str:
    return "never" if seconds is None else f"after {seconds:g} s"
