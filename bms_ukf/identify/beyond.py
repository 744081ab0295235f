"""Rows of the tables beyond the tested temperatures, by Arrhenius, and how much less is known of them.

The tables are held beyond their first and last row. A cell 10 K below its coldest test has half as much resistance
again, so that held tables are sure of a voltage that is wrong.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bms_ukf.cell import ZERO_CELSIUS_K
from bms_ukf.identify import ocv, uncertainty
from bms_ukf.identify.dynamics import Model
from bms_ukf.identify.simulate import KNEE, R0, R0_CHARGE, R1
from bms_ukf.identify.tables import ACTIVATION_K

Array = NDArray[np.float64]

COLD_DEGC, HOT_DEGC = -30.0, 60.0  # where a cell is used
LEAST_K = 5.0  # a row nearer to the tests than this says nothing new
ACTIVATION_SIGMA_K = 1500.0  # of ACTIVATION_K from cell to cell, and of one cell from warm to cold
ACTIVATION_LIMITS_K = (0.0, 9000.0)
MOST_OHM = 9.0  # `CellParams` refuses 10 ohm
TYPICAL_RATE_PER_H = 1 / 3  # current over capacity at which an error of the resistances is weighed
MOST_SCALE = 8.0
MOST_GROWTH = 2.0  # more costs more than it saves: 3 made SoC of an LFP cell three times as wrong, 8 thirty times
UNKNOWN = 0.3  # relative error of a resistance without a stated one


def rows_degC(tested_degC: Array) -> list[float]:
    """Return the temperatures, degC, of the rows that tables of the tested temperatures lack."""
    cold, hot = float(tested_degC[0]), float(tested_degC[-1])
    lacking = [COLD_DEGC] if cold - COLD_DEGC > LEAST_K else []
    return [*lacking, HOT_DEGC] if HOT_DEGC - hot > LEAST_K else lacking


class Extended:
    """Logarithms of a model's tables with rows beyond its tests, shape (channels, temperatures, SoC).

    `source` has the row of the model that each row comes from; `rel_sigma` has, by row, how much less is known of the
    resistances than at that source, relative; `activation_K` has the slope of r0.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        unknowns = model.unknowns
        tested = unknowns.temperature_degC
        self.temperature_degC = np.array(sorted([*tested.tolist(), *rows_degC(tested)]))
        self.source = np.array([int(np.argmin(np.abs(tested - T))) for T in self.temperature_degC])
        self.added = ~np.isin(self.temperature_degC, tested)
        self.rel_sigma = np.zeros(self.temperature_degC.size)
        self.activation_K = np.zeros(self.temperature_degC.size)
        tables = unknowns.tables(model.x)
        self.tables = tables[:, self.source]
        known = uncertainty.tables(model)
        resistances = {R0: "r0_ohm"} | {R1 + 2 * j: f"r{j + 1}_ohm" for j in range(unknowns.structure.pairs)}
        for row in np.flatnonzero(self.added):
            edge = int(self.source[row])
            step = 1 / (self.temperature_degC[row] + ZERO_CELSIUS_K) - 1 / (tested[edge] + ZERO_CELSIUS_K)
            for channel, key in resistances.items():
                slope_K, sigma_K = _activation(tables[channel], known.get(key), tested, edge)
                self.tables[channel, row] += slope_K * step
                if channel == R0:  # as charge transfer has it: the current of the knee goes with 1 / r0
                    self.tables[R0_CHARGE, row] += slope_K * step
                    self.tables[KNEE, row] -= slope_K * step
                    self.activation_K[row], self.rel_sigma[row] = slope_K, abs(sigma_K * step)
        for channel in (R0, R0_CHARGE, *range(R1, tables.shape[0], 2)):
            self.tables[channel] = np.minimum(self.tables[channel], np.log(MOST_OHM))

    def noise(self, noise: dict[str, Any]) -> dict[str, Any]:
        """Return [noise] with rows of `error_scale` by which the interval grows with the distance from the tests."""
        if not self.added.any() or "error_scale" not in noise:
            return noise
        seen_degC, scale = np.array(noise["temperature_degC"]), np.asarray(noise["error_scale"])
        rows = dict(zip(seen_degC.tolist(), scale, strict=True))
        for row in np.flatnonzero(self.added):
            T = float(self.temperature_degC[row])
            nearest = scale[int(np.argmin(np.abs(seen_degC - T)))]
            rows[T] = np.minimum(nearest * self._growth(int(row), noise), MOST_SCALE).round(2)
        temperatures = sorted(rows)
        return noise | {"temperature_degC": temperatures, "error_scale": np.array([rows[T] for T in temperatures])}

    def _growth(self, row: int, noise: dict[str, Any]) -> float:
        """Return by how much the voltage error at a typical current is larger than [noise] says of this row."""
        current_A = TYPICAL_RATE_PER_H * self.model.capacity_Ah
        drops_V = current_A * np.median(np.exp(self.tables[:, row][:, uncertainty.MIDDLE]), axis=1)
        pairs_V = drops_V[R1::2]
        said_V2 = sum(value**2 for key, value in noise.items() if key.endswith("_sigma_V"))
        said_V2 += (noise["r0_rel_sigma"] * drops_V[R0]) ** 2 + noise["rc_rel_sigma"] ** 2 * float(np.sum(pairs_V**2))
        more_V = self.rel_sigma[row] * (drops_V[R0] + float(np.sum(pairs_V)))
        return min(math.hypot(1.0, more_V / math.sqrt(said_V2)), MOST_GROWTH)

    def known(self) -> dict[str, Array]:
        """Return the relative standard errors of `uncertainty.tables`, grown beyond the tests."""
        found = {}
        for key, table in uncertainty.tables(self.model).items():
            grown = self.rel_sigma if key.startswith("r") else np.zeros(self.rel_sigma.size)
            found[key] = np.hypot(table[self.source], grown[:, None])
        return found

    def ocv_sigma_V(self, slow: ocv.Slow) -> Array:
        """Return the standard errors of the OCV rows, V, shape (temperatures, ocv.SOC)."""
        return np.asarray(uncertainty.ocv_V(self.model, slow)[self.source])

    def provenance(self, slow: ocv.Slow) -> dict[str, dict[str, Any]]:
        """Return the sections of errors, the median over 10 to 90 % SoC for each row, and of rows no test has seen."""
        inside = (ocv.SOC >= 0.1) & (ocv.SOC <= 0.9)
        middle = uncertainty.MIDDLE
        found: dict[str, dict[str, Any]] = {
            "provenance.rel_sigma": {k: np.median(v[:, middle], axis=1).round(3) for k, v in self.known().items()},
            "provenance.sigma": {"ocv_mV": np.median(1e3 * self.ocv_sigma_V(slow)[:, inside], axis=1).round(2)},
        }
        if self.added.any():
            found["provenance.arrhenius"] = {
                "temperature_degC": self.temperature_degC[self.added],
                "r0_activation_K": self.activation_K[self.added].round(),
                "r0_rel_sigma": self.rel_sigma[self.added].round(3),
            }
        return found


def _activation(table: Array, sigma: Array | None, tested_degC: Array, edge: int) -> tuple[float, float]:
    """Slope of a table's logarithm over 1/T at its edge, K, and its error: of the tests and of cells in general."""
    if tested_degC.size < 2:
        return ACTIVATION_K, ACTIVATION_SIGMA_K
    next_ = edge + 1 if edge == 0 else edge - 1
    step = 1 / (tested_degC[edge] + ZERO_CELSIUS_K) - 1 / (tested_degC[next_] + ZERO_CELSIUS_K)
    middle = uncertainty.MIDDLE
    seen_K = float(np.median((table[edge] - table[next_])[middle])) / step
    errors = [UNKNOWN if sigma is None else float(np.median(sigma[row, middle])) for row in (edge, next_)]
    own = (step / max(math.hypot(*errors), 1e-6)) ** 2
    general = ACTIVATION_SIGMA_K**-2
    slope_K = (own * seen_K + general * ACTIVATION_K) / (own + general)
    # From warm to cold the slope of one cell changes, too, by about as much as it is known of any.
    return float(np.clip(slope_K, *ACTIVATION_LIMITS_K)), float(
        np.hypot(ACTIVATION_SIGMA_K / 2, (own + general) ** -0.5)
    )
