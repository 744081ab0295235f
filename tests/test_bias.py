"""What tells the current sensor's offset, how much of it is believed, and what is not taken for one."""

from __future__ import annotations

import math

import numba
import numpy as np
import pytest
import synthetic_cell
from drives import CELL

from bms_ukf import Estimate, Estimator, Fault, Sample, Tuning
from bms_ukf.kernel import layout, srukf
from bms_ukf.kernel.layout import form, form_at_compile_time
from bms_ukf.kernel.memory import pointer

SIGMA_A = CELL.cell.capacity_Ah / 50 / 1.96  # of an offset, before anything is known of it
NAN = math.nan


def shown(estimator: Estimator, current_A: float, seconds: range, **sample: object) -> Estimate:
    """The estimate after so many seconds of a current that stands still; a voltage at first only."""
    for k in seconds:
        voltage = float(CELL.ocv_V(0.6, 25.0)) if k == 0 else NAN
        estimate = estimator.step(Sample(k * 10**9, current_A, voltage, 25.0, **sample))
    return estimate


def test_an_open_contactor_tells_the_offset_with_one_sample():
    estimator = Estimator(CELL)
    estimator.step(Sample(0, 2.0, 3.5, 25.0))
    estimate = estimator.step(Sample(10**9, 0.08, NAN, 25.0, open_circuit=True))
    assert estimate.current_bias_A == pytest.approx(0.08, rel=0.02)
    later = estimator.step(Sample(2 * 10**9, 2.0, NAN, 25.0))
    assert later.current_bias_A == pytest.approx(0.08, rel=0.02)


def test_behind_an_open_contactor_soc_stands_still_with_and_without_a_bias_state():
    for tuning in (Tuning(), Tuning(current_bias=False)):
        estimator = Estimator(CELL, tuning=tuning)
        first = shown(estimator, 0.1, range(1), open_circuit=True)
        before = first.soc
        after = shown(estimator, 0.1, range(1, 3600), open_circuit=True)
        assert abs(after.soc - before) < 1e-3, tuning  # an hour of 0.1 A is 2 %


@pytest.mark.parametrize("bias", [True, False])
def test_behind_an_open_contactor_a_current_that_was_held_flows_no_more(bias):
    estimator = Estimator(CELL, tuning=Tuning(current_bias=bias))
    before = shown(estimator, 3.0, range(5)).soc
    after = shown(estimator, NAN, range(5, 3600), open_circuit=True)
    assert after.soc == pytest.approx(before, abs=1e-6)
    assert not after.faults & Fault.CURRENT_MISSING


@pytest.mark.parametrize("reading", [1e6, -math.inf])
def test_a_reading_that_no_sensor_gives_is_no_offset(reading):
    estimator, without = (Estimator(CELL) for _ in range(2))
    for each in (estimator, without):
        each.step(Sample(0, 0.0, 3.5, 25.0))
    told = estimator.step(Sample(10**9, reading, NAN, 25.0, open_circuit=True))
    expected = without.step(Sample(10**9, reading, NAN, 25.0))
    assert not told.faults & Fault.NUMERIC
    assert told.current_bias_A == expected.current_bias_A


def driven(estimator: Estimator, segments: list[tuple[float, int]], start_s: int = 0) -> Estimate:
    """The estimate after segments of so many seconds of a current, a voltage at first only."""
    second = start_s
    for current_A, seconds in segments:
        estimate = shown(estimator, current_A, range(second, second + seconds))
        second += seconds
    return estimate


def test_a_reading_that_comes_back_after_a_load_is_an_offset_and_the_first_of_them_tells_nothing():
    estimator, rest, load = Estimator(CELL), (0.04, 150), (2.0, 30)
    assert abs(driven(estimator, [rest]).current_bias_A) < 0.05 * SIGMA_A
    before = driven(estimator, [load, (0.04, 119)], 150)
    assert abs(before.current_bias_A) < 0.05 * SIGMA_A
    told = driven(estimator, [(0.04, 3)], 299)
    assert told.current_bias_A == pytest.approx(0.04, rel=0.15)
    after = driven(estimator, [(0.04, 300)], 302)
    assert after.current_bias_A == pytest.approx(told.current_bias_A, rel=0.08)  # one rest is one reading


def test_a_slow_discharge_is_not_taken_for_rest_however_long_it_is():
    slow_A = CELL.cell.capacity_Ah / 30
    assert abs(driven(Estimator(CELL), [(slow_A, 20_000)]).current_bias_A) < 0.05 * SIGMA_A


def test_rests_that_differ_tell_nothing():
    estimate = driven(Estimator(CELL), [(0.04, 150), (2.0, 30), (0.08, 150), (2.0, 30), (0.12, 150)])
    assert abs(estimate.current_bias_A) < 0.05 * SIGMA_A


def test_a_reading_that_comes_back_without_a_load_between_tells_nothing():
    estimate = driven(Estimator(CELL), [(0.04, 150), (0.1, 20), (0.04, 150), (0.1, 20), (0.04, 150)])
    assert abs(estimate.current_bias_A) < 0.05 * SIGMA_A


@pytest.mark.parametrize("load_A", [2.6 * SIGMA_A, -2.6 * SIGMA_A, 1.0])
def test_a_load_larger_than_any_offset_is_not_taken_for_one_though_it_comes_back(load_A):
    estimate = driven(Estimator(CELL), [(load_A, 150), (3.0, 30), (load_A, 150), (3.0, 30), (load_A, 150)])
    assert abs(estimate.current_bias_A) < 0.05 * SIGMA_A


