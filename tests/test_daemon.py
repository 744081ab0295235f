"""Frames in, SoC frames out, on a virtual bus: what is published while all is well, in silence, at a steady period."""

from __future__ import annotations

import errno
import itertools
import math
import threading
from dataclasses import replace
from typing import Any

import can
import numpy as np
import pytest
from daemon_rig import (
    AGE_BIT,
    CELL_SIGMA,
    CELL_SOC,
    COUNTERS,
    INNOVATION_BIT,
    NIS_BIT,
    PACK,
    PACK_STATE,
    QUALITY,
    SECOND_NS,
    SIGMA_BIT,
    SOC,
    SOC_BIT,
    STATE,
    VOLTAGE_BIT,
    charge,
    message,
    read,
    rig_of,
)

from bms_ukf import Estimator, Fault, Sample, Status
from bms_ukf import core as core_module
from bms_ukf.alignment import Alignment
from bms_ukf.dbc import own_matrix
from bms_ukf.intake import Intake
from bms_ukf.open_circuit import OpenCircuit
from bms_ukf.pace import Pace
from bms_ukf.pack_output import PackOutput

# --- all is well ----------------------------------------------------------------------------------------------------


def test_soc_on_the_bus_is_what_the_estimator_alone_says_of_the_same_samples(rig, cell, samples):
    alone = Estimator(cell)
    drive = samples(200)
    for sample in drive:
        rig.feed(sample)
    published = rig.estimates()
    assert len(published) == len(drive)
    for sample, told in zip(drive, published, strict=True):
        known = alone.step(sample)
        assert told.status == known.status
        assert told.faults == known.faults
        assert told.soc == pytest.approx(known.soc, abs=SOC_BIT * 0.51)
        assert told.soc_sigma == pytest.approx(known.soc_sigma, abs=SIGMA_BIT * 0.51)
        assert told.voltage_pred_V == pytest.approx(known.voltage_pred_V, abs=VOLTAGE_BIT * 0.51, nan_ok=True)
        assert told.innovation_V == pytest.approx(known.innovation_V, abs=INNOVATION_BIT * 0.51, nan_ok=True)
        assert told.nis == pytest.approx(min(known.nis, 163.81), abs=NIS_BIT * 0.51, nan_ok=True)
        assert told.age_s == pytest.approx(known.age_s, abs=AGE_BIT * 0.51)


def test_alive_counters_move_by_one_with_every_frame_while_steps_are_accepted(rig, samples):
    for sample in samples(40):
        rig.feed(sample)
    frames = rig.frames()
    for arbitration_id in (STATE, QUALITY, SOC):
        counters = [m.data[1] & 0x0F for m in frames if m.arbitration_id == arbitration_id]
        assert len(counters) == 40
        assert {(b - a) % COUNTERS for a, b in itertools.pairwise(counters)} == {1}


def test_a_pack_is_answered_once_a_scan_and_every_cell_in_turn(cell, monkeypatch):
    with rig_of(cell, cells=5) as rig:
        for k in range(1, 9):
            voltages = 3.9 + 0.01 * np.arange(5)
            rig.feed(Sample(k * SECOND_NS, 0.0, voltages, 25.0))
        frames = rig.frames()
        ids = [m.arbitration_id for m in frames]
        assert [i for i in ids if i in {STATE, QUALITY, SOC}] == [STATE, QUALITY, SOC] * 8
        assert ids[-1] == SOC
        assert ids.count(PACK_STATE) == 8
        assert ids.count(CELL_SIGMA) == ids.count(CELL_SOC) == 2, "one of two pages every five seconds"
        pages = [m.data[1] >> 4 | (m.data[2] & 0x3F) << 4 for m in frames if m.arbitration_id == CELL_SOC]
        assert pages == [0, 1]
        soc = rig.estimator.step(Sample(9 * SECOND_NS)).soc
        assert isinstance(soc, np.ndarray)
        assert list(soc) == sorted(soc)
        assert soc[-1] > soc[0] + 0.005


