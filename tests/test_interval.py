"""The published SoC, sigma and bounds: those of a Gaussian truncated to 0..1, as scipy has it; and the status."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import pytest
import synthetic_cell
from hypothesis import given
from hypothesis import strategies as st
from kernel_record import Record
from numpy.typing import NDArray
from scipy.stats import truncnorm

from bms_ukf import Estimator, Fault, Sample, Status, Tuning
from bms_ukf.kernel import interval, layout
from bms_ukf.kernel.jit import entry
from bms_ukf.kernel.layout import form, form_at_compile_time
from bms_ukf.kernel.memory import pointer

CELL = synthetic_cell.cell_of(synthetic_cell.nonlinear())
LANES = 16
SIGMA = (1e-4, 0.5)  # the least and the largest that the kernel has
MEAN = (-0.1, 1.1)
CLOSE = 1e-4  # SoC


@functools.cache
def describe(bits: int) -> Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]:
    """A function of means and sigmas, arrays of one length, that returns (4, length): soc, sigma, low, high."""
    m = form(2, 0, 0, 0, LANES, 0)
    n_rc, hysteresis, bias, core, lanes, compensated, part_lanes = m.variant

    def lanes_of(w: int, y: int) -> None:
        here = form_at_compile_time(n_rc, hysteresis, bias, core, lanes, compensated, part_lanes)
        interval.describe(pointer(w, bits), pointer(y, bits), here, lanes)

    run = entry(lanes_of, "void(int64, int64)")
    dtype = np.float64 if bits == 64 else np.float32

    def described(means: NDArray[np.float64], sigmas: NDArray[np.float64]) -> NDArray[np.float64]:
        results = np.empty((4, len(means)))
        for first in range(0, len(means), LANES):
            count = min(LANES, len(means) - first)
            w, y = np.full((m.size, LANES), np.nan, dtype), np.full((layout.VALUES, LANES), np.nan, dtype)
            w[m.x, :count], w[m.root, :count] = means[first : first + count], sigmas[first : first + count]
            run(w.ctypes.data, y.ctypes.data)
            rows = [layout.Y_SOC, layout.Y_SOC_SIGMA, layout.Y_SOC_LOW, layout.Y_SOC_HIGH]
            results[:, first : first + count] = y[rows, :count]
        return results

    return described


def exact(means: NDArray[np.float64], sigmas: NDArray[np.float64]) -> NDArray[np.float64]:
    """What `describe` gives, by scipy."""
    a, b = -means / sigmas, (1 - means) / sigmas
    low, high = (truncnorm.ppf(q, a, b, means, sigmas) for q in (0.025, 0.975))
    with np.errstate(invalid="ignore"):  # of a third moment that scipy computes beside the mean
        soc = np.clip(truncnorm.stats(a, b, means, sigmas, moments="m"), low, high)
    return np.array([soc, (high - low) / 3.92, low, high])


@pytest.mark.parametrize("bits", [64, 32])
def test_over_all_means_and_sigmas_the_four_numbers_are_those_of_the_truncated_gaussian(bits):
    means, sigmas = (grid.ravel() for grid in np.meshgrid(np.linspace(*MEAN, 61), np.geomspace(*SIGMA, 40)))
    off = np.abs(describe(bits)(means, sigmas) - exact(means, sigmas))
    assert off.max() < CLOSE, (means[off.max(0).argmax()], sigmas[off.max(0).argmax()])


@given(st.lists(st.tuples(st.floats(*MEAN), st.floats(*SIGMA)), min_size=1, max_size=LANES), st.sampled_from([64, 32]))
def test_whatever_the_other_lanes_hold_each_has_its_own_truncated_gaussian(beliefs, bits):
    means, sigmas = np.array(beliefs).T
    soc, sigma, low, high = found = describe(bits)(means, sigmas)
    assert np.abs(found - exact(means, sigmas)).max() < CLOSE
    assert ((low >= 0) & (low <= soc) & (soc <= high) & (high <= 1)).all()
    assert np.abs(sigma - (high - low) / 3.92).max() < 1e-6


@pytest.mark.parametrize("bits", [64, 32])
def test_far_from_both_edges_mean_and_sigma_stay_as_they_are_to_the_last_bit(bits):
    dtype = np.float64 if bits == 64 else np.float32
    means, sigmas = np.linspace(0.3, 0.7, 41).astype(dtype), np.geomspace(1e-4, 0.06, 41).astype(dtype)
    soc, sigma, low, high = describe(bits)(means, sigmas)
    assert (soc == means).all()
    assert (sigma == sigmas).all()
    half = (dtype(1.96) * sigmas).astype(dtype)
    assert np.abs(low - (means - half)).max() <= np.finfo(dtype).eps  # multiplication and subtraction may be one
    assert np.abs(high - (means + half)).max() <= np.finfo(dtype).eps


@pytest.mark.parametrize("distance", [interval.FAR - 1e-3, interval.FAR + 1e-3])
def test_where_an_edge_begins_to_matter_nothing_jumps(distance):
    sigmas = np.geomspace(0.001, 0.1, 50)
    soc, _, low, high = describe(64)(distance * sigmas, sigmas)
    assert np.abs(soc - distance * sigmas).max() < CLOSE
    assert np.abs(low - (distance - 1.96) * sigmas).max() < CLOSE
    assert np.abs(high - (distance + 1.96) * sigmas).max() < CLOSE


def test_a_lane_without_a_belief_has_no_number_and_spoils_no_other():
    means, sigmas = np.array([np.nan, 0.02, np.nan, 0.5]), np.array([np.nan, 0.05, np.nan, 0.3])
    found = describe(64)(means, sigmas)
    assert np.isnan(found[:, [0, 2]]).all()
    assert np.abs(found[:, [1, 3]] - exact(means[[1, 3]], sigmas[[1, 3]])).max() < CLOSE


@pytest.mark.parametrize("precision", ["f64", "f32"])
@pytest.mark.parametrize("cells", [1, 3])
def test_an_estimate_has_the_interval_of_the_belief(precision, cells):
    tuning = Tuning(initial_soc=0.97, initial_soc_sigma=0.03)
    estimator = Estimator(CELL, cells, tuning, precision)
    voltage = float(CELL.ocv_V(0.97, 25.0))
    estimator.step(Sample(0, 0.0, voltage if cells == 1 else np.full(cells, voltage), 25.0))
    estimator._state[:, layout.H_PARTS] = 0  # one Gaussian in place of the components
    estimate = estimator.step(Sample(10**9, 0.0, np.nan if cells == 1 else np.full(cells, np.nan), 25.0))
    m = estimator._form
    means, sigmas = (estimator._state[0, row, :cells].astype(float) for row in (m.x, m.root))
    found = np.array([estimate.soc, estimate.soc_sigma, estimate.soc_low, estimate.soc_high]).reshape(4, cells)
    assert np.abs(found - exact(means, sigmas)).max() < CLOSE
    assert (found[2] < found[0]).all()


@pytest.mark.parametrize(
    ("ok", "invalid", "status", "faults"),
    [
        (0.5, 0.5, Status.OK, Fault.NONE),
        (0.09, 0.5, Status.DEGRADED, Fault.UNCERTAIN),
        (0.05, 0.09, Status.INVALID, Fault.UNCERTAIN),
    ],
)
def test_the_width_of_the_interval_decides_the_status(ok, invalid, status, faults):
    """Of a belief of 0.5 +- 0.05: half-width 0.098."""
    tuning = Tuning(initial_soc=0.5, ok_half_width=ok, invalid_half_width=invalid)
    record = Record(CELL, tuning)
    record.tick(0.0, 0.0, float(CELL.ocv_V(0.5, 25.0)), 25.0)
    record.x, record.root, record["parts"] = np.array([0.5, *[0.0] * 5]), np.diag([0.05, *[1e-3] * 5]), 0.0
    assert record.tick(0.0) == (status, faults)


def test_before_the_first_belief_nothing_is_called_uncertain():
    assert Record(CELL).tick(0.0, 1.0) == (
        Status.INITIALISING,
        Fault.VOLTAGE_MISSING | Fault.TEMPERATURE_MISSING,
    )
