"""Chooses the form of the filter for a cell and a tuning, and writes both into the kernel's `params` buffer."""

from __future__ import annotations

import math
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bms_ukf import pchip
from bms_ukf.cell import CellParams
from bms_ukf.errors import ConfigError
from bms_ukf.kernel import layout as k
from bms_ukf.kernel.adapt import VOLTAGE_ERROR_S
from bms_ukf.kernel.layout import Form, form
from bms_ukf.tuning import Tuning

Array = NDArray[np.float64]
Precision = Literal["f32", "f64"]
BITS = {"f32": 32, "f64": 64}


class Grid(NamedTuple):
    """How fine the kernel's tables are. They are uniform, so that finding an interval is a multiplication."""

    ocv_intervals: int = 200
    dyn_intervals: int = 40
    temperature_step_K: float = 5.0


FULL = Grid()
COMPACT = Grid(ocv_intervals=100, dyn_intervals=20, temperature_step_K=10.0)  # a third of the size, for firmware

# Errors of an equivalent circuit that last: one sigma, and how far in time and in SoC they stay the same. Chosen over
# the plants of the honesty campaign, not for one cell file (`bms-ukf campaign`).
SLOW_SIGMA_V = 0.004  # diffusion, hysteresis and OCV
SLOW_REL = 0.15  # and a share of the polarisation
SLOW_TAU_S, SLOW_SOC = 7200.0, 0.1
R0_AGED_SIGMA = 0.18  # all resistances of an aged cell, relative
R0_TAU_S, R0_SOC = 20_000.0, 0.6
R0_PER_K = 0.03  # how fast a resistance changes with temperature, relative
# Errors that pass within FAST_S.
FAST_SIGMA_V = 0.005
FAST_HYSTERESIS = 1.5  # times the largest hysteresis voltage: one sigma of what a one-state model of it leaves
FAST_REL = 0.6  # after a change of the current, as a share of the change of the ohmic drop

MOVED = 0.5  # of the capacity: a walk of SoC from an unknown gain is here as wide as the error of that gain
HISTORY = 0.35  # of the cell's current range: one sigma of the mean load before a first sample

SOC_SIGMA_MIN = 1e-4  # no reading of an OCV curve is better
SOC_SIGMA_MAX = 0.5  # of a quantity between 0 and 1: more says nothing
ROUNDING_MAX_V = 1e-4  # a tenth of what a good voltage sensor resolves
NOMINAL_DEGC = 25.0  # the nominal voltage of a cell is its OCV at this temperature and half charge
CACHE_TEMPERATURE_K = 0.01  # resistances change by some 3 % a kelvin: what is cached is right to 0.03 %


