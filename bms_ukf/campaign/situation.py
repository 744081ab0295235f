"""One situation: the samples that a vehicle sends, the truth behind them, and the daemon's configuration."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(slots=True)
class Failure:
    """A sensor that fails at `at_s`. `within_s`: limit on the time under load until it is named; None: no limit."""

    sensor: str  # "current" or "voltage": the prefix of the fault bits that name it
    at_s: float
    within_s: float | None = None


@dataclass(slots=True)
class Situation:
    """Rows of one run. A row of NaN in all measured arrays is a silent bus."""

    words: str  # the draw, for people
    plant: str
    cell: str  # cell file
    t_s: Array  # (rows,) increasing, > 0
    current_A: Array  # (rows,) measured, positive = discharge, mean over the interval that ends at t_s
    voltage_V: Array  # (rows, cells) measured
    temperature_degC: Array  # (rows,) measured
    soc: Array  # (rows, cells) true
    loaded: NDArray[np.bool_]  # (rows,) whether a current flows in truth
    true_degC: float  # mean true temperature
    soc_ref_sigma: float = 0.0  # of the truth itself: a recording's reference has one
    tuning: dict[str, Any] = field(default_factory=dict)
    config: dict[str, Any] = field(default_factory=dict)
    failure: Failure | None = None

    @property
    def cells(self) -> int:
        return int(self.voltage_V.shape[1])

    @property
    def silent(self) -> NDArray[np.bool_]:
        """(rows,) True where nothing is sent."""
        missing = np.isnan(self.current_A) & np.isnan(self.temperature_degC)
        return np.asarray(missing & np.isnan(self.voltage_V).all(axis=1))
