"""The estimators that ours is compared with: each is what its textbook says."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic_cell
from drives import terminal

from bms_ukf import CellParams, Estimator, Tuning
from bms_ukf.offline.estimators import prepare
from bms_ukf.offline.signals import Signals, Told
from bms_ukf.offline.start import NO_REST_SIGMA, from_first_voltage

LINEAR = synthetic_cell.cell_of(synthetic_cell.linear())


def signals(rows: int = 600, *, seed: int = 1, dt_s: float = 1.0) -> Signals:
    rng = np.random.default_rng(seed)
    current_A = np.clip(2 + 3 * rng.standard_normal(rows), -5, 10)
    voltage_V = 3.8 - 0.02 * current_A - 2e-4 * np.arange(rows) + 0.003 * rng.standard_normal(rows)
    voltage_V[50:60] = np.nan
    return Signals(dt_s * np.arange(rows), current_A, voltage_V, np.full(rows, 25.0))


def kalman(cell: CellParams, given: Signals, told: Told) -> tuple[np.ndarray, np.ndarray]:
    """SoC and sigma by the Kalman filter's five equations with dense matrices, for a cell that is linear."""
    at = {key: float(value) for key, value in cell.dynamics_at(0.5, 25.0).items()}
    noise, Q_As, tuning = cell.noise, 3600 * cell.cell.capacity_Ah, Tuning()
    r, tau = np.array([at["r1_ohm"], at["r2_ohm"]]), np.array([at["tau1_s"], at["tau2_s"]])
    own_var = np.array([noise.v_rc1_sigma_V, noise.v_rc2_sigma_V]) ** 2
    offset_A, gain = cell.cell.capacity_Ah / 50 / 1.96, np.hypot(0.005 / 1.96, 0.05)
    first = given.current_A[0]
    x = np.array([told.soc, *(r * first / 2)])
    P = np.diag([told.sigma**2, *(own_var + r**2 * ((cell.cell.capacity_Ah / 20) ** 2 + first**2 / 4))])
    H = np.array([1.0, -1.0, -1.0])  # 1 V from empty to full
    found = []
    for k, i in enumerate(given.current_A):
        dt = given.step_s[k]
        a = np.exp(-dt / tau)
        efficiency = cell.cell.coulombic_efficiency if i < 0 else 1.0
        shift = offset_A * np.array([r[0], r[1] + at["r0_ohm"]])
        walk = ((offset_A / Q_As) ** 2 + (gain * i / Q_As) ** 2) * tuning.current_error_horizon_s
        F = np.diag([1.0, *a])
        x = F @ x + np.array([-efficiency * i * dt / Q_As, *((1 - a) * r * i)])
        P = F @ P @ F.T + np.diag([walk * dt, *((1 - a**2) * (own_var + (noise.rc_rel_sigma * r * i) ** 2 + shift**2))])
        if np.isfinite(given.voltage_V[k]):
            drop = at["r0_ohm"] * i
            R = noise.voltage_sigma_V**2 + tuning.voltage_noise_V**2 + (noise.r0_rel_sigma * drop) ** 2
            K = P @ H / (H @ P @ H + R)
            x = x + K * (given.voltage_V[k] - (3.0 + H @ x - drop))
            P = (np.eye(3) - np.outer(K, H)) @ P
        found.append((x[0], np.sqrt(P[0, 0])))
    return np.array(found).T


def test_on_a_linear_cell_the_ekf_is_the_kalman_filter() -> None:
    given, told = signals(), Told(0.7, 0.1)
    soc, sigma = kalman(LINEAR, given, told)
    found = prepare("ekf", LINEAR, Tuning(gate_sigmas=1e6))(given, told)
    assert found["soc"] == pytest.approx(soc, abs=1e-9)
    assert found["soc_sigma"] == pytest.approx(sigma, rel=1e-6)


