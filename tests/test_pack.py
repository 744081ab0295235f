"""What a pack may give and how far it reaches, held against cells that do just what the model says."""

from __future__ import annotations

import math
import tracemalloc

import numpy as np
import pytest
from drives import CELL, steady
from model_cell import ModelCell

from bms_ukf import Estimator, Fault, Sample, Status, Tuning, Wiring, shown
from bms_ukf.pack import Health, Limits, Pack, PackEstimate

NAN = float("nan")
SECOND = 1_000_000_000
STEADY = steady()
CAPACITY_AH = STEADY.cell.capacity_Ah
LIMITS = Limits(current_A=(-200.0, 200.0))  # so that the voltage limits


def known(socs: list[float], loads: float = 0.0, **settings) -> tuple[Pack, PackEstimate, list[ModelCell]]:
    """A pack of model cells, known well, after ten minutes around `loads`, A: r0 shows where a current changes."""
    models = [ModelCell(STEADY, soc) for soc in socs]
    sigma = max(0.005, float(np.std(socs)))
    tuning = Tuning(initial_soc=float(np.mean(socs)), initial_soc_sigma=sigma, current_bias=False)
    estimator = Estimator(STEADY, len(socs), tuning)
    pack = Pack(estimator, settings.pop("limits", LIMITS))
    for k in range(600):
        load = loads * (0.4 if k % 20 < 10 else 1.6) if k < 540 else loads
        volts = np.array([model.step(load, 1.0) for model in models])
        sample = Sample(k * SECOND, load, volts if len(models) > 1 else float(volts[0]), 25.0)
        estimate = estimator.step(sample)
        told = pack.update(estimate, sample)
    return pack, told, models


@pytest.mark.parametrize("load", [0.0, 5.0, -2.5])
def test_a_pulse_at_its_limit_ends_at_the_voltage_limit(load: float):
    pack, told, models = known([0.5, 0.62], load)
    low_V, high_V = STEADY.cell.voltage_limits_V
    for cell, model in enumerate(models):
        for limit_A, limit_V in ((told.cell_discharge_A[cell], low_V), (told.cell_charge_A[cell], high_V)):
            pulsed = ModelCell(STEADY, model.soc)
            pulsed._v_rc = list(model._v_rc)
            for _ in range(100):
                voltage = pulsed.step(float(limit_A), 0.1)
            sigma_A = (told.cell_discharge_sigma_A if limit_A > 0 else told.cell_charge_sigma_A)[cell]
            assert voltage == pytest.approx(limit_V, abs=0.03)
            assert sigma_A > 0
    assert told.discharge_A == min(told.cell_discharge_A)
    assert told.charge_A == max(told.cell_charge_A)
    assert told.discharge_W == pytest.approx(told.discharge_A * 2 * low_V, rel=0.1)
    assert pack.estimator.cells == 2


def test_a_longer_pulse_may_be_no_larger_and_a_current_limit_holds():
    short, long = (known([0.5], limits=Limits(current_A=(-200, 200), pulse_s=s))[1].discharge_A for s in (2.0, 30.0))
    assert long < 0.95 * short
    told = known([0.5])[0]
    limited = Pack(told.estimator).update(told.estimator.coast(601 * SECOND), Sample(601 * SECOND))
    assert limited.discharge_A == STEADY.cell.current_limits_A[1]
    assert limited.discharge_sigma_A == 0


def test_a_pulse_is_in_doubt_as_far_as_its_soc_is():
    """Where SoC is off by one sigma, so is the limit: by what the OCV's slope makes of it, at least."""
    estimator = Estimator(STEADY, 1, Tuning(initial_soc=0.8, initial_soc_sigma=0.02, current_bias=False))
    pack = Pack(estimator, LIMITS)
    estimate = estimator.step(Sample(0, 0.0, float(STEADY.ocv_V(0.8, 25.0)), 25.0))
    told = pack.update(estimate, Sample(0))
    before, sigma_A, slot = told.discharge_A, told.discharge_sigma_A, estimator._form.x
    estimator._state[0, slot, 0] += estimate.soc_sigma
    moved = abs(pack.update(estimate, Sample(0)).discharge_A - before)
    assert 0.3 * moved < sigma_A


