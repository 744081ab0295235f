"""What has flowed through the cells of an estimator, for how long, and what the sensors show while nothing does.

The cells of a string have their current in common: a sample costs the same however many they are. Cells are looked at
one by one where balancing takes something of them, and what it takes holds until it is told anew.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bms_ukf.estimator import Estimator
from bms_ukf.kernel import layout
from bms_ukf.records import Sample

Array = NDArray[np.float64]

REST_C = 0.04  # what is no load, offset included, as a share of the capacity per hour
REST_S = 1800.0  # so long without a load, and what is left of polarisation is what the cell file says it errs by
LOOK_NS = 600_000_000_000  # between two looks at the cells: r0 as the filter has it holds for an hour
WAKE_NS = 1_000_000_000  # the first one after a sleep: the voltages of a vehicle that is about to drive
SHOWN_S = 60.0  # what a sensor showed at earlier rests counts for so long a time of the present one


class Counted:
    """Sums since ever; positive = discharge, and of a charge what stays in the cell.

    They hold as of the last `settle`. A current counts for the time since the one before; one that is not plausible is
    none, as for the estimator. `whole` is False once a current was missing for too long, until somebody sets it.
    """

    __slots__ = (
        "_bled_ns",
        "_bleed_A",
        "_due_ns",
        "_efficiency",
        "_estimator",
        "_flowed",
        "_idle",
        "_idle_A",
        "_idle_ns",
        "_least_A",
        "_load_at_ns",
        "_load_ns",
        "_loaded_s",
        "_longest_ns",
        "_most_A",
        "_string_of",
        "_t_ns",
        "_woken_ns",
        "bled_As",
        "counted_s",
        "moved_As",
        "passed_s",
        "rest_s",
        "shown_A",
        "shown_s",
        "whole",
    )

    def __init__(self, estimator: Estimator) -> None:
        cells, strings = estimator.cells, estimator.wiring.strings
        self._estimator, self._string_of = estimator, estimator.wiring.string_of
        self._efficiency = estimator.cell.cell.coulombic_efficiency
        self._idle_A = REST_C * estimator.cell.cell.capacity_Ah
        plausible = estimator._params[[layout.P_CURRENT_MIN, layout.P_CURRENT_MAX]]
        self._least_A, self._most_A = plausible.tolist()
        self._longest_ns = round(1e9 * estimator.tuning.current_timeout_s)
        self.moved_As, self.shown_A = np.zeros(strings), np.zeros(strings)  # charge; offset of the sensor
        self.bled_As, self._bleed_A = np.zeros(cells), np.zeros(cells)
        self.passed_s = self.counted_s = 0.0  # time, and that of which the sensors have told
        self.rest_s = self.shown_s = 0.0  # the present rest, and the time that `shown_A` is worth
        self.whole = False
        self._t_ns: int | None = None  # of the last current
        self._woken_ns: int | None = None  # until the first current after a sleep
        self._load_at_ns = self._due_ns = 0
        # Since the last settling: A ns through each string (a number if there is one), idle and at all, and times.
        self._flowed: float | Array = 0.0
        self._idle: float | Array = 0.0
        self._idle_ns = self._load_ns = self._bled_ns = 0
        self._loaded_s = 0.0  # since the last look

    def count(self, sample: Sample) -> bool:
        """Count what flowed up to a sample; whether it is time to look at the cells."""
        if sample.bleed_A is not None:
            self._settle_bleed()
        current_A = sample.current_A if self._string_of is None else _largest(sample.string_current_A)
        if not self._least_A <= current_A <= self._most_A:  # NaN, too: the next current is of all that time
            return False
        t_ns = sample.t_ns
        dt = self._longest_ns + 1 if self._t_ns is None else t_ns - self._t_ns
        if not 0 <= dt <= self._longest_ns:
            return dt > 0 and self._begin(t_ns, abs(current_A) <= self._idle_A)
        self._t_ns = t_ns
        if self._string_of is not None:
            return self._count_strings(sample, dt)
        if -self._idle_A <= current_A <= self._idle_A:
            self._idle += current_A * dt
            self._idle_ns += dt
        else:
            self._load_at_ns = t_ns
            self._load_ns += dt
        self._flowed += (current_A if current_A > 0.0 else self._efficiency * current_A) * dt
        return t_ns >= self._due_ns

    def count_rows(self, t_ns: NDArray[np.int64], current_A: Array) -> tuple[int, bool]:
        """`count` for samples of one cell, at least one: how many were counted, and whether it is now time to look."""
        rows = 1 if self._t_ns is None else int(np.searchsorted(t_ns, self._due_ns)) + 1
        t_ns, current_A = t_ns[:rows], current_A[:rows]
        known = (self._least_A <= current_A) & (current_A <= self._most_A)
        told_ns, told_A = t_ns[known], current_A[known]
        dt = np.diff(told_ns, prepend=told_ns[:1] if self._t_ns is None else self._t_ns)
        if self._t_ns is None or (dt < 0).any() or (dt > self._longest_ns).any():
            due = [self.count(Sample(t, i)) for t, i in zip(t_ns.tolist(), current_A.tolist(), strict=True)]
            return len(due), due[-1]
        if not told_ns.size:
            return len(t_ns), False
        idle = np.abs(told_A) <= self._idle_A
        self._t_ns = int(told_ns[-1])
        self._idle = _added(self._idle, told_A[idle] * dt[idle])
        self._idle_ns += int(dt[idle].sum())
        self._load_ns += int(dt[~idle].sum())
        self._load_at_ns = int(told_ns[~idle].max(initial=self._load_at_ns))
        self._flowed = _added(self._flowed, np.where(told_A > 0.0, told_A, self._efficiency * told_A) * dt)
        return len(t_ns), bool(known[-1]) and self._t_ns >= self._due_ns

    @property
    def rested(self) -> bool:
        """Whether the present rest is so long that a voltage tells SoC."""
        return self.rest_s >= REST_S

    def looked(self) -> float:
        """Settle, as the cells are looked at now. Returns how long there was a load since the last time, s.

        The next look is due before long, or when the present rest is long enough.
        """
        self.settle()
        loaded_s, self._loaded_s = self._loaded_s, 0.0
        left_s = REST_S - self.rest_s
        wait_ns = min(LOOK_NS, math.ceil(1e9 * left_s)) if self.rest_s > 0.0 < left_s else LOOK_NS
        self._due_ns = (self._t_ns or 0) + wait_ns
        return loaded_s

    def settle(self) -> None:
        """Bring the sums up to date."""
        self._settle_bleed()
        idle_s, load_s = 1e-9 * self._idle_ns, 1e-9 * self._load_ns
        self.moved_As += np.multiply(1e-9, self._flowed)
        self.passed_s += idle_s + load_s
        self.counted_s += idle_s + load_s
        self._loaded_s += load_s
        if load_s:
            self.rest_s = 1e-9 * ((self._t_ns or 0) - self._load_at_ns)
            self.shown_s = min(self.shown_s, SHOWN_S)
        else:
            self.rest_s += idle_s
        if idle_s:
            self.shown_s += idle_s
            self.shown_A += idle_s / self.shown_s * (np.divide(self._idle, self._idle_ns) - self.shown_A)
        self._flowed = self._idle = 0.0
        self._idle_ns = self._load_ns = self._bled_ns = 0

    def slept(self, off_s: float, t_ns: int) -> None:
        """`off_s` s have passed at rest, as `Estimator.sleep` lets them; the time is `t_ns` now."""
        self.settle()
        self._bleed_A[:] = 0.0
        self.whole = self.whole and self.rest_s > 0.0  # a load went on for nobody knows how long
        self.moved_As += self._estimator.tuning.standby_current_A * off_s
        self.passed_s += off_s
        self.rest_s += off_s
        self._t_ns, self._woken_ns = None, t_ns

    def charge_As(self) -> Array:
        """(cells,) through each of them."""
        return self.of_cells(self.moved_As) + self.bled_As

    def of_cells(self, strings: Array) -> Array:
        """(cells,) what each cell has of its string."""
        return strings[np.zeros(len(self.bled_As), np.intp) if self._string_of is None else self._string_of]

    def parts(self) -> list[ArrayLike]:
        """All of it, settled, for `restore`."""
        self.settle()
        times = [self.passed_s, self.counted_s, self.rest_s, self.shown_s, float(self.whole)]
        return [self.moved_As, self.shown_A, self.bled_As, times]

    def restore(self, moved_As: Array, shown_A: Array, bled_As: Array, times: Array) -> None:
        """Go back to what `parts` gave."""
        self.settle()
        self.moved_As, self.shown_A, self.bled_As = moved_As, shown_A, bled_As
        self.passed_s, self.counted_s, self.rest_s, self.shown_s, whole = times.tolist()
        self.whole, self._t_ns = bool(whole), None

    def _begin(self, t_ns: int, idle: bool) -> bool:
        """A first current, or one after too long without: some has not been seen, unless it slept and is at rest."""
        self.settle()
        waited_s, wait_ns = 0.0, LOOK_NS
        if self._woken_ns is not None and idle:
            waited_s, wait_ns = 1e-9 * (t_ns - self._woken_ns), WAKE_NS
            self.rest_s += waited_s
        else:
            self.whole, self.rest_s = False, 0.0
        self.passed_s += waited_s
        self._t_ns, self._due_ns, self._woken_ns = t_ns, t_ns + wait_ns, None
        return False

    def _count_strings(self, sample: Sample, dt: int) -> bool:
        strings_A = np.asarray(sample.string_current_A)
        if np.abs(strings_A).max() <= self._idle_A:
            self._idle = self._idle + strings_A * dt
            self._idle_ns += dt
        else:
            self._load_at_ns = sample.t_ns
            self._load_ns += dt
        self._flowed = self._flowed + np.where(strings_A > 0.0, strings_A, self._efficiency * strings_A) * dt
        return sample.t_ns >= self._due_ns

    def _settle_bleed(self) -> None:
        """Count what balancing has taken; from now on it takes what the estimator knows."""
        now_ns = self._idle_ns + self._load_ns
        self.bled_As += self._bleed_A * (1e-9 * (now_ns - self._bled_ns))
        self._bled_ns = now_ns
        self._bleed_A = np.nan_to_num(self._estimator.bleed_A)


def _largest(strings_A: Array | None) -> float:
    """The current of the string that has most; NaN unless all are known."""
    return math.nan if strings_A is None else float(strings_A[np.argmax(np.abs(strings_A))])


def _added(total: float | Array, terms: Array) -> float:
    """One after the other, as single samples are: the same to the last bit."""
    return float(np.add.accumulate(np.append(total, terms))[-1])
