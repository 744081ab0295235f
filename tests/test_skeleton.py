"""`bms-ukf init`: what it proposes is what a person would choose, and what it cannot know it asks for."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from bms_ukf import ConfigError, SensorSpec
from bms_ukf.config import Setup
from bms_ukf.skeleton import propose

CAR = """
VERSION ""
BU_: A
BO_ 256 Motor: 8 A
 SG_ MotorCurrent : 0|16@1- (0.1,0) [0|0] "A" A
 SG_ MotorTemp : 16|8@1+ (1,-40) [0|0] "degC" A
 SG_ InverterVoltage : 24|16@1+ (0.1,0) [0|0] "V" A
BO_ 257 BatteryStatus: 8 A
 SG_ MaxChargeCurrent : 0|16@1+ (0.1,0) [0|0] "A" A
 SG_ PackCurrent : 16|16@1- (0.1,0) [-500|500] "A" A
 SG_ PackVoltage : 32|12@1+ (0.125,0) [0|500] "V" A
 SG_ AliveCounter : 48|4@1+ (1,0) [0|15] "" A
 SG_ Checksum : 56|8@1+ (1,0) [0|255] "" A
BO_ 258 BatteryTemps: 8 A
 SG_ BattTempMax : 0|8@1+ (1,-40) [-40|125] "degC" A
 SG_ BattTempAvg : 8|8@1+ (1,-40) [-40|125] "degC" A
 SG_ MainContactor : 16|2@1+ (1,0) [0|3] "" A
CM_ SG_ 257 PackCurrent "Positive while discharging.";
VAL_ 258 MainContactor 0 "Open" 1 "Opening" 2 "Closed" ;
"""
CELLS = """
BO_ 259 BatteryCells: 8 A
 SG_ Page M : 0|8@1+ (1,0) [0|0] "" A
 SG_ CellVolt2 m0 : 24|16@1+ (1,0) [0|0] "mV" A
 SG_ CellVolt1 m0 : 8|16@1+ (1,0) [0|0] "mV" A
 SG_ CellVolt3 m1 : 8|16@1+ (1,0) [0|0] "mV" A
 SG_ CellVolt4 m1 : 24|16@1+ (1,0) [0|0] "mV" A
