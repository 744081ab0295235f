"""The time of a frame, whatever the wall clock that stamped it does."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bms_ukf import clock
from bms_ukf.clock import TOLERANCE_NS, LockstepClock, StampClock

EPOCH_S = 1_790_000_000.0
HOUR_S = 3600.0


class Monotonic:
    """The module `time` as the clock under test sees it."""

    def __init__(self) -> None:
        self.now_ns = 123_456_789

    def monotonic_ns(self) -> int:
        return self.now_ns

    def wait(self, seconds: float) -> None:
        self.now_ns += round(seconds * 1e9)


@pytest.fixture
def monotonic(monkeypatch):
    time = Monotonic()
    monkeypatch.setattr(clock, "time", time)
    return time


def seconds(t_ns: int) -> float:
    return round(t_ns * 1e-9, 6)


def test_time_between_frames_is_that_of_their_stamps_not_of_reading_them(monotonic):
    stamps = StampClock()
    monotonic.wait(0.2)
    first = stamps.at(EPOCH_S)
    monotonic.wait(0.19)
    second = stamps.at(EPOCH_S + 0.1)
    monotonic.wait(0.01)
    third = stamps.at(EPOCH_S + 0.2)
    assert [seconds(first), seconds(second), seconds(third)] == [0.2, 0.3, 0.4]
    assert stamps.steps == 0


@pytest.mark.parametrize("step_s", [HOUR_S, -HOUR_S])
def test_setting_the_wall_clock_moves_no_time(monotonic, step_s):
    stamps = StampClock()
    before = stamps.at(EPOCH_S)
    monotonic.wait(0.1)
    across = stamps.at(EPOCH_S + 0.1 + step_s)
    monotonic.wait(0.1)
    after = stamps.at(EPOCH_S + 0.2 + step_s)
    assert [seconds(across - before), seconds(after - across)] == [0.1, 0.1]
    assert stamps.steps == 1


def test_a_reader_held_up_does_not_count_its_queue_twice(monotonic):
    stamps = StampClock()
    start = stamps.at(EPOCH_S)
    monotonic.wait(3.0)
    queued = [stamps.at(EPOCH_S + 0.1 * k) for k in range(1, 31)]
    assert queued == sorted(queued)
    assert seconds(queued[-1] - start) == 3.0
    monotonic.wait(0.1)
    assert seconds(stamps.at(EPOCH_S + 3.1) - queued[-1]) == 0.1


def test_silence_is_timed_and_a_frame_that_was_on_its_way_is_not_put_before_it(monotonic):
    stamps = StampClock()
    stamps.at(EPOCH_S)
    monotonic.wait(2.0)
    silent = stamps.advance()
    assert seconds(silent) == 2.0
    monotonic.wait(0.001)
    assert stamps.at(EPOCH_S + 1.999) >= silent
    monotonic.wait(1.0)
    assert seconds(stamps.at(EPOCH_S + 2.999)) == 3.0


def test_time_passes_before_the_first_frame(monotonic):
    stamps = StampClock()
    monotonic.wait(5.0)
    assert seconds(stamps.advance()) == 5.0
    monotonic.wait(1.0)
    assert seconds(stamps.at(EPOCH_S)) == 6.0


def test_an_interface_without_stamps_does_not_stop_time(monotonic):
    stamps = StampClock()
    for _ in range(100):
        monotonic.wait(0.1)
        t_ns = stamps.at(0.0)
    assert 10.0 - TOLERANCE_NS * 1e-9 <= seconds(t_ns) <= 10.0


@given(
    frames=st.lists(st.tuples(st.floats(0, 10), st.one_of(st.none(), st.floats(-1e10, 1e10))), max_size=50),
)
def test_no_stamps_make_time_run_backwards_or_ahead_or_fall_behind(frames):
    with pytest.MonkeyPatch.context() as patch:
        monotonic = Monotonic()
        patch.setattr(clock, "time", monotonic)
        stamps, start_ns, last_ns = StampClock(), monotonic.now_ns, 0
        for wait_s, stamp_s in frames:
            monotonic.wait(wait_s)
            t_ns = stamps.advance() if stamp_s is None else stamps.at(stamp_s)
            elapsed_ns = monotonic.now_ns - start_ns
            assert max(last_ns, elapsed_ns - TOLERANCE_NS) <= t_ns <= elapsed_ns
            last_ns = t_ns


def test_in_lockstep_the_simulation_alone_sets_the_time():
    lockstep = LockstepClock()
    lockstep.set(7)
    assert lockstep.at(EPOCH_S) == lockstep.advance() == 7
