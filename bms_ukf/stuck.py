"""Voltages that stand still as the current moves: sensors that repeat themselves.

No rule for a value by itself finds them, as each is plausible. A filter finds them and takes them for news: refused
for long enough, a voltage is believed again. So they are taken for missing here, before it, until they move.

A charger that holds the voltage moves the current too, but slowly and one way. So a voltage stands still where the
current jumps, or goes up and down again, by what moves any cell of this type by MOVED_V at this temperature.

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
NEAR_K = 5.0  # a resistance that was looked up serves for
CHARGED = np.linspace(0.0, 1.0, 21)


class Stuck:
    """Looks at every sample of a daemon before the estimator does. `fault`: what stands still now."""

    def __init__(self, cell: CellParams, cells: int) -> None:
        self.fault = Fault.NONE
        self._cell = cell
        self._temperature_degC, self._at = 25.0, math.nan
        self._ohm = self._knee_A = math.nan
        self._drop_V, self._current_ns = math.nan, -SUDDEN_NS
        self._voltage = _One() if cells == 1 else _Many(cells)

    def take(self, sample: Sample) -> None:
        """Turn into NaN what of the sample stands still: of one string; `strings.StuckStrings` is for several."""
        current_A, t_ns, temperature = sample.current_A, sample.t_ns, sample.temperature_degC
        temperature_degC = temperature if isinstance(temperature, float) else float(temperature[0])
        if temperature_degC == temperature_degC:  # noqa: PLR0124 - not NaN
            self._temperature_degC = temperature_degC
        if current_A == current_A:  # noqa: PLR0124
            if not abs(self._temperature_degC - self._at) < NEAR_K:
                self._look_up()
            drop_V = self._ohm * self._knee_A * math.asinh(current_A / self._knee_A)
            if abs(drop_V - self._drop_V) > MOVED_V and t_ns - self._current_ns <= SUDDEN_NS:
                self._voltage.jumped()
            self._drop_V, self._current_ns = drop_V, t_ns
        sample.voltage_V = self._voltage.take(sample.voltage_V, self._drop_V, t_ns)
        self.fault = Fault.VOLTAGE_IMPLAUSIBLE if self._voltage.stands else Fault.NONE

    def _look_up(self) -> None:
        """Find the least resistance of the cell at this temperature: in the cold, several times that at 25 degC."""
        self._at = self._temperature_degC
        there = self._cell.dynamics_at(CHARGED, self._at)
        self._ohm = float(min(np.min(there["r0_ohm"]), np.min(there["r0_charge_ohm"])))
        self._knee_A = float(np.min(there["r0_knee_A"]))
        self._current_ns = -SUDDEN_NS  # the drops before are those of another resistance


class _One:
    """The voltage of one cell, in a tenth of the time that arrays of one take."""

    def __init__(self) -> None:
        self.stands = False
        self._read = self._low_V = self._high_V = math.nan
        self._up_V = self._down_V = 0.0  # how far the drop went up, and down, under this reading
        self._jumped = False
        self._same = self._since_ns = 0

    def jumped(self) -> None:
        """The current did."""
        self._jumped = True

    def take(self, voltage: PerCell, drop_V: float, t_ns: int) -> PerCell:
        """The voltage, NaN if it stands still."""
        if voltage != voltage:  # noqa: PLR0124
            return voltage
        if voltage != self._read:
            self._read, self._same, self._since_ns, self.stands = float(voltage), 1, t_ns, False
            self._low_V = self._high_V = drop_V
            self._up_V = self._down_V = 0.0
            self._jumped = False
            return voltage
        self._same += 1
        self._low_V, self._high_V = min(self._low_V, drop_V), max(self._high_V, drop_V)
        self._up_V, self._down_V = max(self._up_V, drop_V - self._low_V), max(self._down_V, self._high_V - drop_V)
        long = self._same >= READINGS and t_ns - self._since_ns >= STANDS_NS
        self.stands = long and (self._jumped or min(self._up_V, self._down_V) > MOVED_V)
        return math.nan if self.stands else voltage


class _Many:
    """The same for the cells of a pack, of which a sample may have some."""

    def __init__(self, cells: int) -> None:
        self._still, self._jumped = np.zeros(cells, bool), np.zeros(cells, bool)
        self._read, self._low_V, self._high_V = (np.full(cells, math.nan) for _ in range(3))
        self._up_V, self._down_V = np.zeros(cells), np.zeros(cells)
        self._same, self._since_ns = np.zeros(cells, np.intp), np.zeros(cells, np.int64)

    @property
    def stands(self) -> bool:
        return bool(self._still.any())

    def jumped(self) -> None:
        self._jumped[:] = True

    def take(self, voltage: PerCell, drop_V: float, t_ns: int) -> PerCell:
        voltages = np.asarray(voltage, dtype=float)
        if voltages.ndim == 0:  # nothing measured
            return voltage
        heard = (voltages == voltages).nonzero()[0]  # noqa: PLR0124 - not NaN
        if not heard.size:
            return voltage
        new, old = voltages[heard], self._read[heard]
        again, anew = heard[new == old], heard[new != old]
        self._read[heard] = new
        self._low_V[anew] = self._high_V[anew] = drop_V
        self._up_V[anew] = self._down_V[anew] = 0.0
        self._jumped[anew] = False
        self._low_V[again] = np.minimum(self._low_V[again], drop_V)
        self._high_V[again] = np.maximum(self._high_V[again], drop_V)
        self._up_V[again] = np.maximum(self._up_V[again], drop_V - self._low_V[again])
        self._down_V[again] = np.maximum(self._down_V[again], self._high_V[again] - drop_V)
        self._same[anew], self._since_ns[anew] = 1, t_ns
        self._same[again] += 1
        long = (self._same[heard] >= READINGS) & (t_ns - self._since_ns[heard] >= STANDS_NS)
        moved = self._jumped[heard] | (np.minimum(self._up_V[heard], self._down_V[heard]) > MOVED_V)
        still = long & moved
        self._still[heard] = still
        if still.any():
            voltages = voltages.copy()
            voltages[heard[still]] = math.nan
        return voltages
