"""A recording on an even grid of time, with all of its charge: what a measurement at another rate would have shown."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bms_ukf.recordings.recording import Recording

Array = NDArray[np.float64]


def resample(recording: Recording, step_s: float) -> Recording:
    """The recording at its first time and every `step_s` > 0 after it: means over the interval that ends at each row.

    The current is the charge of the interval over its length, whatever the rows of the recording are, so none is lost.
    Voltage and temperature are means of the rows in it: voltage is NaN where there is none, temperature is held. The
    reference SoC is that at the row's time.
    """
    rows = int(np.floor((recording.time_s[-1] - recording.time_s[0]) / step_s + 1e-9)) + 1
    time_s = recording.time_s[0] + step_s * np.arange(rows)
    charge_As = np.interp(time_s, recording.time_s, np.cumsum(recording.current_A * recording.step_s))
    current_A = np.diff(charge_As, prepend=0.0) / step_s
    current_A[0] = recording.current_A[0]
    # The row whose interval holds each of the recording's; rounding of times must not move one across a border.
    row = np.ceil((recording.time_s - recording.time_s[0]) / step_s - 1e-6).astype(np.int64)
    inside = row < rows
    count = np.bincount(row[inside], minlength=rows)

    def mean(column: Array) -> Array:
        total = np.bincount(row[inside], weights=column[inside], minlength=rows)
        return np.where(count > 0, total / np.maximum(count, 1), np.nan)

    soc_ref = recording.soc_ref
    return Recording(
        recording.name,
        time_s,
        current_A,
        mean(recording.voltage_V),
        _held(mean(recording.temperature_degC)),
        np.interp(time_s, recording.time_s, recording.drawn_Ah),
        None if soc_ref is None else np.interp(time_s, recording.time_s, soc_ref),
        recording.warnings,
    )


def _held(column: Array) -> Array:
    """Each NaN replaced by the number before it; the first is one."""
    return column[np.maximum.accumulate(np.where(np.isfinite(column), np.arange(column.size), 0))]