def test_a_cell_that_is_never_heard_does_not_hide_the_soc_of_the_pack(cell):
    """Until the others have been heard for the voltage's timeout there is none; from then on it is predicted."""
    with rig_of(cell, cells=6) as rig:
        voltages = np.array([3.9, 3.9, math.nan, 3.9, 3.9, 3.88])
        for k in range(1, 20):
            rig.feed(Sample(k * SECOND_NS, 2.5, voltages, 25.0))
        told = read(rig.all_frames())
    assert told["SocEstimate"]["Status"] == "degraded"
    assert 0 < told["PackState"]["UsableSoc"] < told["SocEstimate"]["Soc"] + 3
    assert told["PackState"]["UsableSocSigma"] > 0
    assert (told["PackTimes"]["SilentCells"], told["PackTimes"]["FirstSilentCell"]) == (1, 3)
    assert told["PackEnergy"]["RemainingEnergy"] > 0
    assert told["PackTimes"]["TimeToEmpty"] > 600
    assert told["PackTimes"]["TimeToFull"] == "NotAvailable"
    assert told["PackCurrents"]["ChargeCurrent"] < 0 < told["PackCurrents"]["DischargeCurrent"]


def test_what_a_pack_gives_is_told_by_the_mean_of_the_currents_and_the_voltages_of_a_whole_scan(cell):
    """Nine currents to each scan, and each page of voltages in a frame of its own."""
    with rig_of(cell, cells=6) as rig:
        rig.feed(Sample(SECOND_NS, 2.0, np.full(6, 3.7), 25.0))
        for current_A in (1.0, 3.0, 2.0):
            rig.send(message(*rig.encoder.pack(Sample(0, current_A, 22.2)), stamp_s=1.5))
        rig.feed(Sample(2 * SECOND_NS, 2.0, np.full(6, 3.7), 25.0))
        assert rig.daemon.pack.estimate.power_W == pytest.approx(2.0 * 3.7 * 6, rel=1e-3)


def test_of_a_single_cell_nothing_of_a_pack_is_sent_unless_asked_for(cell, samples):
    ids = []
    for asked in (False, True):
        with rig_of(cell) as rig:
            rig.daemon.pack = PackOutput(rig.estimator) if asked else None
            for sample in samples(3):
                rig.feed(sample)
            ids.append({m.arbitration_id for m in rig.all_frames()})
    assert ids[1] - ids[0] == {0x226, 0x227, 0x228, 0x229, 0x22A}


def test_a_fault_of_one_frame_is_told_with_its_scan_though_other_frames_come_after_it(settled, samples):
    spoilt, good = samples(62)[60:]
    settled.feed(replace(spoilt, current_A=900.0))
    settled.feed(good)
    faults = [told.faults for told in settled.published()]
    assert "CurrentImplausible" in faults[0]
    assert faults[1] == set()


def test_a_fault_of_any_cell_is_told_whichever_page_it_is_on(cell, monkeypatch):
    monkeypatch.setattr(core_module, "PATIENCE_NS", 0)
    with rig_of(cell, cells=6) as rig:
        for k in range(1, 30):
            rig.feed(Sample(k * SECOND_NS, 0.0, np.full(6, 3.7), 25.0))
        rig.frames()
        for k, volts in ((30, 8.0), (31, 2.6), (32, 3.7)):
            rig.feed(Sample(k * SECOND_NS, 0.0, np.array([volts, 3.7, 3.7, 3.7, 3.7, 3.7]), 25.0))
        told = [estimate.faults for estimate in rig.estimates()]
        assert told == [Fault.VOLTAGE_IMPLAUSIBLE, Fault.INNOVATION_REJECTED, Fault.NONE]


def test_before_everything_was_seen_it_says_so_and_gives_no_soc(rig):
    rig.feed(Sample(SECOND_NS, current_A=1.0, voltage_V=3.8))
    (told,) = rig.published()
    assert told.status is Status.INITIALISING
    assert math.isnan(told.soc)
    assert "TemperatureMissing" in told.faults


def test_a_bus_on_which_nothing_was_ever_heard_is_told_so(rig):
    rig.silence(3 * SECOND_NS)
    (told,) = rig.published()
    assert told.status is Status.INITIALISING
    assert math.isnan(told.soc)


def test_a_request_to_stop_is_obeyed_at_once(rig):
    stop = threading.Event()
    stop.set()
    rig.daemon.run(stop)
    assert rig.frames() == []


# --- silence --------------------------------------------------------------------------------------------------------


