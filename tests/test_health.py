"""What the use of a cell tells of its capacity and resistance, and what it must not be taken to tell."""

from __future__ import annotations

import math

import numpy as np
import pytest
import synthetic_cell
from drives import steady, terminal

from bms_ukf import Estimator, Fault, Sample, Tuning, Wiring
from bms_ukf.core import Core
from bms_ukf.decoder import Decoder
from bms_ukf.intake import Intake
from bms_ukf.node import SampleEncoder
from bms_ukf.pace import Pace
from bms_ukf.pack import Health
from bms_ukf.pack.counted import REST_S
from bms_ukf.scaling import scaled

CELL = steady()
PLATEAU = synthetic_cell.cell_of(synthetic_cell.plateau())
SECOND = 1_000_000_000
REST = np.zeros(2400)


def cycle(depth_Ah: float) -> np.ndarray:
    """Current of a day: down by pulses, a rest, up, a rest; the charge that goes comes back."""
    pulses = np.tile(np.repeat([4.0, 0.5, 3.0, 1.5], 30), 200)
    down = pulses[: int(np.searchsorted(np.cumsum(pulses), depth_Ah * 3600))]
    up_s = round(depth_Ah * 3600 / 2.0 / CELL.cell.coulombic_efficiency)
    return np.concatenate([REST, down, REST, np.full(up_s, -2.0)])


def used(
    capacities: list[float], offset_A: float = 0.0, r0: float = 1.0, days: int = 2, gap: bool = False
) -> tuple[Health, Estimator]:
    """Cells of these capacities, multiples of what the estimator is told, after some days."""
    current = np.concatenate([np.tile(cycle(4.0), days), REST])
    truth = [scaled(CELL, capacity, 1.0) for capacity in capacities]
    voltage = np.column_stack([terminal(cell, 0.95, current, r0=r0)[1] for cell in truth])
    voltage += 0.002 * np.random.default_rng(1).standard_normal(voltage.shape)
    estimator = Estimator(CELL, len(capacities))
    health, out = Health(estimator), None
    for k, i in enumerate(current.tolist()):
        if gap and i != 0 and k % 2000 < 20:
            continue
        volts = voltage[k] if len(capacities) > 1 else float(voltage[k, 0])
        sample = Sample(k * SECOND, i + offset_A, volts, 25.0)
        out = estimator.step(sample, out)
        health.follow(sample, out)
    return health, estimator


@pytest.fixture(scope="module")
def pack() -> tuple[Health, Estimator]:
    return used([1.0, 0.9, 0.95], offset_A=0.05)


def test_each_cell_of_a_pack_is_found_to_be_what_it_is_whatever_the_sensor_shows_too_much(pack):
    health, estimator = pack
    np.testing.assert_allclose(health.capacity, [1.0, 0.9, 0.95], rtol=0.015)
    assert (np.abs(health.capacity - [1.0, 0.9, 0.95]) < 2 * health.capacity_sigma).all()
    assert (health.capacity_sigma < 0.02).all()
    np.testing.assert_allclose(estimator.capacity_scale, health.capacity)
    assert (health.segments == 4).all()


def test_what_the_sensors_gain_may_be_wrong_by_is_not_averaged_away(pack):
    health, _ = pack
    assert (health.capacity_sigma > health.estimator.tuning.sensor_spec.current_gain_sigma * 0.9).all()


def test_a_resistance_is_found_by_the_steps_of_the_load_and_a_fresh_one_stays():
    aged, _ = used([1.0], r0=1.3, days=1)
    assert aged.resistance[0] == pytest.approx(1.3, rel=0.1)
    fresh, _ = used([1.0], days=1)
    assert fresh.resistance[0] == pytest.approx(1.0, abs=0.05)
    assert fresh.resistance_sigma[0] < 0.2


def test_charge_that_was_not_counted_tells_nothing():
    health, _ = used([0.9], days=1, gap=True)
    assert health.segments[0] == 0
    assert health.capacity[0] == 1.0
    assert health.capacity_sigma[0] == pytest.approx(0.1, rel=0.01)


def test_a_plateau_tells_hardly_anything():
    """From 80 to 40 % on LFP: the OCV says nothing of where SoC is, so nothing of what the charge was a share of."""
    estimator = Estimator(PLATEAU, 1, Tuning(initial_soc=0.8, initial_soc_sigma=0.01))
    health, out = Health(estimator), None
    current = np.concatenate([REST, np.full(2900, 1.0), REST])
    voltage = PLATEAU.ocv_V(0.8 - np.cumsum(current) / 3600 / PLATEAU.cell.capacity_Ah, 25.0)
    for k, i in enumerate(current.tolist()):
        sample = Sample(k * SECOND, i, float(voltage[k]) - 0.05 * i, 25.0)
        out = estimator.step(sample, out)
        health.follow(sample, out)
    assert health.capacity[0] == pytest.approx(1.0, abs=0.05)
    assert health.capacity_sigma[0] > 0.08


