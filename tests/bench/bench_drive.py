"""The drive that the C kernel and the compiled one are compared on."""

from __future__ import annotations

import numpy as np
import synthetic_cell
from numpy.typing import NDArray

from bms_ukf import CellParams, Estimator, Tuning
from bms_ukf.kernel import layout

Array = NDArray[np.floating]

STEPS = 2000
WARM_UP = 1000  # steps after which the belief of every cell is one Gaussian: C has no components
TUNING = Tuning(initial_soc=0.8, initial_soc_sigma=0.01)


def cell_of(hysteresis: bool) -> CellParams:
    data = synthetic_cell.nonlinear()
    if hysteresis:
        max_V = [[0.020, 0.015, 0.010]]
        data["hysteresis"] = {"soc": [0.0, 0.5, 1.0], "temperature_degC": [25.0], "max_V": max_V, "rate": 20.0}
        data["noise"]["hysteresis_sigma_V"] = 0.003
    return synthetic_cell.cell_of(data)


def tick(estimator: Estimator, dt: float, current: float, voltage: Array, temperature: Array) -> int:
    """A tick as C has it: without what `Estimator.step` does for the cells of a string together. Returns its code."""
    estimator._io[layout.IN_VOLTAGE], estimator._io[layout.IN_TEMPERATURE] = voltage, temperature
    return estimator._tick(*estimator._addresses, float(dt), float(current))


class Drive:
    """Steps of current and temperature, sampled at 1 s with some faster, coinciding and missing samples.

    Two rests show the same offset. Temperature moves by half a kelvin or not at all: the single C cell has no cache of
    its dynamics.
    """

    def __init__(self, cell: CellParams, cells: int, faults: bool = True) -> None:
        random = np.random.default_rng(1)
        count = WARM_UP + STEPS
        current = np.repeat(random.uniform(-4, 8, count // 20), 20)
        for rest in (1000, 1640):
            current[WARM_UP + rest : WARM_UP + rest + 140] = 0.02
        temperature = 25 + np.repeat(random.integers(-10, 10, count // 50) / 2, 50)
        soc = np.clip(0.8 - np.cumsum(current) / (3600 * cell.cell.capacity_Ah), 0, 1)
        ocv = [float(cell.ocv_V(*at)) for at in zip(soc, temperature, strict=True)]
        rest_V = np.array(ocv) - 0.06 * current  # r0 is more than the cell file's
        voltage = rest_V[:, None] + random.normal(0, 0.003, (count, cells))
        temperatures = np.repeat(temperature[:, None], cells, axis=1)
        self._before = list(zip(current[:WARM_UP], voltage[:WARM_UP], temperatures[:WARM_UP], strict=True))
        self.dt = np.ones(STEPS)
        self.current, self.voltage, self.temperature = current[WARM_UP:], voltage[WARM_UP:], temperatures[WARM_UP:]
        if faults:
            self.dt[100:200], self.dt[400:410] = 0.1, 0.0
            self.dt[300] = 7.0  # longer than a current counts
            self.voltage[250:260] = self.voltage[250]
            self.voltage[500:520] = np.nan
            self.voltage[600], self.voltage[1300:1320] = (
                self.voltage[600] + 0.5,
                self.voltage[1300:1320] + 0.3,
            )  # refused
            self.current[700:705], self.current[1400:1412] = np.nan, np.nan
            self.temperature[800:900] = np.nan
            self.voltage[1200], self.current[1500], self.temperature[1600] = 9.0, 1e4, 400.0  # implausible

    def begin(self, estimator: Estimator) -> None:
        """Let a new `estimator` of these cells run up to the first step."""
        for k, (current, voltage, temperature) in enumerate(self._before):
            tick(estimator, min(k, 1), current, voltage, temperature)

    @property
    def samples(self) -> Array:
        """(n, 4) of the first cell, as `CKernel.replay` takes them."""
        return np.column_stack([self.dt, self.current, self.voltage[:, 0], self.temperature[:, 0]])

    @property
    def measured(self) -> Array:
        """(n, 2, cells), as `CKernel.replay_pack` takes them."""
        return np.stack([self.voltage, self.temperature], axis=1)
