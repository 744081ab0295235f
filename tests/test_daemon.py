"""Frames in, SoC frames out, on python-can's virtual bus: what is published while all is well, and while it is not."""

from __future__ import annotations

import errno
import itertools
import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from model_cell import ModelCell

from bms_ukf import CellParams, Estimate, Estimator, Fault, Sample, Status, Tuning, clock
from bms_ukf import core as core_module
from bms_ukf.alignment import Alignment
from bms_ukf.bus import SafeBus, open_bus
from bms_ukf.clock import LockstepClock, StampClock
from bms_ukf.config import Bus
from bms_ukf.core import FAULT_HOLD_NS
from bms_ukf.daemon import Daemon
from bms_ukf.dbc import own_matrix
from bms_ukf.decoder import Decoder
from bms_ukf.intake import Intake
from bms_ukf.node import EstimateDecoder, SampleEncoder
from bms_ukf.open_circuit import OpenCircuit
from bms_ukf.pace import Pace
from bms_ukf.pack_output import PackOutput

SECOND_NS = 1_000_000_000
SILENCE_S = 2.5  # between two and three of the samples below, one a second
COUNTERS = 15  # an alive counter is 0..14
SOC_BIT, SIGMA_BIT = 0.0025e-2, 0.0025e-2  # what a bit of the DBC is worth
VOLTAGE_BIT, INNOVATION_BIT, NIS_BIT, AGE_BIT = 0.0002, 0.0001, 0.01, 0.01
PACK, CELLS, TEMPERATURES, SOC, QUALITY, STATE = 0x120, 0x121, 0x122, 0x220, 0x221, 0x222
DETAIL, HEALTH = 0x224, 0x225
CELL_SOC, PACK_STATE, CELL_SIGMA = 0x223, 0x226, 0x22B

_channels = (f"test-daemon-{k}" for k in itertools.count())


def load_A(k: int) -> float:
    """A drive of sorts, in whole milliampere: rests, discharge, and a little charge."""
    return round(5.0 * math.sin(0.05 * k) + 2.5, 3) if k % 60 > 5 else 0.0


@pytest.fixture
def samples(cell):
    """Makes the samples of a drive, one a second, in units the DBC can carry."""

    def make(count: int) -> list[Sample]:
        battery = ModelCell(cell, soc=0.8)
        made = []
        for k in range(count):
            voltage_V = battery.step(load_A(k), 1.0)
            made.append(Sample((k + 1) * SECOND_NS, load_A(k), round(voltage_V / 0.0005) * 0.0005, 25.0))
        return made

    return make


def charge(drive: list[Sample], cell: CellParams) -> float:
    """What a second's drive per sample takes from SoC."""
    return sum(sample.current_A for sample in drive) / 3600 / cell.cell.capacity_Ah


def read(frames: list[can.Message]) -> dict[str, dict[str, Any]]:
    """The last of each message, as cantools reads it."""
    by_id = {m.frame_id: m for m in own_matrix().sound()}
    return {by_id[m.arbitration_id].name: by_id[m.arbitration_id].decode(bytes(m.data)) for m in frames}  # type: ignore[misc]


class Published(NamedTuple):
    """One SocEstimate and the BmsState before it, as cantools reads them."""

    status: Status
    soc: float  # NaN if not available
    sigma: float
    counter: int
    faults: set[str]


