"""What a load knows of the plant at its terminals, and how one electrical quantity is turned into another."""

from __future__ import annotations

import math

import numpy as np

from bms_ukf.errors import ConfigError
from bms_ukf.loads.segments import Limits, Quantity
from bms_ukf.loads.series import Array

_PROBE = 0.01  # of the voltage: the first change where no resistance is known yet
# Of the current: what a smaller change of it does to the voltage is mostly the work of time. Where a voltage is held it
# may raise the resistance all the same, as one taken too small makes it oscillate: a change not even heard is nothing.
_TELLING, _HEARD = 0.25, 0.01


class Terminal:
    """The plant's last answer, and the line through the last two: v = v_last - R (i - i_last).

    R, the voltage of all cells in series over the current of one, is learnt from steps in which the current changed;
    0 until then. Over a step it includes whatever the cell does within the step, so that following the line to a
    voltage neither overshoots by much nor oscillates.
    """

    def __init__(self, plant_input: Quantity) -> None:
        self._plant_input = plant_input
        self._asked = 0.0
        self._holding = False
        self.cells = 1
        self.low_V = self.high_V = self.voltage_V = math.nan  # of the lowest cell, of the highest, of all in series
        self.low_soc = self.high_soc = math.nan
        self.current_A = 0.0
        self.resistance_ohm = 0.0

    def observe(self, voltage_V: float | Array, soc: float | Array, current_A: float) -> None:
        """Takes the plant's state after a step: cell voltages and SoCs, and the mean current of the step or NaN."""
        before_V, before_A = self.voltage_V, self.current_A
        self.low_V, self.high_V = _extremes(voltage_V)
        self.low_soc, self.high_soc = _extremes(soc)
        self.cells, voltage_sum_V = np.size(voltage_V), float(np.sum(voltage_V))
        if math.isnan(current_A):
            current_A = self._current_asked_for(voltage_sum_V)
        self.voltage_V = voltage_sum_V
        self.current_A = current_A
        change_A, largest_A = current_A - before_A, max(abs(current_A), abs(before_A))
        if change_A and abs(change_A) >= (_HEARD if self._holding else _TELLING) * largest_A:
            slope_ohm = (before_V - self.voltage_V) / change_A  # NaN at the first answer, which has none before it
            if slope_ohm > (0.0 if abs(change_A) >= _TELLING * largest_A else self.resistance_ohm):
                self.resistance_ohm = slope_ohm
        self._holding = False

    def reached(self, limits: Limits) -> bool:
        """Whether one of the limits has been passed. Raises ConfigError for a SoC limit, if the plant gives no SoC."""
        for name, found, sign in (
            ("until_below_V", self.low_V, -1.0),
            ("until_above_V", self.high_V, 1.0),
            ("until_below_soc", self.low_soc, -1.0),
            ("until_above_soc", self.high_soc, 1.0),
        ):
            limit = getattr(limits, name)
            if limit is None:
                continue
            if math.isnan(found):
                raise ConfigError("load", key=name, value=limit, expected="no such limit, as the plant gives no SoC")
            if sign * (found - limit) >= 0:
                return True
        return False

    def holding(self, cell_V: float, highest: bool) -> float:
        """The current that brings the highest (else the lowest) cell to `cell_V`; infinite while R is not known."""
        self._holding = True
        excess_V = (self.high_V if highest else self.low_V) - cell_V
        if not self.resistance_ohm:
            return math.copysign(math.inf, excess_V) if excess_V else 0.0
        return self.current_A + excess_V * self.cells / self.resistance_ohm

    def ask(self, quantity: Quantity, value: float) -> float:
        """The plant's input that makes `quantity` have `value` over the next step, if the line holds."""
        if quantity == self._plant_input:
            self._asked = value
        elif self._plant_input == "current_A":
            self._asked = self._current_of_power(value)
        elif self._plant_input == "power_W":
            self._asked = value * self._voltage_at(value)
        else:
            current_A = value if quantity == "current_A" else self._current_of_power(value)
            if current_A and not self.resistance_ohm:
                self._asked = self.voltage_V * (1 - math.copysign(_PROBE, current_A))
            else:
                self._asked = self._voltage_at(current_A)
        return self._asked

    def _current_of_power(self, power_W: float) -> float:
        # The smaller root of p = i (e - R i), without cancellation; beyond the largest power, the current of that.
        e_V = self.voltage_V + self.resistance_ohm * self.current_A
        root_V = math.sqrt(max(e_V**2 - 4 * self.resistance_ohm * power_W, 0.0))
        return 2 * power_W / (e_V + root_V) if root_V else e_V / (2 * self.resistance_ohm)

    def _current_asked_for(self, voltage_V: float) -> float:
        if self._plant_input == "voltage_V":
            if not math.isnan(self.voltage_V):
                raise ConfigError("load", expected="a current output of the plant, as it takes a voltage")
            return 0.0
        return self._asked if self._plant_input == "current_A" else self._asked / voltage_V

    def _voltage_at(self, current_A: float) -> float:
        return self.voltage_V - self.resistance_ohm * (current_A - self.current_A)


def _extremes(value: float | Array) -> tuple[float, float]:
    return (value, value) if isinstance(value, float) else (float(np.min(value)), float(np.max(value)))
