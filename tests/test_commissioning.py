"""A current whose sign or scale is wrong shows in the steps of a drive; a right one is never accused."""

from __future__ import annotations

import csv
import functools
import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from model_cell import ModelCell

from bms_ukf import CellParams, Fault, Sample
from bms_ukf.campaign import traces
from bms_ukf.commissioning import Commissioning
from bms_ukf.scaling import scaled

CELLS = ["lgm50_chen2020", "panasonic_ncr18650pf", "a123_lfp"]


def drive(cell: CellParams) -> list[Sample]:
    """A city drive of 1 Hz, in noise and bits like those of a vehicle."""
    return [
        Sample((k + 1) * 10**9, current_A, voltage_V, 25.0)
        for k, (current_A, voltage_V) in enumerate(_drive(cell.cell.name))
    ]


@functools.cache
def _drive(name: str) -> list[tuple[float, float]]:
    cell = CellParams.load(name)
    dice, battery, measured = np.random.default_rng(1), ModelCell(cell, soc=0.7), []
    for current_A in cycle_current_A(cell).tolist():
        voltage_V = battery.step(current_A, 1.0) + dice.normal(0.0, 0.002)
        measured.append((current_A, round(voltage_V / 0.001) * 0.001))
    return measured


def cycle_current_A(cell: CellParams) -> np.ndarray:
    dice = np.random.default_rng(2)
    return np.repeat(dice.choice([-0.5, 0.0, 0.3, 1.0, 2.0], 120), 5) * cell.cell.capacity_Ah


def verdict(cell: CellParams, samples: list[Sample], factor: float = 1.0) -> Fault:
    commissioning = Commissioning(cell)
    for sample in samples:
        commissioning.see(Sample(sample.t_ns, factor * sample.current_A, sample.voltage_V, sample.temperature_degC))
    return commissioning.fault


@pytest.mark.parametrize("name", CELLS)
@pytest.mark.parametrize(
    ("factor", "expected"),
    [
        (1.0, Fault.NONE),
        (0.5, Fault.NONE),
        (2.0, Fault.NONE),
        (-1.0, Fault.CURRENT_SIGN),
        (-1000.0, Fault.CURRENT_SIGN),
        (1000.0, Fault.CURRENT_SCALE),
        (0.001, Fault.CURRENT_SCALE),
        (0.05, Fault.CURRENT_SCALE),
    ],
)
def test_sign_and_scale_are_told_from_a_drive(name: str, factor: float, expected: Fault) -> None:
    cell = CellParams.load(name)
    assert verdict(cell, drive(cell), factor) is expected


def test_a_parked_battery_is_accused_of_nothing(cell: CellParams) -> None:
    dice = np.random.default_rng(3)
    noise = dice.normal(0.0, 1.0, (5000, 2))
    samples = [Sample(k * 10**9, 0.05 * i, 3.7 + 0.003 * v, 25.0) for k, (i, v) in enumerate(noise, start=1)]
    assert verdict(cell, samples) is Fault.NONE


@pytest.mark.parametrize("seed", range(20))
def test_current_and_voltage_that_have_nothing_to_do_with_each_other_prove_nothing(cell, seed) -> None:
    dice = np.random.default_rng(seed)
    noise = dice.normal(0.0, 1.0, (1000, 2))
    samples = [Sample(k * 10**9, 5.0 * i, 3.7 + 0.1 * v, 25.0) for k, (i, v) in enumerate(noise, start=1)]
    assert verdict(cell, samples) is Fault.NONE


def test_one_glitch_proves_nothing_and_a_few_do_not_hide_the_truth(cell: CellParams) -> None:
    samples = drive(cell)
    samples[300].current_A = 100.0 * cell.cell.capacity_Ah
    assert verdict(cell, samples) is Fault.NONE
    for k in range(100, 600, 100):
        samples[k].voltage_V = 4.2
    assert verdict(cell, samples, -1.0) is Fault.CURRENT_SIGN


def test_gaps_and_missing_values_are_no_steps(cell: CellParams) -> None:
    samples = drive(cell)
    for k, sample in enumerate(samples):
        sample.t_ns *= 10  # 10 s apart: not a step of the ohmic resistance any more
        sample.voltage_V = math.nan if k % 2 else sample.voltage_V
    assert verdict(cell, samples, -1.0) is Fault.NONE


def test_a_fault_is_taken_back_when_the_current_is_put_right(cell: CellParams) -> None:
    commissioning = Commissioning(cell)
    seen = []
    for factor in (-1.0, 1.0):
        start_ns = len(seen) * 10**13
        for sample in drive(cell):
            commissioning.see(Sample(start_ns + sample.t_ns, factor * sample.current_A, sample.voltage_V, 25.0))
        seen.append(commissioning.fault)
    assert seen == [Fault.CURRENT_SIGN, Fault.NONE]


def test_it_is_said_once_and_in_words(cell: CellParams, caplog: pytest.LogCaptureFixture) -> None:
    verdict(cell, drive(cell), -1.0)
    (record,) = caplog.records
    assert "sign is wrong (signals.current_positive)" in record.getMessage()


def test_a_pack_is_judged_by_one_cell_and_by_another_if_that_is_silent(cell: CellParams) -> None:
    samples = drive(cell)
    for dead in ((), (0,), (0, 1)):
        commissioning = Commissioning(cell)
        for sample in samples:
            voltages = np.full(3, sample.voltage_V)
            voltages[list(dead)] = math.nan
            commissioning.see(Sample(sample.t_ns, -sample.current_A, voltages, np.full(3, 25.0)))
        assert commissioning.fault is Fault.CURRENT_SIGN


@pytest.fixture
def leaf(third_party: Path) -> list[tuple[float, float, float]]:
    """Time, current and voltage of a real vehicle's drive of 19 s at 100 Hz; its current is positive on charge."""
    with (third_party / "can" / "leaf_ZE1_62kWh_EV-CANeplus2.decoded_1DB.csv").open() as table:
        rows = [
            tuple(float(row[k]) for k in ("t_s", "pack_current_A", "pack_voltage_V")) for row in csv.DictReader(table)
        ]
    return [(t, i, v) for t, i, v in rows if i != 511.5 and v != 511.5]


@pytest.mark.parametrize(("sign", "expected"), [(-1.0, Fault.NONE), (1.0, Fault.CURRENT_SIGN)])
def test_the_sign_of_a_real_drive_is_told(leaf, cell, sign, expected) -> None:
    """Repeated, as 19 s are too short; 96 cells in series, 3 in parallel of 58 Ah each are 34 of the cell file's."""
    commissioning = Commissioning(scaled(cell, 34.0))
    for turn, (t_s, current_A, voltage_V) in itertools.product(range(4), leaf):
        t_ns = round((t_s + 30.0 * turn) * 1e9)
        commissioning.see(Sample(t_ns, sign * current_A, voltage_V / 96, 25.0))
    assert commissioning.fault is expected
    assert math.isfinite(commissioning.slope_ohm)


def test_a_cell_whose_resistance_falls_with_the_current_is_not_accused():
    """The campaign's LFP cell at 0 degC: 0.5 ohm at rest, 0.06 ohm over the steps of its own drive."""
    trace = traces.load("prada2013/long_rest_0degC")
    cell = CellParams.load(traces.cell_file(trace))
    check = Commissioning(cell)
    for k, current_A in enumerate(trace.current_A):
        check.see(
            Sample((k + 1) * 10**9, float(current_A), float(trace.voltage_V[k, 0]), float(trace.temperature_degC[k]))
        )
    assert check.steps > 40
    assert check.fault is Fault.NONE
