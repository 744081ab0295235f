"""Other people's messages: a signal map over DBC files that are not ours."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bms_ukf import Estimator
from bms_ukf.dbc import Matrix
from bms_ukf.decoder import Decoder
from bms_ukf.e2e import Crc, Profile
from bms_ukf.errors import ConfigError
from bms_ukf.frames import Outbox
from bms_ukf.node import SampleEncoder
from bms_ukf.pack_encoder import PackEncoder
from bms_ukf.records import NAN, Fault, Sample
from bms_ukf.signals import SignalMap
from bms_ukf.tuning import Tuning

FOREIGN = """
VERSION ""
BU_: A
BO_ 2566838974 Hv: 8 A
 SG_ Current : 7|16@0- (0.1,0) [0|0] "A" A
 SG_ Voltage : 23|16@0+ (0.1,0) [0|0] "V" A
 SG_ Warm : 32|8@1+ (1,-40) [0|0] "degC" A
BO_ 512 Mux: 8 A
 SG_ Which M : 0|8@1+ (1,0) [0|0] "" A
 SG_ Always : 8|8@1+ (1,-40) [0|0] "degC" A
 SG_ V1 m0 : 16|16@1+ (0.001,0) [0|0] "V" A
 SG_ V2 m7 : 16|16@1+ (0.001,0) [0|0] "V" A
"""


@pytest.fixture
def foreign(tmp_path: Path) -> Matrix:
    (tmp_path / "foreign.dbc").write_text(FOREIGN)
    return Matrix([tmp_path / "foreign.dbc"])


def test_a_foreign_map_converts_sign_string_voltage_and_codes(foreign: Matrix) -> None:
    signals = SignalMap(
        current="Hv.Current",
        current_positive="charge",
        pack_voltage="Hv.Voltage",
        series_cells=100,
        temperature=["Hv.Warm"],
        not_available={"Hv.Warm": [255]},
    )
    decoder = Decoder(signals, foreign)
    data = (-1234).to_bytes(2, "big", signed=True) + (3700).to_bytes(2, "big") + bytes([255, 0, 0, 0])
    got = decoder.decode(0x18FEDABE, True, data, 0)
    assert got is not None
    assert got.current_A == pytest.approx(123.4), "negative = discharge on the wire"
    assert got.voltage_V == pytest.approx(3.7)
    assert math.isnan(got.temperature_degC)
    assert decoder.decode(0x18FEDABE, True, data, 0) is not None, "no E2E attributes, no counter to be stuck"


def test_a_signal_outside_the_multiplexing_is_in_every_page(foreign: Matrix) -> None:
    signals = SignalMap(
        current="Hv.Current",
        current_positive="discharge",
        cell_voltage=["Mux.V1", "Mux.V2"],
        temperature=["Mux.Always"],
    )
    decoder = Decoder(signals, foreign, cells=2)
    for page, expected in ((0, [3.5, NAN]), (7, [NAN, 3.5]), (1, [NAN, NAN])):
        got = decoder.decode(512, False, bytes([page, 65]) + (3500).to_bytes(2, "little") + bytes(4), 0)
        assert got is not None
        assert np.broadcast_to(got.voltage_V, 2) == pytest.approx(expected, nan_ok=True)
        assert got.temperature_degC == 25.0


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"current": "Hv.Curent"}, r"mine\.toml: signals\.current is 'Hv\.Curent'; .*Hv\.Current"),
        ({"cell_voltage": ["Mux.V1"]}, r"mine\.toml: signals\.cell_voltage is .*each of 2 cells"),
        ({"pack_voltage": "Hv.Voltage"}, r"mine\.toml: signals\.pack_voltage is .*each of 2 cells"),
        ({"temperature": ["Mux.Always"] * 3}, r"mine\.toml: signals\.temperature is .*each of 2 cells"),
    ],
)
def test_a_map_that_does_not_fit_names_the_file_and_the_key(
    foreign: Matrix, change: dict[str, Any], named: str
) -> None:
    fitting = {"current": "Hv.Current", "current_positive": "charge", "cell_voltage": ["Mux.V1", "Mux.V2"]}
    with pytest.raises(ConfigError, match=named):
        Decoder(SignalMap(**(fitting | change)), foreign, cells=2, source="mine.toml")


NESTED = """
VERSION ""
BU_: A
BO_ 3 Nested: 8 A
 SG_ Outer M : 0|8@1+ (1,0) [0|0] "" A
 SG_ Inner m1M : 8|8@1+ (1,0) [0|0] "" A
 SG_ Current m2 : 16|16@1+ (0.1,0) [0|0] "A" A
