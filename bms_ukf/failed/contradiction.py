"""Whether the intervals of SoC contradict each other, by the charge that flowed between them.

An interval that is right, moved by the charge that flowed since, overlaps every later one that is right. Intervals of
three sigmas are compared: of 95 % intervals one in twenty misses the truth by a little. Where two do not overlap, one
of them was wrong, or the current between them is: nobody can tell which, so none of them is a promise. This finds what
no step of a load shows: a current that is clipped, halved or dead since before the first sample, a voltage that stands
still or jumps, a start that was sure of the wrong SoC.

Innovations of one sign for minutes (`kernel.adapt`) contradict the belief, too.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bms_ukf.estimator import Estimator
from bms_ukf.records import Estimate, PerCell
from bms_ukf.sensor_spec import BOUND_SIGMAS

EVERY_NS = 10_000_000_000  # SoC is slow, and a comparison of 96 cells takes longer than a step of one
MORE = 3.0 / BOUND_SIGMAS - 1.0  # of a half-width, from a 95 % interval to one of three sigmas
GAP_NS = 20_000_000_000  # without a current: the charge is not known
LASTS_NS = 900_000_000_000  # without another contradiction, until the interval counts again
LEAN = 0.85  # limit of a cell's mean normalised innovation; the filter restarts its belief at 0.95
LEAN_AT_REST = 0.6  # the same under a current near zero; measured with a right belief: at most 0.51


class Contradiction:
    """Counts the charge of one string, and compares the intervals of its cells."""

    def __init__(self, estimator: Estimator, cells: NDArray[np.intp] | None = None) -> None:
        """`cells`: those of the string, None for all."""
        tuning, capacity_Ah = estimator.tuning, estimator.cell.cell.capacity_Ah
        self._estimator, self._cells = estimator, slice(None) if cells is None else cells
        self._most = 2.0 * tuning.ok_half_width
        self._share = BOUND_SIGMAS * tuning.charge_gain_sigma  # of the charge moved, that its count may be off by
        self._offset_A = BOUND_SIGMAS * tuning.sensor_spec.current_offset_sigma_A(capacity_Ah)
        self._per_As = 1.0 / (3600.0 * capacity_Ah)
        charge_A, discharge_A = estimator.cell.cell.current_limits_A
        self._least_A, self._most_A = tuning.current_margin * charge_A, tuning.current_margin * discharge_A
        self._adjusted = estimator.adjusted
        self._until_ns: int | None = None
        self.reset()

    def reset(self) -> None:
        """Forget the charge, and with it the intervals: what comes next does not follow what came."""
        self._t_ns: int | None = None
        self.leans = False  # the mean innovations of most cells exceed LEAN_AT_REST
        self._heard_ns = self._checked_ns = 0
        self._current_A = math.nan
        self._charge = self._loose = 0.0  # out of a cell, and what may be wrong with it since the last comparison
        self._low: PerCell = -math.inf  # highest lower bound and lowest upper bound, at zero charge
        self._high: PerCell = math.inf

    def stands(self, t_ns: int) -> bool:
        """Whether two intervals have lately contradicted each other."""
        return self._until_ns is not None and t_ns < self._until_ns

    def take(self, t_ns: int, current_A: float, estimate: Estimate) -> None:
        """`estimate` is the latest, and `current_A` what was measured at `t_ns` after it; NaN: nothing was."""
        if self._t_ns is None or t_ns < self._t_ns or t_ns - self._heard_ns > GAP_NS:
            self.reset()
            self._heard_ns = t_ns
        elif self._current_A == self._current_A:
            moved_As = (t_ns - self._t_ns) * 1e-9 * self._current_A
            self._charge += moved_As * self._per_As
            self._loose += abs(moved_As) * self._share
        if self._least_A <= current_A <= self._most_A:  # the filter does not count a spike either
            self._current_A, self._heard_ns = current_A, t_ns
        self._t_ns = t_ns
        if t_ns - self._checked_ns >= EVERY_NS and self._current_A == self._current_A:
            self._compare(t_ns, estimate)

    def _compare(self, t_ns: int, estimate: Estimate) -> None:
        estimator = self._estimator
        if estimator.adjusted != self._adjusted:  # SoC is a share of another capacity
            self._adjusted = estimator.adjusted
            self.reset()
            self._t_ns = self._heard_ns = t_ns
        since_s = (t_ns - self._checked_ns) * 1e-9 if self._checked_ns else 0.0
        loose = (self._loose + self._offset_A * since_s) * self._per_As
        self._checked_ns, self._loose = t_ns, 0.0
        if isinstance(estimate.soc, float):
            scale = 1.0 / float(estimator.capacity_scale[0])
            low, high = estimate.soc_low, estimate.soc_high
            apart = self._one(low, high, self._charge * scale, loose * scale)
        else:
            per_capacity = 1.0 / estimator.capacity_scale[self._cells]
            low, high = np.asarray(estimate.soc_low)[self._cells], np.asarray(estimate.soc_high)[self._cells]
            apart = self._many(low, high, self._charge * per_capacity, loose * per_capacity)
        lean = np.abs(estimator.lean[self._cells])
        self.leans = bool((lean > LEAN_AT_REST).mean() > 0.5)
        if apart or (lean > LEAN).any():
            self._until_ns = t_ns + LASTS_NS

    def _one(self, low: PerCell, high: PerCell, charge: float, loose: float) -> bool:
        self._low, self._high = self._low - loose, self._high + loose
        if not high - low <= self._most:
            return False
        more = MORE / 2 * (high - low)
        low, high = low + charge - more, high + charge + more
        apart = bool(high < self._low or low > self._high)
        self._low, self._high = (low, high) if apart else (max(self._low, low), min(self._high, high))
        return apart

    def _many(self, low: PerCell, high: PerCell, charge: PerCell, loose: PerCell) -> bool:
        """`_one` for each cell."""
        self._low, self._high = self._low - loose, self._high + loose
        known = high - low <= self._most
        more = MORE / 2 * (high - low)
        low = np.where(known, low + charge - more, -np.inf)
        high = np.where(known, high + charge + more, np.inf)
        apart = (high < self._low) | (low > self._high)
        self._low = np.where(apart, low, np.maximum(self._low, low))
        self._high = np.where(apart, high, np.minimum(self._high, high))
        return bool(apart.any())
