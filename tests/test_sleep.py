"""A stored belief after time with nothing measured: what fades, what stays, what is in doubt."""

from __future__ import annotations

import math

import numpy as np
import pytest
from drives import CELL, terminal, variant

from bms_ukf import Estimator, Sample, Status, Tuning

DAY_S = 86_400.0
CHARGE_AH = CELL.cell.capacity_Ah


def driven(cells: int = 1, **tuning: object) -> Estimator:
    """After ten minutes at 1 C, polarised, SoC 43 %.

    The voltages are the cell's: of others the filter makes a doubt of SoC that would leave no room below the largest.
    """
    estimator = Estimator(CELL, cells, Tuning(initial_soc=0.6, initial_soc_sigma=0.01, **tuning))
    _, voltages = terminal(CELL, 0.6, np.full(600, CHARGE_AH))
    for k, voltage in enumerate(voltages.tolist()):
        shown = voltage if cells == 1 else np.full(cells, voltage)
        estimator.step(Sample(k * 10**9, CHARGE_AH, shown, 25.0))
    return estimator


def believed(estimator: Estimator) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of the first cell."""
    m, state = estimator._form, estimator._state[0, :, 0]
    root = np.zeros((m.n, m.n))
    root[np.tril_indices(m.n)] = state[m.root : m.carry]
    return state[m.x : m.root].copy(), root @ root.T


@pytest.mark.parametrize("bias", [False, True])
def test_polarisation_fades_and_soc_stays_where_it_was(bias):
    estimator = driven(current_bias=bias)
    before, _ = believed(estimator)
    assert abs(before[1:3]).max() > 0.005
    estimator.sleep(DAY_S, 0)
    after, _ = believed(estimator)
    assert after[0] == pytest.approx(before[0], abs=1e-12)
    assert abs(after[1:3]).max() < 1e-9


@pytest.mark.parametrize("bias", [False, True])
def test_doubt_of_soc_grows_with_the_time_off_and_not_with_its_root(bias):
    sigma_A = 0.01
    found = []
    for days in (1.0, 10.0):
        estimator = driven(current_bias=bias, standby_sigma_A=sigma_A)
        _, before = believed(estimator)
        estimator.sleep(days * DAY_S, 0)
        _, after = believed(estimator)
        found.append(after[0, 0] - before[0, 0])
        assert found[-1] == pytest.approx((sigma_A * days * 24 / CHARGE_AH) ** 2, rel=0.01)
    assert found[1] == pytest.approx(100 * found[0], rel=0.02)


def test_what_stays_awake_is_drawn_from_soc():
    estimator = driven(standby_current_A=0.01)
    before, _ = believed(estimator)
    estimator.sleep(DAY_S, 0)
    after, _ = believed(estimator)
    assert before[0] - after[0] == pytest.approx(0.01 * 24 / CHARGE_AH, rel=1e-6)


def test_the_offset_of_the_sensor_draws_nothing_and_is_forgotten():
    estimator = driven(current_bias=True)
    last = estimator._form.root - 1
    estimator._state[0, last, 0] = 0.05
    before, _ = believed(estimator)
    estimator.sleep(30 * DAY_S, 0)
    after, spread = believed(estimator)
    assert after[0] == pytest.approx(before[0], abs=1e-12)
    assert abs(after[-1]) < 1e-6
    assert math.sqrt(spread[-1, -1]) == pytest.approx(CHARGE_AH / 50 / 1.96, rel=1e-6)


def test_the_first_voltage_after_a_long_rest_is_a_measurement_and_not_an_overwrite():
    short, long = driven(), driven()
    believed_soc = believed(short)[0][0]
    rested_V = float(CELL.ocv_V(believed_soc - 0.1, 25.0))
    for estimator, days in ((short, 0.01), (long, 60.0)):
        estimator.sleep(days * DAY_S, 0)
        estimate = estimator.step(Sample(10**9, 0.0, rested_V, 25.0))
    close, far = short.step(Sample(2 * 10**9)).soc, estimate.soc
    assert abs(far - (believed_soc - 0.1)) < 0.03  # months in doubt: the voltage decides
    assert abs(close - believed_soc) < 0.05  # a quarter of an hour: both count


def test_time_may_begin_anew_and_a_belief_that_is_not_there_stays_away():
    estimator = driven()
    estimator.sleep(60.0, -5_000_000_000)
    assert estimator.step(Sample(-4_000_000_000, 0.0, 3.6, 25.0)).status in {Status.OK, Status.DEGRADED}
    empty = Estimator(CELL)
    empty.sleep(60.0, 0)
    assert empty.step(Sample(1)).status is Status.INITIALISING


def test_a_negative_time_off_is_refused():
    with pytest.raises(ValueError, match="off_s"):
        driven().sleep(-1.0, 0)


@pytest.mark.parametrize("precision", ["f64", "f32"])
def test_a_pack_sleeps_as_its_cells_do(precision):
    cell = variant(3, hysteresis=True, core=True)
    pack, one = Estimator(cell, 20, precision=precision), Estimator(cell, 1, precision=precision)
    pack._share_ns = 1 << 62  # else its cells agree on the offset of their sensor meanwhile
    for k in range(100):
        pack.step(Sample(k * 10**9, 2.0, np.full(20, 3.6), 25.0))
        one.step(Sample(k * 10**9, 2.0, 3.6, 25.0))
    for estimator in (pack, one):
        estimator.sleep(DAY_S, 0)
    np.testing.assert_allclose(believed(pack)[0], believed(one)[0], atol=1e-6)
    np.testing.assert_allclose(believed(pack)[1], believed(one)[1], atol=1e-8)
