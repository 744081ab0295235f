"""Received frames to samples."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
from e2e.p11 import e2e_p11_protect
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_ukf.dbc import own_matrix
from bms_ukf.decoder import Decoder
from bms_ukf.node import SampleEncoder
from bms_ukf.records import NAN, Sample

PACK, CELLS, TEMPERATURES = 0x120, 0x121, 0x122
MS = 1_000_000
SAMPLE = Sample(t_ns=0, current_A=12.345, voltage_V=3.7, temperature_degC=25.0)


def sample(**values: Any) -> Sample:
    return replace(SAMPLE, **values)


def protected(name: str, body: bytes, counter: int = 1) -> bytes:
    """A frame of ours with CRC and counter by the autosar-e2e package alone."""
    data = bytearray(b"\0" + body)
    data[1] = data[1] & 0xF0 | counter
    attributes = own_matrix().message(name).dbc.attributes
    e2e_p11_protect(data, int(attributes["E2EDataId"].value), increment_counter=False)
    return bytes(data)


def test_each_frame_gives_what_it_carries_and_nan_for_the_rest() -> None:
    decoder = Decoder()
    pack, temperature, voltage = SampleEncoder().encode(sample())
    got = decoder.decode(*pack, 7)
    assert got is not None
    assert (got.t_ns, got.current_A) == (7, pytest.approx(12.345))
    assert math.isnan(got.voltage_V)
    assert math.isnan(got.temperature_degC)
    got = decoder.decode(*temperature, 8)
    assert got is not None
    assert got.temperature_degC == pytest.approx(25.0)
    assert math.isnan(got.current_A)
    got = decoder.decode(*voltage, 9)
    assert got is not None
    assert got.voltage_V == pytest.approx(3.7)
    assert math.isnan(got.current_A)


@given(current=st.floats(-8000, 8000), voltage=st.floats(0, 8.19), temperature=st.floats(-50, 113.8))
def test_round_trip_is_within_half_a_bit(current: float, voltage: float, temperature: float) -> None:
    decoder = Decoder()
    frames = SampleEncoder().encode(sample(current_A=current, voltage_V=voltage, temperature_degC=temperature))
    pack, warm, cell = (decoder.decode(*frame, 0) for frame in frames)
    assert pack is not None
    assert warm is not None
    assert cell is not None
    assert pack.current_A == pytest.approx(current, abs=0.000501)
    assert cell.voltage_V == pytest.approx(voltage, abs=0.000251)
    assert warm.temperature_degC == pytest.approx(temperature, abs=0.00501)


@pytest.mark.parametrize("cells", [2, 3, 4, 96, 400])
def test_every_cell_arrives_in_its_own_place(cells: int) -> None:
    volts = np.linspace(2.5, 4.2, cells)
    decoder, seen = Decoder(cells=cells), np.full(cells, NAN)
    for frame in SampleEncoder(cells).voltages(sample(voltage_V=volts)):
        got = decoder.decode(*frame, 0)
        assert got is not None
        assert isinstance(got.voltage_V, np.ndarray)
        assert got.voltage_V.shape == (cells,)
        new = ~np.isnan(got.voltage_V)
        assert new.sum() <= 3
        assert np.isnan(seen[new]).all(), "no cell twice"
        seen[new] = got.voltage_V[new]
    assert np.abs(seen - volts).max() < 0.000251


def test_a_page_of_cells_that_are_not_mapped_says_nothing_but_is_accepted() -> None:
    decoder = Decoder(cells=1)
    first, second = SampleEncoder(cells=6).voltages(sample(voltage_V=np.full(6, 3.7)))
    assert decoder.decode(*first, 0) is not None
    assert decoder.decode(*second, 0) is None
    assert decoder.counters.accepted == 2


@pytest.mark.parametrize("raw", [0xFFFFFF, 0xFFFFFE])
def test_not_available_and_error_are_nan(raw: int) -> None:
    data = protected("PackMeasurement", b"\0" + raw.to_bytes(3, "little") + bytes(3))
    got = Decoder().decode(PACK, False, data, 0)
    assert got is not None
    assert math.isnan(got.current_A)


def test_mutable_payloads_are_read_too() -> None:
    """python-can's messages hold bytearrays."""
    arbitration_id, extended, data = SampleEncoder().pack(SAMPLE)
    got = Decoder().decode(arbitration_id, extended, bytearray(data), 0)
    assert got is not None
    assert got.current_A == pytest.approx(12.345)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda i, x, d: (i, x, d[:7], True), "short"),
        (lambda i, x, d: (i, x, b"", True), "short"),
        (lambda i, x, d: (i, x, bytes([d[0] ^ 1]) + d[1:], True), "crc"),
        (lambda i, x, d: (i, x, d[:-1] + bytes([d[-1] ^ 128]), True), "crc"),
        (lambda i, x, d: (CELLS, x, d, True), "crc"),
        (lambda i, x, d: (0x7FF, x, d, True), "unknown_id"),
        (lambda i, x, d: (i, True, d, True), "unknown_id"),
        (lambda i, x, d: (i, x, d, False), "not_data"),
    ],
)
def test_a_spoilt_frame_is_refused_and_counted_once_by_its_reason(spoil, reason: str) -> None:
    decoder = Decoder()
    arbitration_id, is_extended_id, data, classic = spoil(*SampleEncoder().pack(sample()))
    assert decoder.decode(arbitration_id, is_extended_id, data, 0, classic=classic) is None
    assert {name: count for name, count in asdict(decoder.counters).items() if count} == {reason: 1}


