"""What an estimator is given of a recording: its signals, with or without errors, and what it is told of SoC."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bms_ukf.recordings import Recording

Array = NDArray[np.float64]


@dataclass(slots=True, frozen=True)
class Told:
    """SoC before the first sample, 0..1, and its standard deviation."""

    soc: float
    sigma: float


@dataclass(slots=True, frozen=True)
class Signals:
    """Arrays of shape (n,). Row k's current, positive = discharge, is the mean over (t[k-1], t[k]]; NaN: missing."""

    time_s: Array  # increasing
    current_A: Array
    voltage_V: Array
    temperature_degC: Array

    @classmethod
    def of(cls, recording: Recording) -> Signals:
        return cls(recording.time_s, recording.current_A, recording.voltage_V, recording.temperature_degC)

    @property
    def step_s(self) -> Array:
        """Length of the interval that ends at each row; 0 at the first."""
        return np.diff(self.time_s, prepend=self.time_s[:1])

    @property
    def t_ns(self) -> NDArray[np.int64]:
        return np.round(self.time_s * 1e9).astype(np.int64)

    def since(self, row: int) -> Signals:
        """From a row on."""
        kept = slice(row, None)
        return Signals(self.time_s[kept], self.current_A[kept], self.voltage_V[kept], self.temperature_degC[kept])

    def with_errors(
        self, current_offset_A: float = 0.0, current_gain: float = 1.0, voltage_offset_V: float = 0.0
    ) -> Signals:
        """The signals as faulty sensors would show them."""
        current_A = current_gain * self.current_A + current_offset_A
        return replace(self, current_A=current_A, voltage_V=self.voltage_V + voltage_offset_V)

    def rows(self, kept: slice) -> Signals:
        return Signals(self.time_s[kept], self.current_A[kept], self.voltage_V[kept], self.temperature_degC[kept])
