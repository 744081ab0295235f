"""A larger cell of the same family behaves as so many of the small one in parallel."""

from __future__ import annotations

import pytest

from bms_ukf import CellParams, Estimator, Sample
from bms_ukf.scaling import scaled


@pytest.mark.parametrize("name", ["lgm50_chen2020", "panasonic_ncr18650pf", "a123_lfp"])
def test_so_many_times_the_current_gives_the_same_soc_and_voltage(name: str) -> None:
    cell = CellParams.load(name)
    small, large = Estimator(cell), Estimator(scaled(cell, 35.0))
    for k in range(300):
        current_A = 1.5 if k % 40 > 10 else 0.0
        measured = {"voltage_V": float(cell.ocv_V(0.5, 20.0)), "temperature_degC": 20.0} if k % 7 == 0 else {}
        one = small.step(Sample(k * 10**9, current_A, **measured))
        other = large.step(Sample(k * 10**9, 35.0 * current_A, **measured))
        assert other.soc == pytest.approx(one.soc, abs=1e-6, nan_ok=True)
        assert other.voltage_pred_V == pytest.approx(one.voltage_pred_V, abs=1e-5, nan_ok=True)
    assert 0.0 < one.soc < 1.0


def test_capacity_and_resistance_are_scaled_apart_if_asked_for(cell: CellParams) -> None:
    made = scaled(cell, 2.0, 0.8)
    assert made.cell.capacity_Ah == pytest.approx(2 * cell.cell.capacity_Ah)
    assert made.dynamics.r1_ohm[0][0] == pytest.approx(0.8 * cell.dynamics.r1_ohm[0][0])
    assert made.dynamics.tau1_s == cell.dynamics.tau1_s
    assert made.ocv == cell.ocv