def test_health_outlives_a_restart(pack):
    health, _ = pack
    other = Health(Estimator(CELL, 3))
    other.restore(health.snapshot())
    assert other.snapshot() == health.snapshot()
    np.testing.assert_allclose(other.estimator.capacity_scale, health.capacity)


@pytest.mark.parametrize("spoil", [lambda data: data[:-1], lambda data: b"X" + data[1:], lambda _: b""])
def test_what_is_no_health_of_these_cells_is_refused(pack, spoil):
    other = Health(Estimator(CELL, 3))
    before = other.snapshot()
    with pytest.raises(ValueError, match="health"):
        other.restore(spoil(pack[0].snapshot()))
    assert other.snapshot() == before


def followed(health: Health, current: np.ndarray, voltage: np.ndarray, start: int = 0) -> None:
    """One sample a second, of a single cell."""
    out = None
    for k, (i, volts) in enumerate(zip(current.tolist(), voltage.tolist(), strict=True), start):
        sample = Sample(k * SECOND, i, volts, 25.0)
        out = health.estimator.step(sample, out)
        health.follow(sample, out)


def slept_over(offset_A: float, rested: int = 2) -> Health:
    """A cell of 0.9: a rest, down, so many seconds at rest, a night off, and a rest; `offset_A` is the sensor's."""
    current = np.concatenate([REST, cycle(4.0)[len(REST) : -1]])
    down = np.append(current[: np.flatnonzero(current > 0)[-1] + 1], np.zeros(rested))
    soc, voltage = terminal(scaled(CELL, 0.9, 1.0), 0.95, down)
    health = Health(Estimator(CELL))
    followed(health, down + offset_A, voltage)
    t_ns = len(down) * SECOND
    health.restore(health.snapshot())
    health.estimator.sleep(8 * 3600.0, t_ns)
    health.slept(8 * 3600.0, t_ns)
    followed(health, np.full(19, offset_A), np.full(19, float(CELL.ocv_V(soc[-1], 25.0))), len(down) + 1)
    return health


def test_a_night_switched_off_is_a_rest():
    """The voltage after it ends the segment that began with the rest before."""
    health = slept_over(0.0)
    assert health.segments[0] == 1
    assert health.capacity[0] == pytest.approx(0.9, abs=0.02)


def test_what_the_sensor_shows_too_much_has_not_flowed_while_it_was_off():
    """60 mA over a night of 8 h would be a tenth of the capacity."""
    health = slept_over(0.06)
    assert health.segments[0] == 1
    assert health.capacity[0] == pytest.approx(0.9, abs=0.02)


def test_a_process_that_dies_under_load_does_not_know_what_flowed_then():
    assert slept_over(0.0, rested=0).segments[0] == 0


def test_a_current_that_no_cell_can_have_is_not_counted():
    current = np.concatenate([REST, np.full(3600, 2.0), REST])
    _, voltage = terminal(CELL, 0.95, current)
    current[3000] = 3e4
    health = Health(Estimator(CELL))
    followed(health, current, voltage)
    assert health.segments[0] == 1
    assert health.capacity[0] == pytest.approx(1.0, abs=0.01)


def test_what_balancing_takes_is_charge_of_that_cell():
    """0.4 A from one of two cells, for an hour, told once; without it that cell would be of 1.2 times the capacity."""
    current = np.concatenate([REST, np.full(3600, 2.0), REST])
    bled = np.concatenate([REST, np.full(3600, 0.4), REST])
    voltage = np.column_stack([terminal(CELL, 0.95, current)[1], terminal(CELL, 0.95, current + bled)[1]])
    health, out = Health(Estimator(CELL, 2)), None
    for k, i in enumerate(current.tolist()):
        sample = Sample(k * SECOND, i, voltage[k], 25.0)
        if k in {len(REST), len(REST) + 3600}:
            sample.bleed_A = np.array([0.0, bled[k]])
        out = health.estimator.step(sample, out)
        health.follow(sample, out)
    np.testing.assert_array_equal(health.segments, 1)
    np.testing.assert_allclose(health.capacity, 1.0, atol=0.01)


def test_cells_of_parallel_strings_are_told_by_the_current_of_their_own():
    """2 A through one string, 3 A through the other one: by the other's current both cells would have aged or grown."""
    current = np.concatenate([REST, np.full(3600, 2.0), REST])
    voltage = np.column_stack([terminal(CELL, 0.95, through * current)[1] for through in (1.0, 1.5)])
    health, out = Health(Estimator(CELL, 2, wiring=Wiring(string_of=[0, 1]))), None
    for k, i in enumerate(current.tolist()):
        sample = Sample(k * SECOND, math.nan, voltage[k], 25.0, string_current_A=np.array([i, 1.5 * i]))
        out = health.estimator.step(sample, out)
        health.follow(sample, out)
    np.testing.assert_array_equal(health.segments, 1)
    np.testing.assert_allclose(health.capacity, 1.0, atol=0.02)


