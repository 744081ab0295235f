"""The textbook extended Kalman filter on the cell's circuit, over a whole recording: what ours is compared with.

    x = [soc, v_rc1 .., v_hyst]      z = ocv(soc, T) - v_rc1 .. - v_hyst - r0 knee asinh(i / knee)
    x' = F x + B i,  P' = F P F^T + Q
    H = [docv/dsoc, -1 ..],  S = H P H^T + R,  x += P H^T / S innovation,  P -= P H^T H P / S

as in Plett, Battery Management Systems II, 2015, chapter 3. It is tuned as carefully as ours: the same cell file with
all its tables, the same parameters at the mean SoC, the same noise (the model error as correlated processes), the
same first belief, the same gate and recovery. Without these two it was measured to do worse (weighted error on the
Panasonic recordings 6.2 % instead of 3.9 %). The difference is that it takes the OCV curve for its tangent line, and
the cell file for what it says: it does not learn.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bms_ukf import honesty
from bms_ukf.cell import CellParams
from bms_ukf.offline.signals import Signals, Told
from bms_ukf.records import Status
from bms_ukf.tuning import Tuning

Array = NDArray[np.float64]

SOC_STEPS = 400  # of the tables, evenly over 0..1
TEMPERATURE_STEP_K = 2.5
VOLTAGE_ERROR_S = 1.0  # the interval that [noise] of a cell file is derived at: faster readings are each worth less
R0, R0_CHARGE, KNEE, ERROR, RC1 = range(
    5
)  # columns of the tables; pairs of r_j, tau_j follow from RC1, then hysteresis


class Model(NamedTuple):
    """The cell file on an even grid, and the sizes of its errors; tables have shape (temperatures, SoC, ..)."""

    ocv_V: Array
    slope_V: Array  # d ocv / d soc
    dynamics: Array
    coldest_degC: float
    n_rc: int
    hysteresis: int  # 0 or 1
    charge_As: float
    charge_efficiency: float
    hysteresis_rate: float  # 1 / (A s)
    core_K_per_W: float
    core_tau_s: float
    voltage_var_V2: float
    r0_rel_sigma: float
    rc_rel_sigma: float
    state_var_V2: Array  # of the model error that each voltage carries
    offset_sigma_A: float
    soc_walk_offset: float  # growth of SoC's variance, 1/s
    soc_walk_gain: float  # and 1/(s A^2)
    initial_load_sigma_A: float
    gate_sigmas: float
    reject_s: float


def model_of(cell: CellParams, tuning: Tuning) -> Model:
    """What `run` needs of a cell file and the sensors."""
    limits, noise = cell.cell, cell.noise
    known = cell.ocv.temperature_degC + cell.dynamics.temperature_degC + limits.temperature_limits_degC
    rows = int(np.ceil((max(known) - min(known)) / TEMPERATURE_STEP_K)) + 2
    temperatures = min(known) + TEMPERATURE_STEP_K * np.arange(rows)
    soc = np.linspace(0, 1, SOC_STEPS + 1)
    ocv_V = np.array([cell.ocv_V(soc, float(temperature)) for temperature in temperatures])
    tables = [np.column_stack(list(cell.dynamics_at(soc, float(temperature)).values())) for temperature in temperatures]
    charge_As = 3600 * limits.capacity_Ah
    spec, load_A = tuning.sensor_spec, tuning.initial_current_sigma_A
    offset_A = spec.current_offset_sigma_A(limits.capacity_Ah)
    sigmas_V = (noise.v_rc1_sigma_V, noise.v_rc2_sigma_V, noise.v_rc3_sigma_V, noise.hysteresis_sigma_V)
    return Model(
        ocv_V=ocv_V,
        slope_V=np.gradient(ocv_V, soc, axis=1),
        dynamics=np.array(tables),
        coldest_degC=float(temperatures[0]),
        n_rc=cell.dynamics.n_rc,
        hysteresis=int(cell.hysteresis is not None),
        charge_As=charge_As,
        charge_efficiency=limits.coulombic_efficiency,
        hysteresis_rate=cell.hysteresis.rate / charge_As if cell.hysteresis else 0.0,
        core_K_per_W=cell.thermal.core_K_per_W if cell.thermal else 0.0,
        core_tau_s=cell.thermal.core_tau_s if cell.thermal else 1.0,
        voltage_var_V2=noise.voltage_sigma_V**2 + tuning.voltage_white_var_V2,
        r0_rel_sigma=noise.r0_rel_sigma,
        rc_rel_sigma=noise.rc_rel_sigma,
        state_var_V2=np.array([sigma**2 for sigma in sigmas_V if sigma is not None]),
        offset_sigma_A=offset_A,
        soc_walk_offset=(offset_A / charge_As) ** 2 * tuning.current_error_horizon_s,
        soc_walk_gain=(tuning.charge_gain_sigma / charge_As) ** 2 * tuning.current_error_horizon_s,
        initial_load_sigma_A=limits.capacity_Ah / 20 if load_A is None else load_A,
        gate_sigmas=tuning.gate_sigmas,
        reject_s=tuning.reject_s,
    )


def run(model: Model, signals: Signals, told: Told) -> dict[str, NDArray[Any]]:
    """As `Estimator.replay`: arrays by the names of `Estimate`'s fields, a row a sample."""
    rows = signals.time_s.size
    soc, sigma, predicted, innovation, nis = (np.full(rows, np.nan) for _ in range(5))
    inputs = (signals.step_s, signals.current_A, signals.voltage_V, signals.temperature_degC)
    _run(model, *inputs, told.soc, told.sigma, soc, sigma, predicted, innovation, nis)
    low, high = honesty.bounds(np.clip(soc, 0, 1), sigma)
    return {
        "soc": np.clip(soc, 0, 1),
        "soc_sigma": sigma,
        "soc_low": low,
        "soc_high": high,
        "voltage_pred_V": predicted,
        "innovation_V": innovation,
        "nis": nis,
        "status": np.full(rows, Status.OK, dtype=np.int64),
        "faults": np.zeros(rows, dtype=np.int64),
    }


