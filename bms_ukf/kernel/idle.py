"""A tick of the instant before that brings nothing to a block of cells: what it leaves, without a filter step.

A pack's voltages come on the bus a few cells at a time. What flowed is accounted for with the first of them, so for the
blocks that the others do not measure, a step would load, copy and store only.
"""

from __future__ import annotations

import math
from typing import Any

from bms_ukf.kernel import layout as k
from bms_ukf.kernel.ecm import is_number
from bms_ukf.kernel.jit import inline
from bms_ukf.kernel.memory import real


@inline
def has_news(io: Any, first: int, rows: int, lanes: int, shown: Any) -> int:
    """Whether a lane was measured in any way, or showed anything but the code `shown`, which a step might take back."""
    news = 0
    for c in range(lanes):
        at = first + c
        news |= 1 if is_number(io[rows * k.IN_VOLTAGE + at]) | is_number(io[rows * k.IN_TEMPERATURE + at]) else 0
        news |= 1 if is_number(io[rows * k.IN_CURRENT + at]) | is_number(io[rows * k.IN_OFFSET + at]) else 0
        news |= 0 if io[rows * k.OUT_CODE + at] == shown else 1
    return news


@inline
def compare_nothing(io: Any, first: int, rows: int, lanes: int) -> None:
    """The results of a block that stays as it is: no voltage was compared."""
    nan = real(io, math.nan)
    for c in range(lanes):
        io[rows * k.OUT_VOLTAGE_PRED + first + c] = nan
    for c in range(lanes):
        io[rows * k.OUT_INNOVATION + first + c] = nan
    for c in range(lanes):
        io[rows * k.OUT_INNOVATION_VAR + first + c] = nan
    for c in range(lanes):
        io[rows * k.OUT_NIS + first + c] = nan
