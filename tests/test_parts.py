"""A belief of any shape: components against a dense grid, how they are cut and merged, when a Gaussian takes over."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numba
import numpy as np
import pytest
from dense_belief import DenseBelief
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_ukf import CellParams, Estimator, Fault, Sample, Status, Tuning
from bms_ukf.campaign import traces
from bms_ukf.kernel import layout, pieces
from bms_ukf.kernel.layout import form, form_at_compile_time
from bms_ukf.kernel.memory import beyond, pointer

CELL = CellParams.load("lgm50_chen2020")
SECOND = 10**9
POINTS = 2001
VARIANT = form(2, 0, 1, 0, 1, 0, layout.PART_LANES).variant
N = form(*VARIANT).n

# A trace, the row at which it is cut, and what the cell does there.
STARTS = {
    "at rest for hours": ("lgm50_spme/drive_25degC", 300),
    "under a constant load": ("lgm50_spme/constant_25degC", 8300),
    "in mid-drive": ("lgm50_spme/drive_25degC", 9000),
    "while it is charged": ("lgm50_spme/charge_25degC", 9500),
    "in the cold": ("lgm50_spme/drive_n10degC", 14_000),
}


def recorded(name: str, first: int, rows: int) -> traces.Trace:
    trace = traces.load(name)
    here = slice(first, first + rows)
    return trace._replace(
        current_A=trace.current_A[here],
        voltage_V=trace.voltage_V[here],
        temperature_degC=trace.temperature_degC[here],
        soc=trace.soc[here],
    )


def replayed(trace: traces.Trace, tuning: Tuning | None = None) -> dict[str, np.ndarray]:
    t_ns = np.arange(len(trace.current_A)) * round(trace.step_s * 1e9)
    estimator = Estimator(CELL, tuning=tuning)
    return estimator.replay(t_ns, trace.current_A, trace.voltage_V[:, 0], trace.temperature_degC)


@pytest.mark.parametrize("start", STARTS)
def test_bounds_are_those_of_a_dense_grid(start):
    """Within 0.3 % SoC, or an eighth of the interval where that is more.

    In the first minute the histories lose their weight, and then bounds in a flat tail may differ by more.
    """
    trace = recorded(*STARTS[start], 241)
    estimate = replayed(trace, Tuning(adaptive=False))
    current, voltage, degC = trace.current_A, trace.voltage_V[:, 0], trace.temperature_degC
    dense = DenseBelief(CELL, current[0], voltage[0], degC[0], POINTS)
    for row in range(1, len(current)):
        dense.step(1.0, current[row], voltage[row], degC[row])
        if row in {120, 240}:
            low, high = dense.bounds()
            close = max(0.003, (high - low) / 8)
            assert estimate["soc_low"][row] == pytest.approx(low, abs=close), row
            assert estimate["soc_high"][row] == pytest.approx(high, abs=close), row


@pytest.mark.parametrize("start", STARTS)
def test_the_truth_is_inside_from_the_first_row_on(start):
    trace = recorded(*STARTS[start], 1800)
    estimate = replayed(trace)
    truth = trace.soc[:, 0]
    assert np.mean((estimate["soc_low"] <= truth) & (truth <= estimate["soc_high"])) > 0.97


def test_a_gaussian_that_takes_over_moves_no_bound_by_more_than_a_tenth_of_a_percent():
    trace = recorded(*STARTS["in mid-drive"], 1500)
    estimator, components = Estimator(CELL), Estimator(CELL)
    row, never_narrow = 0, components._params.copy()
    never_narrow[layout.P_WIDE_SIGMA] = 0.0
    noise = np.random.default_rng(1).normal(0, 0.001, len(trace.current_A))
    for row, (current, voltage, degC) in enumerate(
        zip(trace.current_A, trace.voltage_V[:, 0] + noise, trace.temperature_degC, strict=True)
    ):
        before, sample = estimator.snapshot(), Sample(row * SECOND, float(current), float(voltage), float(degC))
        gaussian = estimator.step(sample)
        if estimator._state[0, layout.H_PARTS, 0] == 0:
            break
    assert 0 < row < 1400
    components.restore(before)
    components._params[:] = never_narrow
    kept = components.step(sample)
    assert components._state[0, layout.H_PARTS, 0] > 0
    bounds = [(estimate.soc_low, estimate.soc, estimate.soc_high) for estimate in (gaussian, kept)]
    assert 0 < np.abs(np.subtract(*bounds)).max() < 0.001


def test_a_voltage_refused_for_half_a_minute_leaves_a_wide_belief_that_says_so():
    estimator = Estimator(CELL)
    voltage = float(CELL.ocv_V(0.8, 25.0))
    for k in range(1200):
        estimator.step(Sample(k * SECOND, 0.0, voltage, 25.0))
    for k in range(1200, 1240):
        estimate = estimator.step(Sample(k * SECOND, 0.0, float(CELL.ocv_V(0.4, 25.0)), 25.0))
        if Fault.INNOVATION_REJECTED not in estimate.faults:
            break
    assert k in range(1229, 1233)
    assert estimate.soc_low < 0.4 < estimate.soc_high
    assert estimate.status is not Status.OK or estimate.soc_high - estimate.soc_low < 0.2


def test_a_gap_in_a_drive_widens_the_belief_by_all_that_may_have_flowed():
    trace = recorded(*STARTS["in mid-drive"], 2400)
    estimator = Estimator(CELL)
    for row in [*range(900), *range(2000, 2010)]:
        estimate = estimator.step(
            Sample(
                row * SECOND,
                float(trace.current_A[row]),
                float(trace.voltage_V[row, 0]),
                float(trace.temperature_degC[row]),
            )
        )
        if row == 899:
            before = estimate.soc_high - estimate.soc_low
        if row == 2000:
            widest = estimate.soc_high - estimate.soc_low
        if row >= 2000:
            assert estimate.soc_low <= trace.soc[row, 0] <= estimate.soc_high
    assert widest > 3 * before


def test_a_belief_in_components_goes_on_bit_for_bit_from_its_snapshot():
    trace = recorded(*STARTS["in mid-drive"], 40)
    samples = [
        Sample(row * SECOND, float(trace.current_A[row]), float(trace.voltage_V[row, 0]), 25.0) for row in range(40)
    ]
    estimator, other = Estimator(CELL), Estimator(CELL)
    for sample in samples[:20]:
        estimator.step(sample)
    assert estimator._state[0, layout.H_PARTS, 0] == 1
    other.restore(estimator.snapshot())
    for sample in samples[20:]:
        assert estimator.step(sample) == other.step(sample)


def test_a_cell_of_a_pack_has_the_components_of_a_cell_alone():
    trace = recorded(*STARTS["under a constant load"], 90)
    alone, pack = Estimator(CELL), Estimator(CELL, cells=20)
    for row in range(90):
        voltage, current = float(trace.voltage_V[row, 0]), float(trace.current_A[row])
        one = alone.step(Sample(row * SECOND, current, voltage, 25.0))
        many = pack.step(Sample(row * SECOND, current, np.full(20, voltage), np.full(20, 25.0)))
        for name in ("soc", "soc_low", "soc_high"):
            assert getattr(many, name) == pytest.approx(np.full(20, getattr(one, name)), abs=1e-9)


@functools.cache
def summed() -> Callable[..., None]:
    """Cut Gaussians into intervals, then gather all of them: writes mean and root of the sum."""
    n_rc, hysteresis, bias, core, lanes, compensated, part_lanes = VARIANT
    size = form(*VARIANT).size

    @numba.njit
    def run(records: int, count: int, masses: int, sums: int, low: float, width: float, out: int) -> None:
        m = form_at_compile_time(n_rc, hysteresis, bias, core, lanes, compensated, part_lanes)
        a, total, into, mass = pointer(records, 64), pointer(sums, 64), pointer(out, 64), pointer(masses, 64)
        each = pieces.per_interval(m)
        all_of_them = beyond(total, layout.PARTS * each)
        pieces.clear(total, layout.PARTS + 1, m)
        for k in range(count):
            pieces.put(total, layout.PARTS, a, k * size, 1, 0, m, mass[k], low, width, 0)
        for j in range(layout.PARTS):
            if total[j * each] > 0:
                pieces.gather(into, 0, 1, 0, total, j * each, m, low + (j + 0.5) * width)
                pieces.put(all_of_them, 1, into, 0, 1, 0, m, total[j * each], -0.5, 1.0, 0)
        pieces.gather(into, 0, 1, 0, all_of_them, 0, m, 0.0)

    return run


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**31), st.integers(1, 4))
def test_cutting_and_merging_keeps_mean_and_covariance(seed, count):
    m, rng = form(*VARIANT), np.random.default_rng(seed)
    records, masses = np.zeros((count, m.size)), rng.dirichlet(np.ones(count))
    means, covariances = [], []
    for record in records:
        root = np.tril(0.02 * rng.standard_normal((N, N)))
        root[np.diag_indices(N)] = rng.uniform(0.005, 0.05, N)
        mean = np.concatenate([rng.uniform(0.1, 0.9, 1), 0.05 * rng.standard_normal(N - 1)])
        record[m.x : m.root], record[m.root : m.carry] = mean, root[np.tril_indices(N)]
        means.append(mean)
        covariances.append(root @ root.T)
    mean = masses @ np.array(means)
    away = np.array(means) - mean
    covariance = np.einsum("k,kij->ij", masses, covariances) + np.einsum("k,ki,kj->ij", masses, away, away)
    sums, out = np.zeros((layout.PARTS + 1) * (1 + N + N * (N + 1) // 2)), np.zeros(m.size)
    summed()(records.ctypes.data, count, masses.ctypes.data, sums.ctypes.data, 0.0, 1 / layout.PARTS, out.ctypes.data)
    root = np.zeros((N, N))
    root[np.tril_indices(N)] = out[m.root : m.carry]
    np.testing.assert_allclose(out[m.x : m.root], mean, rtol=0, atol=1e-12)
    np.testing.assert_allclose(root @ root.T, covariance, rtol=0, atol=1e-5 * covariance.max())


def test_weights_stay_finite_when_no_component_explains_a_voltage():
    """Far from every component, yet within the gate of their sum: all likelihoods underflow alike."""
    estimator = Estimator(CELL)
    voltage = float(CELL.ocv_V(0.5, 25.0))
    for k in range(60):
        jump = 0.25 if k == 30 else 0.0
        estimate = estimator.step(Sample(k * SECOND, 0.0, voltage + jump, 25.0))
        assert math.isfinite(estimate.soc)
        assert estimate.soc_low <= estimate.soc <= estimate.soc_high