class Rig:
    """A vehicle, the daemon and a witness of what it publishes, on one bus; the test sets the time."""

    def __init__(self, cell: CellParams, cells: int = 1, **options: Any) -> None:
        settings = Bus(interface="virtual", channel=next(_channels))
        self.clock = LockstepClock()
        self.vehicle = open_bus(settings, "vehicle")
        self.bus = SafeBus(lambda: open_bus(settings, "daemon"))
        self.estimator = Estimator(cell, cells, options.pop("tuning", None))
        self.decoder = Decoder(cells=cells)
        options = {"clock": self.clock, "pace": Pace(SILENCE_S)} | options
        self.daemon = Daemon(self.bus, self.estimator, Intake(self.decoder), **options)
        self.encoder = SampleEncoder(cells)

    def close(self) -> None:
        self.bus.close()
        self.vehicle.shutdown()

    def send(self, *messages: can.Message) -> None:
        """Let the daemon handle these."""
        for message in messages:
            self.vehicle.send(message)
        while self.daemon.poll(0.0):
            pass

    def feed(self, sample: Sample) -> None:
        self.clock.set(sample.t_ns)
        self.send(*(message(*frame, stamp_s=sample.t_ns * 1e-9) for frame in self.encoder.encode(sample)))

    def silence(self, t_ns: int) -> None:
        """Nothing on the bus until `t_ns`."""
        self.clock.set(t_ns)
        self.daemon.run(Once())  # type: ignore[arg-type]

    def frames(self) -> list[can.Message]:
        """What was published since the last call, without what only displays and logs want."""
        return [message for message in self.all_frames() if message.arbitration_id not in {DETAIL, HEALTH}]

    def all_frames(self) -> list[can.Message]:
        return list(iter(lambda: self.vehicle.recv(0.0), None))

    def published(self) -> list[Published]:
        """The same, read by cantools: a row for every set of frames."""
        return [_published(state, soc) for state, _, soc in sets(self.frames())]

    def estimates(self) -> list[Estimate]:
        """The same, read as a monitor would."""
        monitor = EstimateDecoder()
        read = [monitor.decode(m.arbitration_id, False, bytes(m.data), 0) for m in self.frames()]
        return [estimate for estimate in read if estimate is not None]


class Once:
    """A request to stop that comes after one turn of the daemon's loop."""

    def __init__(self) -> None:
        self._asked = 0

    def is_set(self) -> bool:
        self._asked += 1
        return self._asked > 1


def message(arbitration_id: int, extended: bool, data: bytes, *, stamp_s: float = 0.0, **kind: bool) -> can.Message:
    return can.Message(stamp_s, arbitration_id, extended, data=data, **kind)


def sets(frames: list[can.Message]) -> list[tuple[can.Message, ...]]:
    """Published frames of a single cell in sets of BmsState, SocQuality, SocEstimate."""
    rows = list(zip(*[iter(frames)] * 3, strict=True))
    assert all([m.arbitration_id for m in row] == [STATE, QUALITY, SOC] for row in rows)
    return rows


def _published(state: can.Message, soc: can.Message) -> Published:
    matrix = own_matrix()
    signals: dict[str, Any] = matrix.message("SocEstimate").decode(bytes(soc.data), decode_choices=False)  # type: ignore[assignment]
    bits: dict[str, Any] = matrix.message("BmsState").decode(bytes(state.data), decode_choices=False)  # type: ignore[assignment]
    missing = bytes(soc.data)[2:4] == b"\xff\xff"
    return Published(
        Status(signals["Status"]),
        math.nan if missing else signals["Soc"] / 100,
        math.nan if missing else signals["SocSigma"] / 100,
        signals["AliveCounter"],
        {name.removeprefix("Fault") for name, bit in bits.items() if name.startswith("Fault") and bit},
    )


@contextmanager
def rig_of(cell: CellParams, cells: int = 1, **options: Any) -> Iterator[Rig]:
    rig = Rig(cell, cells, **options)
    yield rig
    rig.close()


@pytest.fixture
def rig(cell, monkeypatch):
    monkeypatch.setattr(core_module, "PATIENCE_NS", 0)
    with rig_of(cell) as rig:
        yield rig


