"""E2E protection, ours and others', against the specification's examples and an independent implementation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import e2e
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bms_ukf.e2e import (
    COUNTER_WRONG,
    CRC_WRONG,
    Crc,
    PresetName,
    Profile,
    Profile11A,
    Receiver,
    Sender,
    preset,
)

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


# --- what a vehicle may send ------------------------------------------------------------------------------------------

CATALOGUE = {  # check values over b"123456789" as CRC catalogues list them
    Crc(8, 0x1D, 0xFF, 0xFF): 0x4B,  # SAE J1850
    Crc(8, 0x2F, 0xFF, 0xFF): 0xDF,  # AUTOSAR
    Crc(8, 0x31, 0x00, 0x00, reflect=True): 0xA1,  # MAXIM-DOW
    Crc(8, 0xD5): 0xBC,  # DVB-S2
    Crc(16, 0x1021, 0xFFFF): 0x29B1,  # IBM-3740
    Crc(16, 0x8005, 0x0000, 0x0000, reflect=True): 0xBB3D,  # ARC
    Crc(16, 0x1021, 0xFFFF, 0xFFFF, reflect=True): 0x906E,  # IBM-SDLC
    Crc(32, 0x04C11DB7, 0xFFFFFFFF, 0xFFFFFFFF, reflect=True): 0xCBF43926,  # ISO-HDLC
    Crc(32, 0xF4ACFB13, 0xFFFFFFFF, 0xFFFFFFFF, reflect=True): 0x1697D06A,  # AUTOSAR
}


@pytest.mark.parametrize(("crc", "expected"), CATALOGUE.items())
def test_a_crc_has_the_check_value_of_the_catalogues(crc: Crc, expected: int) -> None:
    assert crc.register()(b"123456789", crc.start()) ^ crc.xor_out == expected


def sent_by(protect: Callable[[bytearray], None], count: int, length: int = 8) -> list[bytes]:
    """Frames of an independent sender, one after the other."""
    frame, made = bytearray(range(length)), []
    frame[:3] = bytes(3)
    for _ in range(count):
        protect(frame)
        made.append(bytes(frame))
    return made


P02_IDS = bytes(range(0x40, 0x50))
SENDERS: dict[PresetName, tuple[list[int], Callable[[bytearray], None]]] = {
    "P01": ([0x1234], lambda frame: e2e.p01.e2e_p01_protect(frame, 0x1234)),
    "P11A": ([0x1234], lambda frame: e2e.p11.e2e_p11_protect(frame, 0x1234)),
    "P01_LOW": (
        [0x1234],
        lambda frame: e2e.p01.e2e_p01_protect(frame, 0x1234, data_id_mode=e2e.p01.E2E_P01_DATAID_LOW),
    ),
    "P01_ALT": (
        [0x1234],
        lambda frame: e2e.p01.e2e_p01_protect(frame, 0x1234, data_id_mode=e2e.p01.E2E_P01_DATAID_ALT),
    ),
    "P02": (list(P02_IDS), lambda frame: e2e.p02.e2e_p02_protect(frame, P02_IDS)),
    "P05": ([0x1234], lambda frame: e2e.p05.e2e_p05_protect(frame, 0x1234)),
}


@pytest.mark.parametrize("name", SENDERS)
def test_frames_of_an_independent_sender_are_accepted_and_spoilt_ones_are_not(name: PresetName) -> None:
    data_id, protect = SENDERS[name]
    receiver = Receiver(preset(name, data_id))
    for t, frame in enumerate(sent_by(protect, 40)):
        spoilt = frame[:-1] + bytes([frame[-1] ^ 0x10])
        assert receiver.check(spoilt, t) == CRC_WRONG
        assert receiver.check(frame, t) == 0
        assert receiver.check(frame, t) == COUNTER_WRONG


@pytest.mark.parametrize("name", SENDERS)
def test_another_data_id_is_refused(name: PresetName) -> None:
    data_id, protect = SENDERS[name]
    other = Receiver(preset(name, [n ^ (0x0101 if n > 0xFF else 1) for n in data_id]))
    assert {other.check(frame, t) for t, frame in enumerate(sent_by(protect, 20))} == {CRC_WRONG}


@pytest.mark.parametrize(("name", "data_id"), [("P01", [1, 2]), ("P01", [0x10000]), ("P02", [1] * 15), ("P05", [])])
def test_a_data_id_that_the_profile_cannot_have_is_refused(name: PresetName, data_id: list[int]) -> None:
    with pytest.raises(ValueError, match=r"one number|16 bytes"):
        preset(name, data_id)


@given(payload=st.binary(min_size=8, max_size=8), at=st.integers(0, 6), order=st.sampled_from(["little", "big"]))
def test_a_crc_may_stand_anywhere_and_cover_a_part(payload: bytes, at: int, order: Literal["little", "big"]) -> None:
    """Against the catalogue's CRC-16/IBM-3740 over the bytes put together by hand."""
    profile = Profile(
        Crc(16, 0x1021, 0xFFFF), crc_byte=at, crc_order=order, covers=(1, 6), before=(b"\x07",), after=(b"\x09\x08",)
    )
    covered = bytes(payload[k] for k in range(1, 7) if k not in {at, at + 1})
    right = e2e.crc.calculate_crc16(b"\x07" + covered + b"\x09\x08").to_bytes(2, order)
    frame = payload[:at] + right + payload[at + 2 :]
    check = profile.check()
    assert check is not None
    assert check(frame)
    assert not check(frame[:at] + bytes([right[0] ^ 1]) + frame[at + 1 :])


def test_a_rejected_counter_does_not_become_the_baseline() -> None:
    """A replayed frame must not be accepted because the frame before it was a replay, too."""
    receiver = Receiver(Profile(counter=lambda data: data[0], modulo=16, max_delta=8))
    assert receiver.check(b"\x05", 0) == 0
    replayed = [receiver.check(bytes([n]), 1) for n in (1, 2, 3, 4, 5)]
    assert replayed == [COUNTER_WRONG] * 5
    assert receiver.check(b"\x06", 2) == 0
