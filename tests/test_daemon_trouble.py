"""The daemon among frames that are not to be trusted, failing interfaces and clocks that are set."""

from __future__ import annotations

import errno
import math
from dataclasses import replace

import can
import pytest
from daemon_rig import CELLS, PACK, SECOND_NS, SOC, TEMPERATURES, charge, message, rig_of
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_ukf import Estimate, Fault, Sample, Status, Tuning, clock
from bms_ukf.clock import StampClock
from bms_ukf.core import FAULT_HOLD_NS

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