@pytest.fixture
def settled(rig, samples):
    """A rig whose estimator has seen a minute of driving; what it published then is read and gone."""
    for sample in samples(60):
        rig.feed(sample)
    rig.frames()
    return rig


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
        for tenth in range(1, 101):
            rig.silence(start_ns + tenth * SECOND_NS // 10)
        told = rig.published()
        assert len(told) == 100
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


# --- frames that are not to be trusted ------------------------------------------------------------------------------


def corrupted(data: bytes) -> bytes:
    return bytes([data[0] ^ 0x01]) + data[1:]


@pytest.mark.parametrize(
    ("spoil", "counter"),
    [
        (lambda frame: message(frame[0], frame[1], corrupted(frame[2])), "crc"),
        (lambda frame: message(frame[0], frame[1], frame[2][:7]), "short"),
        (lambda frame: message(frame[0], frame[1], b""), "short"),
    ],
    ids=["bad CRC", "short", "empty"],
)
def test_a_spoilt_frame_is_counted_shown_for_a_while_and_changes_nothing_else(settled, samples, spoil, counter):
    drive = samples(63)
    before = settled.estimator.snapshot()
    frames = settled.encoder.encode(drive[60])
    settled.clock.set(drive[60].t_ns)
    settled.send(*map(spoil, frames))
    assert settled.estimator.snapshot() == before
    assert getattr(settled.decoder.counters, counter) == len(frames)
    assert settled.published() == []

    settled.feed(drive[61])
    (told,) = settled.published()
    assert "E2e" in told.faults
    assert told.status is Status.DEGRADED
    settled.feed(replace(drive[62], t_ns=drive[61].t_ns + FAULT_HOLD_NS - 1))
    assert "E2e" in settled.published()[0].faults
    settled.feed(replace(drive[62], t_ns=drive[61].t_ns + FAULT_HOLD_NS))
    (told,) = settled.published()
    assert told.faults == set()
    assert told.status is Status.OK


def test_a_sender_that_hangs_is_refused_and_its_value_is_soon_missing(settled, samples):
    drive = samples(80)
    stuck = [message(*frame) for frame in settled.encoder.encode(drive[60])]
    settled.clock.set(drive[60].t_ns)
    settled.send(*stuck)
    accepted = settled.estimator.accepted
    settled.frames()
    for sample in drive[61:]:
        settled.clock.set(sample.t_ns)
        settled.send(*stuck)
        settled.silence(sample.t_ns)
    assert settled.estimator.accepted == accepted
    assert settled.decoder.counters.counter == 3 * len(drive[61:])
    told = settled.published()
    assert len({row.counter for row in told}) == 1, "a hanging sender must not make the estimator look alive"
    assert {"CurrentMissing", "VoltageMissing", "E2e"} <= told[-1].faults


@pytest.mark.parametrize(
    ("foreign", "counter"),
    [
        (message(PACK, False, b"", is_remote_frame=True), "not_data"),
        (message(0x20000004, True, bytes(8), is_error_frame=True), "not_data"),
        (message(PACK, False, bytes(8), is_fd=True), "not_data"),
        (message(0x7FF, False, bytes(8)), "unknown_id"),
        (message(PACK, True, bytes(8)), "unknown_id"),
    ],
    ids=["remote", "error", "FD", "unknown id", "extended id"],
)
def test_a_foreign_frame_is_counted_and_is_no_fault(settled, samples, foreign, counter):
    before = settled.estimator.snapshot()
    settled.send(foreign)
    assert settled.estimator.snapshot() == before
    assert getattr(settled.decoder.counters, counter) == 1
    settled.feed(samples(61)[-1])
    (told,) = settled.published()
    assert told.faults == set()


def test_frames_lost_on_the_way_are_shown(settled, samples):
    drive = samples(64)
    settled.encoder.encode(drive[60])  # never arrives
    settled.feed(drive[61])
    (told,) = settled.published()
    assert told.faults == {"Bus"}
    assert told.status is Status.DEGRADED
    settled.feed(drive[63])
    assert settled.published()[0].faults == set()


# --- a failing interface --------------------------------------------------------------------------------------------


class Flaky:
    """A python-can bus in front of another one, which fails with `error` while that is set."""

    def __init__(self, inner: can.BusABC) -> None:
        self.inner = inner
        self.error: Exception | None = None

    def recv(self, timeout: float) -> can.Message | None:
        self._fail()
        return self.inner.recv(timeout)

    def send(self, frame: can.Message) -> None:
        self._fail()
        self.inner.send(frame)

    def shutdown(self) -> None:
        """The inner bus is opened once and kept."""

    def _fail(self) -> None:
        if self.error is not None:
            raise self.error


@pytest.fixture
def flaky(settled):
    """The interface of a settled rig's daemon, which the test can break."""
    flaky = Flaky(settled.bus._bus)  # its opener gives the same again
    settled.bus._bus, settled.bus._opener = flaky, lambda: flaky
    yield flaky
    flaky.inner.shutdown()


@pytest.mark.parametrize(
    "error",
    [can.CanOperationError("down", errno.ENETDOWN), can.CanError("broken"), OSError(errno.ENODEV, "gone")],
    ids=["network down", "python-can", "operating system"],
)
def test_the_state_survives_a_failing_interface_and_the_failure_is_shown(settled, flaky, cell, error, samples):
    drive = samples(70)
    before = replace(settled.daemon.estimate)
    flaky.error = error
    settled.silence(before.t_ns + SECOND_NS)
    assert settled.bus.counters.receive_failed == 1
    flaky.error = None
    settled.bus._retry_at = 0.0
    for sample in drive[61:]:
        settled.feed(sample)
    told = settled.published()
    assert "Bus" in told[0].faults
    assert told[-1].faults == set()
    assert settled.bus.counters.reopened == 1
    assert told[-1].soc == pytest.approx(before.soc - charge(drive[60:], cell), abs=0.005)


def test_a_full_queue_loses_the_answer_and_nothing_else(settled, flaky, samples):
    drive = samples(62)

    def full(_: can.Message) -> None:
        raise can.CanOperationError("queue full", errno.ENOBUFS)

    flaky.send = full
    settled.feed(drive[60])
    assert settled.published() == []
    assert settled.bus.counters.send_failed >= 4
    del flaky.send
    settled.feed(drive[61])
    (told,) = settled.published()
    assert told.faults == {"Bus"}
    assert settled.bus.counters.reopened == 0


# --- time -----------------------------------------------------------------------------------------------------------


class Monotonic:
    now_ns = 0

    def monotonic_ns(self) -> int:
        return self.now_ns


@given(gaps_ms=st.lists(st.integers(1, 4000), min_size=20, max_size=40))
@settings(max_examples=20)
def test_charge_is_counted_over_the_time_between_frames_and_not_per_frame(cell, gaps_ms):
    """Frames as they come, at any intervals below current_timeout_s: no polling period is assumed."""
    with rig_of(cell, tuning=Tuning(current_bias=False)) as rig:
        rig.feed(Sample(0, 0.0, 3.8, 25.0))
        start, t_ns = rig.daemon.estimate.soc, 0
        for gap_ms in gaps_ms:
            t_ns += gap_ms * 1_000_000
            rig.clock.set(t_ns)
            rig.send(message(*rig.encoder.pack(Sample(t_ns, current_A=3.0, voltage_V=3.8))))
        moved = 3.0 * t_ns * 1e-9 / 3600 / cell.cell.capacity_Ah
        assert start - rig.daemon.estimate.soc == pytest.approx(moved, abs=1e-6)


@pytest.mark.parametrize("step_s", [3600.0, -3600.0])
def test_setting_the_wall_clock_moves_no_charge(cell, monkeypatch, step_s, samples):
    monotonic = Monotonic()
    monkeypatch.setattr(clock, "time", monotonic)

    def final(step_s: float) -> Estimate:
        with rig_of(cell, clock=StampClock()) as rig:
            for k, sample in enumerate(samples(60)):
                monotonic.now_ns += SECOND_NS
                stamp_s = 1.79e9 + k + (step_s if k >= 30 else 0.0)
                rig.send(*(message(*frame, stamp_s=stamp_s) for frame in rig.encoder.encode(sample)))
            return replace(rig.daemon.estimate)

    steady, stepped = final(0.0), final(step_s)
    assert stepped.soc == pytest.approx(steady.soc, abs=1e-9)
    assert stepped.status is Status.OK


# --- anything at all ------------------------------------------------------------------------------------------------

ANY_FRAME = st.builds(
    can.Message,
    timestamp=st.floats(0, 1e10),
    arbitration_id=st.sampled_from([PACK, CELLS, TEMPERATURES, SOC, 0x7FF]),
    is_extended_id=st.just(False),
    is_remote_frame=st.just(False),
    is_error_frame=st.booleans(),
    data=st.binary(max_size=8),
)
ANY_VALUE = st.one_of(st.just(math.nan), st.floats(-1e4, 1e4), st.floats(2.0, 4.5))
ANY_SAMPLE = st.builds(
    Sample,
    t_ns=st.integers(0, 10**13),
    current_A=ANY_VALUE,
    voltage_V=st.one_of(ANY_VALUE, st.floats(2.5, 4.2)),
    temperature_degC=st.one_of(ANY_VALUE, st.floats(-40, 80)),
)


@settings(max_examples=150, deadline=None)
@given(events=st.lists(st.one_of(ANY_FRAME, ANY_SAMPLE), max_size=25))
def test_no_frames_in_any_order_raise_or_make_an_ok_soc_outside_0_to_1(cell, events):
    with rig_of(cell) as rig:
        for event in events:
            if isinstance(event, Sample):
                rig.feed(event)
            else:
                rig.send(event)
            for told in rig.published():
                available = told.status in {Status.OK, Status.DEGRADED}
                assert available == (not math.isnan(told.soc))
                assert not available or 0.0 <= told.soc <= 1.0
        shown = rig.daemon.estimate
        assert shown.status in set(Status)
        assert Fault(shown.faults) == shown.faults