def test_a_current_that_moves_is_no_rest():
    estimator, step_A = Estimator(CELL), CELL.cell.capacity_Ah / 350  # more than what counts as standing still
    for k in range(900):
        reading = 2.0 if 300 <= k % 450 < 330 else 0.04 + 0.5 * step_A * (-1) ** k
        estimate = estimator.step(Sample(k * 10**9, reading, 3.5 if k == 0 else NAN, 25.0))
    assert abs(estimate.current_bias_A) < 0.1 * SIGMA_A


@numba.njit
def _update(w: int, y: int) -> None:
    m = form_at_compile_time(2, 0, 1, 0, 1, 0, 0)
    srukf.update(pointer(w, 64), pointer(y, 64), 0, m)


def updated(trust: float, seed: int) -> tuple[np.ndarray, ...]:
    """x and P before and after a random measurement, with the textbook's gain and innovation variance."""
    m, rng = form(2, False, True, False, 1, False), np.random.default_rng(seed)
    n = m.n
    root = np.tril(rng.standard_normal((n, n)))
    root[np.diag_indices(n)] = np.abs(np.diag(root)) + 0.1
    H, r, innovation = rng.standard_normal(n), rng.uniform(0.01, 1.0), rng.standard_normal()
    w, y = np.zeros(m.carry), np.zeros(layout.VALUES)
    before = w[m.x : m.root] = rng.standard_normal(n)
    before = before.copy()
    w[m.root :] = root[np.tril_indices(n)]
    y[layout.Y_FUSE], y[layout.Y_ALPHA], y[layout.Y_INNOVATION] = layout.BY_SIGMA_POINTS, r, innovation
    y[layout.Y_B : layout.Y_B + n], y[layout.Y_TRUST] = H @ root, trust
    _update(w.ctypes.data, y.ctypes.data)
    after = np.zeros((n, n))
    after[np.tril_indices(n)] = w[m.root :]
    assert np.diag(after).min() > 0
    P = root @ root.T
    S = H @ P @ H + r
    return before, P, w[m.x : m.root], after @ after.T, P @ H / S, np.array([S, innovation])


@pytest.mark.parametrize("seed", range(5))
def test_a_bias_that_trusts_the_voltage_wholly_is_that_of_a_kalman_filter(seed):
    x, P, x_new, P_new, K, (S, innovation) = updated(1.0, seed)
    np.testing.assert_allclose(x_new, x + K * innovation, rtol=0, atol=1e-12)
    np.testing.assert_allclose(P_new, P - np.outer(K, K) * S, rtol=0, atol=1e-11)


@pytest.mark.parametrize("seed", range(5))
def test_a_bias_that_trusts_nothing_is_considered_and_not_estimated(seed):
    """The Schmidt-Kalman filter: the other states are updated as ever, the bias and its variance stay."""
    x, P, x_new, P_new, K, (S, innovation) = updated(0.0, seed)
    np.testing.assert_allclose(x_new[:-1], (x + K * innovation)[:-1], rtol=0, atol=1e-12)
    assert x_new[-1] == x[-1]
    expected = P - np.outer(K, K) * S
    expected[-1, -1] = P[-1, -1]
    np.testing.assert_allclose(P_new, expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("trust", [0.05, 0.3, 0.9])
def test_the_variance_of_the_bias_is_that_of_the_gain_it_took(trust):
    """Joseph's form holds for any gain: a share of the gain must not leave the variance of the whole."""
    x, P, x_new, P_new, K, (S, innovation) = updated(trust, 11)
    taken = K * ([1.0] * (len(K) - 1) + [trust])
    np.testing.assert_allclose(x_new, x + taken * innovation, rtol=0, atol=1e-12)
    PH = K * S
    joseph = P - np.outer(taken, PH) - np.outer(PH, taken) + np.outer(taken, taken) * S
    np.testing.assert_allclose(P_new, joseph, rtol=0, atol=1e-11)
    assert P[-1, -1] - P_new[-1, -1] == pytest.approx((1 - (1 - trust) ** 2) * K[-1] ** 2 * S, rel=1e-9)


@pytest.mark.parametrize("rate_hz", [1, 10])
def test_ten_hours_at_rest_on_a_plateau_neither_move_a_belief_nor_make_it_sure(rate_hz):
    cell = synthetic_cell.cell_of(synthetic_cell.plateau())
    steps = 36_000 * rate_hz
    noise = 0.001 * np.random.default_rng(rate_hz).standard_normal(steps)
    t_ns = np.arange(steps) * (10**9 // rate_hz)
    voltage = float(cell.ocv_V(0.45, 25.0)) + noise
    got = Estimator(cell).replay(t_ns, np.zeros(steps), voltage, np.full(steps, 25.0))
    soc, sigma = got["soc"][5 * rate_hz :], got["soc_sigma"][5 * rate_hz :]
    assert sigma[0] > 0.1
    assert np.ptp(soc) < 0.5 * sigma[0]
    # The fast errors of many readings cancel out in an hour or two. Those that last do not: by them SoC stays in doubt.
    settled = slice(7200 * rate_hz, None)
    assert sigma.min() > 0.5 * sigma[0]
    assert sigma[settled].min() > 0.9 * sigma[settled][0]
    assert np.ptp(soc[settled]) < 0.1 * sigma[settled][0]