@njit(cache=True)
def _run(
    m: Model,
    step_s: Array,
    current_A: Array,
    voltage_V: Array,
    temperature_degC: Array,
    first_soc: float,
    first_sigma: float,
    out_soc: Array,
    out_sigma: Array,
    out_predicted: Array,
    out_innovation: Array,
    out_nis: Array,
) -> None:
    n = 1 + m.n_rc + m.hysteresis
    x, F, q = np.zeros(n), np.ones(n), np.zeros(n)
    P, H, PH, at = np.zeros((n, n)), np.full(n, -1.0), np.zeros(n), np.zeros(m.dynamics.shape[2])
    core_K, since_s, refused_s = 0.0, VOLTAGE_ERROR_S, 0.0
    for k in range(step_s.size):
        dt, i, T = step_s[k], current_A[k], temperature_degC[k] + core_K
        efficiency = m.charge_efficiency if i < 0.0 else 1.0
        _look_up(m, x[0] - efficiency * i * dt / m.charge_As if k else first_soc, T, at)
        if k == 0:
            _look_up(m, 0.5, T, at)
            _begin(m, first_soc, first_sigma, i, at, x, P)
            _look_up(m, first_soc, T, at)
        _time_update(m, dt, i, efficiency, at, x, P, F, q)
        drop = at[KNEE] * np.arcsinh(i / at[KNEE]) * (at[R0_CHARGE] if i < 0.0 else at[R0])
        core_K += (1.0 - np.exp(-dt / m.core_tau_s)) * (m.core_K_per_W * i * (drop + x[1:].sum()) - core_K)
        since_s += dt
        if np.isfinite(voltage_V[k]):
            ocv, H[0] = _ocv(m, x[0], T)
            out_predicted[k] = ocv - x[1:].sum() - drop
            out_innovation[k] = voltage_V[k] - out_predicted[k]
            R = at[ERROR] ** 2 * (m.voltage_var_V2 + (m.r0_rel_sigma * drop) ** 2)
            R *= VOLTAGE_ERROR_S / min(max(since_s, 1e-6), VOLTAGE_ERROR_S)
            S = _innovation_variance(H, R, P, PH)
            out_nis[k] = out_innovation[k] ** 2 / S
            refused_s += dt
            if out_nis[k] <= m.gate_sigmas**2:
                _measurement_update(out_innovation[k], S, x, P, PH)
                since_s = refused_s = 0.0
            elif refused_s >= m.reject_s:
                P *= out_nis[k]
                refused_s = 0.0
        # SoC is not held within 0..1: correlated voltages would go on taking what it may not, and run away.
        out_soc[k], out_sigma[k] = x[0], np.sqrt(P[0, 0])