def test_an_empty_cell_is_where_its_voltage_limit_is_met_at_the_stated_rate():
    _, told, _ = known([0.3], limits=Limits(discharge_rate=1.0))
    model = ModelCell(STEADY, 0.9)
    while model.step(CAPACITY_AH, 1.0) > STEADY.cell.voltage_limits_V[0]:
        pass
    assert told.cell_empty_soc[0] == pytest.approx(model.soc, abs=0.003)
    assert told.remaining_Ah == pytest.approx((0.3 - model.soc) * CAPACITY_AH, abs=0.1)


def test_cold_takes_from_what_can_be_had_and_not_from_soc():
    warm, cold = (Estimator(CELL, 2, Tuning(initial_soc_sigma=0.3)) for _ in range(2))
    told = []
    for estimator, T in ((warm, 25.0), (cold, -10.0)):
        sample = Sample(0, 0.0, np.full(2, float(CELL.ocv_V(0.9, T))), T)
        estimate = estimator.step(sample)
        told.append(
            (
                estimate.soc[0],
                Pack(estimator, Limits(discharge_rate=1.0, current_A=(-200, 200))).update(estimate, sample),
            )
        )
    assert told[0][0] == pytest.approx(told[1][0], abs=0.01)
    assert told[1][1].cell_empty_soc[0] > told[0][1].cell_empty_soc[0] + 0.02
    assert told[1][1].remaining_Ah < told[0][1].remaining_Ah - 0.1
    assert told[1][1].cell_discharge_A[0] < told[0][1].cell_discharge_A[0]


def test_the_weakest_cell_decides_in_either_direction():
    pack, told, models = known([0.6, 0.5, 0.7])
    assert (told.empty_first, told.full_first, told.lowest, told.highest) == (1, 2, 1, 2)
    assert told.soc_max - told.soc_min == pytest.approx(0.2, abs=0.02)
    alone = [known([soc])[1] for soc in (0.5, 0.7)]
    assert told.remaining_Ah == pytest.approx(alone[0].remaining_Ah, abs=0.02)
    assert told.chargeable_Ah == pytest.approx(alone[1].chargeable_Ah, abs=0.02)
    assert told.soc == pytest.approx(told.remaining_Ah / (told.remaining_Ah + told.chargeable_Ah))
    assert told.soc_sigma == pytest.approx(told.remaining_sigma_Ah / (told.remaining_Ah + told.chargeable_Ah))
    assert 0.1 < told.remaining_sigma_Ah / CAPACITY_AH * 100 < 5
    assert models[0].soc == 0.6
    assert pack.update(pack.estimator.coast(600 * SECOND), Sample(600 * SECOND)) is told


def test_a_small_cell_may_be_empty_first_though_its_soc_is_higher():
    pack, *_ = known([0.6, 0.6])
    pack.estimator.capacity_scale = [1.0, 0.7]
    told = pack.update(pack.estimator.coast(600 * SECOND), Sample(600 * SECOND))
    assert told.empty_first == told.full_first == 1


@pytest.mark.parametrize("load", [2.5, -1.5])
def test_time_and_energy_to_the_end_are_what_the_cell_takes_for_it(load: float):
    limits = Limits(discharge_rate=0.5, charge_rate=0.3, current_A=(-200, 200))
    _, told, models = known([0.6], load, limits=limits)
    end_soc = float((told.cell_empty_soc if load > 0 else told.cell_full_soc)[0])
    seconds, energy_Ws, power_W = 0, 0.0, told.power_W
    while (models[0].soc - end_soc) * load > 0:
        voltage = models[0].step(load, 1.0)
        seconds, energy_Ws = seconds + 1, energy_Ws + abs(load) * voltage
    expected = told.remaining_Wh if load > 0 else told.chargeable_Wh
    assert expected == pytest.approx(energy_Ws / 3600, rel=0.03)
    taken_s = told.time_to_empty_s if load > 0 else told.time_to_full_s
    assert taken_s == pytest.approx(energy_Ws / abs(power_W), rel=0.03)
    assert math.isnan(told.time_to_full_s if load > 0 else told.time_to_empty_s)