def test_silence_is_answered_by_predictions_that_cannot_be_taken_for_measurements(settled):
    before = settled.daemon.estimate
    last = replace(before)
    start_ns = last.t_ns
    for second in range(1, 601):
        settled.silence(start_ns + second * SECOND_NS)
    told = settled.published()
    assert len(told) == 200, "one every three seconds"
    assert {row.counter for row in told} == {told[0].counter}, "the alive counter is held"
    sigmas = [row.sigma for row in told if not math.isnan(row.sigma)]
    assert sigmas == sorted(sigmas)
    assert sigmas[0] > last.soc_sigma - SIGMA_BIT
    assert sigmas[-1] > 5 * last.soc_sigma
    late = told[1:]  # from 6 s on, past current_timeout_s and voltage_timeout_s
    assert {"CurrentMissing", "VoltageMissing"} <= set.intersection(*(row.faults for row in late))
    assert late[0].status is Status.DEGRADED
    assert {row.status for row in late} <= {Status.DEGRADED, Status.INVALID}
    assert late[-1].status is Status.INVALID, "and in the end no SoC could be defended"
    assert math.isnan(late[-1].soc)


def test_no_charge_is_invented_in_silence(settled, cell, samples):
    start = replace(settled.daemon.estimate)
    settled.feed(replace(samples(61)[-1], current_A=10.0))
    told = []
    for second in range(1, 31):
        settled.silence(start.t_ns + (1 + second) * SECOND_NS)
        told += settled.published()
    held_s = settled.estimator.tuning.current_timeout_s
    most = 10.0 * (1 + held_s) / 3600 / cell.cell.capacity_Ah
    known = [row.soc for row in told if not math.isnan(row.soc)]
    assert min(known) >= start.soc - most - 0.002
    assert known[-1] == known[4], "SoC stands still once the current is too old"


def test_the_alive_counter_moves_again_after_silence(settled, samples):
    drive = samples(70)
    start_ns = drive[59].t_ns
    settled.silence(start_ns + 3 * SECOND_NS)
    (held,) = settled.published()
    settled.feed(drive[63])
    (after,) = settled.published()
    assert (after.counter - held.counter) % COUNTERS == 1
    assert after.status is Status.OK


def test_voltage_alone_missing_is_a_prediction_every_now_and_then(settled, cell, samples):
    drive, before_soc = samples(90), settled.daemon.estimate.soc
    for sample in drive[60:]:
        settled.feed(replace(sample, voltage_V=math.nan))
    told = settled.published()
    assert len(told) == len(drive[60:]) // 3
    assert told[-1].status is Status.DEGRADED
    assert told[-1].faults == {"VoltageMissing"}
    assert told[-1].soc == pytest.approx(before_soc - charge(drive[60:], cell), abs=2 * SOC_BIT)


def test_a_sender_that_says_only_not_available_does_not_make_the_estimator_look_alive(settled, samples):
    start_ns = samples(60)[-1].t_ns
    accepted = settled.estimator.accepted
    for second in range(1, 31):
        settled.feed(Sample(start_ns + second * SECOND_NS))
        settled.silence(start_ns + second * SECOND_NS)
    told = settled.published()
    assert settled.estimator.accepted == accepted
    assert len({row.counter for row in told}) == 1
    assert {"CurrentMissing", "VoltageMissing"} <= told[-1].faults
    sigmas = [row.sigma for row in told]
    assert sigmas == sorted(sigmas)


@pytest.mark.parametrize("dead", [0, 2, 5])
def test_a_dead_cell_does_not_hold_up_the_answers_about_the_others(cell, dead):
    with rig_of(cell, cells=6) as rig:
        for k in range(1, 41):
            voltages = np.full(6, 3.7)
            if k > 20:
                voltages[dead] = math.nan
            rig.feed(Sample(k * SECOND_NS, 0.0, voltages, 25.0))
        answers = [m for m in rig.frames() if m.arbitration_id == SOC]
        assert 39 <= len(answers) <= 40


# --- a steady period ------------------------------------------------------------------------------------------------