SG_MUL_VAL_ 3 Inner Outer 1-1;
SG_MUL_VAL_ 3 Current Inner 2-2;
BO_ 512 SameId: 8 A
 SG_ Current : 0|16@1- (0.1,0) [0|0] "A" A
"""


@pytest.mark.parametrize(
    ("current", "named"),
    [
        ("Nested.Current", "mine.toml: .*one level of multiplexing"),
        ("SameId.Current", "0x200.*no other mapped message"),
    ],
)
def test_a_message_that_cannot_be_told_apart_is_refused(tmp_path: Path, current: str, named: str) -> None:
    for name, content in (("foreign.dbc", FOREIGN), ("nested.dbc", NESTED)):
        (tmp_path / name).write_text(content)
    matrix = Matrix([tmp_path / "foreign.dbc", tmp_path / "nested.dbc"])
    with pytest.raises(ConfigError, match=named):
        Decoder(SignalMap(current, "charge", ["Mux.V1"]), matrix, source="mine.toml")


def test_a_code_for_a_signal_without_a_role_is_refused(foreign: Matrix) -> None:
    signals = SignalMap("Hv.Current", "charge", ["Mux.V1"], not_available={"Hv.Warn": [255]})
    with pytest.raises(ConfigError, match=r"mine.toml: signals.not_available is 'Hv.Warn'"):
        Decoder(signals, foreign, source="mine.toml")


def test_nothing_is_sent_unprotected(foreign: Matrix) -> None:
    with pytest.raises(ConfigError, match="P11A"):
        Outbox(foreign.message("Hv"))


def test_more_cells_than_the_matrix_has_are_refused() -> None:
    for make in (SampleEncoder, lambda cells: PackEncoder(cells, 10.0), lambda cells: Decoder(cells=cells)):
        with pytest.raises(ConfigError):
            make(403)


@pytest.fixture
def leaf(third_party: Path) -> Path:
    return third_party / "can"


def test_a_nissan_leaf_recording_is_read_as_its_publishers_read_it(leaf: Path) -> None:
    matrix = Matrix([leaf / "EV-can_ZE1.dbc"], strict=False)
    assert len(matrix.warnings) == 1
    signals = SignalMap(
        current="x1DB.LB_Current",
        current_positive="charge",
        pack_voltage="x1DB.LB_Total_Voltage",
        series_cells=96,
        not_available={"x1DB.LB_Current": [1023], "x1DB.LB_Total_Voltage": [1023]},
    )
    decoder = Decoder(signals, matrix)
    ours = []
    with (leaf / "leaf_ZE1_62kWh_EV-CANeplus2.candump.log").open() as log:
        for line in log:
            stamp, _, frame = line.split()
            arbitration_id, data = frame.split("#")
            t_ns = round(float(stamp[1:-1]) * 1e9)
            got = decoder.decode(int(arbitration_id, 16), len(arbitration_id) > 3, bytes.fromhex(data), t_ns)
            if got is not None:
                ours.append((-got.current_A, got.voltage_V * 96))
    with (leaf / "leaf_ZE1_62kWh_EV-CANeplus2.decoded_1DB.csv").open() as table:
        theirs = [(float(row["pack_current_A"]), float(row["pack_voltage_V"])) for row in csv.DictReader(table)]
    theirs = [(NAN if i == 511.5 else i, NAN if v == 511.5 else v) for i, v in theirs]
    assert len(ours) > 1000
    assert np.array(ours) == pytest.approx(np.array(theirs), nan_ok=True)


def test_the_other_vehicle_files_are_read_leniently(leaf: Path) -> None:
    matrix = Matrix([leaf / "Model3CAN.dbc", leaf / "nissan_leaf_2018.dbc"], strict=False)
    assert len(matrix.warnings) == 1
    assert "Model3CAN.dbc" in matrix.warnings[0]
    signals = SignalMap("ID132HVBattAmpVolt.SmoothBattCurrent132", "charge", ["ID132HVBattAmpVolt.BattVoltage132"])
    assert Decoder(signals, matrix).decode(0x132, False, bytes(8), 0) is not None
    with pytest.raises(ConfigError, match="does not fit"):
        matrix.find("ID5D5RearDItemps.DI_lashAngle")


# --- units, codes, ranges ---------------------------------------------------------------------------------------------

UNITS = """
VERSION ""
BU_: A
BO_ 513 U: 8 A
 SG_ Milli : 0|24@1- (1,0) [0|0] "mA" A
 SG_ Kilo : 24|16@1- (0.0001,0) [0|0] "kA" A
 SG_ Bare : 40|16@1- (0.1,0) [0|0] "" A