def test_cells_are_looked_at_once_in_ten_minutes_and_not_with_every_sample(monkeypatch):
    """What a look costs grows with the cells, and a pack gives hundreds of samples a second."""
    looks, look = [], Health._look
    monkeypatch.setattr(Health, "_look", lambda health, estimate: (looks.append(1), look(health, estimate)))
    health = Health(Estimator(CELL, 96))
    estimate = health.estimator.coast(0)
    for k in range(6001):
        health.follow(Sample(k * SECOND, 1.0), estimate)
    assert len(looks) == 10


def test_storing_what_is_known_every_ten_seconds_does_not_keep_it_from_being_told():
    current = np.concatenate([REST, cycle(4.0)[len(REST) :], REST])
    _, voltage = terminal(scaled(CELL, 0.9, 1.0), 0.95, current)
    alone, stored = Health(Estimator(CELL)), Health(Estimator(CELL))
    followed(alone, current, voltage)
    for k in range(0, len(current), 10):
        followed(stored, current[k : k + 10], voltage[k : k + 10], start=k)
        stored.snapshot()
    assert stored.segments[0] == alone.segments[0] > 0
    assert stored.told_s[0] == pytest.approx(alone.told_s[0])
    assert stored.capacity[0] == pytest.approx(alone.capacity[0], abs=1e-9)
    assert stored.resistance[0] == pytest.approx(alone.resistance[0], abs=1e-9)


def test_a_rest_that_is_hardly_long_enough_is_seen(monkeypatch):
    """Whenever the looks before it were: half an hour between two loads."""
    observed, observe = [], Health._observe
    monkeypatch.setattr(Health, "_observe", lambda health, estimate: (observed.append(1), observe(health, estimate))[1])
    for load_s in range(601, 1300, 97):
        health = Health(Estimator(CELL))
        rest = np.zeros(round(REST_S) + 2)
        current = np.concatenate([np.ones(load_s), rest, np.ones(5)])
        _, voltage = terminal(CELL, 0.95, current)
        followed(health, current, voltage)
        assert observed.pop()
        assert not observed


def test_replay_tells_what_following_every_step_does_and_changes_no_soc_but_by_it():
    current = np.concatenate([REST, cycle(4.0)[len(REST) :], REST])
    _, voltage = terminal(scaled(CELL, 0.9, 1.0), 0.95, current)
    stepped, replayed = Health(Estimator(CELL)), Health(Estimator(CELL))
    followed(stepped, current, voltage)
    rows = np.arange(len(current)) * SECOND, current, voltage, np.full(len(current), 25.0)
    told = replayed.replay(*rows)
    assert replayed.snapshot() == stepped.snapshot()
    assert replayed.estimator.snapshot() == stepped.estimator.snapshot()
    first = int(np.argmax(np.isfinite(told["soh"])))
    assert 0 < first < len(current) - 1
    assert told["soh"][-1] == stepped.capacity[0]
    alone = Estimator(CELL).replay(*rows)
    np.testing.assert_array_equal(told["soc"][: first - 60], alone["soc"][: first - 60])


def test_nothing_told_is_not_a_whole_capacity():
    told = Health(Estimator(CELL, 3)).ageing()
    assert math.isnan(told.capacity_min)
    assert math.isnan(told.resistance_max)
    assert (told.capacity_cell, told.resistance_cell, told.segments) == (-1, -1, 0)


@pytest.mark.parametrize(("sign", "told"), [(1.0, 0.9), (-1.0, math.nan)])
def test_the_daemon_tells_it_from_frames_and_not_while_the_sign_of_the_current_is_wrong(sign, told):
    current = np.concatenate([REST, cycle(4.0)[len(REST) :], REST])
    _, voltage = terminal(scaled(CELL, 0.9, 1.0), 0.95, current)
    health, vehicle = Health(Estimator(CELL)), SampleEncoder()
    core = Core(health.estimator, Intake(Decoder()), Pace(silence_s=math.inf), health)
    for k, i in enumerate(current.tolist()):
        for frame in vehicle.encode(Sample(0, sign * i, float(voltage[k]), 25.0)):
            core.hear(*frame, k * SECOND)
    np.testing.assert_allclose(health.told_capacity, told, atol=0.02)
    assert (core.commissioning.fault is Fault.CURRENT_SIGN) == (sign < 0)
