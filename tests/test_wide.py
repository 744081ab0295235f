"""The update of a wide belief against a quadrature of the whole posterior, and what it must survive."""

from __future__ import annotations

import math

import numpy as np
import pytest
import synthetic_cell
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_record import Record

from bms_ukf import CellParams, Fault, Tuning
from bms_ukf.kernel.adapt import VOLTAGE_ERROR_S

CELL = synthetic_cell.cell_of(synthetic_cell.nonlinear())
LINEAR = synthetic_cell.cell_of(synthetic_cell.linear())
PLAIN = {"gate_sigmas": 1e6, "adaptive": False, "current_bias": False}
ALWAYS = Tuning(wide_soc_sigma=1e-9, **PLAIN)
NEVER = Tuning(wide_soc_sigma=0.5, **PLAIN)


def believing(cell: CellParams, tuning: Tuning, x: np.ndarray, P: np.ndarray) -> Record:
    """A running record at 25 degC and 1 A, with the belief set and no voltage fused into it yet."""
    record = Record(cell, tuning)
    record.tick(0.0, 1.0, 3.5, 25.0)
    record.x, record.root = x, np.linalg.cholesky(P)
    record["voltage_age"] = VOLTAGE_ERROR_S  # the next voltage is not crowded
    record["fresh"] = 1.0
    return record


def covariance(sigmas: list[float], correlation: float) -> np.ndarray:
    P = np.outer(sigmas, sigmas)
    P[0, 1:] *= correlation
    P[1:, 0] *= correlation
    P[1, 2] = P[2, 1] = 0.3 * P[1, 2]
    return P


def exact_posterior(record: Record, x: np.ndarray, P: np.ndarray, z: float) -> tuple[np.ndarray, np.ndarray]:
    """Moments over a fine grid of SoC, the RC voltages given SoC being a Kalman update each; SoC within the tables."""
    drop = record.drop(x[0], 25.0, 1.0)
    R = CELL.noise.voltage_sigma_V**2 + ALWAYS.voltage_noise_V**2 + (CELL.noise.r0_rel_sigma * drop) ** 2
    soc = np.linspace(-0.02, 1.02, 20_001)
    slope = P[1:, 0] / P[0, 0]
    rest = P[1:, 1:] - np.outer(slope, P[0, 1:])
    H = np.array([-1.0, -1.0])
    S = H @ rest @ H + R
    K = rest @ H / S
    prior_mean = x[1:] + np.outer(soc - x[0], slope)
    g = np.array([record.ocv(s, 25.0) for s in soc]) - drop
    e = z - g - prior_mean @ H
    log_weight = -0.5 * ((soc - x[0]) ** 2 / P[0, 0] + e**2 / S)
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    points = np.column_stack([soc, prior_mean + np.outer(e, K)])
    mean = weight @ points
    away = points - mean
    spread = (weight * away.T) @ away
    spread[1:, 1:] += rest - np.outer(K, K) * S
    return mean, spread


@pytest.mark.parametrize("correlation", [0.0, -0.8, 0.5])
@pytest.mark.parametrize("voltage", [3.2, 3.45, 3.5, 3.9])
def test_the_moments_are_those_of_the_posterior(voltage, correlation):
    x, P = np.array([0.5, 0.01, 0.005]), covariance([0.2, 0.012, 0.015], correlation)
    record = believing(CELL, ALWAYS, x, P)
    mean, spread = exact_posterior(record, x, P, voltage)
    assert not record.tick(0.0, 1.0, voltage, 25.0)[1] & ~Fault.UNCERTAIN
    sigmas = np.sqrt(np.diag(spread))
    assert np.abs((record.x - mean) / sigmas).max() < 0.05
    assert np.abs((record.P - spread) / np.outer(sigmas, sigmas)).max() < 0.15


@pytest.mark.parametrize("voltage", [3.4, 3.5, 3.7])
def test_on_a_linear_cell_it_is_the_update_by_sigma_points(voltage):
    x, P = np.array([0.5, 0.01, 0.005]), covariance([0.08, 0.012, 0.015], 0.2)
    quadrature, sigma_points = (believing(LINEAR, tuning, x, P) for tuning in (ALWAYS, NEVER))
    for record in (quadrature, sigma_points):
        record.tick(0.0, 1.0, voltage, 25.0)
    sigmas = np.sqrt(np.diag(sigma_points.P))
    assert np.abs((quadrature.x - sigma_points.x) / sigmas).max() < 0.01
    assert np.abs((quadrature.P - sigma_points.P) / np.outer(sigmas, sigmas)).max() < 0.05


@settings(deadline=None, max_examples=60)
@given(
    st.floats(-0.5, 1.5),
    st.floats(0.01, 0.5),
    st.floats(1e-4, 0.2),
    st.floats(-0.99, 0.99),
    st.floats(2.5, 4.5),
    st.floats(-40, 80),
)
def test_no_belief_and_no_voltage_make_it_fail(soc, soc_sigma, rc_sigma, correlation, voltage, current):
    P = covariance([soc_sigma, rc_sigma, rc_sigma], 0.0)
    P[0, 1] = P[1, 0] = correlation * soc_sigma * rc_sigma * 0.9
    record = believing(CELL, ALWAYS, np.array([soc, 0.0, 0.0]), P)
    _, faults = record.tick(0.0, current, voltage, 25.0)
    assert not faults & Fault.NUMERIC
    assert np.diag(record.root).min() > 0
    assert 0 < record.root[0, 0] <= math.hypot(0.5, 0.1)


@pytest.mark.parametrize(("told", "truth"), [(0.8, 0.6), (0.4, 0.6), (0.3, 0.5), (0.9, 0.7), (0.7, 0.9), (0.25, 0.05)])
def test_a_start_that_is_told_wrong_by_a_sigma_becomes_right_and_is_honest_on_the_way(told, truth):
    record = Record(CELL, Tuning(initial_soc=told, initial_soc_sigma=0.2))
    v1 = v2 = 0.0
    current = 2.0
    for k in range(900):
        r1, tau1, r2, tau2 = (record.dynamics(truth, 25.0)[key] for key in ("r1_ohm", "tau1_s", "r2_ohm", "tau2_s"))
        if k > 0:
            truth -= current / 18000
            v1 += (r1 * current - v1) * -math.expm1(-1 / tau1)
            v2 += (r2 * current - v2) * -math.expm1(-1 / tau2)
        voltage = record.ocv(truth, 25.0) - v1 - v2 - record.drop(truth, 25.0, current)
        record.tick(1.0, current, voltage, 25.0)
        assert abs(record.x[0] - truth) < 3.5 * record.root[0, 0], k
        if truth < 0.03:
            break
    assert abs(record.x[0] - truth) < 0.1
