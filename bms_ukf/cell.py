"""A cell: what the estimator knows of one, loaded from a cell file and refused when it cannot be true.

The model is v = ocv(soc, T) - v_rc1 - v_rc2 - r0 knee asinh(i / knee), with current i positive on discharge;
`kernel.ecm` has the equations. SoC is the charge above the empty state at 25 degC over the capacity at 25 degC.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from bms_ukf import pchip, resources, toml

Array = NDArray[np.float64]
Temperature = Annotated[float, Field(ge=-60, le=120)]
Knots = Annotated[list[float], Field(min_length=2, max_length=1001)]
Rows = Annotated[list[list[float]], Field(min_length=1)]
ZERO_CELSIUS_K = 273.15


class Limits(toml.Section):
    """[cell]: what the cell is, and where it may be used."""

    name: Annotated[str, Field(min_length=1)]
    chemistry: str
    capacity_Ah: Annotated[float, Field(gt=0, le=2000)]
    coulombic_efficiency: Annotated[float, Field(gt=0.9, le=1)] = 1.0
    voltage_limits_V: Annotated[list[Annotated[float, Field(gt=0.5, lt=6)]], Field(min_length=2, max_length=2)]
    current_limits_A: Annotated[list[float], Field(min_length=2, max_length=2)]  # [charge < 0, discharge > 0]
    temperature_limits_degC: Annotated[list[Temperature], Field(min_length=2, max_length=2)]

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for key in ("voltage_limits_V", "temperature_limits_degC"):
            low, high = getattr(self, key)
            _require(low < high, f"{key} as [lower, upper]")
        charge, discharge = self.current_limits_A
        _require(charge < 0 < discharge, "current_limits_A as [charge < 0, discharge > 0], A")
        return self


class Ocv(toml.Section):
    """[ocv]: open-circuit voltage, one row per temperature, over SoC knots that cover 0..1."""

    temperature_degC: Annotated[list[Temperature], Field(min_length=1)]
    soc: Knots
    voltage_V: Rows
    docv_dT_V_per_K: list[Annotated[float, Field(gt=-0.01, lt=0.01)]] | None = None  # with a single row only

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        _require_knots(self.soc, "ocv.soc")
        _require_increasing(self.temperature_degC, "ocv.temperature_degC")
        _require_shape(self.voltage_V, len(self.temperature_degC), len(self.soc), "ocv.voltage_V")
        for row in self.voltage_V:
            _require_increasing(row, "ocv.voltage_V", "with SoC")
            _require(row[0] > 0.5 and row[-1] < 6, "ocv.voltage_V in volts per cell, 0.5..6")
        if self.docv_dT_V_per_K is not None:
            _require(len(self.temperature_degC) == 1, "docv_dT_V_per_K only with a single ocv.temperature_degC")
            _require(len(self.docv_dT_V_per_K) == len(self.soc), "one docv_dT_V_per_K per ocv.soc")
        return self


class Dynamics(toml.Section):
    """[dynamics]: resistances and time constants, one row per temperature, over SoC knots that cover 0..1."""

    soc: Knots
    temperature_degC: Annotated[list[Temperature], Field(min_length=1)]
    r0_ohm: Rows
    r1_ohm: Rows
    tau1_s: Rows
    r2_ohm: Rows
    tau2_s: Rows
    r0_knee_A: Rows | None = None  # current above which the drop over r0 grows with the logarithm; None: never

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        _require_knots(self.soc, "dynamics.soc")
        _require_increasing(self.temperature_degC, "dynamics.temperature_degC")
        for key, low, high in _DYNAMICS_RANGES:
            table = getattr(self, key)
            if table is None:
                continue
            _require_shape(table, len(self.temperature_degC), len(self.soc), f"dynamics.{key}")
            for value in (value for row in table for value in row):
                _require(low < value < high, f"dynamics.{key} between {low:g} and {high:g}, got {value:g}")
        _require(bool(np.all(np.less(self.tau1_s, self.tau2_s))), "dynamics.tau1_s below dynamics.tau2_s everywhere")
        return self


_DYNAMICS_RANGES = (
    ("r0_ohm", 0.0, 10.0),
    ("r1_ohm", 0.0, 10.0),
    ("tau1_s", 0.01, 1e5),
    ("r2_ohm", 0.0, 10.0),
    ("tau2_s", 0.01, 1e6),
    ("r0_knee_A", 0.0, 1e6),
)
NO_KNEE_A = 1e6  # so far above any current that the drop is linear


class Noise(toml.Section):
    """[noise]: how far the model itself is to be trusted, one sigma. It sets the filter's Q and R."""

    voltage_sigma_V: Annotated[float, Field(gt=0, lt=0.5)]  # white
    r0_rel_sigma: Annotated[float, Field(ge=0, lt=2)]  # relative: adds |i| r0 of it to the voltage error
    v_rc1_sigma_V: Annotated[float, Field(gt=0, lt=0.5)]  # correlated over tau1
    v_rc2_sigma_V: Annotated[float, Field(gt=0, lt=0.5)]  # correlated over tau2
    rc_rel_sigma: Annotated[float, Field(ge=0, lt=2)]  # relative error of r1 and r2


