"""Signals that arrive late are put back beside those of their instant."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bms_ukf.alignment import Alignment
from bms_ukf.records import Sample

MS = 1_000_000


def test_without_a_difference_samples_pass_as_they_are() -> None:
    sample = Sample(7, 1.0, 3.7, 25.0)
    for alignment in (Alignment(), Alignment(0.2, 0.2, 0.2)):
        assert alignment.put(sample)[0] is sample
        assert alignment.behind_ns == 0


def test_a_late_voltage_meets_the_current_of_its_instant() -> None:
    alignment = Alignment(voltage_s=0.1)
    out = []
    for k in range(20):
        out += alignment.put(Sample(k * 10 * MS, current_A=float(k)))
        if k >= 10:
            out += alignment.put(Sample(k * 10 * MS, voltage_V=3.0 + (k - 10) / 100))
    pairs = {}
    for sample in out:
        if math.isnan(sample.voltage_V):
            pairs[sample.t_ns] = sample.current_A
        else:
            assert pairs[sample.t_ns] == round((sample.voltage_V - 3.0) * 100), "current first, of the same instant"
    assert len(pairs) == 10


def test_a_frame_with_both_is_taken_apart_and_nothing_of_it_is_lost() -> None:
    alignment = Alignment(voltage_s=0.05)
    cells = np.array([3.5, np.nan, 3.7])
    out = list(alignment.put(Sample(100 * MS, 2.0, cells, 25.0)))
    cells[:] = 0.0  # the decoder's array, which the next frame overwrites
    out += alignment.due(150 * MS)
    assert [s.t_ns for s in out] == [50 * MS, 100 * MS, 100 * MS]
    assert np.array_equal(out[0].voltage_V, [3.5, np.nan, 3.7], equal_nan=True)
    assert (out[1].current_A, out[2].temperature_degC) == (2.0, 25.0)


@given(
    received=st.lists(st.tuples(st.integers(0, 300 * MS), st.sampled_from("cvt")), max_size=40),
    lags=st.tuples(*[st.floats(0, 2)] * 3),
)
def test_what_comes_out_is_in_order_and_complete(received: list[tuple[int, str]], lags: tuple[float, ...]) -> None:
    alignment, t_ns, out = Alignment(*lags), 0, []
    for wait_ns, role in received:
        t_ns += wait_ns
        out += alignment.put(Sample(t_ns, 1.0 if role == "c" else math.nan, 3.7 if role == "v" else math.nan, 25.0))
        out = [Sample(s.t_ns, s.current_A, s.voltage_V, s.temperature_degC) for s in out]
    out += alignment.due(t_ns + alignment.behind_ns + 10**10)
    times = [sample.t_ns for sample in out]
    assert times == sorted(times)
    assert sum(not math.isnan(s.temperature_degC) for s in out) == len(received)
    assert sum(not math.isnan(s.voltage_V) for s in out) == sum(role == "v" for _, role in received)
