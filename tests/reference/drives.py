"""Drives of synthetic cells, and cells of every form, for the tests that compare filters."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import synthetic_cell
from kernel_record import Record
from scipy.signal import lfilter

from bms_ukf import CellParams, Estimator, Tuning
from bms_ukf.kernel import layout

CELL = synthetic_cell.cell_of(synthetic_cell.nonlinear())
# Sigma points alone: neither the gate nor the quadrature for wide beliefs (`test_wide`) steps in, nothing is adapted.
PLAIN = {"gate_sigmas": 1e6, "wide_soc_sigma": 0.5, "adaptive": False, "current_bias": False}


def variant(n_rc: int, hysteresis: bool, core: bool = False, uneven: bool = False) -> CellParams:
    """CELL with so many RC pairs, perhaps with hysteresis, a core of its own temperature, errors that are `uneven`."""
    data = synthetic_cell.nonlinear()
    dynamics, noise = data["dynamics"], data["noise"]
    if n_rc == 1:
        del dynamics["r2_ohm"], dynamics["tau2_s"], noise["v_rc2_sigma_V"]
    if n_rc == 3:
        dynamics["r3_ohm"] = dynamics["r2_ohm"]
        dynamics["tau3_s"] = [[8 * tau for tau in row] for row in dynamics["tau2_s"]]
        noise["v_rc3_sigma_V"] = 0.003
    if hysteresis:
        data["hysteresis"] = {
            "soc": [0.0, 0.4, 1.0],
            "temperature_degC": [0.0, 25.0],
            "max_V": [[0.03, 0.02, 0.01], [0.02, 0.015, 0.005]],
            "rate": 120.0,
        }
        noise["hysteresis_sigma_V"] = 0.003
    if core:
        data["thermal"] = {"core_K_per_W": 3.0, "core_tau_s": 90.0}
    if uneven:
        noise |= {"soc": [0.0, 0.5, 1.0], "temperature_degC": [5.0, 25.0]}
        noise["error_scale"] = [[3.0, 0.8, 2.0], [1.5, 0.5, 1.2]]
    return synthetic_cell.cell_of(data)


def exact(cell: CellParams, tuning: Tuning) -> Record:
    """A record whose cached table row serves for one temperature only."""
    record = Record(cell, tuning)
    record.params[layout.P_CACHE_TEMPERATURE] = 0.0
    return record


def drive(steps: int, varying_dt: bool, seed: int) -> Iterator[tuple[float, float, float, float]]:
    """(dt, current, voltage, temperature) of a noisy drive from 90 % that warms up, voltage from a cell of its own."""
    rng = np.random.default_rng(seed)
    model = Record(CELL)
    soc, v1, v2, current = 0.9, 0.0, 0.0, 0.0
    for k in range(steps):
        dt = float(rng.choice([0.01, 0.1, 0.7, 1.0, 3.3])) if varying_dt else 1.0
        temperature = 10.0 + 20.0 * k / steps
        current = 0.9 * current + 0.1 * 2.5 + rng.standard_normal() - (0.8 if k % 97 > 85 else 0.0)
        at = model.dynamics(soc, temperature)
        soc -= current * dt / 18000
        v1 += (at["r1_ohm"] * current - v1) * -math.expm1(-dt / at["tau1_s"])
        v2 += (at["r2_ohm"] * current - v2) * -math.expm1(-dt / at["tau2_s"])
        voltage = model.ocv(soc, temperature) - v1 - v2 - model.drop(soc, temperature, current)
        voltage += 0.004 * rng.standard_normal()
        yield dt, current, voltage, temperature + 0.2 * rng.standard_normal()


def steady() -> CellParams:
    """CELL with resistances that do not depend on SoC: a simulation in closed form is then no worse than the filter."""
    data = synthetic_cell.nonlinear()
    dynamics = data["dynamics"]
    for key in dynamics.keys() - {"soc", "temperature_degC"}:
        dynamics[key] = [[row[3]] * len(row) for row in dynamics[key]]
    return synthetic_cell.cell_of(data)


def terminal(
    cell: CellParams, soc: float, current: np.ndarray, rate_hz: float = 1.0, r0: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """SoC and terminal voltage of a `steady` cell at 25 degC that was at rest at `soc`, with `r0` times its r0."""
    moved = np.where(current < 0, cell.cell.coulombic_efficiency, 1.0) * current
    soc_after = soc - np.cumsum(moved) / rate_hz / (3600 * cell.cell.capacity_Ah)
    r = {key: float(value) for key, value in cell.dynamics_at(0.6, 25.0).items()}
    voltage = cell.ocv_V(soc_after, 25.0) - r0 * r["r0_ohm"] * r["r0_knee_A"] * np.arcsinh(current / r["r0_knee_A"])
    for j in range(1, cell.dynamics.n_rc + 1):
        a = math.exp(-1 / rate_hz / r[f"tau{j}_s"])
        voltage -= lfilter([1 - a], [1, -a], r[f"r{j}_ohm"] * current)
    return soc_after, voltage


def float32_against_float64(rate_hz: int, steps: int) -> tuple[float, float]:
    """Largest difference of SoC after the first tenth, in its sigmas, over a cycling load; how far SoC travelled."""
    cell = steady()
    rng = np.random.default_rng(rate_hz)
    t = np.arange(steps) / rate_hz
    current = 2.0 * np.sign(np.sin(2 * np.pi * t / 5400)) + 1.5 * np.sin(2 * np.pi * t / 97)
    for _ in range(5):  # charging loses a percent, so it takes more
        moved = np.where(current < 0, cell.cell.coulombic_efficiency, 1.0) * current
        current -= moved.mean()
    soc, voltage = terminal(cell, 0.75, current, rate_hz)
    voltage += 0.003 * rng.standard_normal(steps)
    t_ns = np.round(t * 1e9).astype(np.int64)
    f64, f32 = (
        Estimator(cell, precision=precision).replay(t_ns, current, voltage, np.full(steps, 25.0))
        for precision in ("f64", "f32")
    )
    apart = np.abs(f64["soc"] - f32["soc"]) / f64["soc_sigma"]
    return float(apart[steps // 10 :].max()), float(np.ptp(soc))