"""


def made(tmp_path: Path, dbc: str) -> tuple[str, list[str]]:
    """The skeleton of a DBC, and its gaps; it lies in can.toml beside the DBC."""
    (tmp_path / "car.dbc").write_text(dbc)
    text, gaps = propose([tmp_path / "car.dbc"], tmp_path / "can.toml")
    (tmp_path / "can.toml").write_text(text)
    return text, gaps


def test_the_batterys_own_signals_are_proposed_and_not_the_motors(tmp_path: Path) -> None:
    text, gaps = made(tmp_path, CAR)
    signals = tomllib.loads(text)["signals"]
    assert signals == {
        "dbc": ["car.dbc"],
        "current": "BatteryStatus.PackCurrent",
        "current_positive": "discharge",
        "pack_voltage": "BatteryStatus.PackVoltage",
        "temperature": ["BatteryTemps.BattTempAvg"],
        "not_available": {
            "BatteryStatus.PackCurrent": [32767],
            "BatteryStatus.PackVoltage": [4095],
            "BatteryTemps.BattTempAvg": [255],
        },
    }
    assert "#   or BatteryTemps.BattTempMax" in text
    assert '# contactor = "BatteryTemps.MainContactor"\n# contactor_open = ["Open"]' in text
    assert '# [signals.e2e.BatteryStatus]\n# counter = "AliveCounter"\n# crc = { width = 8' in text
    assert "byte = 7 }" in text
    assert gaps == ["signals.series_cells: how many cells in series pack_voltage is the sum of"]


def test_what_is_to_be_filled_in_is_named_by_check_and_then_it_passes(tmp_path: Path) -> None:
    text, _ = made(tmp_path, CAR)
    with pytest.raises(ConfigError, match=r"signals.voltage is 'BatteryStatus.PackVoltage'; .*series_cells"):
        Setup.load(tmp_path / "can.toml")
    (tmp_path / "can.toml").write_text(text.replace("# series_cells = 96", "series_cells = 96"))
    assert Setup.load(tmp_path / "can.toml").warnings == []


def test_numbered_voltages_are_cells_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    text, gaps = made(tmp_path, CAR + CELLS)
    config = tomllib.loads(text)
    assert config["signals"]["cell_voltage"] == [f"BatteryCells.CellVolt{k}" for k in (1, 2, 3, 4)]
    assert config["cells"] == 4
    assert gaps == []
    assert Setup.load(tmp_path / "can.toml").warnings == []


@pytest.mark.parametrize(
    ("comment", "positive"),
    [
        ("Positive = charge", "charge"),
        ("Pack current, negative while discharging", "charge"),
        ("+ means discharge", "discharge"),
        ("negative is charging", "discharge"),
        ("of the charging socket", None),
    ],
)
def test_the_sign_is_read_from_the_comment_or_asked_for_but_never_guessed(tmp_path, comment, positive) -> None:
    text, gaps = made(tmp_path, CAR.replace("Positive while discharging.", comment))
    assert tomllib.loads(text)["signals"].get("current_positive") == positive
    assert any(gap.startswith("signals.current_positive") for gap in gaps) == (positive is None)


def filled_in(text: str) -> str:
    """As a user would: the sign, and 96 cells in series."""
    return re.sub(r"^# (current_positive = \S+|series_cells = \d+)", r"\1", text, flags=re.MULTILINE)


@pytest.fixture
def vehicles(third_party: Path) -> Path:
    return third_party / "can"


@pytest.mark.parametrize(
    ("dbc", "expected", "cells"),
    [
        (
            "EV-can_ZE1.dbc",
            {
                "current": "x1DB.LB_Current",
                "pack_voltage": "x1DB.LB_Total_Voltage",
                "temperature": ["x5C0.LB_HistData_Temp_WakeupPhase_AVG"],
            },
            1,
        ),
        (
            "Model3CAN.dbc",
            {
                "current": "ID132HVBattAmpVolt.SmoothBattCurrent132",
                "temperature": ["ID312BMSthermal.BMSminPackTemperature"],
            },
            108,
        ),
    ],
)
def test_of_a_real_vehicle_the_right_signals_are_proposed(vehicles, tmp_path, dbc, expected, cells) -> None:
    text, gaps = propose([vehicles / dbc], tmp_path / "can.toml")
    config = tomllib.loads(text)
    assert config["cells"] == cells
    assert expected.items() <= config["signals"].items()
    assert any(gap.startswith("signals.current_positive") for gap in gaps)
    (tmp_path / "can.toml").write_text(filled_in(text))
    (warning,) = Setup.load(tmp_path / "can.toml").warnings
    assert f"{dbc}: not strictly valid" in warning


def test_a_dbc_without_a_battery_is_told_so_for_every_role(vehicles, tmp_path) -> None:
    text, gaps = propose([vehicles / "nissan_leaf_2018.dbc"], tmp_path / "can.toml")
    assert [gap.split(":")[0] for gap in gaps] == [
        "signals.current",
        "signals.temperature",
        "signals.pack_voltage",
        "signals.current_positive",
    ]
    (tmp_path / "can.toml").write_text(text)
    with pytest.raises(ConfigError, match=r"signals.current: expected this key, which is missing"):
        Setup.load(tmp_path / "can.toml")


def test_the_sensor_specification_stands_in_the_skeleton_with_its_defaults_and_is_valid_there(tmp_path: Path) -> None:
    text, _ = made(tmp_path, CAR)
    begin = text.index("# [sensor_spec]")
    section = text[begin : text.index("\n\n", begin)]
    stated = tomllib.loads(re.sub(r"^# ", "", section, flags=re.MULTILINE))["sensor_spec"]
    assert set(stated) == set(SensorSpec.model_fields)
    defaults = {name: field.default for name, field in SensorSpec.model_fields.items() if field.default is not None}
    assert {name: stated[name] for name in defaults} == defaults
    SensorSpec(**stated)
