"""What flows through the estimator: a `Sample` goes in, an `Estimate` comes out, and nothing else joins the two sides.

Sign: current is positive on discharge. Time is integer nanoseconds of whatever clock stamped the data (frames, plant,
file); only differences matter. NaN means "not measured", never 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, IntFlag

import numpy as np
from numpy.typing import NDArray

NAN = float("nan")

PerCell = float | NDArray[np.float64]


class Status(IntEnum):
    """How far an estimate is to be trusted. The same numbers in the DBC, the FMU and the C header."""

    INITIALISING = 0  # not every signal has been seen yet: SoC is not available
    OK = 1  # no fault, and the interval is no wider than ok_half_width allows
    DEGRADED = 2  # a SoC with its interval, but a fault is set
    INVALID = 3  # the interval is wider than invalid_half_width allows: SoC is not available

    @property
    def word(self) -> str:
        return self.name.lower()


class Source(IntEnum):
    """What the SoC was last corrected by."""

    NONE = 0  # nothing: it is not known
    STORED = 1  # what was known before a restart
    START = 2  # the first voltage
    VOLTAGE = 3  # a voltage under load
    REST = 4  # the voltage of a cell that has rested

    @property
    def word(self) -> str:
        return self.name.lower()


class Stored(IntEnum):
    """What became, at the start, of the belief stored before it."""

    NONE = 0  # there was none
    USED = 1
    FOREIGN = 2  # refused: of another cell file, tuning, number of cells or version
    CORRUPT = 3  # refused: damaged, or something else
    FUTURE = 4  # refused: younger than the present, so the wall clock was set back
    STALE = 5  # refused: too old
    UNREADABLE = 6

    @property
    def word(self) -> str:
        return self.name.lower()


class Fault(IntFlag):
    """Why a status is not `OK`. The same bits in the kernel's return value, the DBC, the FMU and the C header."""

    NONE = 0
    CURRENT_MISSING = 1 << 0  # none for longer than current_timeout_s: no charge is counted
    VOLTAGE_MISSING = 1 << 1  # none for longer than voltage_timeout_s
    TEMPERATURE_MISSING = 1 << 2  # none for longer than temperature_timeout_s: the last one is held
    CURRENT_IMPLAUSIBLE = 1 << 3  # outside the plausible range, ignored
    VOLTAGE_IMPLAUSIBLE = 1 << 4
    TEMPERATURE_IMPLAUSIBLE = 1 << 5
    INNOVATION_REJECTED = 1 << 6  # the voltage was too far from its prediction, not fused
    TIME_REVERSED = 1 << 7  # stamped before the previous sample: refused whole
    NUMERIC = 1 << 8  # a step gave a value that is not finite: refused whole, state kept
    OUT_OF_TABLE = 1 << 9  # SoC or temperature beyond the cell file's tables: extrapolated
    E2E = 1 << 10  # frames refused for length, counter or CRC
    BUS = 1 << 11  # frames lost, or not sent
    CURRENT_SIGN = 1 << 12  # voltage rises with the current: the sign of one of them is wrong
    CURRENT_SCALE = 1 << 13  # voltage steps are far from what the current's steps and the cell's resistance explain
    UNCERTAIN = 1 << 14  # the interval of SoC is wider than ok allows, or contradicts an earlier one
    CURRENT_FAILED = 1 << 15  # the current sensor reads a value that the voltage contradicts: dead, stuck or clipped


@dataclass(slots=True)
class Sample:
    """One set of measurements at `t_ns`; any of them may be missing (NaN), and those are predicted or held.

    `current_A` is the mean over the interval that ends at `t_ns`, so it moves the charge of that interval.
    """

    t_ns: int
    current_A: float = NAN  # positive = discharge
    voltage_V: PerCell = NAN  # cell terminal voltage; array of shape (cells,) for a pack
    temperature_degC: PerCell = NAN  # array of shape (cells,), or (sensors,) where a `Wiring` says whose they are
    open_circuit: bool = False  # the contactor is known to be open: nothing flows, `current_A` is the sensor's offset
    string_current_A: NDArray[np.float64] | None = None  # (strings,) in place of `current_A`, by a `Wiring`; or none
    bleed_A: NDArray[np.float64] | None = None  # (cells,) what balancing takes, as `Estimator.bleed_A`; None: as before

    @property
    def currents_A(self) -> PerCell:
        """What was measured of the current: of several strings an array of shape (strings,)."""
        return self.current_A if self.string_current_A is None else self.string_current_A


@dataclass(slots=True)
class Detail:
    """What is told on the bus of an estimate beyond it; of a pack, of its mean cell."""

    soc_slewed: float = NAN  # 0..1, follows the SoC without steps; NaN where that is not available
    source: Source = Source.NONE
    current_bias_A: float = NAN  # what the current sensor shows too much, positive = discharge; NaN: not known
    stored: Stored = Stored.NONE


@dataclass(slots=True)
class Estimate:
    """What is known after a sample. For a pack every `PerCell` field is an array of shape (cells,)."""

    t_ns: int = 0
    soc: PerCell = NAN  # 0..1, mean of the posterior truncated to 0..1; NaN while initialising or invalid
    soc_sigma: PerCell = NAN  # (soc_high - soc_low) / 3.92
    voltage_pred_V: PerCell = NAN  # predicted before the voltage was fused
    innovation_V: PerCell = NAN  # measured minus predicted; NaN if no voltage came
    innovation_var_V2: PerCell = NAN
    nis: PerCell = NAN  # innovation^2 / innovation_var: chi-square, 1 degree of freedom, if the model is right
    age_s: PerCell = NAN  # time since a voltage was last fused
    status: Status = Status.INITIALISING
    faults: Fault = Fault.NONE
    current_bias_A: PerCell = NAN  # what the current sensor shows too much, positive = discharge; NaN: not estimated
    r0_ohm: PerCell = NAN  # ohmic resistance in the direction of the current, as tracked
    soc_low: PerCell = NAN  # 2.5 % quantile of SoC, 0..1; NaN where `soc` is
    soc_high: PerCell = NAN  # 97.5 % quantile


def mean_known(values: PerCell) -> float:
    """Over those cells that are not NaN, and NaN without any."""
    if isinstance(values, float):
        return values
    known = values[~np.isnan(values)]
    return float(known.mean()) if known.size else NAN


def largest_known(values: PerCell) -> float:
    """Of those cells that are not NaN, and NaN without any."""
    return values if isinstance(values, float) else float(np.fmax.reduce(values))


def smallest_known(values: PerCell) -> float:
    """Return the smallest of the cells that are not NaN, and NaN without any."""
    return values if isinstance(values, float) else float(np.fmin.reduce(values))
