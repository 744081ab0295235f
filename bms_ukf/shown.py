"""Copy the kernel's results into an `Estimate`: which rows, and where a SoC is withheld."""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bms_ukf.kernel import layout
from bms_ukf.kernel.step import FAULT_MASK, STATUS_SHIFT
from bms_ukf.records import Estimate, Fault, Status

_STATUS = tuple(Status)
HIDDEN = tuple(status in {Status.INITIALISING, Status.INVALID} for status in Status)  # no SoC that could be shown
_FIRST_SHOWN, _FIRST_INVALID = (status << STATUS_SHIFT for status in (Status.OK, Status.INVALID))  # of a cell's codes
_faults = functools.cache(Fault)  # making one costs more than the filter step

# Fields of an Estimate and their rows of the kernel's `io`.
SHOWN = {
    "soc": layout.OUT_SOC,
    "soc_sigma": layout.OUT_SOC_SIGMA,
    "voltage_pred_V": layout.OUT_VOLTAGE_PRED,
    "innovation_V": layout.OUT_INNOVATION,
    "innovation_var_V2": layout.OUT_INNOVATION_VAR,
    "nis": layout.OUT_NIS,
    "age_s": layout.OUT_AGE,
    "current_bias_A": layout.OUT_BIAS,
    "r0_ohm": layout.OUT_R0,
    "soc_low": layout.OUT_SOC_LOW,
    "soc_high": layout.OUT_SOC_HIGH,
}
SOC_FIELDS = ("soc", "soc_sigma", "soc_low", "soc_high")
_COMPARISON = ("voltage_pred_V", "innovation_V", "innovation_var_V2", "nis")


def blank(cells: int) -> Estimate:
    """An Estimate for the results of `cells` cells."""
    if cells == 1:
        return Estimate()
    return Estimate(**{name: np.full(cells, math.nan) for name in SHOWN})  # type: ignore[arg-type]


def show_cell(row: Any, code: int, estimate: Estimate) -> None:
    """Fill in status, faults and the results of one cell; `row` has a number for each row of `io`."""
    status = code >> STATUS_SHIFT
    estimate.status, estimate.faults = _STATUS[status], _faults(code & FAULT_MASK)
    if HIDDEN[status]:
        estimate.soc = estimate.soc_sigma = estimate.soc_low = estimate.soc_high = math.nan
    else:
        estimate.soc = row[layout.OUT_SOC]
        estimate.soc_sigma = row[layout.OUT_SOC_SIGMA]
        estimate.soc_low = row[layout.OUT_SOC_LOW]
        estimate.soc_high = row[layout.OUT_SOC_HIGH]
    estimate.voltage_pred_V = row[layout.OUT_VOLTAGE_PRED]
    estimate.innovation_V = row[layout.OUT_INNOVATION]
    estimate.innovation_var_V2 = row[layout.OUT_INNOVATION_VAR]
    estimate.nis = row[layout.OUT_NIS]
    estimate.age_s = row[layout.OUT_AGE]
    estimate.current_bias_A = row[layout.OUT_BIAS]
    estimate.r0_ohm = row[layout.OUT_R0]


def show_pack(io: NDArray[Any], code: int, estimate: Estimate) -> None:
    """Fill in status, faults and the results of several cells; `io` has shape (IO_ROWS, cells)."""
    status = code >> STATUS_SHIFT
    estimate.status, estimate.faults = _STATUS[status], _faults(code & FAULT_MASK)
    for name, row in SHOWN.items():
        getattr(estimate, name)[:] = io[row]
    if status != Status.OK:
        codes = io[layout.OUT_CODE]  # NaN before the first step
        shown = (codes >= _FIRST_SHOWN) & (codes < _FIRST_INVALID) & (not HIDDEN[status])
        for name in SOC_FIELDS:
            getattr(estimate, name)[~shown] = math.nan


def clear_comparison(estimate: Estimate) -> None:
    """Set what the last voltage was compared with to NaN, so that no comparison counts twice."""
    for name in _COMPARISON:
        if isinstance(estimate.soc, float):
            setattr(estimate, name, math.nan)
        else:
            getattr(estimate, name)[:] = math.nan