@njit(cache=True)
def _begin(m: Model, soc: float, sigma: float, i: float, at: Array, x: Array, P: Array) -> None:
    """The load may have begun just now or long ago: the RC voltages are between nothing and r i."""
    x[0], P[0, 0] = soc, sigma * sigma
    load_var = m.initial_load_sigma_A**2 + (i / 2) ** 2
    for j in range(m.n_rc):
        r = at[RC1 + 2 * j]
        x[1 + j] = r * i / 2
        P[1 + j, 1 + j] = at[ERROR] ** 2 * m.state_var_V2[j] + r * r * load_var
    if m.hysteresis:
        P[-1, -1] = at[ERROR] ** 2 * m.state_var_V2[-1] + at[-1] ** 2 / 3


@njit(cache=True)
def _time_update(
    m: Model, dt: float, i: float, efficiency: float, at: Array, x: Array, P: Array, F: Array, q: Array
) -> None:
    x[0] -= efficiency * i * dt / m.charge_As
    q[0] = dt * (m.soc_walk_offset + m.soc_walk_gain * i * i)
    for j in range(m.n_rc):
        r = at[RC1 + 2 * j]
        F[1 + j] = np.exp(-dt / at[RC1 + 2 * j + 1])
        x[1 + j] = F[1 + j] * x[1 + j] + (1.0 - F[1 + j]) * r * i
        # An offset of the current shifts every drop; the slowest process carries that of r0 too.
        shifted = m.offset_sigma_A * (r + at[R0] if j == m.n_rc - 1 else r)
        stationary = at[ERROR] ** 2 * (m.state_var_V2[j] + (m.rc_rel_sigma * r * i) ** 2) + shifted**2
        q[1 + j] = (1.0 - F[1 + j] ** 2) * stationary
    if m.hysteresis:
        F[-1] = np.exp(-m.hysteresis_rate * abs(i) * dt)
        x[-1] = F[-1] * x[-1] + (1.0 - F[-1]) * at[-1] * (-1.0 if i < 0.0 else 1.0)
        q[-1] = (1.0 - F[-1] ** 2) * at[ERROR] ** 2 * m.state_var_V2[-1]
    for row in range(x.size):
        for column in range(x.size):
            P[row, column] *= F[row] * F[column]
        P[row, row] += q[row]


@njit(cache=True)
def _innovation_variance(H: Array, R: float, P: Array, PH: Array) -> float:
    """S = H P H^T + R; writes P H^T to `PH`."""
    S = R
    for row in range(H.size):
        PH[row] = 0.0
        for column in range(H.size):
            PH[row] += P[row, column] * H[column]
        S += H[row] * PH[row]
    return S


@njit(cache=True)
def _measurement_update(innovation: float, S: float, x: Array, P: Array, PH: Array) -> None:
    for row in range(x.size):
        x[row] += PH[row] / S * innovation
        for column in range(x.size):
            P[row, column] -= PH[row] * PH[column] / S


@njit(cache=True)
def _place(m: Model, soc: float, T: float) -> tuple[int, float, int, float]:
    """Table rows and columns around a point, and its part of the way to the next; SoC may lie outside 0..1."""
    rows = m.ocv_V.shape[0]
    u = min(max((T - m.coldest_degC) / TEMPERATURE_STEP_K, 0.0), rows - 1.0)
    row = min(int(u), rows - 2)
    column = min(max(int(np.floor(soc * SOC_STEPS)), 0), SOC_STEPS - 1)
    return row, u - row, column, soc * SOC_STEPS - column


@njit(cache=True)
def _ocv(m: Model, soc: float, T: float) -> tuple[float, float]:
    """OCV and its slope; beyond 0..1 it goes on by the edge slope."""
    row, f, column, d = _place(m, soc, T)
    inside = min(max(d, 0.0), 1.0)
    left = (1 - f) * m.ocv_V[row, column] + f * m.ocv_V[row + 1, column]
    right = (1 - f) * m.ocv_V[row, column + 1] + f * m.ocv_V[row + 1, column + 1]
    left_slope = (1 - f) * m.slope_V[row, column] + f * m.slope_V[row + 1, column]
    right_slope = (1 - f) * m.slope_V[row, column + 1] + f * m.slope_V[row + 1, column + 1]
    return left + d * (right - left), left_slope + inside * (right_slope - left_slope)


@njit(cache=True)
def _look_up(m: Model, soc: float, T: float, at: Array) -> None:
    row, f, column, d = _place(m, min(max(soc, 0.0), 1.0), T)
    for c in range(at.size):
        left = (1 - f) * m.dynamics[row, column, c] + f * m.dynamics[row + 1, column, c]
        right = (1 - f) * m.dynamics[row, column + 1, c] + f * m.dynamics[row + 1, column + 1, c]
        at[c] = left + d * (right - left)
