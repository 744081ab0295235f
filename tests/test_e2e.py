"""AUTOSAR E2E profile 11 A, against the specification's examples and an independent implementation."""

from __future__ import annotations

import e2e
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bms_ukf.e2e import COUNTER_WRONG, CRC_WRONG, Profile11A, Receiver, Sender

PROFILE = Profile11A(data_id=0x0123, max_delta=7, timeout_ns=500)


def frames(count: int, profile: Profile11A = PROFILE, word: int = 0) -> list[bytes]:
    """`count` frames with counters 0, 1, …, 14, 0, …"""
    sender = Sender(profile, length=8)
    return [sender.protect(word, tick + 1) for tick in range(count)]


def test_first_frames_are_those_printed_in_the_specification() -> None:
    """AUTOSAR FO R20-11, E2E Protocol Specification, examples of profile 11: BOTH, data ID 0x0123, 8 bytes of zeros."""
    assert [frame.hex() for frame in frames(2)] == ["cc00000000000000", "9101000000000000"]


@given(data_id=st.integers(0, 0xFFFF), payload=st.integers(0, 2**52 - 1), sent=st.integers(1, 20))
def test_an_independent_receiver_and_sender_agree(data_id: int, payload: int, sent: int) -> None:
    profile = Profile11A(data_id)
    ours = frames(sent, profile, payload << 12)[-1]
    assert e2e.p11.e2e_p11_check(bytearray(ours), data_id)
    theirs = bytearray((payload << 12).to_bytes(8, "little"))
    theirs[1] |= (sent - 1) % 15
    e2e.p11.e2e_p11_protect(theirs, data_id, increment_counter=False)
    assert ours == theirs


def test_one_or_two_flipped_bits_are_never_accepted() -> None:
    frame = int.from_bytes(frames(3, word=0x0123_4567_89AB_C000)[-1], "little")
    flips = {1 << i | 1 << j for i in range(64) for j in range(64)}
    verdicts = {Receiver(PROFILE).check((frame ^ flip).to_bytes(8, "little"), 0) for flip in flips}
    assert verdicts == {CRC_WRONG}


def test_a_frame_under_another_data_id_is_refused() -> None:
    assert Receiver(Profile11A(data_id=0x0124)).check(frames(1)[0], 0) == CRC_WRONG


def test_counter_15_which_the_profile_never_sends_is_refused() -> None:
    frame = bytearray(8)
    frame[1] = 15
    e2e.p11.e2e_p11_protect(frame, PROFILE.data_id, increment_counter=False)
    assert Receiver(PROFILE).check(bytes(frame), 0) == COUNTER_WRONG


def test_counter_is_held_while_the_tick_is() -> None:
    sender = Sender(PROFILE, length=8)
    assert [sender.protect(0, tick)[1] for tick in (1, 1, 2, 2, 5, 6)] == [0, 0, 1, 1, 2, 3]


def test_a_sender_that_never_ticked_sends_one_counter_only() -> None:
    sender = Sender(PROFILE, length=8)
    assert len({sender.protect(0, 0) for _ in range(5)}) == 1


@pytest.mark.parametrize(
    ("counter", "verdict"),
    [(4, 0), (5, 1), (10, 6), (11, COUNTER_WRONG), (3, COUNTER_WRONG), (2, COUNTER_WRONG), (14, COUNTER_WRONG)],
)
def test_after_counter_3(counter: int, verdict: int) -> None:
    sent = frames(15)
    receiver = Receiver(PROFILE)
    assert receiver.check(sent[3], 0) == 0
    assert receiver.check(sent[counter], 1) == verdict


def test_a_sequence_that_wraps_loses_nothing() -> None:
    receiver = Receiver(PROFILE)
    assert [receiver.check(frame, t) for t, frame in enumerate(frames(40))] == [0] * 40


def test_state_moves_only_on_accept() -> None:
    sent = frames(15)
    receiver = Receiver(PROFILE)
    receiver.check(sent[3], 0)
    corrupt = bytes([sent[6][0] ^ 1]) + sent[6][1:]
    refused = [receiver.check(corrupt, 1), receiver.check(sent[14], 2), receiver.check(sent[3], 3)]
    assert refused == [CRC_WRONG, COUNTER_WRONG, COUNTER_WRONG]
    assert receiver.check(sent[4], 4) == 0, "still the successor of 3"


def test_after_a_long_silence_any_other_counter_is_accepted() -> None:
    sent = frames(15)
    receiver = Receiver(PROFILE)
    receiver.check(sent[3], 0)
    assert receiver.check(sent[1], 500) == COUNTER_WRONG
    assert receiver.check(sent[1], 501) >= 0


def test_a_stuck_counter_is_refused_however_long_it_lasts() -> None:
    frame = frames(1)[0]
    receiver = Receiver(PROFILE)
    receiver.check(frame, 0)
    assert {receiver.check(frame, t) for t in range(1, 10_000, 100)} == {COUNTER_WRONG}


def test_a_clock_that_jumps_back_does_not_open_the_window() -> None:
    sent = frames(15)
    receiver = Receiver(PROFILE)
    receiver.check(sent[3], 10_000)
    assert receiver.check(sent[1], -10_000) == COUNTER_WRONG
    assert receiver.check(sent[4], -10_000) == 0
