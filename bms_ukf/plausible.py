"""Decides whether a number can be a quantity of a lithium cell, or is the same quantity in another unit.

A wrong unit is off by a large factor, so the ranges are wide: no cell, however large, cold or aged, lies outside.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class Range(NamedTuple):
    """From the lowest to the highest value a cell can have, and other units, by their size in this one."""

    low: float
    high: float
    unit: str
    others: Mapping[str, float]

    def times(self, factor: float) -> Range:
        """The range of a quantity that is in proportion to this one; the other units stay."""
        return self._replace(low=factor * self.low, high=factor * self.high)

    def doubt(self, value: float, of: str = "") -> str | None:
        """Return what was expected instead of a value outside the range, `of` what; None if the value is inside.

        The text names the unit in which the value would be right.
        """
        if self.low <= value <= self.high:
            return None
        fits = [name for name, size in self.others.items() if self.low <= value * size <= self.high]
        hint = f": is it in {' or '.join(fits)}?" if fits else ""
        return f"{self.low:.3g} to {self.high:.3g} {self.unit}{of}{hint}"


MILLI, KILO = 1e-3, 1e3
# Of a cell's open-circuit or terminal voltage: a typical one, not an extreme.
VOLTAGE_V = Range(1.0, 5.0, "V", {"mV": MILLI, "kV": KILO})
# Drop of r0 at a current that empties the cell in an hour: 9 mV for a large LTO cell, 1 V in the deepest cold.
DROP_AT_1C_V = Range(1.5e-3, 8.0, "Ohm", {"mOhm": MILLI, "uOhm": 1e-6, "kOhm": KILO})
RATE_PER_H = Range(5e-3, 200.0, "A", {"mA": MILLI, "kA": KILO})
KELVIN_OFFSET_DEGC = 273.15
HOTTEST_DEGC = 150.0  # above it, a temperature is in K
MOST_SOC = 1.5  # above it, SoC is in percent
