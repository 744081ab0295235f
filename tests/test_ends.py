"""The ends of SoC: a full or an empty cell shows in its voltage, whatever the count of the charge has come to."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic_cell
from drives import CELL

from bms_ukf import CellParams, Estimator, Tuning

PLATEAU = synthetic_cell.cell_of(synthetic_cell.plateau())


def tapered(cell: CellParams, soc: np.ndarray, current_A: np.ndarray) -> tuple[np.ndarray, ...]:
    """Time, current, voltage and temperature of a cell that follows its model, a row a second."""
    v = np.zeros(cell.dynamics.n_rc)
    voltage = []
    for z, i in zip(soc, current_A, strict=True):
        at = cell.dynamics_at(z, 25.0)
        for j in range(cell.dynamics.n_rc):
            tau, r = float(at[f"tau{j + 1}_s"]), float(at[f"r{j + 1}_ohm"])
            v[j] = r * i + (v[j] - r * i) * np.exp(-1 / tau)
        r0 = float(at["r0_charge_ohm"] if i < 0 else at["r0_ohm"])
        knee = float(at["r0_knee_A"])
        voltage.append(float(cell.ocv_V(z, 25.0)) - v.sum() - r0 * knee * np.arcsinh(i / knee))
    rows = len(voltage)
    return np.arange(rows) * 10**9, current_A, np.array(voltage), np.full(rows, 25.0)


@pytest.mark.parametrize("efficiency", [0.97, 1.0])
@pytest.mark.parametrize(("cell", "told"), [(CELL, 0.75), (CELL, 0.95), (PLATEAU, 0.85), (PLATEAU, 0.95)])
def test_a_taper_at_the_upper_limit_tells_a_full_cell_whatever_the_charge_efficiency(cell, efficiency, told):
    """From 85 % to full, the current halving every 20 minutes at the end; efficiency is only what the file says.

    The OCV of CELL rises by 3 mV in the last percent; a voltage is good for 8 mV. SoC is the mean of what is left of
    the belief below full. Of half a Gaussian at an end, that is 1.4 `soc_sigma` away from this end.
    """
    limits = cell.cell.model_copy(update={"coulombic_efficiency": efficiency})
    believed = cell.model_copy(update={"cell": limits})
    charge = cell.cell.capacity_Ah * 3600
    current, soc, z = [], [], 0.85
    while z < 0.9995:
        i = -min(0.5, max(2.0 * (1 - z), 0.02)) * cell.cell.capacity_Ah
        z -= i / charge
        current.append(i)
        soc.append(z)
    estimator = Estimator(believed, tuning=Tuning(initial_soc=told, initial_soc_sigma=0.1))
    got = estimator.replay(*tapered(cell, np.array(soc), np.array(current)))
    assert got["soc"][-1] == pytest.approx(soc[-1], abs=max(0.01, 1.6 * got["soc_sigma"][-1]))
    assert got["soc_low"][-1] > 0.96
    assert got["soc_high"][-1] > 0.999


@pytest.mark.parametrize("told", [0.05, 0.35])
def test_the_cut_off_tells_an_empty_cell(told):
    charge = CELL.cell.capacity_Ah * 3600
    current = np.full(2200, 0.3 * CELL.cell.capacity_Ah)
    soc = 0.19 - np.cumsum(current) / charge
    estimator = Estimator(CELL, tuning=Tuning(initial_soc=told, initial_soc_sigma=0.15))
    got = estimator.replay(*tapered(CELL, soc, current))
    assert got["soc"][-1] == pytest.approx(soc[-1], abs=0.01)
