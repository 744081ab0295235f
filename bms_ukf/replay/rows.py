"""Rows of a trace as they come: of one cell, or of a pack what its frames tell of it."""

from __future__ import annotations

import math
from array import array

import numpy as np
from numpy.typing import NDArray

from bms_ukf.records import NAN, Estimate, PerCell, Sample, largest_known, mean_known, smallest_known
from bms_ukf.trace import Trace

COLUMNS = (
    "current_A",
    "voltage_V",
    "temperature_degC",
    "soc",
    "soc_sigma",
    "status",
    "faults",
    "current_bias_A",
    "voltage_pred_V",
    "innovation_V",
    "nis",
    "r0_ohm",
    "soh",
    "soc_low",
    "soc_high",
)


class Rows:
    """What was measured last, and what was estimated. Of a pack mean SoC, largest sigma and NIS, outermost bounds."""

    def __init__(self) -> None:
        self._values, self._t_ns = array("d"), array("q")
        self._current_A = self._voltage_V = self._temperature_degC = NAN
        self._strings_A: NDArray[np.float64] | None = None

    def measured(self, sample: Sample) -> None:
        """Take note of what this one carries."""
        current_A, voltage_V = sample.current_A, mean_known(sample.voltage_V)
        strings_A = sample.string_current_A
        if strings_A is not None:
            held_A = strings_A if self._strings_A is None else np.where(np.isnan(strings_A), self._strings_A, strings_A)
            self._strings_A = held_A.copy()
            current_A = float(held_A.sum())
        temperature_degC = mean_known(sample.temperature_degC)
        if not math.isnan(current_A):
            self._current_A = current_A
        if not math.isnan(voltage_V):
            self._voltage_V = voltage_V
        if not math.isnan(temperature_degC):
            self._temperature_degC = temperature_degC

    def add(self, t_ns: int, estimate: Estimate, soh: float = NAN) -> None:
        """A row; `soh` is the capacity that has been told."""
        nis = estimate.nis
        worst = 0 if isinstance(nis, float) else int(np.argmax(np.nan_to_num(nis, nan=-1.0)))
        self._t_ns.append(t_ns)
        self._values.extend(
            (
                self._current_A,
                self._voltage_V,
                self._temperature_degC,
                mean_known(estimate.soc),
                largest_known(estimate.soc_sigma),
                int(estimate.status),
                int(estimate.faults),
                mean_known(estimate.current_bias_A),
                _of_cell(worst, estimate.voltage_pred_V),
                _of_cell(worst, estimate.innovation_V),
                _of_cell(worst, nis),
                _of_cell(worst, estimate.r0_ohm),
                soh,
                smallest_known(estimate.soc_low),
                largest_known(estimate.soc_high),
            )
        )

    def trace(self) -> Trace:
        """All rows."""
        columns = np.array(self._values).reshape(-1, len(COLUMNS)).T
        return Trace.of(np.array(self._t_ns), dict(zip(COLUMNS, columns, strict=True)))


def _of_cell(k: int, values: PerCell) -> float:
    return values if isinstance(values, float) else float(values[k])