def test_with_a_period_sets_come_at_a_steady_rate_however_fast_the_frames_do(cell, samples):
    with rig_of(cell, pace=Pace(period_s=0.5)) as rig:
        times = []
        for sample in samples(20):
            for tenth in range(10):
                rig.feed(replace(sample, t_ns=sample.t_ns + tenth * SECOND_NS // 10))
                times += [sample.t_ns + tenth * SECOND_NS // 10] * len(rig.published())
        assert set(np.diff(times)) == {SECOND_NS // 2}


def test_with_a_period_silence_is_told_at_the_same_rate_and_the_counter_is_held(cell, samples, monkeypatch):
    monkeypatch.setattr(core_module, "PATIENCE_NS", 0)
    with rig_of(cell, pace=Pace(period_s=0.1)) as rig:
        for sample in samples(30):
            rig.feed(sample)
        rig.frames()
        start_ns = samples(30)[-1].t_ns
        for tenth in range(1, 301):
            rig.silence(start_ns + tenth * SECOND_NS // 10)
        told = rig.published()
        assert len(told) == 300
        assert len({row.counter for row in told}) == 1
        assert {"CurrentMissing", "VoltageMissing"} <= told[-1].faults
        assert told[-1].sigma > told[0].sigma


# --- what a display and a log want ----------------------------------------------------------------------------------


def signals_of(name: str, frames: list[can.Message]) -> list[dict[str, Any]]:
    found = own_matrix().message(name)
    return [dict(found.decode(bytes(m.data))) for m in frames if m.arbitration_id == found.frame_id]  # type: ignore[arg-type]


def test_detail_comes_with_every_set_and_health_once_a_second(cell, samples):
    with rig_of(cell, pace=Pace(2.5)) as rig:
        for sample in samples(10):
            for half in range(2):
                rig.feed(replace(sample, t_ns=sample.t_ns + half * SECOND_NS // 2))
        frames = rig.all_frames()
        detail, health = signals_of("SocDetail", frames), signals_of("BusHealth", frames)
        assert (len(detail), len(health)) == (20, 10)
        assert [str(row["Source"]) for row in detail[:2]] == ["start", "voltage"]
        soc = signals_of("SocEstimate", frames)[-1]["Soc"]
        assert detail[-1]["SocSlewed"] == pytest.approx(soc, abs=2.0)
        assert abs(detail[-1]["CurrentBias"]) < 0.2
        assert {row["FramesRefused"] for row in health} == {0}


def test_what_was_refused_or_not_sent_is_counted_on_the_bus(settled, flaky, samples):
    drive = samples(70)
    settled.send(message(PACK, False, bytes(8)))
    flaky.error = can.CanOperationError("queue full", errno.ENOBUFS)
    settled.daemon._publish(drive[61].t_ns)
    flaky.error = None
    settled.all_frames()
    settled.feed(drive[65])
    (health,) = signals_of("BusHealth", settled.all_frames())
    assert (health["FramesRefused"], health["FramesNotSent"]) == (1, settled.bus.counters.send_failed)
    assert health["FramesNotSent"] >= 4


def test_a_current_of_the_wrong_sign_is_told_on_the_bus_and_not_passed_as_ok(cell, samples):
    with rig_of(cell) as rig:
        for sample in samples(200):
            rig.feed(replace(sample, current_A=-sample.current_A))
        told = rig.published()
        assert "CurrentSign" not in told[20].faults
        assert "CurrentSign" in told[-1].faults
        assert told[-1].status is not Status.OK


@pytest.mark.parametrize(("reading_A", "bias_A", "within_A"), [(0.12, 0.12, 0.015), (5.0, 0.0, 0.2)])
def test_behind_open_contactors_a_small_reading_is_published_as_offset_and_a_large_one_counts(
    cell, reading_A, bias_A, within_A
):
    with rig_of(cell) as rig:
        rig.daemon.intake = Intake(rig.decoder, OpenCircuit(limit_A=0.5))
        rig.decoder.contactor.is_open = True
        for k in range(1, 60):
            rig.decoder.contactor.t_ns = k * SECOND_NS
            rig.feed(Sample(k * SECOND_NS, reading_A, 3.7, 25.0))
        published = signals_of("SocDetail", rig.all_frames())[-1]["CurrentBias"]
        assert published == pytest.approx(bias_A, abs=within_A)
        rig.feed(Sample(61 * SECOND_NS, reading_A, 3.7, 25.0))
        health = signals_of("BusHealth", rig.all_frames())[-1]
        assert health["Contradictions"] == (reading_A > 0.5)


def test_signals_that_arrive_late_are_estimated_as_if_they_did_not(cell, samples):
    """Voltages half a second late, against the same drive in time: the same SoC and NIS."""
    punctual, told = Estimator(cell), []
    with rig_of(cell) as rig:
        late = Alignment(voltage_s=0.5)
        rig.daemon.intake = Intake(rig.decoder, alignment=late)
        for sample in samples(100):
            current, temperature, voltage = rig.encoder.encode(sample)
            rig.clock.set(sample.t_ns)
            rig.send(message(*current), message(*temperature))
            rig.clock.set(sample.t_ns + SECOND_NS // 2)
            rig.send(message(*voltage))
            told.append(replace(rig.daemon.estimate))
        known = [replace(punctual.step(sample)) for sample in samples(100)]
    assert [e.soc for e in told[1:]] == pytest.approx([e.soc for e in known[1:]], abs=2e-5)
    assert [e.nis for e in told[1:]] == pytest.approx([e.nis for e in known[1:]], abs=0.02)