def test_a_longer_frame_is_read_as_far_as_the_dbc_goes() -> None:
    arbitration_id, extended, data = SampleEncoder().pack(sample())
    got = Decoder().decode(arbitration_id, extended, data + b"\xff", 0)
    assert got is not None
    assert got.current_A == pytest.approx(12.345)


def test_stuck_and_rewound_counters_are_refused_and_lost_frames_counted() -> None:
    encoder, decoder = SampleEncoder(), Decoder()
    sent = [encoder.pack(sample()) for _ in range(12)]
    order = [0, 1, 1, 2, 0, 5, 6]  # 1 repeated, 0 rewound, 3 and 4 lost
    accepted = [decoder.decode(*sent[k], t * 10 * MS) is not None for t, k in enumerate(order)]
    assert accepted == [True, True, False, True, False, True, True]
    assert (decoder.counters.counter, decoder.counters.lost, decoder.counters.refused) == (2, 2, 2)


def test_messages_have_counters_of_their_own() -> None:
    encoder, decoder = SampleEncoder(), Decoder()
    for _ in range(20):
        for frame in encoder.encode(sample()):
            assert decoder.decode(*frame, 0) is not None
    assert decoder.counters.lost == 0


def test_asking_for_the_counters_changes_nothing() -> None:
    decoder = Decoder()
    before = asdict(decoder.counters)
    assert decoder.counters.refused == 0
    assert asdict(decoder.counters) == before


KNOWN_IDS = st.sampled_from([PACK, CELLS, TEMPERATURES])
IDS = KNOWN_IDS | st.integers(-1, 2**29)


@settings(max_examples=1000)
@given(st.lists(st.tuples(IDS, st.booleans(), st.binary(max_size=64), st.integers(), st.booleans()), max_size=20))
def test_no_bytes_at_all_raise_and_every_frame_is_accounted_for(
    received: list[tuple[int, bool, bytes, int, bool]],
) -> None:
    decoder = Decoder(cells=4)
    for arbitration_id, extended, data, t_ns, classic in received:
        decoder.decode(arbitration_id, extended, data, t_ns, classic=classic)
    counters = asdict(decoder.counters)
    assert sum(counters.values()) - counters["lost"] == len(received)


@settings(max_examples=300)
@given(
    name=st.sampled_from(["PackMeasurement", "CellVoltages", "CellTemperatures"]),
    body=st.binary(min_size=7, max_size=7),
)
def test_whatever_the_bits_are_a_good_frame_is_read_as_cantools_reads_it(name: str, body: bytes) -> None:
    """A page that is not in the DBC says nothing."""
    message, data = own_matrix().message(name), protected(name, body)
    got = Decoder(cells=6).decode(message.frame_id, False, data, 0)
    if got is None:
        assert data[1] >> 4 | data[2] << 4 & 0x3F0 != 0
        return
    theirs = {k: v if isinstance(v, float) else NAN for k, v in message.decode(data).items()}
    if name == "PackMeasurement":
        assert got.current_A == pytest.approx(theirs["PackCurrent"], nan_ok=True)
    elif name == "CellTemperatures":
        assert got.temperature_degC == pytest.approx(theirs["Sensor1"], nan_ok=True)
    else:
        cells = [theirs.get(f"Cell{k + 1}", NAN) for k in range(6)]
        assert got.voltage_V == pytest.approx(cells, nan_ok=True)
