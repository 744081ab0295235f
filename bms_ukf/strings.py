"""Parallel strings, each with a current sensor of its own: what looks at the sensors of one looks at those of each."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bms_ukf.cell import CellParams
from bms_ukf.commissioning import Commissioning
from bms_ukf.records import Fault, PerCell, Sample
from bms_ukf.stuck import Stuck
from bms_ukf.wiring import Wiring

Cells = NDArray[np.intp]


class StuckStrings:
    """`stuck.Stuck` for each string. `fault`: what stands still now, in any of them."""

    def __init__(self, cell: CellParams, wiring: Wiring) -> None:
        self.fault = Fault.NONE
        self._strings = [(k, cells, Stuck(cell, len(cells))) for k, cells in wiring.members().items()]

    def take(self, sample: Sample) -> None:
        """Turn into NaN the voltages of the sample that stand still."""
        fault = Fault.NONE
        for string, members, stuck in self._strings:
            own = seen_by(string, members, sample)
            stuck.take(own)
            if stuck.fault is Fault.NONE:
                continue
            fault |= stuck.fault
            if not isinstance(sample.voltage_V, float):
                sample.voltage_V = with_values(sample.voltage_V, members, own.voltage_V)
        self.fault = fault


class CommissioningStrings:
    """`commissioning.Commissioning` of each string's sensor. `fault`: what is wrong with any of them."""

    def __init__(self, cell: CellParams, wiring: Wiring) -> None:
        self._strings = [(k, cells, Commissioning(cell, k + 1)) for k, cells in wiring.members().items()]

    @property
    def fault(self) -> Fault:
        fault = Fault.NONE
        for _, _, commissioning in self._strings:
            fault |= commissioning.fault
        return fault

    def see(self, sample: Sample) -> None:
        for string, members, commissioning in self._strings:
            commissioning.see(seen_by(string, members, sample))


def seen_by(string: int, members: Cells, sample: Sample) -> Sample:
    """The current and the cells of one string, as a sample of it alone; temperatures are as they are."""
    strings_A, voltage_V = sample.string_current_A, sample.voltage_V
    if not isinstance(voltage_V, float):
        voltage_V = voltage_V[members] if len(members) > 1 else float(voltage_V[members[0]])
    current_A = math.nan if strings_A is None else float(strings_A[string])
    return Sample(sample.t_ns, current_A, voltage_V, sample.temperature_degC, sample.open_circuit)


def with_values(values: NDArray[np.float64], where: Cells | list[int] | int, new: PerCell) -> NDArray[np.float64]:
    """A copy, as the array is the decoder's."""
    values = values.copy()
    values[where] = new
    return values
