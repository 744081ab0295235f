"""A laboratory for cells that exist only for the tests: loads, their voltages, and a manifest of both."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import synthetic_cell
from numpy.typing import NDArray

from bms_ukf.cell import CellParams

Array = NDArray[np.float64]
LabTest = tuple[str, float, Array, float]  # role, degC, load in A, s from row to row

MANIFEST = """format = 1
cell = "little"
chemistry = "none"
current_positive = "discharge"
"""


def pulse_load_A(capacity_Ah: float) -> Array:
    """Rests of 20 min, a pulse of 1C to either side, and 5 % of the charge at C/2, down to empty."""
    level = [np.zeros(1200), np.full(10, capacity_Ah), np.zeros(60), np.full(10, -capacity_Ah), np.zeros(60)]
    return np.tile(np.concatenate([*level, np.full(360, capacity_Ah / 2)]), 20)


def measured(cell: CellParams, current_A: Array, step_s: float, temperature_degC: float) -> Array:
    """Return the voltage of the cell, from full to the lower limit, with noise of half a millivolt."""
    capacity_Ah, knots = cell.cell.capacity_Ah, np.linspace(0, 1, 201)
    soc = 1 - np.cumsum(current_A) * step_s / 3600 / capacity_Ah
    at = {key: np.interp(soc, knots, table) for key, table in cell.dynamics_at(knots, temperature_degC).items()}
    voltage_V = np.interp(soc, knots, cell.ocv_V(knots, temperature_degC))
    voltage_V = voltage_V - at["r0_ohm"] * at["r0_knee_A"] * np.arcsinh(current_A / at["r0_knee_A"])
    for j in range(cell.dynamics.n_rc):
        v = 0.0
        decay = np.exp(-step_s / at[f"tau{j + 1}_s"])
        drive_V = (1 - decay) * at[f"r{j + 1}_ohm"] * current_A
        out = np.empty(soc.size)
        for k, (a, b) in enumerate(zip(decay.tolist(), drive_V.tolist(), strict=True)):
            v = a * v + b
            out[k] = v
        voltage_V = voltage_V - out
    voltage_V = voltage_V + np.random.default_rng(4).normal(0, 5e-4, soc.size)
    rows = int(np.argmax((voltage_V < cell.cell.voltage_limits_V[0]) | (soc < 0.002))) or soc.size
    return np.asarray(voltage_V[:rows])


def write(folder: Path, cell: CellParams, tests: Sequence[LabTest]) -> Path:
    """Write the recordings of the tests and their manifest into a folder; return its path."""
    low, high = cell.cell.voltage_limits_V
    text = MANIFEST + f"voltage_limits_V = [{low}, {high}]\n"
    for role, temperature_degC, current_A, step_s in tests:
        voltage_V = measured(cell, current_A, step_s, temperature_degC)
        time_s = np.arange(voltage_V.size) * step_s
        table = np.column_stack([time_s, current_A[: voltage_V.size], voltage_V])
        file = f"{role}_{temperature_degC:g}.csv"
        np.savetxt(folder / file, table, delimiter=",", header="time_s,current_A,voltage_V", comments="", fmt="%.5f")
        text += f'[[test]]\nrole = "{role}"\nfile = "{file}"\ntemperature_degC = {temperature_degC}\n'
    (folder / "m.toml").write_text(text)
    return folder / "m.toml"


def slow_A(cell: CellParams) -> Array:
    return np.concatenate([np.zeros(5), np.full(1300, cell.cell.capacity_Ah / 20)])


def drive_A(capacity_Ah: float, seed: int) -> Array:
    """Return a load that changes every 8 s about means of one to seven minutes, down to 5 % of the charge."""
    rng = np.random.default_rng(seed)
    parts: list[Array] = []
    while sum(part.sum() for part in parts) < 0.95 * capacity_Ah * 3600:
        n = int(rng.integers(60, 400))
        fast = np.repeat(rng.normal(0, 0.5 * capacity_Ah, n // 8 + 1), 8)[:n]
        parts.append(np.clip(rng.uniform(-0.15, 1.0) * capacity_Ah + fast, -capacity_Ah, 2.5 * capacity_Ah))
    return np.concatenate(parts)


def cell_of(kind: str) -> CellParams:
    made: CellParams = synthetic_cell.cell_of(getattr(synthetic_cell, kind)())
    return made
