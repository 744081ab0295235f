"""A cell file's own prediction of a test: the voltage from the current alone, from a known SoC, without any filter.

What is judged here is the cell file as it stands, read by `CellParams` and looked up on the grid the estimator uses,
not the unknowns it came from.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bms_ukf import pchip
from bms_ukf.cell import NO_KNEE_A, ZERO_CELSIUS_K, CellParams
from bms_ukf.identify.samples import Samples
from bms_ukf.identify.simulate import HYSTERESIS, KNEE, R0, R0_CHARGE, R1, Place, between, drop, lowpass

Array = NDArray[np.float64]


@dataclass(slots=True)
class Prediction:
    """What a cell file says of a test; arrays of shape (n,), and one row of `r_ohm` and `tau_s` for each pair."""

    name: str
    step_s: Array
    current_A: Array
    temperature_degC: Array
    soc: Array
    counted: NDArray[np.bool_]
    measured_V: Array
    predicted_V: Array
    ohmic_V: Array
    r_ohm: list[Array]
    tau_s: list[Array]

    @property
    def error_V(self) -> Array:
        """Predicted minus measured."""
        return self.predicted_V - self.measured_V

    def rmse_V(self, low: float = 0.1, high: float = 0.9) -> float:
        """Root mean square error over the counted rows between two SoC; NaN if there are none."""
        rows = self.counted & (self.soc > low) & (self.soc < high)
        return float(np.sqrt(np.mean(self.error_V[rows] ** 2))) if rows.any() else float("nan")


def predict(cell: CellParams, test: Samples) -> Prediction:
    """Open loop over a test with the SoC it counts, from rest."""
    temperature_degC = test.temperature_degC
    if cell.thermal is not None:
        heat_W = test.current_A * (ocv_V(cell, test.soc, temperature_degC) - test.voltage_V)
        rise_K = cell.thermal.core_K_per_W * lowpass(test.step_s, heat_W, cell.thermal.core_tau_s)
        temperature_degC = temperature_degC + rise_K
    soc, rows = _grid(cell)
    tables = _tables(cell, soc, rows)
    inverse_K = -1 / (rows + ZERO_CELSIUS_K)
    place = Place(*between(-1 / (temperature_degC + ZERO_CELSIUS_K), inverse_K), *between(test.soc, soc))
    rate = 0.0 if cell.hysteresis is None else cell.hysteresis.rate / (3600 * cell.cell.capacity_Ah)
    below_V = np.empty(test.soc.size)
    nothing = np.empty((0, tables.size + 1))
    drop(test.step_s, test.current_A, test.current_at_end_A, place, tables, rate, 1, below_V, nothing)

    def looked_up(channel: int) -> Array:
        corners = np.zeros(test.soc.size)
        for g, u in ((0, 1 - place.soc_part), (1, place.soc_part)):
            cold = tables[channel, place.temperature, place.soc + g]
            warm = tables[channel, place.temperature + 1, place.soc + g]
            corners += u * np.exp(cold + place.temperature_part * (warm - cold))
        return corners

    r0 = np.where(test.current_at_end_A < 0, looked_up(R0_CHARGE), looked_up(R0))
    knee = looked_up(KNEE)
    return Prediction(
        name=test.name,
        step_s=test.step_s,
        current_A=test.current_A,
        temperature_degC=test.temperature_degC,
        soc=test.soc,
        counted=test.counted,
        measured_V=test.voltage_V,
        predicted_V=ocv_V(cell, test.soc, temperature_degC) - below_V,
        ohmic_V=r0 * knee * np.arcsinh(test.current_at_end_A / knee),
        r_ohm=[looked_up(R1 + 2 * j) for j in range(cell.dynamics.n_rc)],
        tau_s=[looked_up(R1 + 2 * j + 1) for j in range(cell.dynamics.n_rc)],
    )


def ocv_V(cell: CellParams, soc: Array, temperature_degC: Array) -> Array:
    """Open-circuit voltage at every row; SoC and temperature held at the edges of the table."""
    rows = np.array(cell.ocv.temperature_degC)
    soc = np.clip(soc, cell.ocv.soc[0], cell.ocv.soc[-1])
    curves = np.array([pchip.interpolate(cell.ocv.soc, row, soc) for row in cell.ocv.voltage_V])
    if rows.size == 1:
        slope = cell.ocv.docv_dT_V_per_K
        entropic = 0.0 if slope is None else np.interp(soc, cell.ocv.soc, slope) * (temperature_degC - rows[0])
        return np.asarray(curves[0] + entropic)
    left, part = between(temperature_degC, rows)
    every = np.arange(soc.size)
    return np.asarray((1 - part) * curves[left, every] + part * curves[left + 1, every])


def _grid(cell: CellParams) -> tuple[Array, Array]:
    """SoC and temperature knots of all tables of the dynamics together."""
    soc, temperatures = set(cell.dynamics.soc), set(cell.dynamics.temperature_degC)
    if cell.hysteresis is not None:
        soc |= set(cell.hysteresis.soc)
        temperatures |= set(cell.hysteresis.temperature_degC)
    if len(temperatures) == 1:
        temperatures |= {max(temperatures) + 1.0}
    return np.array(sorted(soc)), np.array(sorted(temperatures))


def _tables(cell: CellParams, soc: Array, rows: Array) -> Array:
    """Logarithms of the tables on a grid, shape (channels, temperatures, soc)."""
    tables = np.zeros((R1 + 2 * cell.dynamics.n_rc, rows.size, soc.size))
    for row, temperature in enumerate(rows):
        values = cell.dynamics_at(soc, float(temperature))
        tables[R0, row] = np.log(values["r0_ohm"])
        tables[R0_CHARGE, row] = np.log(values.get("r0_charge_ohm", values["r0_ohm"]))
        tables[KNEE, row] = np.log(values.get("r0_knee_A", np.full(soc.size, NO_KNEE_A)))
        if cell.hysteresis is not None:
            tables[HYSTERESIS, row] = np.log(np.maximum(values["hysteresis_V"], 1e-9))
        for j in range(cell.dynamics.n_rc):
            tables[R1 + 2 * j, row] = np.log(values[f"r{j + 1}_ohm"])
            tables[R1 + 2 * j + 1, row] = np.log(values[f"tau{j + 1}_s"])
    return tables
