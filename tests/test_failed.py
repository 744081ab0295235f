"""A current sensor that fails is named and what it said is taken back; one that is right is never accused."""

from __future__ import annotations

import functools
import itertools
import logging
import math

import numpy as np
import pytest
import sensor_failures
from daemon_rig import rig_of

from bms_ukf import CellParams, Estimate, Estimator, Fault, Sample, Status
from bms_ukf.campaign import classes
from bms_ukf.failed import CurrentSensor, Watch
from bms_ukf.failed.blocks import Blocks
from bms_ukf.failed.contradiction import Contradiction
from bms_ukf.failed.rewind import BACK_NS, EVERY_NS, Rewind

NAN = math.nan
SECOND_NS = 10**9
AT_S = 900


def course(cell: CellParams, seconds: int, seed: int = 1, current_A: float | None = None) -> list[Sample]:
    """A drive of steps, or a constant load, as measured each second."""
    return [Sample(t_ns, *shown, 25.0) for t_ns, *shown in _course(cell.cell.name, seconds, seed, current_A)]


@functools.cache
def _course(name: str, seconds: int, seed: int, current_A: float | None) -> list[tuple[int, float, float]]:
    """By the cell's parameters at 60 %: as much of it as a judge of changes sees, in a tenth of a cell's time."""
    cell, dice, soc, rows = CellParams.load(name), np.random.default_rng(seed), 0.8, []
    at = {key: float(value) for key, value in cell.dynamics_at(0.6, 25.0).items()}
    charged = np.linspace(0.0, 1.0, 201)
    ocv_V, rc_V = cell.ocv_V(charged, 25.0), [0.0, 0.0]
    drive_A = np.repeat(dice.choice([-0.6, 0.0, 0.3, 0.8, 1.5], -(-seconds // 4)), 4) * cell.cell.capacity_Ah
    for k in range(seconds):
        load_A = float(drive_A[k]) if current_A is None else current_A
        soc -= load_A / 3600 / cell.cell.capacity_Ah
        for j in (0, 1):
            fall = -math.expm1(-1.0 / at[f"tau{j + 1}_s"])
            rc_V[j] += fall * (at[f"r{j + 1}_ohm"] * load_A - rc_V[j])
        drop_V = at["r0_ohm"] * at["r0_knee_A"] * math.asinh(load_A / at["r0_knee_A"])
        voltage_V = float(np.interp(soc, charged, ocv_V)) - sum(rc_V) - drop_V + dice.normal(0.0, 0.001)
        rows.append(((k + 1) * SECOND_NS, round(load_A + dice.normal(0.0, 0.01), 3), round(voltage_V, 3)))
    return rows


FAILURES = {
    "dead": lambda current_A, dice: 0.0,
    "dead with noise": lambda current_A, dice: round(dice.normal(0.0, 0.005), 3),
    "stuck": lambda current_A, dice: 1.234,
    "flipped": lambda current_A, dice: -current_A,
    "halved": lambda current_A, dice: 0.5 * current_A,
}


def named_s(cell: CellParams, samples: list[Sample], failure: str, at_s: int = AT_S) -> tuple[float, Fault]:
    """How long after its failure the sensor is named, and as what."""
    sensor, dice = CurrentSensor(cell, 1), np.random.default_rng(2)
    for sample in samples:
        if sample.t_ns > at_s * SECOND_NS:
            sample.current_A = FAILURES[failure](sample.current_A, dice)
        if sensor.see(sample, 0.7):
            return sample.t_ns / SECOND_NS - at_s, sensor.fault
    return math.inf, Fault.NONE


KINDS = [
    ("dead", 120.0, Fault.CURRENT_FAILED),
    ("dead with noise", 120.0, Fault.CURRENT_FAILED),
    ("stuck", 120.0, Fault.CURRENT_FAILED),
    ("flipped", 60.0, Fault.CURRENT_SIGN),
    ("halved", 60.0, Fault.CURRENT_SCALE),
]
CELLS = [
    *itertools.product(["lgm50_chen2020", "panasonic_ncr18650pf"], KINDS),
    # At 1C its r0 makes 12 mV: half of it shows too little in noise of 1 mV.
    *itertools.product(["a123_lfp"], KINDS[:-1]),
]


@pytest.mark.parametrize(("name", "kind"), CELLS)
def test_a_sensor_that_fails_in_a_drive_is_named_in_time(name, kind):
    failure, within_s, fault = kind
    cell = CellParams.load(name)
    for seed in (1, 2, 3):
        took_s, found = named_s(cell, course(cell, AT_S + 200, seed), failure)
        assert 0 < took_s <= within_s
        assert found is fault


@pytest.mark.parametrize("load", [0.2, 0.5, 1.0])
@pytest.mark.parametrize("at_s", [0, 300])
def test_a_sensor_that_is_dead_under_a_constant_load_is_named_within_ten_minutes(cell, load, at_s):
    """Dead before the load begins, or while it flows."""
    loaded = course(cell, 900, current_A=load * cell.cell.capacity_Ah)
    rest = [Sample((k + 1) * SECOND_NS, 0.0, round(3.9 + 0.001 * (k % 2), 3), 25.0) for k in range(120)]
    jump_V = rest[-1].voltage_V - (loaded[0].voltage_V + 0.025 * load * cell.cell.capacity_Ah)
    for sample in loaded:
        sample.t_ns += 120 * SECOND_NS
        sample.voltage_V += jump_V
    took_s, found = named_s(cell, rest + loaded, "dead", at_s)
    assert took_s - (120 if at_s == 0 else 0) <= 600
    assert found is Fault.CURRENT_FAILED


@pytest.mark.parametrize("load", [0.3, 0.5, 1.0])
@pytest.mark.parametrize("shown_A", [0.0, 0.05])
def test_a_load_that_has_flowed_since_before_the_first_sample_names_a_sensor_that_shows_none(cell, load, shown_A):
    """No step of the current shows it: only a voltage that goes on falling, where a rest comes to an end."""
    estimator, estimate = Estimator(cell), Estimate()
    watch, dice = Watch(estimator), np.random.default_rng(3)
    for sample in course(cell, 600, current_A=load * cell.cell.capacity_Ah):
        sample.current_A = round(shown_A + dice.normal(0.0, 0.005), 3)
        watch.take(sample, estimate)
        if watch.fault is Fault.CURRENT_FAILED:
            break
        estimate = estimator.step(sample)
    assert watch.fault is Fault.CURRENT_FAILED


def test_innovations_before_a_reset_do_not_accuse_a_sensor_after_it(cell):
    estimator = Estimator(cell)
    contradiction = Contradiction(estimator)
    for sample in course(cell, 600, current_A=0.5 * cell.cell.capacity_Ah):
        sample.current_A = 0.0
        contradiction.take(sample.t_ns, 0.0, estimator.step(sample))
        if contradiction.leans:
            break
    assert contradiction.leans
    contradiction.reset()
    assert not contradiction.leans


@pytest.mark.parametrize("name", sensor_failures.RIGHT)
def test_a_sensor_that_is_right_is_not_accused_in_any_situation_of_the_campaign(name):
    situation = classes.situation(name, 5)
    assert sensor_failures.watch(situation, until_first=False).fault is Fault.NONE, situation.words


@pytest.mark.parametrize("step_s", [0.01, 0.1, 1.0, 10.0])
@pytest.mark.parametrize("resolution_V", [0.001, 0.01])
@pytest.mark.parametrize("resolution_A", [0.001, 0.1])
def test_a_cell_that_relaxes_for_hours_after_a_load_accuses_nobody(cell, step_s, resolution_V, resolution_A):
    dice, sensor = np.random.default_rng(5), CurrentSensor(cell, 1)
    rows = min(round(7200 / step_s), 6000)
    t_s = step_s * np.arange(rows)
    current_A = np.where(t_s < 60, 5.0, 0.0) + dice.normal(0.0, 0.02, rows)
    since_s = np.maximum(t_s - 60.0, 0.0)
    risen_V = 0.05 * (since_s > 0) + 0.06 * -np.expm1(-since_s / 15) + 0.05 * -np.expm1(-since_s / 400)
    voltage_V = 3.6 + 1.6 * risen_V + dice.normal(0.0, 0.001, rows)
    shown = zip(
        t_s.tolist(),
        (np.round(current_A / resolution_A) * resolution_A).tolist(),
        (np.round(voltage_V / resolution_V) * resolution_V).tolist(),
        strict=True,
    )
    for now_s, shown_A, shown_V in shown:
        assert not sensor.see(Sample(round(1e9 * now_s), shown_A, shown_V, 25.0), 0.6)


def test_a_spike_on_a_resting_cell_is_not_blamed_on_the_current(cell):
    sensor = CurrentSensor(cell, 1)
    for k in range(600):
        voltage_V = 4.1 if k in {100, 300, 320, 340, 360, 420} else 3.7
        assert not sensor.see(Sample(k * SECOND_NS, 0.0, voltage_V, 25.0))


@pytest.mark.parametrize("failure", ["dead", "flipped", "halved"])
def test_what_a_failed_sensor_said_is_taken_back_and_missing_until_it_is_right(cell, failure, caplog):
    estimator, dice = Estimator(cell), np.random.default_rng(2)
    watch, estimate = Watch(estimator), Estimate()
    caplog.set_level(logging.INFO)
    samples = course(cell, AT_S + 400)
    truth, faults, errors, sigmas = 0.8, [], [], []
    for sample in samples:
        truth -= sample.current_A / 3600 / cell.cell.capacity_Ah
        t_s = sample.t_ns / SECOND_NS
        if AT_S < t_s <= AT_S + 200:
            sample.current_A = FAILURES[failure](sample.current_A, dice)
        watch.take(sample, estimate)
        estimate = estimator.step(sample)
        assert math.isnan(sample.current_A) == (watch.fault is not Fault.NONE)
        faults.append(watch.fault)
        errors.append(abs(estimate.soc - truth))
        sigmas.append(estimate.soc_sigma)
    named = next(k for k, fault in enumerate(faults) if fault)
    assert faults[-1] is Fault.NONE, "right again, and used again"
    right = next(k for k in range(named, len(faults)) if not faults[k])
    assert right - (AT_S + 200) < 120
    assert not any(faults[:AT_S] + faults[right:])
    assert max(errors[AT_S:named]) > 0.0
    missing = slice(named, AT_S + 200)
    assert all(error < 3.0 * sigma for error, sigma in zip(errors[missing], sigmas[missing], strict=True))
    charge_A, discharge_A = cell.cell.current_limits_A
    unknown_As = (discharge_A - charge_A) / 2 * (named - AT_S)  # one sigma; the voltage at the end takes some of it
    gained = math.sqrt(max(sigmas[named] ** 2 - sigmas[AT_S - 1] ** 2, 0.0))
    assert gained > 0.75 * unknown_As / 3600 / cell.cell.capacity_Ah, "the time since is a gap"
    told = [record.levelno for record in caplog.records]
    assert told == [logging.ERROR, logging.INFO], "once each"


@pytest.mark.parametrize(("period_s", "dead_s"), [(120, 20), (200, 60), (300, 30)])
@pytest.mark.parametrize("seed", [1, 2])
def test_what_fails_now_and_then_is_not_used_again_in_between(cell, period_s, dead_s, seed):
    sensor, used_s, named = CurrentSensor(cell, 1), 0, False
    for k, sample in enumerate(course(cell, AT_S + 2700, seed)):
        if k > AT_S and k % period_s < dead_s:
            sample.current_A = 0.0
        sensor.see(sample, 0.7)
        named |= sensor.fault is not Fault.NONE
        used_s += named and sensor.fault is Fault.NONE
    assert named
    assert used_s <= 300  # of 2700: once, and until it fails again


def test_the_fault_is_on_the_bus_and_the_status_not_ok(cell):
    with rig_of(cell) as rig:
        told = []
        for sample in course(cell, AT_S):
            if sample.t_ns > 600 * SECOND_NS:
                sample.current_A = 0.0
            rig.feed(sample)
            told += rig.published()
    named = next(k for k, row in enumerate(told) if "CurrentFailed" in row.faults)
    assert 600 < named < 720
    assert all(row.status is not Status.OK and "CurrentFailed" in row.faults for row in told[named:])


def test_the_estimator_goes_back_to_before_the_failure_and_the_copies_do_not_pile_up(cell):
    estimator, rewind = Estimator(cell), Rewind()
    known = {}
    for sample in course(cell, 900):
        rewind.keep(estimator, sample.t_ns)
        known[sample.t_ns] = estimator.step(sample).soc
    assert len(rewind._kept) <= BACK_NS // EVERY_NS + 1
    since_ns = 800 * SECOND_NS
    rewind.back(estimator, since_ns, 900 * SECOND_NS)
    assert estimator.t_ns == 900 * SECOND_NS
    before = [soc for t_ns, soc in known.items() if since_ns - 30 * SECOND_NS < t_ns < since_ns]
    after = estimator.coast(900 * SECOND_NS)
    assert min(before) - 0.02 < after.soc < max(before) + 0.02
    assert after.faults & Fault.CURRENT_MISSING


@pytest.mark.parametrize("cells", [1, 5])
def test_what_an_estimator_goes_back_to_is_bit_for_bit_what_it_knew(cell, cells):
    """Of a start, whose belief is one of components that narrow from sample to sample."""
    estimator, samples = Estimator(cell, cells), course(cell, 60)

    def step(sample: Sample) -> tuple[float, ...]:
        volts = sample.voltage_V if cells == 1 else sample.voltage_V + 0.02 * np.arange(cells)
        estimate = estimator.step(Sample(sample.t_ns, sample.current_A, volts, 25.0))
        return tuple(np.ravel([estimate.soc, estimate.soc_low, estimate.soc_high]))

    for sample in samples[:5]:
        step(sample)
    kept = estimator.keep()
    first = [step(sample) for sample in samples[5:]]
    estimator.go_back(kept)
    assert [step(sample) for sample in samples[5:]] == first


@pytest.mark.parametrize("cells", [1, 3])
@pytest.mark.parametrize("share", [1.0, 0.5, -1.0])
def test_intervals_contradict_each_other_where_the_charge_between_them_is_not_what_flowed(cell, cells, share):
    """A tenth of the capacity an hour flows, and SoC falls by it; the sensor shows a `share` of that."""
    estimator = Estimator(cell, cells)
    contradiction = Contradiction(estimator)
    stands = []
    for k in range(0, 3 * 3600, 10):
        soc = 0.8 - 0.1 * k / 3600 - 0.1 * (np.arange(cells) == 2)  # of one cell of a pack by more, from the first on
        low, high = (soc - 0.01, soc + 0.01) if cells > 1 else (float(soc[0]) - 0.01, float(soc[0]) + 0.01)
        estimate = Estimate(soc=(low + high) / 2, soc_low=low, soc_high=high)
        contradiction.take(k * SECOND_NS, share * 0.1 * cell.cell.capacity_Ah, estimate)
        stands.append(contradiction.stands(k * SECOND_NS))
    assert any(stands) == (share != 1.0)
    assert not any(stands[:30]), "the intervals are wider than that"


def test_a_wide_interval_and_a_gap_in_the_current_contradict_nothing(cell):
    contradiction = Contradiction(Estimator(cell))
    for k in range(3600):
        soc = 0.8 if k < 1800 else 0.4
        half = 0.01 if (k % 1000 < 500 and k < 1800) or k > 1900 else 0.3
        shown_A = NAN if 1700 < k < 1850 else 0.0
        contradiction.take(k * SECOND_NS, shown_A, Estimate(soc=soc, soc_low=soc - half, soc_high=soc + half))
        assert not contradiction.stands(k * SECOND_NS)


@pytest.mark.parametrize("spike_A", [500.0, -500.0, math.inf])
def test_a_current_that_the_filter_ignores_moves_no_charge_between_intervals(cell, spike_A):
    contradiction = Contradiction(Estimator(cell))
    for k in range(600):
        shown_A = spike_A if k % 30 == 29 else 0.0
        contradiction.take(k * SECOND_NS, shown_A, Estimate(soc=0.6, soc_low=0.58, soc_high=0.62))
        assert not contradiction.stands(k * SECOND_NS)


def test_a_block_is_the_same_whichever_frame_of_an_instant_comes_first():
    def blocks(*order: str) -> list[tuple[float, float]]:
        made, taken = [], Blocks(1, math.inf, (0.0, 5.0))
        for k in range(1, 20):
            parts = {"i": Sample(k * SECOND_NS, float(k)), "v": Sample(k * SECOND_NS, voltage_V=3.0 + 0.01 * k)}
            made += [taken.take(parts[part]) for part in order]
        return [(block.current_A, block.voltage_V) for block in made if block is not None][1:]

    assert blocks("i", "v") == blocks("v", "i")


def test_a_voltage_that_was_silent_for_a_while_is_no_step_of_a_load(cell):
    sensor, told = CurrentSensor(cell, 1), []
    for sample in course(cell, 900):
        if 300 < sample.t_ns / SECOND_NS % 400 <= 320:
            sample.voltage_V = NAN
        told.append(sensor.see(sample, 0.7))
    assert not any(told)
