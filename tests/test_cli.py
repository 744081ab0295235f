"""What a user types, and what comes back: an exit code, and for a mistake one line on stderr."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from bms_ukf import __version__, cli, resources, service
from bms_ukf.scenario import Scenario
from bms_ukf.toml import load

PLANT = resources.find("lgm50_spme", "plants", ".fmu")
CONFIG = """
format = 1
cell = "{cell}"
[bus]
interface = "{interface}"
channel = "{channel}"
"""
SCENARIO = """
format = 1
name = "short"
[plant]
fmu = "{fmu}"
variables = {{ {variables} }}
[load]
segments = [{{ current_A = 1.0, duration_s = 20 }}]
[bus]
interface = "virtual"
channel = "test-cli"
[estimator]
cell = "{cell}"
"""
SIGNALS = """
[signals]
dbc = ["{dbc}"]
current = "BatteryStatus.Current"
current_positive = "charge"
cell_voltage = ["{voltage}"]
temperature = ["CellStatus.Temperature"]
"""


@pytest.fixture
def config(tmp_path):
    def write(
        interface: str = "socketcan", channel: str = "nocan7", cell: str = "lgm50_chen2020", more: str = ""
    ) -> Path:
        path = tmp_path / "can.toml"
        path.write_text(CONFIG.format(cell=cell, interface=interface, channel=channel) + more)
        return path

    return write


@pytest.fixture
def scenario(tmp_path):
    def write(fmu: str | Path = "lgm50_spme", variables: str = "", cell: str = "lgm50_chen2020") -> Path:
        path = tmp_path / "short.toml"
        path.write_text(SCENARIO.format(fmu=fmu, variables=variables, cell=cell))
        return path

    return write


@pytest.fixture
def altered_plant(tmp_path):
    """The shipped plant with words of its description replaced, and a folder renamed."""

    def alter(words: Mapping[str, str], rename: tuple[str, str] = ("", "")) -> Path:
        path = tmp_path / "altered.fmu"
        with zipfile.ZipFile(PLANT) as old, zipfile.ZipFile(path, "w") as new:
            for name in old.namelist():
                data = old.read(name)
                if name == "modelDescription.xml":
                    for word, other in words.items():
                        assert word.encode() in data
                        data = data.replace(word.encode(), other.encode())
                new.writestr(name.replace(*rename), data)
        return path

    return alter


# --- fine -----------------------------------------------------------------------------------------------------------


def test_without_arguments_it_says_what_it_can_do(bms_ukf):
    ended = bms_ukf()
    assert ended.code == 0
    assert all(command in ended.out for command in ("demo", "run", "cosim"))


def test_it_knows_its_version(bms_ukf):
    assert bms_ukf("--version").out == f"bms-ukf, version {__version__}\n"


def test_cosim_writes_the_summary_and_the_trace_it_was_asked_for(bms_ukf, scenario, tmp_path):
    ended = bms_ukf("cosim", scenario(), "--json", tmp_path / "r.json", "--out", tmp_path / "trace.csv")
    assert ended.code == 0
    summary = json.loads((tmp_path / "r.json").read_text())
    assert (summary["n"], summary["duration_s"]) == (20, 20.0)
    assert {"rmse_pct", "max_pct", "coverage95", "settled_s", "final_soc", "after_600s"} <= summary.keys()
    with (tmp_path / "trace.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 20
    assert list(rows[0])[:8] == [
        "time_s",
        "soc",
        "soc_sigma",
        "voltage_pred_V",
        "innovation_V",
        "nis",
        "status",
        "faults",
    ]
    assert float(rows[-1]["soc"]) == pytest.approx(summary["final_soc"])


def test_check_explains_a_config_without_opening_its_bus(bms_ukf, config):
    ended = bms_ukf("run", config(), "--check")
    assert ended.code == 0
    assert "lgm50_chen2020" in ended.out
    assert "socketcan:nocan7" in ended.out
    assert ended.err == ""


# --- stopping -------------------------------------------------------------------------------------------------------


class Signalled:
    """A bus on which nothing ever happens, but that the process is sent a signal as soon as it listens."""

    def __init__(self, number: int) -> None:
        self._number = number
        self.closed = False

    def recv(self, timeout: float) -> None:
        os.kill(os.getpid(), self._number)

    def send(self, message: Any) -> None:
        """Nobody is there."""

    def shutdown(self) -> None:
        self.closed = True


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 0), (signal.SIGINT, 130)])
def test_a_signal_ends_the_daemon_tidily(bms_ukf, config, monkeypatch, number, code):
    bus = Signalled(number)
    monkeypatch.setattr(service, "open_bus", lambda *_: bus)
    before = signal.getsignal(number)
    assert bms_ukf("run", config()).code == code
    assert bus.closed
    assert signal.getsignal(number) is before


# --- mistakes -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["demoo"], "demoo"),
        (["run"], "CONFIG"),
        (["run", "can.toml", "--fast"], "--fast"),
        (["cosim"], "SCENARIO"),
        (
            ["cosim", "nothing.toml"],
            "nothing.toml: expected a file, or one of the shipped scenarios: days, demo, faults",
        ),
        (["cosim", "--inspect", "nothing.fmu"], "nothing.fmu: expected a file, or one of the shipped plants: "),
        (["cosim", "demo", "--json", "no/such/folder/r.json"], "no/such/folder/r.json"),
        (["cosim", "demo", "--out", "no/such/folder/trace.csv"], "no/such/folder/trace.csv"),
        (["cosim", "demo", "--out", "."], ".: expected a file to be written"),
        (["cosim", "x" * 300], "shipped scenarios: days, demo, faults"),
        (["cosim", "~nobody-of-that-name/x.toml"], "shipped scenarios: days, demo, faults"),
        (["run", "nothing.toml"], "nothing.toml: expected a readable TOML file"),
    ],
)
def test_wrong_usage_is_one_line(bms_ukf, tmp_path, monkeypatch, arguments, told):
    monkeypatch.chdir(tmp_path)
    assert told in bms_ukf(*arguments).line


def test_an_interface_that_is_not_there_is_one_line(bms_ukf, config):
    line = bms_ukf("run", config(channel="nocan7")).line
    assert "can.toml: bus.channel is 'socketcan:nocan7'; expected" in line


def test_an_unknown_kind_of_interface_is_one_line(bms_ukf, config):
    assert "can.toml: bus.interface is 'nonsense'; expected" in bms_ukf("run", config(interface="nonsense")).line


@pytest.mark.parametrize("more", [[], ["--check"]])
def test_run_refuses_a_bus_that_no_other_process_can_reach(bms_ukf, config, more):
    line = bms_ukf("run", config(interface="virtual"), *more).line
    assert "bus.interface is 'virtual'; expected a bus that other processes can reach" in line


def test_a_typo_in_a_cell_file_is_one_line_with_the_key_that_was_meant(bms_ukf, config, tmp_path):
    shipped = resources.find("lgm50_chen2020", "cells", ".toml").read_text()
    (tmp_path / "mine.toml").write_text(shipped.replace("capacity_Ah =", "capacity_ah =", 1))
    line = bms_ukf("run", config(cell="mine.toml")).line
    assert "mine.toml: cell.capacity_ah is" in line
    assert "did you mean capacity_Ah?" in line


def test_a_signal_that_is_not_in_the_dbc_is_one_line_with_those_that_are(bms_ukf, config):
    dbc = Path(__file__).resolve().parents[1] / "models" / "configs" / "example.dbc"
    line = bms_ukf("run", config(more=SIGNALS.format(dbc=dbc, voltage="CellStatus.Voltag"))).line
    assert "can.toml: signals.cell_voltage is 'CellStatus.Voltag'; expected" in line
    assert "CellStatus.Voltage" in line


@pytest.fixture(params=["cosim", "--inspect"])
def use_fmu(request, bms_ukf, scenario):
    """Uses an FMU in each of the two ways there are."""
    if request.param == "cosim":
        return lambda fmu: bms_ukf("cosim", scenario(fmu))
    return lambda fmu: bms_ukf("cosim", "--inspect", fmu)


def test_an_fmu_without_co_simulation_is_one_line(use_fmu, altered_plant):
    fmu = altered_plant({"<CoSimulation": "<ModelExchange", "</CoSimulation": "</ModelExchange"})
    assert "altered.fmu is 'FMI 2.0, model exchange only'; expected FMI 2.0 or 3.0 co-simulation" in use_fmu(fmu).line


def test_an_fmu_for_another_platform_is_one_line_with_those_it_is_for(use_fmu, altered_plant):
    line = use_fmu(altered_plant({"<SourceFiles>": "<!--", "</SourceFiles>": "-->"}, ("/linux64", "/win64"))).line
    assert "altered.fmu: binaries is 'win64'; expected" in line


@pytest.mark.parametrize("content", [b"", b"no zip", PLANT.read_bytes()[:2000]])
def test_what_is_no_fmu_is_one_line(use_fmu, tmp_path, content):
    (tmp_path / "broken.fmu").write_bytes(content)
    assert "broken.fmu: expected an FMU" in use_fmu(tmp_path / "broken.fmu").line


def test_a_variable_the_fmu_does_not_have_is_one_line_with_those_it_has(bms_ukf, scenario):
    line = bms_ukf("cosim", scenario(variables='voltage_V = "voltag_V"')).line
    assert "variables.voltage_V is 'voltag_V'; expected a variable of the FMU, such as voltage_V" in line


def test_no_traceback_from_a_process_of_its_own(tmp_path):
    (tmp_path / "can.toml").write_text("format = 1\n")
    command = [sys.executable, "-m", "bms_ukf", "run", "can.toml"]
    ended = subprocess.run(command, cwd=tmp_path, env=outside(), capture_output=True, text=True, check=False)
    assert ended.stdout == ""
    assert ended.stderr.startswith("bms-ukf: can.toml: ")
    assert ended.stderr.count("\n") == 1
    assert ended.returncode == 2


def outside() -> dict[str, str]:
    """The environment of a process that runs elsewhere, but finds this checkout."""
    return os.environ | {"PYTHONPATH": str(Path(cli.__file__).parents[2])}


# --- inspection -----------------------------------------------------------------------------------------------------


def test_what_inspection_prints_of_the_shipped_plant_runs_as_it_is(bms_ukf, tmp_path):
    shown = bms_ukf("cosim", "--inspect", PLANT)
    assert shown.code == 0
    (tmp_path / "plant.toml").write_text(shown.out)
    assert bms_ukf("cosim", tmp_path / "plant.toml", "--json", tmp_path / "r.json").code == 0
    assert json.loads((tmp_path / "r.json").read_text())["n_scored"] == 600


def test_inspection_shows_each_variable_with_all_that_is_declared_of_it(bms_ukf):
    out = bms_ukf("cosim", "--inspect", PLANT).out
    rows = {words[1]: words for line in out.splitlines() if len(words := line.split()) > 8 and words[0] == "#"}
    assert rows["current_A"][2:9] == ["input", "continuous", "Real", "A", "0.0", "-50.0", "50.0"]
    assert rows["soc_initial"][2:6] == ["parameter", "fixed", "Real", "1"]
    assert {"voltage_V", "temperature_degC", "soc", "ambient_degC"} <= rows.keys()
    assert "FMI 2.0 co-simulation" in out
    assert "state get and set" in out
    assert "warning" not in out


def test_variables_of_other_names_are_matched_by_name_and_unit(bms_ukf, altered_plant, tmp_path):
    others = {
        'name="current_A"': 'name="batteryCurrent"',
        'name="voltage_V"': 'name="u"',
        'name="temperature_degC"': 'name="T_core_temp"',
        'name="ambient_degC"': 'name="T_ambient"',
        'name="soc"': 'name="pack.SoC"',
    }
    (tmp_path / "plant.toml").write_text(bms_ukf("cosim", "--inspect", altered_plant(others)).out)
    assert load(tmp_path / "plant.toml", Scenario).plant.variables == {
        "current_A": "batteryCurrent",
        "ambient_degC": "T_ambient",
        "voltage_V": "u",
        "temperature_degC": "T_core_temp",
        "soc": "pack.SoC",
    }
    assert bms_ukf("cosim", tmp_path / "plant.toml").code == 0


def test_a_role_that_nothing_fits_is_a_gap_with_a_warning(bms_ukf, altered_plant, tmp_path):
    out = bms_ukf("cosim", "--inspect", altered_plant({'name="voltage_V"': 'name="u"', 'unit="V"': 'unit="1"'})).out
    assert "# warning: no output looks like voltage_V in V" in out
    (tmp_path / "plant.toml").write_text(out)
    assert "variables.voltage_V" in bms_ukf("cosim", tmp_path / "plant.toml").line


def test_findings_of_the_validation_are_warnings(bms_ukf, altered_plant):
    ended = bms_ukf("cosim", "--inspect", altered_plant({'name="soc_initial"': 'name="soc"'}))
    assert ended.code == 0
    assert "# warning: validation: " in ended.out


def test_init_writes_a_skeleton_and_tells_what_is_to_be_filled_in(bms_ukf, tmp_path):
    dbc = Path(__file__).resolve().parents[1] / "models" / "configs" / "example.dbc"
    ended = bms_ukf("init", dbc, "--out", tmp_path / "can.toml")
    assert (ended.code, ended.out) == (0, "")
    assert ended.err == "fill in signals.series_cells: how many cells in series pack_voltage is the sum of\n"
    text = (tmp_path / "can.toml").read_text()
    assert 'current_positive = "charge"   # as its comment says' in text
    assert "[signals]" in bms_ukf("init", dbc).out
    (tmp_path / "can.toml").write_text(text.replace("# series_cells", "series_cells"))
    checked = bms_ukf("run", "--check", tmp_path / "can.toml")
    assert "current: BatteryStatus.Current" in checked.out


def test_init_of_what_is_no_dbc_is_one_line(bms_ukf, tmp_path):
    assert "no.dbc: expected a readable DBC file" in bms_ukf("init", tmp_path / "no.dbc").line
