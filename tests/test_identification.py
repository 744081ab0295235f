"""The shipped cell file against the plant it was identified from, and the fit that made it against known tables."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from bms_ukf.cell import CellParams
from bms_ukf.plant import open_plant

ROOT = Path(__file__).resolve().parents[1]
FMU = ROOT / "models" / "plants" / "lgm50_spme.fmu"
SECOND = 1_000_000_000


@pytest.fixture(scope="module")
def cell():
    return CellParams.load("lgm50_chen2020")


@pytest.fixture(scope="module")
def ecm_fit():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "models" / "cells")
        import ecm_fit

        yield ecm_fit
        del sys.modules["ecm_fit"]


def test_the_open_circuit_voltage_is_the_plant_s_within_half_a_millivolt(cell):
    for soc in np.linspace(0.02, 1.0, 25):
        with open_plant(FMU, parameters={"soc_initial": float(soc)}) as plant:
            assert plant.state.voltage_V == pytest.approx(float(cell.ocv_V(soc, 25.0)), abs=5e-4)


def test_the_capacity_is_the_charge_the_plant_s_soc_counts(cell):
    with open_plant(FMU, parameters={"soc_initial": 0.9}) as plant:
        drawn = plant.state.soc - plant.step(2.5, 3600 * SECOND).soc
    assert cell.cell.capacity_Ah == pytest.approx(2.5 / drawn, rel=1e-4)


@pytest.mark.parametrize(("ambient_degC", "limit_V"), [(25.0, 0.004), (0.0, 0.008)])
def test_the_circuit_follows_the_plant_open_loop_on_a_load_it_never_saw(cell, ambient_degC, limit_V):
    load = np.random.default_rng(7).normal(1.2, 2.5, 400).clip(-4, 9).repeat(4)
    soc, slow, errors = 0.8, np.zeros(2), []
    with open_plant(FMU, parameters={"soc_initial": soc}, ambient_degC=ambient_degC) as plant:
        for current_A in load:
            state = plant.step(current_A, SECOND)
            soc -= current_A / 3600 / cell.cell.capacity_Ah
            at = {key: float(value) for key, value in cell.dynamics_at(soc, state.temperature_degC).items()}
            fade = np.exp(-1 / np.array([at["tau1_s"], at["tau2_s"]]))
            slow = fade * slow + (1 - fade) * np.array([at["r1_ohm"], at["r2_ohm"]]) * current_A
            drop = at["r0_ohm"] * at["r0_knee_A"] * np.arcsinh(current_A / at["r0_knee_A"])
            predicted = float(cell.ocv_V(soc, state.temperature_degC)) - slow.sum() - drop
            errors.append(predicted - state.voltage_V)
    assert np.sqrt(np.mean(np.square(errors))) < limit_V


def test_the_fit_finds_the_tables_that_made_a_recording(ecm_fit):
    soc_knots, temperatures = np.array([0.0, 0.5, 1.0]), np.array([0.0, 30.0])
    r0 = np.array([[0.05, 0.03, 0.04], [0.03, 0.02, 0.025]])
    r_ohm, knee_A, tau_s = np.stack([r0, 0.4 * r0, 0.6 * r0]), np.array([2.0, 6.0]), np.array([20.0, 250.0])
    truth = ecm_fit.Tables(soc_knots, temperatures, r_ohm, knee_A, tau_s)

    def ocv(soc):
        return 3.0 + soc

    recordings = []
    rng = np.random.default_rng(0)
    for ambient in (2.0, 28.0):
        current_A = rng.normal(1.5, 3.0, 1200).repeat(8)
        step_s = np.ones_like(current_A)
        soc = 1 - np.cumsum(current_A) / 3600 / 5
        record = ecm_fit.Recording(ambient, step_s, current_A, soc, np.full_like(soc, ambient), soc)
        record.voltage_V = truth.simulate(record, ocv)
        recordings.append(record)
    guess = np.full((3, 2, 3), 0.01), np.full(2, 3.0), np.array([10.0, 400.0])
    start = ecm_fit.Tables(soc_knots, temperatures, *guess)
    found = ecm_fit.fit(recordings, ocv, start, keep=1, roughness_mV=0.0)
    np.testing.assert_allclose(found.r_ohm, truth.r_ohm, rtol=1e-3)
    np.testing.assert_allclose(found.knee_A, truth.knee_A, rtol=1e-2)
    np.testing.assert_allclose(found.tau_s, truth.tau_s, rtol=1e-3)
