"""Writes a cell and a tuning into the kernel's `params` buffer."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bms_ukf import pchip
from bms_ukf.cell import CellParams
from bms_ukf.kernel import layout as k
from bms_ukf.kernel.entry import N
from bms_ukf.tuning import Tuning

Array = NDArray[np.float64]

# The kernel's tables are uniform, so that finding an interval is a multiplication.
OCV_INTERVALS = 200
DYN_INTERVALS = 40
TEMPERATURE_STEP_K = 5.0
SOC_SIGMA_MAX = 0.5  # of a quantity between 0 and 1: more says nothing


def params(cell: CellParams, tuning: Tuning) -> Array:
    """The `params` buffer, 64-byte aligned, for `kernel.entry`."""
    ocv, ocv_grid = _ocv_table(cell)
    dyn, dyn_grid = _dynamics_table(cell)
    p = aligned(k.PARAMS_HEADER + ocv.size + dyn.size)
    _write_cell(p, cell, tuning)
    _write_tuning(p, cell, tuning)
    _write_table(p, k.P_OCV, k.PARAMS_HEADER, ocv, ocv_grid, OCV_INTERVALS)
    _write_table(p, k.P_DYN, k.PARAMS_HEADER + ocv.size, dyn, dyn_grid, DYN_INTERVALS)
    return p


def aligned(size: int) -> Array:
    """A float64 buffer of NaN that starts on a cache line."""
    raw = np.full(size + 7, np.nan)
    start = -raw.ctypes.data % 64 // 8
    return raw[start : start + size]


def _write_cell(p: Array, cell: CellParams, tuning: Tuning) -> None:
    limits, noise = cell.cell, cell.noise
    p[k.P_CHARGE_COULOMB] = 3600 * limits.capacity_Ah
    p[k.P_CE_CHARGE] = limits.coulombic_efficiency
    low, high = limits.voltage_limits_V
    p[k.P_VOLTAGE_MIN], p[k.P_VOLTAGE_MAX] = low - tuning.voltage_margin_V, high + tuning.voltage_margin_V
    charge, discharge = limits.current_limits_A
    p[k.P_CURRENT_MIN], p[k.P_CURRENT_MAX] = charge * tuning.current_margin, discharge * tuning.current_margin
    p[k.P_TEMPERATURE_MIN], p[k.P_TEMPERATURE_MAX] = -60.0, 120.0
    p[k.P_TABLE_TEMPERATURE_MIN], p[k.P_TABLE_TEMPERATURE_MAX] = limits.temperature_limits_degC
    p[k.P_CURRENT_RANGE] = (discharge - charge) / 2
    p[k.P_VAR_VOLTAGE] = noise.voltage_sigma_V**2 + tuning.voltage_sensor_sigma_V**2
    p[k.P_R0_REL], p[k.P_RC_REL] = noise.r0_rel_sigma, noise.rc_rel_sigma
    p[k.P_VAR_RC], p[k.P_VAR_RC2] = noise.v_rc1_sigma_V**2, noise.v_rc2_sigma_V**2


def _write_tuning(p: Array, cell: CellParams, tuning: Tuning) -> None:
    capacity_Ah = cell.cell.capacity_Ah
    charge = p[k.P_CHARGE_COULOMB]
    offset_A = capacity_Ah / 100 if tuning.current_offset_sigma_A is None else tuning.current_offset_sigma_A
    # An error that stays the same over the horizon H and is then redrawn: SoC walks with variance sigma^2 H per second.
    p[k.P_CURRENT_OFFSET] = offset_A
    p[k.P_SOC_WALK_OFFSET] = (offset_A / charge) ** 2 * tuning.current_error_horizon_s
    p[k.P_SOC_WALK_GAIN] = (tuning.current_gain_sigma / charge) ** 2 * tuning.current_error_horizon_s
    spread = tuning.alpha**2 * (N + tuning.kappa)
    p[k.P_GAMMA], p[k.P_W] = math.sqrt(spread), 1 / (2 * spread)
    p[k.P_E2] = tuning.beta + tuning.alpha**2 * (N + tuning.kappa - 1)
    p[k.P_GATE2], p[k.P_REJECT_S] = tuning.gate_sigmas**2, tuning.reject_s
    p[k.P_CURRENT_TIMEOUT] = tuning.current_timeout_s
    p[k.P_VOLTAGE_TIMEOUT] = tuning.voltage_timeout_s
    p[k.P_TEMPERATURE_TIMEOUT] = tuning.temperature_timeout_s
    p[k.P_SOC_SIGMA_MAX], p[k.P_SOC_SIGMA_INVALID] = SOC_SIGMA_MAX, tuning.soc_sigma_invalid
    p[k.P_INITIAL_SOC] = tuning.initial_soc
    p[k.P_INITIAL_SIGMA] = tuning.initial_soc_sigma
    p[k.P_WIDE_SIGMA] = tuning.wide_soc_sigma
    unknown_load = tuning.initial_current_sigma_A
    p[k.P_INITIAL_CURRENT] = capacity_Ah / 5 if unknown_load is None else unknown_load


def _write_table(p: Array, descriptor: int, offset: int, table: Array, temperatures: Array, intervals: int) -> None:
    p[offset : offset + table.size] = table.ravel()
    p[descriptor + k.T_OFFSET] = offset
    p[descriptor + k.T_ROWS] = len(temperatures)
    p[descriptor + k.T_ROW_SIZE] = table[0].size
    p[descriptor + k.T_KNOTS] = intervals
    p[descriptor + k.T_TEMP0] = temperatures[0]
    p[descriptor + k.T_INV_DTEMP] = 1 / (temperatures[1] - temperatures[0])
    p[descriptor + k.T_INV_DSOC] = intervals


def _ocv_table(cell: CellParams) -> tuple[Array, Array]:
    """(rows, intervals, 4) cubic coefficients in the fraction of an interval, and the rows' temperatures."""
    if cell.ocv.docv_dT_V_per_K is not None:
        temperatures = np.array(cell.cell.temperature_limits_degC)  # linear in between, exactly
    else:
        temperatures = _uniform(cell.ocv.temperature_degC)
    soc = np.linspace(0, 1, OCV_INTERVALS + 1)
    h = 1 / OCV_INTERVALS
    rows = []
    for temperature in temperatures:
        coefficients = pchip.coefficients(soc, cell.ocv_V(soc, temperature))
        rows.append(coefficients * h ** np.arange(k.OCV_COEFFICIENTS))
    return np.array(rows), temperatures


def _dynamics_table(cell: CellParams) -> tuple[Array, Array]:
    """(rows, knots, 6) values of r0, r1, tau1, r2, tau2, knee, and the rows' temperatures."""
    temperatures = _uniform(cell.dynamics.temperature_degC)
    soc = np.linspace(0, 1, DYN_INTERVALS + 1)
    rows = [np.column_stack(list(cell.dynamics_at(soc, temperature).values())) for temperature in temperatures]
    return np.array(rows), temperatures


def _uniform(temperatures: list[float]) -> Array:
    """At least two temperatures, evenly spaced at most TEMPERATURE_STEP_K apart, that span those given."""
    low, high = temperatures[0], temperatures[-1]
    if low == high:
        return np.array([low, low + TEMPERATURE_STEP_K])  # both rows come out alike: the tables hold beyond their edge
    return np.linspace(low, high, math.ceil((high - low) / TEMPERATURE_STEP_K) + 1)
