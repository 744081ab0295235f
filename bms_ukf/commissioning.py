"""Whether the current on the bus is this cell's: its voltage must fall where the current rises, and by its resistance.

A sign, a unit or a number of parallel cells that is wrong in the configuration shows in the steps of a drive. The slope
of voltage over current steps is found by least squares over the last hundreds of them.
"""

from __future__ import annotations

import logging
import math

import numpy as np
from numpy.typing import NDArray

from bms_ukf.cell import CellParams
from bms_ukf.records import Fault, Sample

log = logging.getLogger(__name__)

SPACING_S = (0.5, 3.0)  # between the two readings of a step: past the noise of sampling, before slow polarisation
MEMORY = 0.995  # what is kept of the sums with every step
ENOUGH = 40.0  # steps, as far as they are remembered
CORRELATED = 0.6  # over so many steps by chance once in ten thousand drives
OUTLIER = 4.0  # times the rms of the steps so far
MOVED_V = 0.002  # rms of the voltage's steps: below it, its own resolution is seen
LEAST, MOST = 1 / 3, 6.0  # times the file's resistance: what temperature and age explain; a wrong unit is 10 or 1000


class Commissioning:
    """Looks at every sample. `fault` is what the data say is wrong: CURRENT_SIGN, CURRENT_SCALE or nothing."""

    def __init__(self, cell: CellParams, string: int | None = None) -> None:
        """`string` is the number by which its sensor is named, if there are several."""
        self.fault = Fault.NONE
        self._of = "" if string is None else f" of string {string}"
        self.slope_ohm = math.nan  # of voltage over current, below 0 if all is well
        self.steps = 0.0  # that it rests upon
        self._cell, self._temperature_degC = cell, 25.0
        self._limits_A = cell.cell.current_limits_A
        self._ohmic: dict[int, tuple[float, float]] = {}  # r0, ohm, and its knee, A
        self._current_A = math.nan
        self._last: tuple[int, float, float] | None = None  # time, current and voltage
        self._index = 0  # of the cell that is looked at
        self._xx = self._xy = self._yy = 0.0
        self._expected = 0.0  # what the sum of products of current and voltage steps would be by the cell file

    def see(self, sample: Sample) -> None:
        if math.isfinite(sample.current_A):
            self._current_A = sample.current_A
        temperature = sample.temperature_degC
        temperature_degC = temperature if isinstance(temperature, float) else float(temperature[0])
        if math.isfinite(temperature_degC):
            self._temperature_degC = temperature_degC
        voltage = sample.voltage_V
        voltage_V = voltage if isinstance(voltage, float) else self._voltage(sample.t_ns, voltage)
        if not (math.isfinite(voltage_V) and math.isfinite(self._current_A)):
            return
        last = self._last
        apart_s = 0.0 if last is None else (sample.t_ns - last[0]) * 1e-9
        if last is not None and apart_s < SPACING_S[0]:
            return
        self._last = sample.t_ns, self._current_A, voltage_V
        if last is not None and apart_s <= SPACING_S[1]:
            expected_V = self._drop_V(last[1]) - self._drop_V(self._current_A)
            self._add(self._current_A - last[1], voltage_V - last[2], expected_V)

    def _voltage(self, t_ns: int, voltage: NDArray[np.float64]) -> float:
        """That of one cell, always the same one unless it is heard no more."""
        if math.isnan(voltage[self._index]) and self._silent(t_ns):
            self._index, self._last = int(np.argmin(np.isnan(voltage))), None
        return float(voltage[self._index])

    def _silent(self, t_ns: int) -> bool:
        return self._last is None or (t_ns - self._last[0]) * 1e-9 > 2 * SPACING_S[1]

    def _add(self, current_step_A: float, voltage_step_V: float, expected_V: float) -> None:
        share = min(self._share(current_step_A, self._xx), self._share(voltage_step_V, self._yy))
        current_step_A, voltage_step_V = share * current_step_A, share * voltage_step_V
        self._expected = MEMORY * self._expected + current_step_A * share * expected_V
        self.steps = MEMORY * self.steps + 1.0
        self._xx = MEMORY * self._xx + current_step_A**2
        self._xy = MEMORY * self._xy + current_step_A * voltage_step_V
        self._yy = MEMORY * self._yy + voltage_step_V**2
        fault = self._judge()
        if fault is not None and fault is not self.fault:
            self.fault = fault
            self._tell()

    def _share(self, step: float, squares: float) -> float:
        """By which a step is made smaller that would outweigh the others: a single glitch proves nothing."""
        most = OUTLIER * math.sqrt(squares / self.steps) if self.steps >= 1.0 else math.inf
        return 1.0 if abs(step) <= most or most == 0.0 else most / abs(step)

    def _judge(self) -> Fault | None:
        """None while the steps do not tell."""
        if self.steps < ENOUGH or self._yy < self.steps * MOVED_V**2:
            return None
        if self._xy * self._xy < CORRELATED**2 * self._xx * self._yy or self._xx == 0.0:
            return None
        self.slope_ohm = self._xy / self._xx
        if self.slope_ohm > 0:
            return Fault.CURRENT_SIGN
        # A knee only makes a slope smaller than r0: a table's knee that is too small must not accuse a right current.
        too_large = -self.slope_ohm >= MOST * self._at_degree()[0]
        too_small = self._expected >= 0.0 or self._ratio <= LEAST
        return Fault.CURRENT_SCALE if too_large or too_small else Fault.NONE

    @property
    def _ratio(self) -> float:
        """Of the voltage's steps to those that the cell file expects of the current's."""
        return self._xy / self._expected if self._expected else math.inf

    def _at_degree(self) -> tuple[float, float]:
        """r0, ohm, and its knee, A, at half charge and the nearest whole degree.

        Looked up once, as it takes longer than all the rest.
        """
        degree = round(self._temperature_degC)
        if degree not in self._ohmic:
            values = self._cell.dynamics_at(0.5, degree)
            self._ohmic[degree] = float(values["r0_ohm"]), float(values["r0_knee_A"])
        return self._ohmic[degree]

    def _drop_V(self, current_A: float) -> float:
        """Ohmic, with the knee of the resistance: over steps of a cold LFP cell its slope is an eighth of that at rest.

        Beyond the currents of the cell the drop goes on straight: a logarithm would hide a wrong unit.
        """
        r0_ohm, knee_A = self._at_degree()
        within_A = min(max(current_A, self._limits_A[0]), self._limits_A[1])
        beyond_A = (current_A - within_A) / math.hypot(1.0, within_A / knee_A)
        return r0_ohm * (knee_A * math.asinh(within_A / knee_A) + beyond_A)

    def _tell(self) -> None:
        seen = f"over {self.steps:.0f} steps the voltage changes by {1e3 * self.slope_ohm:.3g} mV per A of discharge"
        if self.fault is Fault.CURRENT_SIGN:
            told = {"of": self._of, "seen": seen}
            log.error("current%(of)s: %(seen)s: its sign is wrong (signals.current_positive)", told)
        elif self.fault is Fault.CURRENT_SCALE:
            log.error(
                "current%(of)s: %(seen)s, %(ratio).3g times what the cell's resistance explains: its scale is wrong, "
                "or that of the cell (signals.unit, parallel_cells, capacity_scale)",
                {"of": self._of, "seen": seen, "ratio": self._ratio},
            )
        else:
            log.info("current%(of)s: %(seen)s: its sign and scale are right", {"of": self._of, "seen": seen})
