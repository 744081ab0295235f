"""A cell: what the estimator knows of one, loaded from a cell file and refused when it cannot be true.

The model is v = ocv(soc, T) - v_rc1 - v_rc2 .. - v_hyst - r0 knee asinh(i / knee), with current i positive on
discharge; `kernel.ecm` has the equations. SoC is the charge above the empty state at 25 degC over the capacity there.
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
Sigma = Annotated[float, Field(gt=0, lt=0.5)]
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
    """[dynamics]: resistances and time constants, one row per temperature, over SoC knots that cover 0..1.

    One to three RC pairs, the faster first.
    """

    soc: Knots
    temperature_degC: Annotated[list[Temperature], Field(min_length=1)]
    r0_ohm: Rows
    r0_charge_ohm: Rows | None = None  # None: as r0_ohm
    r0_knee_A: Rows | None = None  # current above which the drop over r0 grows with the logarithm; None: never
    r1_ohm: Rows
    tau1_s: Rows
    r2_ohm: Rows | None = None
    tau2_s: Rows | None = None
    r3_ohm: Rows | None = None
    tau3_s: Rows | None = None

    @property
    def n_rc(self) -> int:
        """Number of RC pairs."""
        return sum(table is not None for table in (self.r1_ohm, self.r2_ohm, self.r3_ohm))

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        _require_knots(self.soc, "dynamics.soc")
        _require_increasing(self.temperature_degC, "dynamics.temperature_degC")
        for key, (low, high) in _DYNAMICS_RANGES.items():
            table = getattr(self, key)
            if table is None:
                continue
            _require_shape(table, len(self.temperature_degC), len(self.soc), f"dynamics.{key}")
            for value in (value for row in table for value in row):
                _require(low < value < high, f"dynamics.{key} between {low:g} and {high:g}, got {value:g}")
        for j in (2, 3):
            r, tau = getattr(self, f"r{j}_ohm"), getattr(self, f"tau{j}_s")
            _require((r is None) == (tau is None), f"dynamics.r{j}_ohm and dynamics.tau{j}_s together or not at all")
            slower = getattr(self, f"tau{j - 1}_s")
            _require(tau is None or slower is not None, f"dynamics.r{j - 1}_ohm where there is dynamics.r{j}_ohm")
            ordered = tau is None or bool(np.all(np.less(slower, tau)))
            _require(ordered, f"dynamics.tau{j - 1}_s below dynamics.tau{j}_s everywhere")
        return self


_DYNAMICS_RANGES = {
    "r0_ohm": (0.0, 10.0),
    "r0_charge_ohm": (0.0, 10.0),
    "r0_knee_A": (0.0, 1e6),
    "r1_ohm": (0.0, 10.0),
    "tau1_s": (0.01, 1e5),
    "r2_ohm": (0.0, 10.0),
    "tau2_s": (0.01, 1e6),
    "r3_ohm": (0.0, 10.0),
    "tau3_s": (0.01, 1e7),
}
NO_KNEE_A = 1e6  # so far above any current that the drop is linear


class Hysteresis(toml.Section):
    """[hysteresis]: how far [ocv], the mean of both directions, is from the OCV of a long charge or discharge."""

    soc: Knots
    temperature_degC: Annotated[list[Temperature], Field(min_length=1)]
    max_V: Rows  # half the width between the branches
    rate: Annotated[float, Field(gt=0, lt=1e5)]  # approach to a branch, 1 / (SoC moved)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        _require_knots(self.soc, "hysteresis.soc")
        _require_increasing(self.temperature_degC, "hysteresis.temperature_degC")
        _require_shape(self.max_V, len(self.temperature_degC), len(self.soc), "hysteresis.max_V")
        for value in (value for row in self.max_V for value in row):
            _require(0 <= value < 0.5, f"hysteresis.max_V between 0 and 0.5, got {value:g}")
        return self


class Thermal(toml.Section):
    """[thermal]: the temperature the tables are read at, above that of the surface, which is measured.

    Above 0 it is that of a core warmer than the surface; below 0, depletion under load outweighs the warmth.
    """

    core_K_per_W: Annotated[float, Field(gt=-1000, lt=1000)]
    core_tau_s: Annotated[float, Field(gt=0, lt=1e6)]


class Noise(toml.Section):
    """[noise]: how far the model itself is to be trusted, one sigma. It sets the filter's Q and R."""

    voltage_sigma_V: Sigma  # white
    r0_rel_sigma: Annotated[float, Field(ge=0, lt=2)]  # relative: adds |i| r0 of it to the voltage error
    v_rc1_sigma_V: Sigma  # correlated over tau1
    v_rc2_sigma_V: Sigma | None = None  # over tau2, and so on: one for each RC pair
    v_rc3_sigma_V: Sigma | None = None
    rc_rel_sigma: Annotated[float, Field(ge=0, lt=2)]  # relative error of r1..
    hysteresis_sigma_V: Sigma | None = None  # where there is a [hysteresis]
    # Where the model errs more or less than that: a factor on all of it.
    soc: Knots | None = None
    temperature_degC: Annotated[list[Temperature], Field(min_length=1)] | None = None
    error_scale: Rows | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        given = [part is not None for part in (self.soc, self.temperature_degC, self.error_scale)]
        _require(all(given) or not any(given), "noise.soc, temperature_degC and error_scale together or not at all")
        if self.soc is None or self.temperature_degC is None or self.error_scale is None:
            return self
        _require_knots(self.soc, "noise.soc")
        _require_increasing(self.temperature_degC, "noise.temperature_degC")
        _require_shape(self.error_scale, len(self.temperature_degC), len(self.soc), "noise.error_scale")
        for value in (value for row in self.error_scale for value in row):
            _require(0.05 <= value <= 50, f"noise.error_scale between 0.05 and 50, got {value:g}")
        return self