def state_size(form: Form, cells: int) -> int:
    """Numbers in the `state` buffer: the blocks of records, then the components of every cell."""
    blocks = -(-cells // form.lanes)
    return blocks * form.lanes * form.size + cells * form.parts


def form_of(cell: CellParams, tuning: Tuning, lanes: int = 1, bits: int = 64, part_lanes: int = k.PART_LANES) -> Form:
    """The filter that the cell and the tuning ask for."""
    hysteresis, core = cell.hysteresis is not None, cell.thermal is not None
    bias = int(tuning.current_bias)
    return form(cell.dynamics.n_rc, int(hysteresis), bias, int(core), lanes, int(bits == 32), part_lanes)


def params(cell: CellParams, tuning: Tuning, bits: int = 64, grid: Grid = FULL) -> NDArray[Any]:
    """The `params` buffer, 64-byte aligned, of numbers of 32 or 64 bits. Raises ConfigError for an unsound tuning."""
    tuning.check(cell, "tuning", "sensor_spec")
    ocv, ocv_temperatures = _ocv_table(cell, grid)
    dyn, dyn_temperatures = _dynamics_table(cell, grid)
    p = np.full(k.PARAMS_HEADER + ocv.size + dyn.size, np.nan)
    _write_cell(p, cell, tuning)
    _write_tuning(p, cell, tuning, bits)
    _write_table(p, k.P_OCV, k.PARAMS_HEADER, ocv, ocv_temperatures, grid.ocv_intervals)
    _write_table(p, k.P_DYN, k.PARAMS_HEADER + ocv.size, dyn, dyn_temperatures, grid.dyn_intervals)
    buffer = aligned(p.size, bits)
    buffer[:] = p
    return buffer


def aligned(size: int, bits: int = 64, *, filled: bool = True) -> NDArray[Any]:
    """Return a buffer of NaN that starts on a cache line; not `filled`, it takes no memory before it is used."""
    raw = np.empty(size + 16, dtype=np.float64 if bits == 64 else np.float32)
    if filled:
        raw[:] = np.nan
    start: int = -raw.ctypes.data % 64 // raw.itemsize
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
    p[k.P_VAR_VOLTAGE] = noise.voltage_sigma_V**2 + tuning.voltage_white_var_V2
    p[k.P_FAST_VAR] = FAST_SIGMA_V**2
    if cell.hysteresis:
        p[k.P_FAST_VAR] += (FAST_HYSTERESIS * float(np.median(cell.hysteresis.max_V))) ** 2
    p[k.P_RC_REL] = noise.rc_rel_sigma
    _write_lasting_errors(p, cell, tuning)
    p[k.P_HISTORY] = HISTORY * p[k.P_CURRENT_RANGE]
    for j, sigma in enumerate(voltage_sigmas(cell)):
        p[k.P_VAR_V + j] = sigma**2
    p[k.P_HYSTERESIS_RATE] = cell.hysteresis.rate / p[k.P_CHARGE_COULOMB] if cell.hysteresis else 0.0
    if cell.thermal:
        p[k.P_CORE_K_PER_W], p[k.P_CORE_TAU] = cell.thermal.core_K_per_W, cell.thermal.core_tau_s


def _write_lasting_errors(p: Array, cell: CellParams, tuning: Tuning) -> None:
    spec, noise = tuning.sensor_spec, cell.noise
    offset_V = spec.voltage_offset_sigma_V(float(cell.ocv_V(0.5, NOMINAL_DEGC)))
    p[k.P_SLOW_VAR], p[k.P_SLOW_TAU] = SLOW_SIGMA_V**2 + offset_V**2, SLOW_TAU_S
    p[k.P_SLOW_REL] = SLOW_REL
    p[k.P_SLOW_RATE] = 1 / (SLOW_SOC * p[k.P_CHARGE_COULOMB])
    warmer = R0_PER_K * spec.temperature_sigma_K
    p[k.P_R0_VAR], p[k.P_R0_TAU] = noise.r0_rel_sigma**2 + R0_AGED_SIGMA**2 + warmer**2, R0_TAU_S
    p[k.P_R0_RATE] = 1 / (R0_SOC * p[k.P_CHARGE_COULOMB])
    p[k.P_FAST_REL] = math.hypot(FAST_REL, spec.skew_sigma_s / VOLTAGE_ERROR_S)


def _write_tuning(p: Array, cell: CellParams, tuning: Tuning, bits: int) -> None:
    capacity_Ah = cell.cell.capacity_Ah
    charge = p[k.P_CHARGE_COULOMB]
    spec = tuning.sensor_spec
    offset_A = spec.current_offset_sigma_A(capacity_Ah)
    # An error that stays the same over the horizon H and is then redrawn: SoC walks with variance sigma^2 H per second.
    # With a state of its own the offset is no noise.
    unseen_A = 0.0 if tuning.current_bias else offset_A
    p[k.P_BIAS_SIGMA], p[k.P_BIAS_TAU] = offset_A, tuning.current_error_horizon_s
    p[k.P_ALIKE] = tuning.bias_error_correlation
    p[k.P_STILL], p[k.P_PARASITIC] = capacity_Ah / 400, capacity_Ah / 300
    p[k.P_SOC_WALK_OFFSET] = (unseen_A / charge) ** 2 * tuning.current_error_horizon_s
    p[k.P_SOC_WALK_GAIN] = tuning.charge_gain_sigma**2 * MOVED / charge
    _write_weights(p, form_of(cell, tuning).n, tuning, cell.cell.voltage_limits_V[1], bits)
    p[k.P_GATE2], p[k.P_REJECT_S] = tuning.gate_sigmas**2, tuning.reject_s
    p[k.P_CURRENT_TIMEOUT] = tuning.current_timeout_s
    p[k.P_VOLTAGE_TIMEOUT] = tuning.voltage_timeout_s
    p[k.P_TEMPERATURE_TIMEOUT] = tuning.temperature_timeout_s
    p[k.P_SOC_SIGMA_MIN], p[k.P_SOC_SIGMA_MAX] = SOC_SIGMA_MIN, SOC_SIGMA_MAX
    p[k.P_OK_HALF_WIDTH], p[k.P_INVALID_HALF_WIDTH] = tuning.ok_half_width, tuning.invalid_half_width
    p[k.P_CACHE_TEMPERATURE] = CACHE_TEMPERATURE_K
    p[k.P_ADAPT] = float(tuning.adaptive)
    p[k.P_EXCITED] = capacity_Ah / 10
    p[k.P_INITIAL_SOC] = tuning.initial_soc
    p[k.P_INITIAL_SIGMA] = tuning.initial_soc_sigma
    p[k.P_WIDE_SIGMA] = tuning.wide_soc_sigma
    unknown_load = tuning.initial_current_sigma_A
    p[k.P_INITIAL_CURRENT] = capacity_Ah / 20 if unknown_load is None else unknown_load


def _write_weights(p: Array, n: int, tuning: Tuning, voltage_V: float, bits: int) -> None:
    """Raises ConfigError, with the reason, for a set of sigma points that is unsound for so many states and bits."""
    alpha, beta, kappa = tuning.alpha, tuning.beta, tuning.kappa
    spread = alpha**2 * (n + kappa)
    if not spread > 0:
        raise ConfigError("tuning", key="kappa", value=kappa, expected=f"above {-n}, as there are {n} states")
    factor = beta + alpha**2 * (n + kappa - 1)
    if factor < 0:
        expected = f"beta + alpha^2 (n + kappa - 1) not below 0, got {factor:g}: a variance could turn negative"
        raise ConfigError("tuning", key="beta", value=beta, expected=expected)
    # The mean shift w (g+ + g- - 2 g0) has the rounding of four voltages in it, times w.
    rounding_V = 4 * voltage_V * (2**-24 if bits == 32 else 2**-53) / (2 * spread)
    if rounding_V > ROUNDING_MAX_V:
        expected = f"larger: float{bits} would put {rounding_V:.1g} V of rounding into every predicted voltage"
        raise ConfigError("tuning", key="alpha", value=alpha, expected=expected)
    p[k.P_GAMMA], p[k.P_W], p[k.P_E2] = math.sqrt(spread), 1 / (2 * spread), factor


def voltage_sigmas(cell: CellParams) -> list[float]:
    """Of the model error that each voltage state carries, V."""
    noise = cell.noise
    sigmas = (noise.v_rc1_sigma_V, noise.v_rc2_sigma_V, noise.v_rc3_sigma_V, noise.hysteresis_sigma_V)
    return [sigma for sigma in sigmas if sigma is not None]


def state_names(cell: CellParams) -> list[str]:
    """Of the filter's states but the bias."""
    names = ["soc", *(f"v_rc{j + 1}_V" for j in range(cell.dynamics.n_rc))]
    return [*names, *(["v_hyst_V"] if cell.hysteresis else []), "v_slow_V", "r0_error"]


def _write_table(p: Array, descriptor: int, offset: int, table: Array, temperatures: Array, intervals: int) -> None:
    p[offset : offset + table.size] = table.ravel()
    p[descriptor + k.T_OFFSET] = offset
    p[descriptor + k.T_ROWS] = len(temperatures)
    p[descriptor + k.T_ROW_SIZE] = table[0].size
    p[descriptor + k.T_INTERVALS] = intervals
    p[descriptor + k.T_TEMP0] = temperatures[0]
    p[descriptor + k.T_INV_DTEMP] = 1 / (temperatures[1] - temperatures[0])


def _ocv_table(cell: CellParams, grid: Grid) -> tuple[Array, Array]:
    """(rows, 1 + intervals + 1, 4) cubic coefficients in the fraction of an interval, and the rows' temperatures."""
    if cell.ocv.docv_dT_V_per_K is not None:
        temperatures = np.array(cell.cell.temperature_limits_degC)  # linear in between, exactly
    else:
        temperatures = _uniform(cell.ocv.temperature_degC, grid)
    soc = np.linspace(0, 1, grid.ocv_intervals + 1)
    h = 1 / grid.ocv_intervals
    rows = []
    for temperature in temperatures:
        voltage = cell.ocv_V(soc, temperature)
        inside = pchip.coefficients(soc, voltage) * h ** np.arange(k.OCV_COEFFICIENTS)
        below = [voltage[0] - inside[0, 1], inside[0, 1], 0, 0]
        above = [voltage[-1], inside[-1] @ [0, 1, 2, 3], 0, 0]
        rows.append(np.vstack([below, inside, above]))
    return np.array(rows), temperatures


def _dynamics_table(cell: CellParams, grid: Grid) -> tuple[Array, Array]:
    """(rows, knots, channels) values of the `D_*` channels, and the rows' temperatures."""
    known = {*cell.dynamics.temperature_degC, *(cell.noise.temperature_degC or [])}
    known |= set(cell.hysteresis.temperature_degC) if cell.hysteresis else set()
    temperatures = _uniform(sorted(known), grid)
    soc = np.linspace(0, 1, grid.dyn_intervals + 1)
    rows = [np.column_stack(list(cell.dynamics_at(soc, temperature).values())) for temperature in temperatures]
    return np.array(rows), temperatures


def _uniform(temperatures: list[float], grid: Grid) -> Array:
    """At least two temperatures, evenly spaced at most the grid's step apart, that span those given."""
    low, high = temperatures[0], temperatures[-1]
    if low == high:
        return np.array(
            [low, low + grid.temperature_step_K]
        )  # both rows come out alike: the tables hold beyond their edge
    return np.linspace(low, high, math.ceil((high - low) / grid.temperature_step_K) + 1)