@pytest.mark.parametrize("at_first", [0.7, 0.71])
def test_on_a_linear_cell_ours_and_the_ekf_agree_but_for_errors_that_last(at_first: float) -> None:
    """Same circuit, sensors and start, and voltages of that circuit: no error lasts, and the two need not differ.

    Ours doubts the curve, the resistances and the start, too, so it is the wider.
    """
    given, told = signals(), Told(0.7, 0.015)
    soc, voltage_V = terminal(LINEAR, at_first, given.current_A)
    given.voltage_V[:] = voltage_V + 0.003 * np.random.default_rng(1).standard_normal(len(voltage_V))
    tuning = Tuning(gate_sigmas=1e6, current_bias=False, adaptive=False)
    ours, ekf = (prepare(name, LINEAR, tuning)(given, told) for name in ("srukf", "ekf"))
    apart = np.abs(ours["soc"] - ekf["soc"])
    assert np.all(apart < ours["soc_sigma"])
    assert np.all(apart < 0.01)
    assert np.all(ours["soc_sigma"] > ekf["soc_sigma"])
    assert np.all(ours["soc_sigma"] < 0.025)
    for found in (ours, ekf):
        assert np.all(np.abs(found["soc"] - soc) < 1.5 * found["soc_sigma"])


def test_the_ekf_refuses_an_outlier_and_finds_its_way_when_it_was_soc_that_was_wrong() -> None:
    given = signals()
    right = prepare("ekf", LINEAR)(given, Told(0.7, 0.1))["soc"]
    outlier = given.with_errors()
    outlier.voltage_V[300] += 0.5
    assert prepare("ekf", LINEAR)(outlier, Told(0.7, 0.1))["soc"][300] == pytest.approx(right[300], abs=1e-3)
    wrong = prepare("ekf", LINEAR)(given, Told(0.2, 0.001))["soc"]
    assert wrong[20] == pytest.approx(0.2, abs=0.02)
    assert wrong[-1] == pytest.approx(right[-1], abs=0.05)  # it was off by 0.5


def test_ours_is_the_estimator_and_nothing_else(cell: CellParams) -> None:
    given = signals()
    found = prepare("srukf", cell)(given, Told(0.6, 0.1))
    estimator = Estimator(cell, tuning=Tuning(initial_soc=0.6, initial_soc_sigma=0.1))
    expected = estimator.replay(given.t_ns, given.current_A, given.voltage_V, given.temperature_degC)
    np.testing.assert_array_equal(found["soc"], expected["soc"])


def test_ours_counts_all_charge_of_rows_far_apart(cell: CellParams) -> None:
    """A recording's current is the mean over its interval, however long: it is not one that has timed out."""
    hour = Signals(np.arange(0, 3601, 60.0), np.full(61, 1.0), np.full(61, np.nan), np.full(61, 25.0))
    hour.voltage_V[0] = float(cell.ocv_V(0.8, 25.0))
    soc = prepare("srukf", cell, Tuning(current_bias=False))(hour, Told(0.8, 0.001))["soc"]
    assert soc[0] - soc[-1] == pytest.approx(1 / cell.cell.capacity_Ah, rel=1e-6)


def test_coulomb_counting_is_exact_at_any_interval_and_counts_what_charging_loses() -> None:
    time_s = np.array([0.0, 1.0, 1.5, 61.5, 100.0])
    current_A = np.array([9.0, 2.0, -4.0, 3.0, -1.0])  # what flowed before the first row is not of the recording
    given = Signals(time_s, current_A, np.full(5, 3.7), np.full(5, 25.0))
    found = prepare("coulomb", LINEAR)(given, Told(0.5, 0.02))
    moved_As = np.cumsum([0.0, 2.0, -4.0 * 0.5 * 0.99, 180.0, -38.5 * 0.99])
    assert found["soc"] == pytest.approx(0.5 - moved_As / 18000, abs=1e-12)
    assert found["soc_sigma"][0] == 0.02
    assert np.all(np.diff(found["soc_sigma"]) > 0)


@pytest.mark.parametrize("soc", [0.1, 0.5, 0.9])
def test_the_first_voltage_at_rest_gives_the_soc_and_a_band_that_holds_it(cell: CellParams, soc: float) -> None:
    rest = Signals(np.arange(20.0), np.zeros(20), np.full(20, float(cell.ocv_V(soc, 25.0))), np.full(20, 25.0))
    told = from_first_voltage(cell, rest, Tuning())
    assert abs(told.soc - soc) < 2 * told.sigma
    assert told.sigma < 0.1
    assert from_first_voltage(cell, rest.with_errors(5.0), Tuning()).sigma == NO_REST_SIGMA
