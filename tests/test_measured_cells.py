"""Shipped cells against the measurements they were made from: what their files say of themselves is so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bms_ukf import identify
from bms_ukf.cell import CellParams
from bms_ukf.identify import openloop
from bms_ukf.manifest import Manifest
from bms_ukf.replay import rerun
from bms_ukf.replay.rerun import Options
from bms_ukf.score import score

CELLS = Path(__file__).resolve().parents[1] / "models" / "cells"

# Open-loop voltage error on tests never fitted, 10 to 90 % SoC: mean over the tests of a temperature, mV.
GATES_MV = {
    "panasonic_ncr18650pf": {25: 15, 10: 22, 0: 40, -10: 58},
    "a123_lfp": {45: 12, 25: 8, 5: 12, -15: 25},
    "lgm50": {45: 12, 25: 16, 10: 24, 0: 36},
}


@pytest.mark.usefixtures("third_party")
@pytest.mark.parametrize("name", sorted(GATES_MV))
def test_a_shipped_cell_predicts_the_voltage_of_tests_never_fitted(name: str) -> None:
    path = CELLS / "manifests" / f"{name}.toml"
    cell = CellParams.load(CELLS / f"{name}.toml")
    _, chosen, _, _ = identify.load(path, Manifest.load(path))
    found_mV: dict[float, list[float]] = {}
    stated_mV = list(cell.provenance["validate_rmse_mV"].values())
    for test, stated in zip(chosen["validate"], stated_mV, strict=True):
        rmse_mV = 1e3 * openloop.predict(cell, test).rmse_V()
        assert rmse_mV == pytest.approx(stated, abs=0.1)
        found_mV.setdefault(test.test.temperature_degC, []).append(rmse_mV)
    for temperature, gate_mV in GATES_MV[name].items():
        assert np.mean(found_mV[temperature]) <= gate_mV


@pytest.mark.usefixtures("third_party")
@pytest.mark.parametrize("recording", ["25degC_Cycle_2", "25degC_US06", "10degC_US06", "0degC_US06", "n10degC_US06"])
def test_soc_is_as_good_at_the_rate_a_cell_was_recorded_at_as_once_a_second(third_party: Path, recording: str) -> None:
    cell = CellParams.load("panasonic_ncr18650pf")
    path = third_party / "panasonic_ncr18650pf" / f"{recording}.csv.gz"
    error_pct = {}
    for resample_s in (None, 1.0):
        options = Options(current_positive="charge", resample_s=resample_s)
        _, summary = rerun.rerun(rerun.load(path, options), cell, options)
        error_pct[resample_s] = summary["rmse_pct"]
    assert error_pct[None] < 1.0 + 1.5 * error_pct[1.0]
    assert error_pct[None] < 3.0


# SoC error of the estimator on the same tests, %, mean over those of a temperature. At 0 and -10 degC the reference
# itself is known to 2 and 3 %.
SOC_GATES_PCT = {
    "panasonic_ncr18650pf": {25: 1.2, 10: 1.3, 0: 2.0, -10: 4.0},
    "a123_lfp": {45: 2.5, 25: 2.0, 5: 3.0, -15: 4.0},
}


@pytest.mark.usefixtures("third_party")
@pytest.mark.parametrize("name", sorted(SOC_GATES_PCT))
def test_soc_on_tests_never_fitted_is_right_and_its_error_bar_true(name: str) -> None:
    cell = CellParams.load(CELLS / f"{name}.toml")
    summary = score(CELLS / "manifests" / f"{name}.toml", cell).summary
    ours, ekf, coulomb = (summary["estimators"][key] for key in ("srukf", "ekf", "coulomb"))
    for temperature, gate_pct in SOC_GATES_PCT[name].items():
        assert ours["temperatures"][str(temperature)]["rmse_pct"] <= gate_pct
    ours_only = [o for o in summary["outcomes"] if o["estimator"] == "srukf" and o["use"] == "validate"]
    nominal = [outcome for outcome in ours_only if outcome["case"] == "nominal"]
    held = [outcome["figures"]["coverage95"] for outcome in nominal]
    assert min(held) > 0.85
    assert np.mean(held) > 0.92
    for group in ("initial SoC", "current offset", "current offset 0.1 A"):
        error_pct = ours["groups"][group]["rmse_pct"]
        assert error_pct < 0.85 * coulomb["groups"][group]["rmse_pct"]
        assert error_pct < 1.2 * ekf["groups"][group]["rmse_pct"]  # about equal where both trust the voltage
