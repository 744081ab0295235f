"""Cells of known tables, tested at three temperatures: no row makes up for another, and no pair for a slower one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import synthetic_cell
from lab_tests import drive_A, pulse_load_A, slow_A, write

from bms_ukf import identify
from bms_ukf.cell import CellParams


def transferring(activation_K: float, knee_A: float) -> CellParams:
    """Return a cell of 5 Ah with r0 of a charge transfer: r0 times knee is the same everywhere. Nothing heats it."""
    data = synthetic_cell.nonlinear()
    rows, knots = [0.0, 25.0, 45.0], np.array([0.0, 0.2, 1.0])
    factor = [float(np.exp(activation_K * (1 / (T + 273.15) - 1 / 298.15))) for T in rows]

    def table(value: float, power: float) -> list[list[float]]:
        return [[value * f**power] * knots.size for f in factor]

    data["dynamics"] = {
        "soc": knots.tolist(),
        "temperature_degC": rows,
        "r0_ohm": table(0.03, 1.0),
        "r0_knee_A": table(knee_A, -1.0),
        "r1_ohm": table(0.01, 0.7),
        "tau1_s": table(60.0, 0.0),
    }
    data["noise"] = {key: value for key, value in data["noise"].items() if "rc2" not in key}
    return synthetic_cell.cell_of(data)


@pytest.mark.parametrize(("activation_K", "knee_A"), [(6000.0, 2.0), (3000.0, 6.0), (1000.0, 20.0)])
def test_r0_of_every_tested_temperature_is_that_of_the_pulses(
    tmp_path: Path, activation_K: float, knee_A: float
) -> None:
    """Pulses of one size tell r0 and knee only together; a row that shares them out at will is off by many times."""
    truth = transferring(activation_K, knee_A)
    tests = [("ocv", 25.0, slow_A(truth), 60.0), ("drive", 25.0, drive_A(5.0, 2), 1.0)]
    tests += [("pulse", T, pulse_load_A(5.0), 1.0) for T in (0.0, 25.0, 45.0)]
    found = identify.run(write(tmp_path, truth, tests))
    assert found.model.unknowns.structure.core is None
    for T in (0.0, 25.0, 45.0):
        ours, true = (cell.dynamics_at(0.5, T) for cell in (found.cell, truth))
        for current_A in (1.0, 5.0):
            drops = [
                float(at["r0_knee_A"] * np.arcsinh(current_A / at["r0_knee_A"]) * at["r0_ohm"]) for at in (ours, true)
            ]
            assert drops[0] == pytest.approx(drops[1], rel=0.3)
        assert 1 / 1.6 < float(ours["r0_ohm"] / true["r0_ohm"]) < 1.6


@pytest.mark.parametrize("slow_tau_s", [None, 2500.0])
def test_a_slow_pair_is_added_where_there_is_one(tmp_path: Path, slow_tau_s: float | None) -> None:
    data = synthetic_cell.linear()
    data["dynamics"] |= {"tau2_s": [[90.0, 90.0]]}
    if slow_tau_s:
        data["dynamics"] |= {"r3_ohm": [[0.03, 0.03]], "tau3_s": [[slow_tau_s, slow_tau_s]]}
        data["noise"] |= {"v_rc3_sigma_V": 0.004}
    truth = synthetic_cell.cell_of(data)
    tests = [("ocv", 25.0, slow_A(truth), 60.0), ("drive", 25.0, drive_A(5.0, 2), 1.0)]
    found = identify.run(write(tmp_path, truth, [*tests, ("pulse", 25.0, pulse_load_A(5.0), 1.0)]))
    dynamics = found.cell.dynamics_at(0.5, 25.0)
    assert found.cell.dynamics.n_rc == (3 if slow_tau_s else 2)
    if slow_tau_s:
        assert 1 / 2 < float(dynamics["tau3_s"]) / slow_tau_s < 2
        assert float(dynamics["r3_ohm"]) == pytest.approx(0.03, rel=0.5)
