"""A voltage that repeats itself is found out, and nothing else is taken for one."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bms_ukf import CellParams, Fault, Sample
from bms_ukf.recordings import read
from bms_ukf.stuck import STANDS_NS, Stuck

NAN = math.nan
OHM = 0.03
STANDS_S = STANDS_NS // 10**9


def drive(steps: int, seed: int = 1) -> np.ndarray:
    return np.round(np.random.default_rng(seed).normal(2.0, 4.0, steps), 2)


def voltages(current: np.ndarray, resolution_V: float = 0.001) -> np.ndarray:
    return np.round((3.7 - OHM * current) / resolution_V) * resolution_V


def faults(stuck: Stuck, current: np.ndarray, voltage: np.ndarray, step_s: float = 1.0) -> list[Fault]:
    found = []
    for k, (i, v) in enumerate(zip(current.tolist(), voltage.tolist(), strict=True)):
        stuck.take(Sample(round(k * step_s * 1e9), i, v, 25.0))
        found.append(stuck.fault)
    return found


@pytest.fixture
def stuck(cell: CellParams) -> Stuck:
    return Stuck(cell, 1)


def test_a_voltage_that_stands_still_under_a_moving_current_is_missing_until_it_moves(stuck):
    current = drive(60)
    voltage = voltages(current)
    voltage[20:40] = voltage[20]
    found = faults(stuck, current, voltage)
    assert set(found[:20] + found[40:]) == {Fault.NONE}
    assert set(found[20 + STANDS_S + 2 : 40]) == {Fault.VOLTAGE_IMPLAUSIBLE}
    sample = Sample(60 * 10**9, 1.0, float(voltage[-1]), 25.0)
    stuck.take(sample)
    assert not math.isnan(sample.voltage_V)


@pytest.mark.parametrize(("degC", "found"), [(-10.0, Fault.VOLTAGE_IMPLAUSIBLE), (40.0, Fault.NONE)])
def test_in_the_cold_a_smaller_load_shows_that_a_voltage_stands_still(stuck, degC, found):
    """Steps of 1 A drop more than 30 mV at -10 degC, and less at 40."""
    for k in range(30):
        stuck.take(Sample(k * 10**9, float(k // 5 % 2), 3.7, degC))
    assert stuck.fault is found


def test_what_stands_still_is_not_given_to_the_estimator(stuck):
    current, last = drive(30), 0.0
    for k, i in enumerate(current.tolist()):
        sample = Sample(k * 10**9, i, 3.7, 25.0)
        stuck.take(sample)
        last = sample.voltage_V
        assert sample.current_A == i
    assert math.isnan(last)


@pytest.mark.parametrize("current_A", [0.0, -2.5])
def test_a_resting_or_charging_cell_repeats_its_readings_and_is_believed(stuck, current_A):
    rng = np.random.default_rng(3)
    slow = 3.9 - 0.1 * np.exp(-np.arange(3600) / 600)
    voltage = np.round(slow + 0.002 * rng.standard_normal(3600), 3)
    assert set(faults(stuck, np.full(3600, current_A), voltage)) == {Fault.NONE}
    assert set(faults(stuck, np.full(3600, current_A), np.full(3600, 3.9))) == {Fault.NONE}


def test_steps_of_a_load_with_a_voltage_that_follows_are_believed(stuck):
    current = np.repeat(drive(60), 30)
    assert set(faults(stuck, current, voltages(current))) == {Fault.NONE}


@pytest.mark.parametrize("resolution_V", [0.001, 0.002, 0.005, 0.01])
@pytest.mark.parametrize("step_s", [0.1, 1.0, 10.0])
@pytest.mark.parametrize("cells", [1, 3])
def test_the_constant_voltage_at_the_end_of_a_charge_is_believed(cell, resolution_V, step_s, cells):
    """The charger moves the current, by a lot and for an hour, but slowly and one way."""
    stuck, rng = Stuck(cell, cells), np.random.default_rng(4)
    time_s = np.arange(0.0, 3600.0, step_s)
    current = -5.0 * np.exp(-time_s / 900.0) + 0.02 * rng.standard_normal(len(time_s))
    volts = np.round(4.15 / resolution_V) * resolution_V
    for t_s, i in zip(time_s.tolist(), current.tolist(), strict=True):
        sample = Sample(round(1e9 * t_s), i, volts if cells == 1 else np.full(cells, volts), 25.0)
        stuck.take(sample)
        assert stuck.fault is Fault.NONE
    assert not np.isnan(sample.voltage_V).any()


def test_a_voltage_that_stands_still_while_a_charge_is_broken_off_is_missing(stuck):
    current = np.concatenate([np.full(60, -5.0), np.zeros(60)])
    voltage = np.concatenate([4.0 + 1e-4 * np.arange(55), np.full(65, 4.0055)])
    found = faults(stuck, current, voltage)
    assert set(found[:60]) == {Fault.NONE}
    assert set(found[62:]) == {Fault.VOLTAGE_IMPLAUSIBLE}


@given(st.lists(st.floats(-1e6, 1e6) | st.just(NAN), min_size=3, max_size=30), st.integers(0, 2))
def test_one_cell_and_a_pack_of_one_are_told_the_same(cell, values, shift):
    current = [1.0 * k * (k % (shift + 2)) for k in range(len(values))]
    one, pack = Stuck(cell, 1), Stuck(cell, 2)
    for k, (i, v) in enumerate(zip(current, values, strict=True)):
        alone, both = Sample(k * 10**9, i, v, 25.0), Sample(k * 10**9, i, np.array([v, v]), 25.0)
        one.take(alone)
        pack.take(both)
        assert one.fault == pack.fault
        np.testing.assert_equal(both.voltage_V, [alone.voltage_V] * 2)
        np.testing.assert_equal(both.current_A, alone.current_A)


def test_one_cell_of_a_pack_that_stands_still_is_missing_alone_whatever_page_it_comes_in(cell):
    stuck = Stuck(cell, 4)
    for k, i in enumerate(drive(60).tolist()):
        for page in (slice(0, 2), slice(2, 4)):
            voltage = np.full(4, NAN)
            voltage[page] = round(3.7 - OHM * i, 3)
            voltage[1] = 3.7 if page.start == 0 else NAN
            sample = Sample(k * 10**9, i, voltage, 25.0)
            stuck.take(sample)
    assert stuck.fault == Fault.VOLTAGE_IMPLAUSIBLE
    assert np.isnan(sample.voltage_V).tolist() == [True, True, False, False]
    assert stuck._voltage._still.tolist() == [False, True, False, False]


@pytest.mark.parametrize(
    ("name", "recording"),
    [("panasonic_ncr18650pf", "25degC_US06"), ("panasonic_ncr18650pf", "n10degC_US06"), ("a123_lfp", "DYN_P25")],
)
@pytest.mark.parametrize("resolution_V", [0.001, 0.005])
def test_no_sensor_of_a_measured_drive_is_called_stuck(third_party: Path, name, recording, resolution_V):
    measured = read(third_party / name / f"{recording}.csv.gz", current_positive="charge", temperature_degC=25.0)
    stuck = Stuck(CellParams.load(name), 1)
    voltage = np.round(measured.voltage_V / resolution_V) * resolution_V
    found = 0
    for t_s, i, v in zip(measured.time_s.tolist(), measured.current_A.tolist(), voltage.tolist(), strict=True):
        stuck.take(Sample(round(t_s * 1e9), i, v, 25.0))
        found += stuck.fault is not Fault.NONE
    assert found == 0