BO_ 514 V: 8 A
 SG_ MilliVolt : 0|16@1+ (1,0) [0|0] "mV" A
 SG_ Kelvin : 16|16@1+ (0.1,0) [0|0] "K" A
 SG_ Fahrenheit : 32|16@1- (0.1,0) [0|0] "°F" A
 SG_ Celsius : 48|8@1- (1,0) [0|0] "°C" A
 SG_ Main : 56|2@1+ (1,0) [0|0] "" A
VAL_ 514 Main 0 "open" 1 "closed" 3 "SNA" ;
"""


@pytest.fixture
def units(tmp_path: Path) -> Matrix:
    (tmp_path / "units.dbc").write_text(UNITS, encoding="cp1252")
    return Matrix([tmp_path / "units.dbc"])


@pytest.mark.parametrize(
    ("current", "raw", "expected"),
    [("U.Milli", -12345, -12.345), ("U.Kilo", 123, 12.3), ("U.Bare", -55, -5.5)],
)
def test_a_current_is_in_ampere_whatever_the_unit_of_the_dbc(units, current, raw, expected) -> None:
    decoder = Decoder(SignalMap(current, "discharge", ["V.MilliVolt"]), units)
    _, signal = units.find(current)
    data = ((raw & (1 << signal.length) - 1) << signal.start).to_bytes(8, "little")
    got = decoder.decode(513, False, data, 0)
    assert got is not None
    assert got.current_A == pytest.approx(expected)
    assert [bool(b.warning) for b in decoder.bound] == [current == "U.Bare", False]


@pytest.mark.parametrize(("name", "raw"), [("V.Kelvin", 2982), ("V.Fahrenheit", 770), ("V.Celsius", 25)])
def test_a_temperature_is_in_degrees_celsius_whatever_the_unit_of_the_dbc(units, name, raw) -> None:
    decoder = Decoder(SignalMap("U.Milli", "charge", ["V.MilliVolt"], temperature=[name]), units)
    _, signal = units.find(name)
    got = decoder.decode(514, False, (raw << signal.start | 3700).to_bytes(8, "little"), 0)
    assert got is not None
    assert (got.voltage_V, got.temperature_degC) == (pytest.approx(3.7), pytest.approx(25.0, abs=0.051))


def test_a_stated_unit_overrules_the_dbc(units) -> None:
    signals = SignalMap("U.Bare", "charge", ["V.MilliVolt"], unit={"U.Bare": "mA"})
    (current, _) = Decoder(signals, units).bound
    assert (current.bit, current.warning) == (pytest.approx(1e-4), "")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"current": "V.MilliVolt"}, r"signals is 'V.MilliVolt'; expected a current, but its unit in the DBC is 'mV'"),
        ({"unit": {"U.Milli": "mV"}}, r"signals.unit is 'mV'; expected a unit of current: A, mA"),
        ({"unit": {"U.Kilo": "A"}}, r"signals.unit is 'U.Kilo'; expected a signal that has a role"),
        ({"plausible": {"U.Milli": [5.0, 5.0]}}, r"signals.plausible is \[5.0, 5.0\]; expected \[lowest, highest\]"),
        ({"contactor": "V.Main", "contactor_open": ["opened"]}, r"'opened'; expected raw values .* or open, closed"),
        ({"contactor": "V.Main", "contactor_open": [4]}, r"contactor_open is 4; expected raw values .* 0 to 3"),
        ({"contactor": "V.Main"}, r"contactor_open: expected the values of V.Main that mean open"),
        ({"e2e": {"W": Profile()}}, r"signals.e2e is 'W'; expected a message with a signal that has a role"),
    ],
)
def test_a_map_that_cannot_be_meant_is_one_line(units, change, told) -> None:
    fitting = {"current": "U.Milli", "current_positive": "charge", "cell_voltage": ["V.MilliVolt"]}
    with pytest.raises(ConfigError, match=told):
        Decoder(SignalMap(**(fitting | change)), units, source="mine.toml")


def test_a_value_beyond_its_plausible_range_is_neither_used_nor_taken_for_missing(units, cell) -> None:
    signals = SignalMap("U.Milli", "charge", ["V.MilliVolt"], plausible={"U.Milli": [-2000, 3000]})
    decoder, estimator = Decoder(signals, units), Estimator(cell, tuning=Tuning(initial_soc_sigma=0.02))
    estimator.step(Sample(0, 1.0, 3.7, 25.0))
    faults = []
    for k, milliampere in enumerate((-2000, 3000, 3001, -2001), start=1):
        sample = decoder.decode(513, False, (milliampere & 0xFFFFFF).to_bytes(8, "little"), k)
        assert sample is not None
        faults.append(estimator.step(sample).faults)
    assert faults == [Fault.NONE, Fault.NONE, Fault.CURRENT_IMPLAUSIBLE, Fault.CURRENT_IMPLAUSIBLE]


def test_contactors_are_heard_without_a_sample_being_made_of_them(units) -> None:
    signals = SignalMap(
        "U.Milli",
        "charge",
        ["V.MilliVolt"],
        contactor="V.Main",
        contactor_open=["open"],
        not_available={"V.Main": [3]},
    )
    decoder = Decoder(signals, units)
    heard = []
    for t_ns, raw in ((1, 0), (2, 1), (3, 3)):
        decoder.decode(514, False, (raw << 56).to_bytes(8, "little"), t_ns)
        heard.append((decoder.contactor.is_open, decoder.contactor.t_ns))
    assert heard == [(True, 1), (False, 2), (False, None)]


def test_current_through_cells_in_parallel_is_shared(units) -> None:
    got = Decoder(SignalMap("U.Milli", "charge", ["V.MilliVolt"], parallel_cells=3), units).decode(
        513, False, (3000).to_bytes(8, "little"), 0
    )
    assert got is not None
    assert got.current_A == pytest.approx(-1.0)


LEAF_E2E = {  # byte 7 is a CRC over the other seven, the low two bits of byte 6 a counter
    "x1DB": Profile(Crc(8, 0x85), crc_byte=7, counter=lambda data: data[6] & 3, modulo=4, max_delta=2)
}


def test_every_0x1db_of_a_real_leaf_passes_its_crc_and_counter_and_a_flipped_bit_does_not(leaf: Path) -> None:
    matrix = Matrix([leaf / "EV-can_ZE1.dbc"], strict=False)
    signals = SignalMap(
        "x1DB.LB_Current", "charge", pack_voltage="x1DB.LB_Total_Voltage", series_cells=96, e2e=LEAF_E2E
    )
    decoder, spoilt = Decoder(signals, matrix), Decoder(signals, matrix)
    for line in (leaf / "leaf_ZE1_62kWh_EV-CANeplus2.candump.log").read_text().splitlines():
        stamp, _, frame = line.split()
        identifier, data = frame.split("#")
        if identifier == "1DB":
            payload, t_ns = bytes.fromhex(data), round(float(stamp[1:-1]) * 1e9)
            decoder.decode(0x1DB, False, payload, t_ns)
            spoilt.decode(0x1DB, False, bytes([payload[0] ^ 0x20]) + payload[1:], t_ns)
    assert decoder.counters.accepted > 1500
    assert decoder.counters.refused <= decoder.counters.accepted // 100, "the recorder lost a frame now and then"
    assert decoder.counters.crc == 0
    assert spoilt.counters.accepted == 0
