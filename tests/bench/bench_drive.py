"""The drive that the C kernel and the compiled one are compared on."""

from __future__ import annotations

import numpy as np
import synthetic_cell

from bms_ukf import CellParams, Tuning

STEPS = 2000
# C has no bias state, and no quadrature: the start is never so wide as to need it.
TUNING = Tuning(initial_soc=0.8, initial_soc_sigma=0.01, current_bias=False)


def cell_of(hysteresis: bool) -> CellParams:
    data = synthetic_cell.nonlinear()
    if hysteresis:
        max_V = [[0.020, 0.015, 0.010]]
        data["hysteresis"] = {"soc": [0.0, 0.5, 1.0], "temperature_degC": [25.0], "max_V": max_V, "rate": 20.0}
        data["noise"]["hysteresis_sigma_V"] = 0.003
    return synthetic_cell.cell_of(data)


class Drive:
    """Steps of current and temperature, sampled at 1 s with some faster, coinciding and missing samples.

    Temperature moves by half a kelvin or not at all: the single C cell has no cache of its dynamics.
    """

    def __init__(self, cell: CellParams, cells: int, faults: bool = True) -> None:
        random = np.random.default_rng(1)
        self.dt = np.ones(STEPS)
        self.dt[0] = 0.0
        self.current = np.repeat(random.uniform(-4, 8, STEPS // 20), 20)
        temperature = 25 + np.repeat(random.integers(-10, 10, STEPS // 50) / 2, 50)
        soc = np.clip(0.8 - np.cumsum(self.current) / (3600 * cell.cell.capacity_Ah), 0, 1)
        ocv = [float(cell.ocv_V(*at)) for at in zip(soc, temperature, strict=True)]
        rest = np.array(ocv) - 0.06 * self.current  # r0 is more than the cell file's
        self.voltage = rest[:, None] + random.normal(0, 0.003, (STEPS, cells))
        self.temperature = np.repeat(temperature[:, None], cells, axis=1)
        if faults:
            self.dt[100:200], self.dt[400:410] = 0.1, 0.0
            self.dt[300] = 7.0  # longer than a current counts
            self.voltage[500:520] = np.nan
            self.voltage[600], self.voltage[1300:1320] = (
                self.voltage[600] + 0.5,
                self.voltage[1300:1320] + 0.3,
            )  # refused
            self.current[700:705], self.current[1400:1412] = np.nan, np.nan
            self.temperature[800:900] = np.nan
            self.voltage[1200], self.current[1500], self.temperature[1600] = 9.0, 1e4, 400.0  # implausible

    @property
    def samples(self) -> np.ndarray:
        """(n, 4) of the first cell, as `CKernel.replay` takes them."""
        return np.column_stack([self.dt, self.current, self.voltage[:, 0], self.temperature[:, 0]])

    @property
    def measured(self) -> np.ndarray:
        """(n, 2, cells), as `CKernel.replay_pack` takes them."""
        return np.stack([self.voltage, self.temperature], axis=1)
