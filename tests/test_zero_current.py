"""The offset of the current sensor is learnt while the contactors are open, and only then."""

from __future__ import annotations

import math

import pytest

from bms_ukf.zero_current import HEARD_NS, SETTLE_NS, ZeroCurrent

STEP_NS = 10_000_000


def drive(zero: ZeroCurrent, reading_A: float, seconds: float, is_open: bool, start_ns: int = 0) -> float:
    """The last corrected current after so long with one reading, the contactors heard with every one."""
    corrected = math.nan
    for k in range(int(seconds * 1e9) // STEP_NS):
        t_ns = start_ns + k * STEP_NS
        corrected = zero.corrected(reading_A, t_ns, is_open, t_ns)
    return corrected


def test_an_offset_seen_with_open_contactors_is_gone_afterwards():
    zero = ZeroCurrent(limit_A=0.5)
    drive(zero, 0.12, 10.0, is_open=True)
    assert zero.offset_A == pytest.approx(0.12)
    assert drive(zero, 5.12, 1.0, is_open=False, start_ns=10**11) == pytest.approx(5.0)
    assert zero.offset_A == pytest.approx(0.12), "a load is no offset"


def test_what_flows_just_after_opening_is_no_offset():
    zero = ZeroCurrent(limit_A=0.5)
    drive(zero, 0.3, SETTLE_NS / 1e9, is_open=True)
    assert zero.offset_A == 0.0


def test_a_current_through_open_contactors_is_a_contradiction_and_no_offset():
    zero = ZeroCurrent(limit_A=0.5)
    assert drive(zero, 20.0, 10.0, is_open=True) == 20.0
    assert zero.contradicted > 0


def test_contactors_not_heard_of_any_more_say_nothing():
    zero = ZeroCurrent(limit_A=0.5)
    for k in range(2000):
        zero.corrected(0.1, HEARD_NS + 1 + k * STEP_NS, True, 0)
        zero.corrected(0.1, HEARD_NS + 1 + k * STEP_NS, True, None)
    assert zero.offset_A == 0.0


def test_a_drifting_offset_is_followed_and_a_missing_reading_is_none():
    zero = ZeroCurrent(limit_A=0.5)
    drive(zero, 0.1, 100.0, is_open=True)
    assert math.isnan(zero.corrected(math.nan, 10**11, True, 10**11))
    drive(zero, -0.1, 100.0, is_open=True, start_ns=10**11)
    assert zero.offset_A == pytest.approx(-0.1, abs=0.001)