class CellParams(toml.Document):
    """One cell type. Immutable; made by `load`."""

    cell: Limits
    ocv: Ocv
    dynamics: Dynamics
    noise: Noise
    provenance: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _possible(self) -> Self:
        low, high = self.cell.voltage_limits_V
        for row in self.ocv.voltage_V:
            inside = low - 0.3 < row[0] and row[-1] < high + 0.3
            _require(inside, f"ocv.voltage_V near cell.voltage_limits_V, got {row[0]:g}..{row[-1]:g} V")
        for temperature in self.cell.temperature_limits_degC:
            row = list(self._ocv_row(temperature))
            _require_increasing(row, "ocv", f"with SoC at {temperature:g} degC, after docv_dT_V_per_K")
        return self

    @classmethod
    def load(cls, cell: str | Path) -> Self:
        """The cell file at a path, or the shipped cell of that name. Raises ConfigError naming file, key and value."""
        return toml.load(resources.find(cell, "cells", ".toml"), cls)

    def ocv_V(self, soc: ArrayLike, temperature_degC: float) -> Array:
        """Open-circuit voltage at SoC in 0..1: PCHIP in SoC; linear in temperature between rows, held beyond."""
        return pchip.interpolate(self.ocv.soc, self._ocv_row(temperature_degC), soc)

    def dynamics_at(self, soc: ArrayLike, temperature_degC: float) -> dict[str, Array]:
        """`r0_ohm, r1_ohm, tau1_s, r2_ohm, tau2_s, r0_knee_A` at SoC values in 0..1.

        Linear in SoC; between temperatures in log over 1/T (Arrhenius), held beyond the first and last.
        """
        inverse_K = [1 / (T + ZERO_CELSIUS_K) for T in reversed(self.dynamics.temperature_degC)]
        at = 1 / (temperature_degC + ZERO_CELSIUS_K)
        values = {}
        for key, _, _ in _DYNAMICS_RANGES:
            table = getattr(self.dynamics, key)
            if table is None:
                table = np.full_like(self.dynamics.r0_ohm, NO_KNEE_A)
            log_rows = np.log(table)[::-1]
            row = np.exp([np.interp(at, inverse_K, column) for column in log_rows.T])
            values[key] = np.interp(np.asarray(soc, dtype=float), self.dynamics.soc, row)
        return values

    def _ocv_row(self, temperature_degC: float) -> Array:
        rows = np.asarray(self.ocv.voltage_V)
        if self.ocv.docv_dT_V_per_K is not None:
            low, high = self.cell.temperature_limits_degC
            warmer = np.clip(temperature_degC, low, high) - self.ocv.temperature_degC[0]
            return np.asarray(rows[0] + warmer * np.asarray(self.ocv.docv_dT_V_per_K))
        return np.array([np.interp(temperature_degC, self.ocv.temperature_degC, column) for column in rows.T])


def _require(condition: bool, expected: str) -> None:
    if not condition:
        raise ValueError(expected)


def _require_increasing(values: list[float], key: str, along: str = "") -> None:
    for k, (left, right) in enumerate(pairwise(values)):
        _require(
            left < right, f"{key} strictly increasing {along}, but entry {k} is {left:g} and entry {k + 1} is {right:g}"
        )


def _require_knots(soc: list[float], key: str) -> None:
    _require_increasing(soc, key)
    _require(soc[0] <= 0 and soc[-1] >= 1 and soc[0] > -0.5 and soc[-1] < 1.5, f"{key} as fractions that cover 0..1")


def _require_shape(table: list[list[float]], rows: int, columns: int, key: str) -> None:
    shape_ok = len(table) == rows and all(len(row) == columns for row in table)
    _require(shape_ok, f"{key} as {rows} rows (temperatures) of {columns} numbers (SoC)")