class CellParams(toml.Document):
    """One cell type. Immutable; made by `load`."""

    cell: Limits
    ocv: Ocv
    dynamics: Dynamics
    hysteresis: Hysteresis | None = None
    thermal: Thermal | None = None
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
        for j in (2, 3):
            stated, used = getattr(self.noise, f"v_rc{j}_sigma_V") is not None, j <= self.dynamics.n_rc
            _require(stated == used, f"noise.v_rc{j}_sigma_V where there is dynamics.r{j}_ohm, and only there")
        stated, used = self.noise.hysteresis_sigma_V is not None, self.hysteresis is not None
        _require(stated == used, "noise.hysteresis_sigma_V where there is a [hysteresis], and only there")
        return self

    @classmethod
    def load(cls, cell: str | Path) -> Self:
        """The cell file at a path, or the shipped cell of that name. Raises ConfigError naming file, key and value."""
        return toml.load(resources.find(cell, "cells", ".toml"), cls)

    def ocv_V(self, soc: ArrayLike, temperature_degC: float) -> Array:
        """Open-circuit voltage at SoC in 0..1: PCHIP in SoC; linear in temperature between rows, held beyond."""
        return pchip.interpolate(self.ocv.soc, self._ocv_row(temperature_degC), soc)

    def dynamics_at(self, soc: ArrayLike, temperature_degC: float) -> dict[str, Array]:
        """All that [dynamics], [hysteresis] and [noise] say of SoC in 0..1 at a temperature, in the kernel's order.

        `r0_ohm, r0_charge_ohm, r0_knee_A, error_scale, r1_ohm, tau1_s` and so on, `hysteresis_V` last if there is any.

        Linear in SoC; between temperatures in log over 1/T (Arrhenius), held beyond the first and last.
        """
        dynamics, at = self.dynamics, np.asarray(soc, dtype=float)
        values = {}
        for key in _DYNAMICS_RANGES:
            table = getattr(dynamics, key)
            if table is None and key == "r0_charge_ohm":
                table = dynamics.r0_ohm
            if table is None and key == "r0_knee_A":
                table = np.full_like(dynamics.r0_ohm, NO_KNEE_A)
            if table is not None:
                row = np.exp(_row_at(dynamics.temperature_degC, np.log(table), temperature_degC))
                values[key] = np.interp(at, dynamics.soc, row)
            if key == "r0_knee_A":
                values["error_scale"] = self._error_scale(at, temperature_degC)
        if self.hysteresis is not None:
            row = _row_at(self.hysteresis.temperature_degC, np.array(self.hysteresis.max_V), temperature_degC)
            values["hysteresis_V"] = np.interp(at, self.hysteresis.soc, row)
        return values

    def _error_scale(self, soc: Array, temperature_degC: float) -> Array:
        noise = self.noise
        if noise.soc is None or noise.temperature_degC is None or noise.error_scale is None:
            return np.ones_like(soc)
        row = _row_at(noise.temperature_degC, np.array(noise.error_scale), temperature_degC)
        return np.interp(soc, noise.soc, row)

    def _ocv_row(self, temperature_degC: float) -> Array:
        rows = np.asarray(self.ocv.voltage_V)
        if self.ocv.docv_dT_V_per_K is not None:
            low, high = self.cell.temperature_limits_degC
            warmer = np.clip(temperature_degC, low, high) - self.ocv.temperature_degC[0]
            return np.asarray(rows[0] + warmer * np.asarray(self.ocv.docv_dT_V_per_K))
        return np.array([np.interp(temperature_degC, self.ocv.temperature_degC, column) for column in rows.T])


def _row_at(temperatures: list[float], table: Array, temperature_degC: float) -> Array:
    """The row of a table at a temperature: linear in 1/T, held at the edges."""
    inverse_K = [1 / (T + ZERO_CELSIUS_K) for T in reversed(temperatures)]
    at = 1 / (temperature_degC + ZERO_CELSIUS_K)
    return np.array([np.interp(at, inverse_K, column) for column in table[::-1].T])


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
