"""A pack of cells that differ: in capacity, resistance, current, temperature sensor, and in whether they are heard."""

from __future__ import annotations

import numpy as np
import pytest
from drives import CELL, steady, terminal

from bms_ukf import Estimate, Estimator, Fault, Sample, SensorSpec, Status, Tuning, Wiring
from bms_ukf.scaling import scaled

NAN = float("nan")
SECOND = 1_000_000_000
SOC = 0.6
APART = Tuning(current_bias=False)  # the cells do not tell each other of their sensor's offset
OCV = float(CELL.ocv_V(SOC, 25.0))


def current(k: int) -> float:
    return 3.0 * ((k // 20) % 2) - (1.0 if k % 7 == 3 else 0.0)


def voltage(k: int) -> float:
    return OCV - 0.03 * current(k) - 2e-5 * k


def run(estimator: Estimator, steps: int, first: int = 0) -> Estimate:
    for k in range(first, first + steps):
        estimate = estimator.step(Sample(k * SECOND, current(k), np.full(estimator.cells, voltage(k)), 25.0))
    return estimate


def test_a_cell_that_is_never_heard_does_not_hide_the_pack():
    pack, whole = Estimator(CELL, 20, APART), Estimator(CELL, 20, APART)
    for k in range(400):
        volts = np.full(20, voltage(k))
        shown = whole.step(Sample(k * SECOND, current(k), volts, 25.0))
        volts[17] = NAN
        estimate = pack.step(Sample(k * SECOND, current(k), volts, 25.0))
        if k == 10:
            early = float(estimate.soc_sigma[17])
    assert estimate.status is Status.DEGRADED
    assert Fault.VOLTAGE_MISSING in estimate.faults
    assert np.flatnonzero(pack.cell_faults & Fault.VOLTAGE_MISSING).tolist() == [17]
    others = np.arange(20) != 17
    np.testing.assert_array_equal(estimate.soc[others], shown.soc[others])
    assert abs(estimate.soc[17] - shown.soc[17]) < 2 * estimate.soc_sigma[17]
    assert estimate.soc_sigma[17] > early > 0.03 > shown.soc_sigma[17]
    assert estimate.age_s[17] == pytest.approx(399)


def test_a_cell_that_is_heard_at_last_is_measured_from_then_on():
    pack = Estimator(CELL, 3)
    for k in range(600):
        volts = np.full(3, voltage(k))
        volts[1] = NAN if k < 60 else volts[1]
        estimate = pack.step(Sample(k * SECOND, current(k), volts, 25.0))
        if k == 59:
            assert Fault.VOLTAGE_MISSING in estimate.faults
            unheard = float(estimate.soc_sigma[1])
    assert estimate.status is Status.OK
    assert estimate.soc_sigma[1] < 0.5 * unheard
    assert estimate.soc_sigma[1] < 0.03
    assert abs(estimate.soc[1] - estimate.soc[0]) < 2 * estimate.soc_sigma[1]


def test_a_scan_in_parts_is_that_of_each_cell_alone():
    """Three cells take turns: a cell between its voltages is predicted, and as well known as one alone would be."""
    pack, alone = Estimator(CELL, 3, APART), Estimator(CELL, tuning=APART)
    for k in range(90):
        volts = np.where(np.arange(3) == k % 3, voltage(k), NAN)
        estimate = pack.step(Sample(k * SECOND, current(k), volts, 25.0))
        single = alone.step(Sample(k * SECOND, current(k), voltage(k) if k % 3 == 1 else NAN, 25.0))
    assert estimate.status is Status.OK
    assert estimate.soc[1] == pytest.approx(single.soc, rel=1e-9)
    assert estimate.soc_sigma[1] == pytest.approx(single.soc_sigma, rel=1e-9)


def test_a_cell_that_has_become_invalid_hides_itself_only():
    pack = Estimator(CELL, 2, Tuning(invalid_half_width=0.2, cell_spread_sigma=0.2))
    for k in range(120):
        estimate = pack.step(Sample(k * SECOND, current(k), np.array([voltage(k), NAN]), 25.0))
    assert pack.cell_status.tolist() == [Status.OK, Status.INVALID]
    assert estimate.status is Status.DEGRADED
    assert np.isnan(estimate.soc).tolist() == [False, True]


@pytest.mark.parametrize("parallel", [3.0, 0.5])
def test_a_parallel_group_by_its_scales_is_the_larger_cell(parallel: float):
    spec = SensorSpec(current_offset_A=0.196)
    tuning = Tuning(current_bias=False, sensor_spec=spec, initial_current_sigma_A=0.1, adaptive=False)
    group, cell = Estimator(CELL, 2, tuning), Estimator(scaled(CELL, parallel), tuning=tuning)
    group.capacity_scale, group.resistance_scale = parallel, 1 / parallel
    for k in range(300):
        sample = Sample(k * SECOND, parallel * current(k), voltage(k), 25.0)
        of_group, of_cell = group.step(sample), cell.step(sample)
    assert of_group.soc[0] == pytest.approx(of_cell.soc, abs=1e-5)
    assert of_group.r0_ohm[1] == pytest.approx(of_cell.r0_ohm, rel=1e-6)


def test_a_smaller_cell_in_the_pack_falls_faster():
    pack = Estimator(CELL, 20, Tuning(initial_soc=SOC, initial_soc_sigma=0.01))
    pack.capacity_scale = np.where(np.arange(20) == 4, 0.8, 1.0)
    first = run(pack, 1).soc.copy()
    for k in range(1, 1000):
        estimate = pack.step(Sample(k * SECOND, 3.0, np.full(20, NAN), 25.0))
    fallen = first - estimate.soc
    assert fallen[4] == pytest.approx(fallen[3] / 0.8, rel=1e-4)
    np.testing.assert_array_equal(pack.capacity_scale, np.where(np.arange(20) == 4, 0.8, 1.0))


def test_a_bleed_takes_charge_from_its_cell_and_is_no_offset_of_the_sensor():
    cell, bleed_A, seconds = steady(), 0.1, 7200
    rest = np.zeros(seconds)
    rest[1800:2400] = rest[4200:4800] = 2.5  # rests, with loads between: as `bias` wants them
    bled = np.column_stack([terminal(cell, 0.8, rest + extra)[1] for extra in (0.0, bleed_A)])
    truth = terminal(cell, 0.8, rest + bleed_A)[0][-1]
    pack, unaware = Estimator(cell, 2), Estimator(cell, 2)
    pack.bleed_A = [NAN, bleed_A]
    for k in range(seconds):
        sample = Sample(k * SECOND, float(rest[k]), bled[k], 25.0)
        estimate, blind = pack.step(sample), unaware.step(sample)
    assert abs(estimate.soc[1] - truth) < 0.5 * abs(blind.soc[1] - truth)
    assert abs(estimate.current_bias_A[1]) < 0.02


def test_each_string_is_counted_by_its_own_current():
    wired = Estimator(CELL, 4, wiring=Wiring(string_of=[0, 1, 1, 0]))
    strings = [Estimator(CELL, 2), Estimator(CELL, 2)]
    for k in range(200):
        currents = np.array([current(k), NAN if 80 < k < 120 else 0.5 * current(k)])
        volts = [voltage(k), voltage(k) + 0.01]
        estimate = wired.step(Sample(k * SECOND, NAN, np.array(volts)[[0, 1, 1, 0]], 25.0, string_current_A=currents))
        apart = [
            s.step(Sample(k * SECOND, float(currents[j]), np.full(2, volts[j]), 25.0)) for j, s in enumerate(strings)
        ]
    np.testing.assert_allclose(estimate.soc[[0, 1]], [apart[0].soc[0], apart[1].soc[0]], rtol=1e-9)
    np.testing.assert_allclose(estimate.soc_sigma[[3, 2]], [apart[0].soc_sigma[0], apart[1].soc_sigma[0]], rtol=1e-9)


def test_the_current_of_one_string_that_fails_is_a_fault_of_its_cells():
    wired = Estimator(CELL, 3, wiring=Wiring(string_of=[0, 0, 1]))
    for k in range(30):
        currents = np.array([1.0, 1.0 if k < 10 else NAN if k < 29 else 1e6])
        estimate = wired.step(Sample(k * SECOND, NAN, np.full(3, OCV), 25.0, string_current_A=currents))
    assert (wired.cell_faults & Fault.CURRENT_MISSING > 0).tolist() == [False, False, True]
    assert (wired.cell_faults & Fault.CURRENT_IMPLAUSIBLE > 0).tolist() == [False, False, True]
    assert estimate.status is Status.DEGRADED


def test_cells_share_the_temperature_sensor_they_are_wired_to():
    wired, plain = Estimator(CELL, 3, wiring=Wiring(sensor_of=[1, 0, 1])), Estimator(CELL, 3)
    for k in range(60):
        of_wired = wired.step(Sample(k * SECOND, current(k), voltage(k), np.array([10.0, 30.0])))
        of_plain = plain.step(Sample(k * SECOND, current(k), voltage(k), np.array([30.0, 10.0, 30.0])))
    np.testing.assert_array_equal(of_wired.soc, of_plain.soc)
    assert of_wired.r0_ohm[1] > of_wired.r0_ohm[0]


@pytest.mark.parametrize("indices", [[0, 0], [0, -1, 0], []])
def test_a_wiring_that_does_not_fit_is_refused(indices: list[int]):
    with pytest.raises(ValueError, match="string_of"):
        Estimator(CELL, 3, wiring=Wiring(string_of=indices))


@pytest.mark.parametrize("scale", [0.0, -1.0, NAN])
def test_a_scale_that_is_no_scale_is_refused(scale: float):
    with pytest.raises(ValueError, match="above 0"):
        Estimator(CELL, 2).capacity_scale = scale


def test_scales_outlive_a_restart():
    first, second = Estimator(CELL, 3), Estimator(CELL, 3)
    first.capacity_scale, first.resistance_scale = [0.9, 1.0, 1.1], [1.3, 1.0, 0.8]
    run(first, 30)
    second.restore(first.snapshot())
    np.testing.assert_allclose(second.capacity_scale, [0.9, 1.0, 1.1])
    np.testing.assert_allclose(second.resistance_scale, [1.3, 1.0, 0.8])
    np.testing.assert_array_equal(run(first, 5, 30).soc, run(second, 5, 30).soc)
