"""What is known of a pack beyond its cells."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bms_ukf.records import NAN, Fault, Status

Array = NDArray[np.float64]


def _none() -> Array:
    return np.empty(0)


@dataclass(slots=True)
class Ageing:
    """How the cells of an estimator have aged: multiples of the cell file's capacity and r0; NaN = not told yet.

    Cells of which nothing has been told are left out of least, most and mean. Cells are counted from 0, -1 is none.
    """

    capacity_min: float = NAN
    capacity_sigma: float = NAN  # one standard deviation, of that cell
    capacity_mean: float = NAN
    capacity_cell: int = -1  # the one with the least
    segments: int = 0  # that have told of that cell
    resistance_max: float = NAN
    resistance_sigma: float = NAN
    resistance_mean: float = NAN
    resistance_cell: int = -1


@dataclass(slots=True)
class PackEstimate:
    """A pack after a sample; positive = discharge, NaN = not known, cells are counted from 0, and -1 is none of them.

    Of parallel strings, currents, charges and energies are those of all together. Charge and energy are what the pack
    gives or takes until the first cell of a string is empty or full at the rates of its `Limits`, at its present
    temperature; `soc` is charge left over the sum of both. Cells that are not known are left out, `silent` counts them.
    The arrays are overwritten by the next update.
    """

    t_ns: int = 0
    status: Status = Status.INITIALISING
    faults: Fault = Fault.NONE

    soc: float = NAN  # usable, 0..1
    soc_sigma: float = NAN  # one standard deviation, by the cell that is empty first
    remaining_Ah: float = NAN  # >= 0
    remaining_sigma_Ah: float = NAN
    remaining_Wh: float = NAN  # >= 0, at the recent current, or the rate of `Limits` if there is none
    chargeable_Ah: float = NAN  # >= 0
    chargeable_Wh: float = NAN  # >= 0
    empty_first: int = -1  # the cells that limit these
    full_first: int = -1

    power_W: float = NAN  # mean of late, of the pack
    time_to_empty_s: float = NAN  # at that power; NaN unless it discharges
    time_to_full_s: float = NAN  # at that power; NaN unless it charges

    soc_min: float = NAN  # of a cell, charge over its capacity, 0..1
    soc_max: float = NAN
    soc_spread: float = NAN  # standard deviation between the cells
    lowest: int = -1
    highest: int = -1

    discharge_A: float = NAN  # >= 0, that a pulse may have
    discharge_sigma_A: float = NAN  # of the cell that limits it; 0 where only a current limit does
    discharge_W: float = NAN  # what the pack gives at the end of it
    discharge_cell: int = -1
    charge_A: float = NAN  # <= 0
    charge_sigma_A: float = NAN
    charge_W: float = NAN  # <= 0
    charge_cell: int = -1

    silent: int = 0  # cells that are predicted for want of a voltage, or not known at all
    silent_cell: int = -1  # the first of them

    current_bias_A: Array = field(default_factory=_none)  # (strings,) what each current sensor shows too much
    cell_empty_soc: Array = field(default_factory=_none)  # (cells,) where each is empty at that rate, 0..1
    cell_full_soc: Array = field(default_factory=_none)
    cell_discharge_A: Array = field(default_factory=_none)  # (cells,) of a string of such cells
    cell_discharge_sigma_A: Array = field(default_factory=_none)
    cell_charge_A: Array = field(default_factory=_none)
    cell_charge_sigma_A: Array = field(default_factory=_none)
