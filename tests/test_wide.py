"""The update of a wide Gaussian against a quadrature of the whole posterior, and what it must survive."""

from __future__ import annotations

import math

import numpy as np
import pytest
import synthetic_cell
from hypothesis import given, settings
from hypothesis import strategies as st
from kernel_record import Record

from bms_ukf import CellParams, Fault, Filter, Tuning
from bms_ukf.kernel import layout
from bms_ukf.kernel.adapt import FAST_S
from bms_ukf.kernel.ohmic import SMALL_LOAD

CELL = synthetic_cell.cell_of(synthetic_cell.nonlinear())
LINEAR = synthetic_cell.cell_of(synthetic_cell.linear())
PLAIN = {"gate_sigmas": 1e6, "adaptive": False, "current_bias": False}
ALWAYS = Tuning(wide_soc_sigma=1e-9, **PLAIN)
NEVER = Tuning(wide_soc_sigma=0.5, **PLAIN)
X = [0.5, 0.01, 0.005, -0.002, 0.1]  # soc, v_rc1, v_rc2, v_slow, r0_error
SIGMAS = [0.012, 0.015, 0.005, 0.2]  # of all but SoC
STEP_S, STEPS = 30.0, 20


def believing(cell: CellParams, tuning: Tuning, x: list[float], P: np.ndarray, current: float = 1.0) -> Filter:
    """A filter at 25 degC that a current has polarised, with the belief then set."""
    filter_ = Filter(cell, [0.5, 0.0, 0.0, 0.0, 0.0], [0.1, *SIGMAS], tuning)
    for _ in range(STEPS):
        assert not filter_.predict(STEP_S, current, 25.0) & Fault.NUMERIC
    m = filter_._form
    filter_._state[m.x : m.root] = x
    filter_._state[m.root : m.carry] = np.linalg.cholesky(P)[np.tril_indices(m.n)]
    filter_._state[layout.H_VOLTAGE_AGE] = FAST_S  # the next voltage is not crowded
    return filter_


def fused(filter_: Filter, voltage: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance after the voltage."""
    filter_.innovate(voltage)
    assert not filter_.update() & Fault.NUMERIC
    return filter_.x, filter_.sqrt_P @ filter_.sqrt_P.T


def covariance(soc_sigma: float, correlation: float) -> np.ndarray:
    """SoC has the `correlation` with both RC voltages, which have 0.3 with each other."""
    P = np.diag([soc_sigma, *SIGMAS]) ** 2
    P[0, 1:3] = P[1:3, 0] = correlation * soc_sigma * np.array(SIGMAS[:2])
    P[0, 4] = P[4, 0] = 0.3 * soc_sigma * SIGMAS[3]
    P[1, 2] = P[2, 1] = 0.3 * SIGMAS[0] * SIGMAS[1]
    return P


def exact_posterior(filter_: Filter, x: list[float], P: np.ndarray, z: float) -> tuple[np.ndarray, np.ndarray]:
    """Moments over a fine grid of SoC, the rest given SoC being a Kalman update each; SoC within the tables."""
    record, p, held = Record(CELL, ALWAYS), filter_._params, filter_._state
    at = record.dynamics(0.5 - STEP_S * STEPS / 18000, 25.0)
    drop = record.drop(0.5 - STEP_S * STEPS / 18000, 25.0, 1.0)
    # What the last step added is not in the slope over the r0 error.
    recent = held[layout.H_RECENT] - (drop - held[layout.H_RECENT]) * STEP_S / 3.0
    after = held[layout.H_POLARISED : layout.H_POLARISED + 2]
    kept = np.array([math.exp(-STEP_S / at["tau1_s"]), math.exp(-STEP_S / at["tau2_s"])])
    before = (after - (1 - kept) * [at["r1_ohm"], at["r2_ohm"]]) / kept
    small = SMALL_LOAD * p[layout.P_STILL] * at["r0_ohm"]  # both drops are above it: an error of r0 scales the rest
    lead, now = recent - small + before.sum(), drop - small + after.sum()
    fast = (p[layout.P_FAST_REL] * (drop - recent)) ** 2
    R = (p[layout.P_VAR_VOLTAGE] + p[layout.P_FAST_VAR] + fast) / (1 + 1 / 300)
    soc = np.linspace(-0.02, 1.02, 20_001)
    x = np.array(x)
    slope = P[1:, 0] / P[0, 0]
    rest = P[1:, 1:] - np.outer(slope, P[0, 1:])
    H = np.array([-1.0, -1.0, -1.0, -lead])
    S = H @ rest @ H + R
    K = rest @ H / S
    prior_mean = x[1:] + np.outer(soc - x[0], slope)
    g = np.array([record.ocv(s, 25.0) for s in soc]) - drop - (now - lead) * x[4]
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


@pytest.mark.parametrize("correlation", [0.0, -0.6, 0.5])
@pytest.mark.parametrize("voltage", [3.2, 3.45, 3.5, 3.9])
def test_the_moments_are_those_of_the_posterior(voltage, correlation):
    P = covariance(0.2, correlation)
    filter_ = believing(CELL, ALWAYS, X, P)
    mean, spread = exact_posterior(filter_, X, P, voltage)
    x, after = fused(filter_, voltage)
    sigmas = np.sqrt(np.diag(spread))
    assert np.abs((x - mean) / sigmas).max() < 0.05
    assert np.abs((after - spread) / np.outer(sigmas, sigmas)).max() < 0.15


@pytest.mark.parametrize("voltage", [3.4, 3.5, 3.7])
def test_on_a_linear_cell_it_is_the_update_by_sigma_points(voltage):
    P = covariance(0.08, 0.2)
    (x, spread), (expected, by_points) = (fused(believing(LINEAR, t, X, P), voltage) for t in (ALWAYS, NEVER))
    sigmas = np.sqrt(np.diag(by_points))
    assert np.abs((x - expected) / sigmas).max() < 0.01
    assert np.abs((spread - by_points) / np.outer(sigmas, sigmas)).max() < 0.05


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
    P = np.diag([soc_sigma, rc_sigma, rc_sigma, *SIGMAS[2:]]) ** 2
    P[0, 1] = P[1, 0] = correlation * soc_sigma * rc_sigma * 0.9
    filter_ = believing(CELL, ALWAYS, [soc, 0.0, 0.0, 0.0, 0.0], P, current)
    fused(filter_, voltage)
    root = filter_.sqrt_P
    assert np.diag(root).min() > 0
    assert 0 < root[0, 0] <= math.hypot(0.5, 0.1)


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
