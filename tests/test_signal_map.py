"""Other people's messages: a signal map over DBC files that are not ours."""

from __future__ import annotations

import csv
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bms_ukf.codec import Decoder, Encoder, SignalMap
from bms_ukf.dbc import Matrix
from bms_ukf.errors import ConfigError
from bms_ukf.frames import Outbox
from bms_ukf.node import SampleEncoder
from bms_ukf.records import NAN

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
        assert got.voltage_V == pytest.approx(expected, nan_ok=True)
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
    for make in (SampleEncoder, Encoder, lambda cells: Decoder(cells=cells)):
        with pytest.raises(ConfigError):
            make(403)


@pytest.fixture
def leaf() -> Path:
    folder = os.environ.get("BMS_UKF_DATA")
    if folder is None:
        pytest.skip("BMS_UKF_DATA is not set: the recording of a Nissan Leaf was not read")
    return Path(folder) / "can"


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
