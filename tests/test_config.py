"""The CONFIG format: its example is whole and works, and a mistake in one is one line that names it."""

from __future__ import annotations

import re
from pathlib import Path

import cantools
import pytest
from pydantic import BaseModel

from bms_ukf import ConfigError, Tuning, resources, toml
from bms_ukf.config import Bus, Config, Setup, Signals

EXAMPLE = Path(__file__).resolve().parents[1] / "models" / "configs" / "example.toml"
MINIMAL = """
format = 1
cell = "lgm50_chen2020"
[bus]
interface = "socketcan"
channel = "vcan0"
"""
SIGNALS = """
[signals]
dbc = ["vehicle.dbc"]
current = "BatteryStatus.Current"
current_positive = "charge"
cell_voltage = ["CellStatus.Voltage"]
temperature = ["CellStatus.Temperature"]
"""


@pytest.fixture
def config(tmp_path):
    """Writes a CONFIG, beside a vehicle's DBC, and loads all it names."""
    (tmp_path / "vehicle.dbc").write_bytes((EXAMPLE.parent / "example.dbc").read_bytes())

    def load(text: str) -> Setup:
        path = tmp_path / "can.toml"
        path.write_text(text, encoding="utf-8")
        return Setup.load(path)

    return load


def test_the_example_works_with_the_dbc_beside_it():
    setup = Setup.load(EXAMPLE)
    assert setup.warnings == []
    battery = cantools.database.load_file(EXAMPLE.parent / "example.dbc").get_message_by_name("BatteryStatus")
    data = battery.encode({"Current": 12.5, "Voltage": 3.7})
    sample = setup.decoder.decode(battery.frame_id, False, data, 7)
    assert sample is not None
    assert (sample.t_ns, sample.current_A) == (7, -12.5), "positive is charge there, and discharge here"


@pytest.mark.parametrize("model", [Config, Bus, Signals, Tuning])
def test_the_example_shows_every_key(model: type[BaseModel]):
    text = EXAMPLE.read_text(encoding="utf-8")
    shown = set(re.findall(r"^(?:# )?\[?(\w+)(?:\]| = )", text, flags=re.MULTILINE))
    assert set(model.model_fields) <= shown


def test_what_the_example_sets_in_the_estimator_is_the_default():
    assert toml.load(EXAMPLE, Config).estimator == Tuning()


def test_the_shortest_config_expects_the_projects_own_messages(config):
    setup = config(MINIMAL)
    assert (0x120, False) in setup.decoder.ids()
    assert setup.cell.cell.name == "lgm50_chen2020"


def test_files_are_looked_for_beside_the_config(config, tmp_path, monkeypatch, cell):
    (tmp_path / "my_cell.toml").write_bytes(resources.find("lgm50_chen2020", "cells", ".toml").read_bytes())
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    setup = config(MINIMAL.replace("lgm50_chen2020", "my_cell.toml") + SIGNALS)
    assert setup.cell == cell
    assert sorted(setup.decoder.ids()) == [(0x200, False), (0x201, False)]


def test_a_dbc_that_is_not_strictly_valid_is_read_with_a_warning(config, tmp_path):
    overlong = 'BO_ 514 Other: 1 Vehicle\n SG_ A : 0|16@1+ (1,0) [0|1] "" Bms\n'
    (tmp_path / "odd.dbc").write_text(f"{(tmp_path / 'vehicle.dbc').read_text()}\n{overlong}")
    setup = config(MINIMAL + SIGNALS.replace("vehicle.dbc", "odd.dbc"))
    (warning,) = setup.warnings
    assert "odd.dbc" in warning


@pytest.mark.parametrize(
    ("text", "key", "told"),
    [
        (MINIMAL.replace("channel", "chanel"), "bus.chanel", "did you mean channel?"),
        (MINIMAL.replace("format = 1", "format = 2"), "format", "1"),
        (MINIMAL.replace("format = 1", ""), "format", "missing"),
        (MINIMAL.replace('"vcan0"', "0"), "bus.channel", "string"),
        ("silence_s = 0\n" + MINIMAL, "silence_s", "greater than 0"),
        ("cells = 2000\n" + MINIMAL, "cells", "400"),
        (MINIMAL + "[estimator]\ninitial_soc = 50\n", "estimator.initial_soc", "less than or equal to 1"),
        (MINIMAL + "[estimator]\ngate_sigma = 5\n", "estimator.gate_sigma", "did you mean gate_sigmas?"),
        (MINIMAL + SIGNALS + 'pack_voltage = "BatteryStatus.Voltage"\n', "signals", "either cell_voltage or pack_volt"),
        (MINIMAL + SIGNALS.replace("CellStatus.V", "CellStatus.U"), "signals.cell_voltage", "CellStatus.Voltage"),
        (MINIMAL + SIGNALS.replace("BatteryStatus", "BateryStatus"), "signals.current", "BatteryStatus"),
        (MINIMAL + SIGNALS.replace('"charge"', '"in"'), "signals.current_positive", "'charge' or 'discharge'"),
        ("cells = 2\n" + MINIMAL + SIGNALS, "signals.cell_voltage", "each of 2 cells"),
    ],
)
def test_a_mistake_is_one_line_naming_file_key_and_what_was_expected(config, tmp_path, text, key, told):
    with pytest.raises(ConfigError) as refused:
        config(text)
    line = str(refused.value)
    assert line.startswith(f"{tmp_path / 'can.toml'}: {key}")
    assert told in line
    assert "\n" not in line


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (MINIMAL.replace("lgm50_chen2020", "lgm50"), "lgm50: expected a file, or one of the shipped cells: "),
        (MINIMAL + SIGNALS.replace("vehicle.dbc", "no.dbc"), "no.dbc: expected a readable DBC file"),
        (MINIMAL + SIGNALS.replace("vehicle.dbc", "can.toml"), "can.toml: expected a readable DBC file"),
        ("format = \n", "can.toml: expected TOML"),
    ],
)
def test_a_file_that_is_missing_or_unreadable_is_named(config, text, told):
    with pytest.raises(ConfigError) as refused:
        config(text)
    assert told in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_missing_config_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"nothing\.toml: expected a readable TOML file"):
        Setup.load(tmp_path / "nothing.toml")
