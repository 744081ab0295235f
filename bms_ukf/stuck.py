"""Voltages that stand still as the current moves: sensors that repeat themselves.

No rule for a value by itself finds them, as each is plausible. A filter finds them and takes them for news: refused
for long enough, a voltage is believed again. So they are taken for missing here, before it, until they move.

A charger that holds the voltage moves the current too, but slowly and one way. So a voltage stands still where the
current jumps, or goes up and down again, by what would move any cell of this type by MOVED_V.

Where it ends: a sensor with bits larger than MOVED_V / 2 may stand still by itself, and one that stands still without
the current moving is right. A voltage that jumps, or is off by less than the filter refuses, is not found here. Of
temperatures nothing is: within the plausible range the cell's own response tells too little.
"""

from __future__ import annotations

import math

import numpy as np

from bms_ukf.cell import CellParams
from bms_ukf.records import Fault, PerCell, Sample

MOVED_V = 0.03  # far beyond noise and resolution of a cell's voltage: what a sensor that works must show
READINGS = 3  # as the current read may be of another moment than the voltage
STANDS_NS = 4_000_000_000  # a cycler's voltmeter was seen to repeat itself for 2.7 s in a drive
SUDDEN_NS = 3_000_000_000  # between two readings of the current, for their difference to be a jump


class Stuck:
    """Looks at every sample of a daemon before the estimator does. `fault`: what stands still now."""

    def __init__(self, cell: CellParams, cells: int) -> None:
        self.fault = Fault.NONE
        dynamics = cell.dynamics
        ohm = float(min(np.min(r) for r in (dynamics.r0_ohm, dynamics.r0_charge_ohm) if r is not None))
        self._moved_A = MOVED_V / ohm
        self._current_A, self._current_ns = math.nan, 0
        self._voltage = _One() if cells == 1 else _Many(cells)

    def take(self, sample: Sample) -> None:
        """Turn into NaN what of the sample stands still: of one string; `strings.StuckStrings` is for several."""
        current_A, t_ns = sample.current_A, sample.t_ns
        if current_A == current_A:  # noqa: PLR0124 - not NaN
            if abs(current_A - self._current_A) > self._moved_A and t_ns - self._current_ns <= SUDDEN_NS:
                self._voltage.jumped()
            self._current_A, self._current_ns = current_A, t_ns
        sample.voltage_V = self._voltage.take(sample.voltage_V, self._current_A, self._moved_A, t_ns)
        self.fault = Fault.VOLTAGE_IMPLAUSIBLE if self._voltage.stands else Fault.NONE


class _One:
    """The voltage of one cell, in a tenth of the time that arrays of one take."""

    def __init__(self) -> None:
        self.stands = False
        self._read = self._low_A = self._high_A = math.nan
        self._up_A = self._down_A = 0.0  # how far the current went up, and down, under this reading
        self._jumped = False
        self._same = self._since_ns = 0

    def jumped(self) -> None:
        """The current did."""
        self._jumped = True

    def take(self, voltage: PerCell, current_A: float, moved_A: float, t_ns: int) -> PerCell:
        """The voltage, NaN if it stands still."""
        if voltage != voltage:  # noqa: PLR0124
            return voltage
        if voltage != self._read:
            self._read, self._same, self._since_ns, self.stands = float(voltage), 1, t_ns, False
            self._low_A = self._high_A = current_A
            self._up_A = self._down_A = 0.0
            self._jumped = False
            return voltage
        self._same += 1
        self._low_A, self._high_A = min(self._low_A, current_A), max(self._high_A, current_A)
        self._up_A, self._down_A = max(self._up_A, current_A - self._low_A), max(self._down_A, self._high_A - current_A)
        long = self._same >= READINGS and t_ns - self._since_ns >= STANDS_NS
        self.stands = long and (self._jumped or min(self._up_A, self._down_A) > moved_A)
        return math.nan if self.stands else voltage


class _Many:
    """The same for the cells of a pack, of which a sample may have some."""

    def __init__(self, cells: int) -> None:
        self._still, self._jumped = np.zeros(cells, bool), np.zeros(cells, bool)
        self._read, self._low_A, self._high_A = (np.full(cells, math.nan) for _ in range(3))
        self._up_A, self._down_A = np.zeros(cells), np.zeros(cells)
        self._same, self._since_ns = np.zeros(cells, np.intp), np.zeros(cells, np.int64)

    @property
    def stands(self) -> bool:
        return bool(self._still.any())

    def jumped(self) -> None:
        self._jumped[:] = True

    def take(self, voltage: PerCell, current_A: float, moved_A: float, t_ns: int) -> PerCell:
        voltages = np.asarray(voltage, dtype=float)
        if voltages.ndim == 0:  # nothing measured
            return voltage
        heard = (voltages == voltages).nonzero()[0]  # noqa: PLR0124 - not NaN
        if not heard.size:
            return voltage
        new, old = voltages[heard], self._read[heard]
        again, anew = heard[new == old], heard[new != old]
        self._read[heard] = new
        self._low_A[anew] = self._high_A[anew] = current_A
        self._up_A[anew] = self._down_A[anew] = 0.0
        self._jumped[anew] = False
        self._low_A[again] = np.minimum(self._low_A[again], current_A)
        self._high_A[again] = np.maximum(self._high_A[again], current_A)
        self._up_A[again] = np.maximum(self._up_A[again], current_A - self._low_A[again])
        self._down_A[again] = np.maximum(self._down_A[again], self._high_A[again] - current_A)
        self._same[anew], self._since_ns[anew] = 1, t_ns
        self._same[again] += 1
        long = (self._same[heard] >= READINGS) & (t_ns - self._since_ns[heard] >= STANDS_NS)
        moved = self._jumped[heard] | (np.minimum(self._up_A[heard], self._down_A[heard]) > moved_A)
        still = long & moved
        self._still[heard] = still
        if still.any():
            voltages = voltages.copy()
            voltages[heard[still]] = math.nan
        return voltages
