"""What the cells of a string know together of their current sensor's offset, against the same in full covariances."""

from __future__ import annotations

import numpy as np
import pytest
from drives import steady, terminal

from bms_ukf import Estimator, Sample, Tuning, Wiring
from bms_ukf.kernel import entry, layout
from bms_ukf.percell import SHARE_NS

CELL = steady()
SECOND = 1_000_000_000
OFFSET_A = 0.08


def pack_after(seconds: int, cells: int, tuning: Tuning | None = None, shares: bool = True, **settings) -> Estimator:
    """A drive of equal cells from unequal SoC, each voltage with noise of its own, and OFFSET_A in every current."""
    random = np.random.default_rng(2)
    current = np.repeat(random.uniform(-2.0, 4.0, seconds // 50 + 1), 50)[:seconds]
    voltage = np.column_stack([terminal(CELL, 0.8 + 0.005 * c, current)[1] for c in range(cells)])
    voltage += 0.003 * random.standard_normal(voltage.shape)
    estimator = Estimator(CELL, cells, tuning, **settings)
    if not shares:
        estimator._share_ns = 1 << 62
    for k in range(seconds):
        estimator.step(Sample(k * SECOND, current[k] + OFFSET_A, voltage[k], 25.0))
    return estimator


def beliefs(estimator: Estimator) -> tuple[np.ndarray, np.ndarray]:
    """(cells, n) means and (cells, n, n) covariances."""
    m, flat = estimator._form, estimator._state.transpose(0, 2, 1).reshape(-1, estimator._form.size)[: estimator.cells]
    roots = np.zeros((estimator.cells, m.n, m.n))
    roots[:, *np.tril_indices(m.n)] = flat[:, m.root : m.carry]
    return flat[:, m.x : m.root].astype(float), roots @ roots.transpose(0, 2, 1)


def common(estimator: Estimator) -> tuple[np.ndarray, np.ndarray]:
    slots = (layout.H_SHARED, layout.H_SHARED_VAR)
    return tuple(estimator._state[:, slot].reshape(-1)[: estimator.cells].astype(float) for slot in slots)


def exchange(estimator: Estimator, string: int = 0) -> None:
    params, state, *_ = estimator._addresses
    entry.exchange(estimator._form, 64)(params, state, estimator._strings.ctypes.data, string, estimator.cells)


@pytest.mark.parametrize("alike", [0.0, 0.5])
def test_an_exchange_is_the_fusion_of_what_is_new_in_each_cell(alike):
    estimator = pack_after(599, 5, Tuning(bias_error_correlation=alike))
    mean, cov = beliefs(estimator)
    known, known_var = common(estimator)
    assert np.ptp(known_var) < 1e-12 * known_var[0], "all of one string know the same in common"
    own, var = mean[:, -1], cov[:, -1, -1]
    new = 1 / var - 1 / known_var
    assert (new > 0).all()
    z = (own / var - known / known_var) / new
    worth = new.sum() ** 2 / (new**2).sum()
    discount = 1 / (1 + (worth - 1) * alike)
    fused_var = 1 / (1 / known_var[0] + discount * new.sum())
    fused = known[0] + fused_var * discount * (new * (z - known[0])).sum()
    exchange(estimator)
    after, cov_after = beliefs(estimator)
    told = var > fused_var
    assert told.sum() >= 3
    for c in np.flatnonzero(told):
        gain = cov[c, :, -1] / var[c]
        np.testing.assert_allclose(after[c], mean[c] + gain * (fused - own[c]), rtol=1e-9, atol=1e-12)
        expected = cov[c] + np.outer(gain, gain) * (fused_var - var[c])
        np.testing.assert_allclose(cov_after[c], expected, rtol=1e-8, atol=1e-14)
    np.testing.assert_array_equal(after[~told], mean[~told])


def test_nothing_new_is_counted_twice():
    estimator = pack_after(599, 5)
    exchange(estimator)
    mean, cov = beliefs(estimator)
    for _ in range(100):
        exchange(estimator)
    again, cov_again = beliefs(estimator)
    np.testing.assert_allclose(again, mean, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(cov_again, cov, rtol=1e-9, atol=1e-15)


def test_what_an_open_contactor_tells_is_told_once_however_many_cells_hear_it():
    pack, alone = Estimator(CELL, 40), Estimator(CELL)
    ocv = float(CELL.ocv_V(0.6, 25.0))
    for k in range(200):
        of_pack = pack.step(Sample(k * SECOND, OFFSET_A, np.full(40, ocv), 25.0, open_circuit=k == 100))
        of_one = alone.step(Sample(k * SECOND, OFFSET_A, ocv, 25.0, open_circuit=k == 100))
    assert of_pack.current_bias_A[3] == pytest.approx(of_one.current_bias_A, abs=2e-4)
    assert beliefs(pack)[1][0, -1, -1] > 0.8 * float(
        np.sum(alone._state[0, alone._form.carry - alone._form.n : alone._form.carry] ** 2)
    )


def test_cells_together_know_the_offset_better_and_are_honest_about_it():
    together, apart = pack_after(5400, 12), pack_after(5400, 12, shares=False)
    errors, sigmas = zip(
        *((b[0][:, -1] - OFFSET_A, np.sqrt(b[1][:, -1, -1])) for b in map(beliefs, (together, apart))), strict=True
    )
    assert SHARE_NS < 5400 * SECOND
    assert np.sqrt(np.mean(errors[0] ** 2)) < np.sqrt(np.mean(errors[1] ** 2))
    assert sigmas[0].max() < sigmas[1].min()
    assert (np.abs(errors[0]) < 2 * sigmas[0]).all()


def test_the_sensor_of_another_string_tells_nothing():
    wired = Estimator(CELL, 4, wiring=Wiring(string_of=[0, 0, 1, 1]))
    ocv = float(CELL.ocv_V(0.6, 25.0))
    for k in range(200):
        offsets = np.array([OFFSET_A, -OFFSET_A])
        sample = Sample(k * SECOND, np.nan, np.full(4, ocv), 25.0, open_circuit=True, string_current_A=offsets)
        estimate = wired.step(sample)
    np.testing.assert_allclose(estimate.current_bias_A, [OFFSET_A, OFFSET_A, -OFFSET_A, -OFFSET_A], rtol=0.05)


def test_a_cell_that_sleeps_knows_no_more_of_the_offset_afterwards():
    estimator = pack_after(1200, 3)
    before = beliefs(estimator)[1][:, -1, -1]
    estimator.sleep(3600.0, 0)
    after, (_, in_common) = beliefs(estimator)[1][:, -1, -1], common(estimator)
    assert (after > before).all()
    np.testing.assert_allclose(in_common, after, rtol=1e-9)
