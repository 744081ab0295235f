"""Sensors that repeat themselves: a voltage that stands still as the current moves, a current as the voltage jumps.

No rule for a value by itself finds them, as each is plausible. A filter finds them and takes them for news: refused
for long enough, a voltage is believed again. So they are taken for missing here, before it, until they move.
"""

from __future__ import annotations

import math
import statistics
from collections import deque

import numpy as np

from bms_ukf.cell import CellParams
from bms_ukf.records import Fault, PerCell, Sample

MOVED_V = 0.03  # far beyond noise and resolution of a cell's voltage: what a sensor that works must show
READINGS = 3  # as the current read may be of another moment than the voltage
STANDS_NS = 4_000_000_000  # a cycler's voltmeter was seen to repeat itself for 2.7 s in a drive
JUMPS = 4  # of the voltage, up and down in turns, that a current leaves unexplained; a spike makes two
JUMPS_NS = 60_000_000_000  # within which


class Stuck:
    """Looks at every sample of a daemon before the estimator does. `fault`: what stands still now."""

    def __init__(self, cell: CellParams, cells: int) -> None:
        self.fault = Fault.NONE
        dynamics = cell.dynamics
        self._ohm = float(min(np.min(r) for r in (dynamics.r0_ohm, dynamics.r0_charge_ohm) if r is not None))
        self._current_A = math.nan
        self._jumps: deque[int] = deque(maxlen=JUMPS)  # when the voltage jumped, under this current
        self._last_V = 0.0  # by how much it did last
        self._voltage = _One() if cells == 1 else _Many(cells)

    def take(self, sample: Sample) -> None:
        """Turn into NaN what of the sample stands still: of one string; `strings.StuckStrings` is for several."""
        current_A, voltage_V = sample.current_A, sample.voltage_V
        if current_A == current_A and current_A != self._current_A:  # noqa: PLR0124 - not NaN
            self._current_A = current_A
            self._jumps.clear()
            self._last_V = 0.0
        sample.voltage_V, moved_V = self._voltage.take(voltage_V, self._current_A, self._ohm, sample.t_ns)
        if abs(moved_V) > MOVED_V and moved_V * self._last_V <= 0:
            self._jumps.append(sample.t_ns)
            self._last_V = moved_V
        frozen = len(self._jumps) == JUMPS and sample.t_ns - self._jumps[0] < JUMPS_NS
        if frozen:
            sample.current_A = math.nan
        self.fault = _FAULTS[self._voltage.stands, frozen]


_FAULTS = {
    (False, False): Fault.NONE,
    (True, False): Fault.VOLTAGE_IMPLAUSIBLE,
    (False, True): Fault.CURRENT_IMPLAUSIBLE,
    (True, True): Fault.VOLTAGE_IMPLAUSIBLE | Fault.CURRENT_IMPLAUSIBLE,
}


class _One:
    """The voltage of one cell, in a tenth of the time that arrays of one take."""

    def __init__(self) -> None:
        self.stands = False
        self._read = self._low_A = self._high_A = math.nan
        self._same = self._since_ns = 0

    def take(self, voltage: PerCell, current_A: float, ohm: float, t_ns: int) -> tuple[PerCell, float]:
        """The voltage, NaN if it stands still, and by how much it moved since the one before, V."""
        if voltage != voltage:  # noqa: PLR0124
            return voltage, 0.0
        if voltage != self._read:
            moved = float(voltage) - self._read
            self._read, self._same, self._since_ns, self.stands = float(voltage), 1, t_ns, False
            self._low_A = self._high_A = current_A
            return voltage, moved
        self._same += 1
        self._low_A, self._high_A = min(self._low_A, current_A), max(self._high_A, current_A)
        long = self._same >= READINGS and t_ns - self._since_ns >= STANDS_NS
        self.stands = long and ohm * (self._high_A - self._low_A) > MOVED_V
        return (math.nan if self.stands else voltage), 0.0


class _Many:
    """The same for the cells of a pack, of which a sample may have some."""

    def __init__(self, cells: int) -> None:
        self._still = np.zeros(cells, bool)
        self._read, self._low_A, self._high_A = (np.full(cells, math.nan) for _ in range(3))
        self._same, self._since_ns = np.zeros(cells, np.intp), np.zeros(cells, np.int64)

    @property
    def stands(self) -> bool:
        return bool(self._still.any())

    def take(self, voltage: PerCell, current_A: float, ohm: float, t_ns: int) -> tuple[PerCell, float]:
        """The same; it has moved by the median over the cells: where most move, it is not their sensors."""
        voltages = np.asarray(voltage, dtype=float)
        if voltages.ndim == 0:  # nothing measured
            return voltage, 0.0
        heard = (voltages == voltages).nonzero()[0]  # noqa: PLR0124 - not NaN
        if not heard.size:
            return voltage, 0.0
        new, old = voltages[heard], self._read[heard]
        moved = (new - old).tolist()
        again, anew = heard[new == old], heard[new != old]
        self._read[heard] = new
        self._low_A[anew] = self._high_A[anew] = current_A
        self._low_A[again] = np.minimum(self._low_A[again], current_A)
        self._high_A[again] = np.maximum(self._high_A[again], current_A)
        self._same[anew], self._since_ns[anew] = 1, t_ns
        self._same[again] += 1
        long = (self._same[heard] >= READINGS) & (t_ns - self._since_ns[heard] >= STANDS_NS)
        still = long & (ohm * (self._high_A[heard] - self._low_A[heard]) > MOVED_V)
        self._still[heard] = still
        if still.any():
            voltages = voltages.copy()
            voltages[heard[still]] = math.nan
        known = [step for step in moved if not math.isnan(step)]
        return voltages, statistics.median(known) if known else 0.0