def test_a_pack_at_rest_has_no_time_to_empty():
    told = known([0.5])[1]
    assert math.isnan(told.time_to_empty_s)
    assert math.isnan(told.time_to_full_s)
    assert told.remaining_Wh > 0


def test_a_cell_that_is_not_heard_is_named_and_the_rest_is_told():
    estimator = Estimator(STEADY, 3, Tuning(current_bias=False))
    pack = Pack(estimator)
    ocv = float(STEADY.ocv_V(0.6, 25.0))
    for k in range(60):
        sample = Sample(k * SECOND, 0.0, np.array([ocv, ocv, NAN]), 25.0)
        told = pack.update(estimator.step(sample), sample)
        if k == 2:
            assert told.status is Status.INITIALISING
            assert math.isnan(told.remaining_Ah)
            assert told.silent_cell == 2
    assert told.status is Status.DEGRADED
    assert Fault.VOLTAGE_MISSING in told.faults
    assert (told.silent, told.silent_cell) == (1, 2)
    assert told.soc > 0
    assert told.power_W == 0


def test_before_anything_is_known_nothing_is_told():
    estimator = Estimator(STEADY, 2)
    told = Pack(estimator).update(estimator.step(Sample(0)), Sample(0))
    assert math.isnan(told.soc)
    assert math.isnan(told.power_W)
    assert told.empty_first == told.discharge_cell == -1
    assert told.silent == 2


def test_strings_add_up():
    wired = Estimator(STEADY, 4, Tuning(current_bias=False), wiring=Wiring(string_of=[0, 0, 1, 1]))
    pack, single = Pack(wired, LIMITS), known([0.6, 0.6])[1]
    ocv = float(STEADY.ocv_V(0.6, 25.0))
    for k in range(600):
        sample = Sample(k * SECOND, NAN, np.full(4, ocv), 25.0, string_current_A=np.array([0.0, 0.01]))
        told = pack.update(wired.step(sample), sample)
    assert told.remaining_Ah == pytest.approx(2 * single.remaining_Ah, rel=0.05)
    assert told.remaining_Wh == pytest.approx(2 * single.remaining_Wh, rel=0.05)
    assert told.discharge_A == pytest.approx(2 * min(told.cell_discharge_A))
    assert told.power_W == pytest.approx(0.02 * ocv, rel=0.01)


def test_in_float32_the_same_is_told():
    told = []
    for precision in ("f32", "f64"):
        estimator = Estimator(CELL, 2, precision=precision)
        sample = Sample(0, 1.0, np.full(2, 3.5), 25.0)
        told.append(Pack(estimator, LIMITS).update(estimator.step(sample), sample))
    for name in ("soc", "remaining_Wh", "discharge_A", "charge_A", "discharge_sigma_A"):
        assert getattr(told[0], name) == pytest.approx(getattr(told[1], name), rel=2e-3), name


def test_a_cell_takes_less_than_two_kilobytes_beside_its_components():
    cells = 1000
    tracemalloc.start()
    estimator = Estimator(STEADY, cells)
    kept = Pack(estimator), Health(estimator), shown.blank(estimator.cells)
    taken = tracemalloc.get_traced_memory()[0] - estimator._parts.nbytes  # pages that no belief has used take none
    tracemalloc.stop()
    assert kept
    assert taken / cells < 2048


def test_before_every_cell_was_heard_nothing_is_known_but_which_is_silent():
    estimator = Estimator(STEADY, 3)
    sample = Sample(0, 1.0, np.array([3.7, NAN, 3.7]), 25.0)
    told = Pack(estimator).update(estimator.step(sample), sample)
    assert told.status is Status.INITIALISING
    assert math.isnan(told.soc)
    assert (told.empty_first, told.silent, told.silent_cell) == (-1, 1, 1)
