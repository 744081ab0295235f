"""Which rows of a trace are rest, drive, constant load or charge: where a situation may be cut.

Times are seconds up to and including a row, 0 where the state does not hold. A trace starts at equilibrium, so a
rest that begins with it has lasted for ever.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bms_ukf.campaign import library

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

REST_C = 0.002  # a smaller current is a rest, C
LOAD_C = 0.04  # a larger one is a load
STEADY_C = 0.005  # change from row to row of a constant current; a CV phase decays more slowly
UNSTEADY_C = 0.03  # standard deviation over WINDOW_S of a drive
WINDOW_S = 120.0


class Spans(NamedTuple):
    """Of a trace: seconds in each state, (rows,)."""

    rested_s: Array
    loaded_s: Array  # constant discharge
    charged_s: Array  # constant current or voltage
    driven_s: Array
    resting_s: Array  # rest from this row on


@lru_cache(maxsize=256)
def of(name: str) -> Spans:
    """Return the spans of the trace of that name."""
    trace = library.load(name)
    current_C = trace.current_A / float(trace.capacity_Ah.mean())
    rest = np.abs(current_C) < REST_C
    steady = np.abs(np.diff(current_C, prepend=current_C[:1])) < STEADY_C
    rested_s = _lasting(rest, trace.step_s)
    rested_s[: int(np.argmin(rest)) if not rest.all() else rest.size] = np.inf
    return Spans(
        rested_s,
        _lasting(steady & (current_C > LOAD_C), trace.step_s),
        _lasting(steady & (current_C < -LOAD_C), trace.step_s),
        _lasting(_unsteady(current_C, trace.step_s), trace.step_s),
        _lasting(rest[::-1], trace.step_s)[::-1],
    )


def _lasting(holds: Mask, step_s: float) -> Array:
    """Return for how long `holds` has been true without a break, in seconds."""
    rows = np.arange(1, holds.size + 1)
    return np.asarray((rows - np.maximum.accumulate(np.where(holds, 0, rows))) * step_s)


def _unsteady(current_C: Array, step_s: float) -> Mask:
    """Return the rows with a current that varied over the last WINDOW_S and flowed in the last quarter of that."""
    rows = max(round(WINDOW_S / step_s), 2)

    def mean(values: Array, over: int) -> Array:
        total = np.concatenate([np.zeros(over), np.cumsum(values)])
        return np.asarray((total[over:] - total[:-over]) / over)

    variance = mean(current_C**2, rows) - mean(current_C, rows) ** 2
    flowed = mean(np.abs(current_C), max(rows // 4, 1)) > REST_C
    return np.asarray((variance > UNSTEADY_C**2) & flowed)
