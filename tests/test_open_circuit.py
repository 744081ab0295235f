"""Which readings of the current are taken for the sensor's offset: those with open contactors, and only those."""

from __future__ import annotations

import math

from bms_ukf.open_circuit import HEARD_NS, SETTLE_NS, OpenCircuit

STEP_NS = 10_000_000


def told(circuit: OpenCircuit, reading_A: float, seconds: float, is_open: bool, start_ns: int = 0) -> list[bool]:
    """What is said of so long with one reading, the contactors heard with every one."""
    times = [start_ns + k * STEP_NS for k in range(int(seconds * 1e9) // STEP_NS)]
    return [circuit.nothing_flows(reading_A, t_ns, is_open, t_ns) for t_ns in times]


def test_what_flows_just_after_opening_is_no_offset_and_what_is_left_is():
    found = told(OpenCircuit(0.5), 0.12, 10.0, is_open=True)
    settled = SETTLE_NS // STEP_NS
    assert not any(found[:settled])
    assert all(found[settled:])


def test_a_load_is_no_offset_and_contactors_that_closed_settle_anew():
    circuit = OpenCircuit(0.5)
    assert told(circuit, 0.12, 10.0, is_open=True)[-1]
    assert not any(told(circuit, 0.12, 1.0, is_open=False, start_ns=10**11))
    assert not told(circuit, 0.12, 1.0, is_open=True, start_ns=2 * 10**11)[-1]


def test_a_current_through_open_contactors_is_a_contradiction_and_no_offset():
    assert not any(told(OpenCircuit(0.5), 20.0, 10.0, is_open=True))


def test_contactors_not_heard_of_any_more_say_nothing():
    circuit = OpenCircuit(0.5)
    for k in range(2000):
        assert not circuit.nothing_flows(0.1, HEARD_NS + 1 + k * STEP_NS, True, 0)
        assert not circuit.nothing_flows(0.1, HEARD_NS + 1 + k * STEP_NS, True, None)


def test_without_a_reading_open_contactors_still_tell_that_nothing_flows():
    found = told(OpenCircuit(0.5), math.nan, 10.0, is_open=True)
    settled = SETTLE_NS // STEP_NS
    assert not any(found[:settled])
    assert all(found[settled:])


def test_contradictions_are_counted_as_often_as_they_begin():
    circuit = OpenCircuit(0.5)
    for reading_A, contradictions in ((20.0, 1), (math.nan, 1), (20.0, 1), (0.1, 1), (-20.0, 2)):
        told(circuit, reading_A, 5.0, is_open=True, start_ns=10**12)
        assert circuit.contradictions == contradictions
    told(circuit, 20.0, 5.0, is_open=False)
    told(circuit, 20.0, 1.0, is_open=True)
    assert circuit.contradictions == 2, "not settled"


def test_a_missing_reading_after_a_contradiction_does_not_settle_it():
    circuit = OpenCircuit(0.5)
    told(circuit, 20.0, 5.0, is_open=True)
    assert not any(told(circuit, math.nan, 5.0, is_open=True, start_ns=5 * 10**9))
