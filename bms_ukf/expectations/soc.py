"""Expectations of the SoC itself."""

from __future__ import annotations

from typing import Literal

import numpy as np

from bms_ukf import honesty
from bms_ukf.expectations.base import Soc, Windowed, pct
from bms_ukf.expectations.record import Record
from bms_ukf.records import Status


class SocError(Windowed):
    """There is a SoC in the window, and no row of it is further than `below` from the truth."""

    kind: Literal["soc_error"]
    below: Soc

    def wanted(self) -> str:
        return f"at most {pct(self.below)} {self.where()}"

    def judge(self, record: Record) -> tuple[bool, str]:
        error = np.where(record.within(*self.window), np.abs(record.error()), np.nan)
        if not np.isfinite(error).any():
            return False, "no SoC"
        row = int(np.nanargmax(error))
        return bool(error[row] <= self.below), f"{pct(error[row])} at {record.t_s[row]:g} s"


class Coverage(Windowed):
    """At least this share of the rows with a SoC has the truth inside the published interval."""

    kind: Literal["coverage"]
    at_least: Soc

    def wanted(self) -> str:
        return f"the truth inside the interval in at least {100 * self.at_least:g} % of rows {self.where()}"

    def judge(self, record: Record) -> tuple[bool, str]:
        known = record.within(*self.window) & np.isfinite(record.error())
        if not known.any():
            return False, "no SoC"
        share = float(np.mean(honesty.inside(*record.interval(), record.trace["soc_ref"])[known]))
        return share >= self.at_least, f"{100 * share:.1f} %"


class NeverValidAndWrong(Windowed):
    """No row with status ok is wrong: further than `above` from the truth, or beyond three sigmas of its interval."""

    kind: Literal["never_valid_and_wrong"]
    above: Soc | None = None  # None: three sigmas, as the interval has them

    def wanted(self) -> str:
        wrong = "the truth beyond three sigmas" if self.above is None else f"an error above {pct(self.above)}"
        return f"no row with status ok and {wrong} {self.where()}"

    def judge(self, record: Record) -> tuple[bool, str]:
        ok = record.within(*self.window) & record.answered & (record.trace.status == Status.OK)
        error = np.abs(record.error())
        far = honesty.beyond(*record.interval(), record.trace["soc_ref"]) if self.above is None else error > self.above
        wrong = np.flatnonzero(ok & far)
        if not wrong.size:
            return True, f"none in {int(ok.sum())}"
        return False, f"{wrong.size} in {int(ok.sum())}, first {pct(error[wrong[0]])} at {record.t_s[wrong[0]]:g} s"
