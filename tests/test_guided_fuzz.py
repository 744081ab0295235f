"""No input brings the daemon to do other than an independent way in says; `make soak` looks for such by coverage."""

from __future__ import annotations

import pytest
from guided_fuzz import Target
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_ukf.dbc import Field
from bms_ukf.e2e import Receiver

WAKE, FRAME, PROTECTED = 0x80, 0x05, 0x03
CURRENT, VOLTAGE, TEMPERATURE = 0 << 3, 1 << 3, 2 << 3
LATER = 0x40  # 30 ms


@pytest.fixture(scope="module")
def target() -> Target:
    return Target()


def frames(*payloads: tuple[int, bytes]) -> bytes:
    return bytes([WAKE]) + b"".join(bytes([LATER | PROTECTED | kind]) + data for kind, data in payloads)


def measured(current_raw: int, voltage_raw: int, temperature_raw: int) -> bytes:
    """All signals, one frame each."""
    return frames(
        (CURRENT, (current_raw << 16).to_bytes(8, "little")),
        (TEMPERATURE, (temperature_raw << 22).to_bytes(8, "little")),
        (VOLTAGE, (voltage_raw << 22).to_bytes(8, "little")),
    )


@settings(max_examples=200)
@given(data=st.binary(max_size=150))
def test_no_input_leads_the_daemon_away_from_what_others_make_of_it(target: Target, data: bytes) -> None:
    target(data)


def test_frames_that_are_right_are_compared_and_published(target: Target) -> None:
    before = target.judge.steps
    target(measured(8_001_000, 7400, 7500))
    assert target.judge.steps >= before + 3
    assert 0.0 <= target.judge.told.soc <= 1.0


def test_a_receiver_that_lets_everything_pass_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Receiver, "check", lambda *_: 0)
    target = Target()
    spoilt = bytes([WAKE, FRAME | CURRENT]) + bytes(8)
    with pytest.raises((AssertionError, IndexError)):
        target(spoilt)


def test_a_wrong_scale_of_the_current_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    extract = Field.extract
    monkeypatch.setattr(Field, "extract", lambda field, factor=1.0, plus=0.0: extract(field, 0.5 * factor, plus))
    target = Target()
    with pytest.raises(AssertionError):
        target(measured(8_001_000, 7400, 7500))
