"""Scenarios with faults against the daemon: the library in `hil/`, verdicts, typos, and the same trace every time."""

from __future__ import annotations

import time
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from pydantic import TypeAdapter

from bms_ukf import scenario
from bms_ukf.expectations import Expectation
from bms_ukf.expectations.record import CellsTold, Record
from bms_ukf.faults import can, plant, sensor, system
from bms_ukf.hil import runner
from bms_ukf.plant import PlantState
from bms_ukf.records import Estimate, Sample, Status

LIBRARY = Path(__file__).parent / "hil"
FILES = sorted(LIBRARY.glob("*.toml"))
KINDS = [
    part.model_fields["kind"].annotation.__args__[0]
    for module in (sensor, can, plant, system)
    for part in module.AnyFault.__args__
]
SHORT = """
format = 1
name = "short"
step_s = 0.5
plant = { fmu = "lgm50_spme", parameters = { soc_initial = 0.8 } }
load = { segments = [{ rest_s = 2 }, { current_A = 5.0, duration_s = 18 }] }
sensors = { seed = 3, current = { noise_A = 0.02 }, voltage = { noise_V = 0.002 } }
estimator = { cell = "lgm50_chen2020" }
"""

LOSS = '[[fault]]\nkind = "loss"\nat_s = 3\n'


@pytest.fixture
def short(tmp_path):
    """Writes a scenario of 20 s with these tables more, and returns its path."""

    def write(more: str, **changes: str) -> Path:
        text = SHORT
        for old, new in changes.items():
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "short.toml"
        path.write_text(text + more)
        return path

    return write


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_the_daemon_meets_what_a_scenario_expects_of_it(path):
    result = runner.run(*scenario.load(path), "direct")
    assert not [f"{verdict.wanted}; found {verdict.found}" for verdict in result.verdicts if not verdict.passed]


def test_the_library_has_every_kind_of_fault_against_a_plant_that_is_not_the_estimators_model():
    library = [scenario.load(path)[0] for path in FILES]
    assert len(library) >= 40
    assert set(KINDS) <= {fault.kind for found in library for fault in found.fault}
    assert {found.plant.fmu for found in library} == {"lgm50_spme", "pack_96s"}
    assert all(found.expect for found in library)
    assert [found.name for found in library] == [path.stem for path in FILES]


def test_the_example_shows_every_table_and_passes(bms_ukf):
    found, _ = scenario.load("faults")
    assert not set(scenario.Scenario.model_fields) - found.model_fields_set
    ended = bms_ukf("hil", "faults")
    assert ended.code == 0, ended.out


def test_cosim_runs_the_same_file_without_faults_and_says_so(short, bms_ukf, caplog):
    ended = bms_ukf("cosim", short(LOSS))
    assert ended.code == 0
    assert "without its faults and expectations" in caplog.text
    assert "cells is 2; expected 1" in bms_ukf("cosim", short("", step_s="cells = 2\nstep_s")).line


def test_a_run_is_the_same_every_time_and_over_each_transport_in_this_process(short):
    path = short(
        """
[[fault]]
kind = "loss"
share = 0.3
at_s = 3
for_s = 5
[[fault]]
kind = "daemon_killed"
at_s = 10
for_s = 3
[[fault]]
kind = "interface_down"
at_s = 15
for_s = 2
"""
    )
    hashes = [runner.run(*scenario.load(path), interface).trace_hash for interface in ("direct", "direct", "virtual")]
    assert len(set(hashes)) == 1
    path.write_text(path.read_text().replace("seed = 3", "seed = 4"))
    assert runner.run(*scenario.load(path), "direct").trace_hash not in hashes


def test_a_scenario_made_to_fail_exits_with_1_and_names_the_expectation_everywhere(short, bms_ukf, tmp_path):
    path = short('[[expect]]\nkind = "soc_error"\nbelow = 1e-6\n[[expect]]\nkind = "coverage"\nat_least = 0.1\n')
    junit = tmp_path / "junit.xml"
    ended = bms_ukf("hil", path, "--interface", "direct", "--junit", junit)
    assert ended.code == 1
    assert "short: soc_error: at most 0.00 % from 0 s to the end; found " in ended.out
    suite = ET.parse(junit).getroot().find("testsuite")
    assert suite is not None
    assert (suite.get("name"), suite.get("tests"), suite.get("failures")) == ("short", "3", "1")
    (failed,) = [case for case in suite.iter("testcase") if case.find("failure") is not None]
    assert failed.get("name") == "soc_error: at most 0.00 % from 0 s to the end"
    assert "found" in str(failed.find("failure").get("message"))
    digest = next(entry.get("value") for entry in suite.iter("property") if entry.get("name") == "trace_sha256")
    assert digest[:8] in ended.out


UNMET = """
[[fault]]
kind = "open_wire"
signal = "voltage_V"
at_s = 8
for_s = 8
[[expect]]
kind = "coverage"
at_least = 0.5
from_s = 30
[[expect]]
kind = "never_valid_and_wrong"
above = 1e-9
[[expect]]
kind = "status_sequence"
sequence = ["ok"]
[[expect]]
kind = "stored_state"
word = "used"
[[expect]]
kind = "plant_failure"
failure = "crash"
[[expect]]
kind = "detected"
fault = "open_wire"
by = "voltage_missing"
within_s = 1
[[expect]]
kind = "recovered"
fault = "open_wire"
within_s = 1
below = 1e-9
[[expect]]
kind = "not_detected"
fault = "open_wire"
[[expect]]
kind = "cell_soc_error"
below = 0.5
[[expect]]
kind = "lowest_cell"
cell = 1
below = 0.5
"""


def test_each_kind_of_expectation_fails_where_it_is_not_met_and_says_what_was_found(short):
    result = runner.run(*scenario.load(short(UNMET)), "direct")
    assert not [verdict.wanted for verdict in result.verdicts if verdict.passed]
    assert [verdict.found for verdict in result.verdicts if not verdict.wanted.startswith("never")] == [
        "no SoC",
        "ok, degraded, ok",
        "none",
        "none",
        "after 5.5 s",
        "never",
        "voltage_missing after 5.5 s",
        "no cells",
        "no cells",
    ]


def test_what_is_expected_of_cells_fails_by_the_cell_that_is_wrong_named_wrong_or_never_told():
    told, true = np.array([0.50, 0.42, 0.61]), np.array([0.50, 0.40, 0.60])

    def found(kind: str, soc: np.ndarray, named: float = 2.0, lowest_soc: float = 0.42, **keys: object) -> str:
        record = Record([])
        answer = Estimate(0, soc=0.5, status=Status.OK)
        state = PlantState(0, voltage_V=true, temperature_degC=true, soc=true, current_A=0.0)
        record.append(Sample(0, 0.0, true, true), answer, state, CellsTold(soc, named, lowest_soc))
        expectation = TypeAdapter(Expectation).validate_python({"kind": kind, **keys})
        verdict = expectation.verdict(record)
        return f"{verdict.passed}: {verdict.found}"

    assert found("cell_soc_error", told, below=0.03) == "True: 2.00 % of cell 2"
    assert found("cell_soc_error", told, below=0.015) == "False: 2.00 % of cell 2"
    assert found("cell_soc_error", np.array([0.5, 0.4, np.nan]), below=0.5) == "False: no SoC of 1 cells"
    assert found("lowest_cell", told, cell=2, below=0.03) == "True: an error of 2.00 %"
    assert found("lowest_cell", told, cell=2, below=0.015) == "False: an error of 2.00 %"
    assert found("lowest_cell", told, lowest_soc=np.nan, cell=2, below=0.5).startswith("False")
    assert found("lowest_cell", told, named=3.0, cell=2, below=0.5) == "False: cell 3"
    assert found("lowest_cell", told, named=np.nan, cell=2, below=0.5) == "False: none"
    assert found("lowest_cell", told, cell=1, below=0.5) == "False: in truth cell 2 is the lowest at some time"


def test_the_report_has_the_fault_matrix_and_a_figure_and_the_verdicts_of_each_scenario(short, bms_ukf, tmp_path):
    page = tmp_path / "hil.html"
    assert bms_ukf("hil", short(UNMET), LIBRARY / "plant_nan.toml", "--report", page).code == 1
    text = page.read_text("utf-8")
    assert "1 of 2 scenarios passed" in text
    assert text.count("data:image/png;base64,") == 2
    matrix = text.partition("Fault matrix")[2].partition("</table>")[0]
    assert "open wire" in matrix
    assert "plant nan" in matrix
    assert "detected: voltage_missing within 1 s of open_wire</td><td>after 5.5 s" in text
    assert '="http' not in text


def test_what_a_transport_cannot_do_is_said_and_not_passed(short, bms_ukf, tmp_path):
    path = short('[[fault]]\nkind = "clock_step"\nstep_s = 60.0\nat_s = 3\n')
    junit = tmp_path / "junit.xml"
    ended = bms_ukf("hil", path, "--interface", "socketcan", "--channel", "vcan0", "--junit", junit)
    assert "short: not run: clock_step: the wall clock of this machine is not set" in ended.out
    assert "0/0" not in ended.out
    (skipped,) = ET.parse(junit).getroot().iter("skipped")
    assert "clock_step" in str(skipped.get("message"))


def test_a_plant_that_fails_fails_the_scenario_that_does_not_expect_it(short):
    path = short('[[fault]]\nkind = "plant_crash"\nat_s = 5\n')
    result = runner.run(*scenario.load(path), "direct")
    assert result.outcome == "failed"
    assert [verdict.wanted for verdict in result.verdicts if not verdict.passed] == ["the plant runs to the end"]
    assert "killed by SIGKILL" in str(result.reason)


def test_real_time_is_kept_and_late_steps_are_counted(short):
    faster = {"duration_s = 18": "duration_s = 1", "step_s = 0.5": "step_s = 0.05"}
    path = short('[pace]\nmode = "realtime"\n', **faster)
    late: list[int] = []

    def linger(step: int, steps: int) -> None:
        if step == 10:
            time.sleep(0.5)
            late.append(step)

    result = runner.run(*scenario.load(path), "direct", watch=linger)
    assert late
    assert result.wall_s > 2.9
    assert 1 <= result.overruns < 60


OFFSET = '[[fault]]\nkind = "offset"\nsignal = "voltage_V"\noffset = 0.1\nat_s = 3\n'
DETECTED = '[[expect]]\nkind = "detected"\nfault = "loss"\nby = "bus"\nwithin_s = 1\n'


@pytest.mark.parametrize(
    ("more", "told"),
    [
        (LOSS.replace("loss", "los"), "(did you mean loss?)"),
        (LOSS.replace("loss", "x"), "fault.0.kind is 'x'; expected one of offset, scale, drift,"),
        (LOSS + "shar = 0.5\n", "fault.0.loss.shar is 0.5; expected no such key (did you mean share?)"),
        (LOSS.replace("at_s = 3", "at_s = -3"), "at_s is -3; expected greater than or equal to 0"),
        (LOSS + 'message = "PackMeasurment"\n', "'PackMeasurment'; expected 'PackMeasurement', 'CellVoltages'"),
        (OFFSET + "cell = 2\n", "cell of at most 1, as many as there are, not 2"),
        ('[[fault]]\nkind = "plant_crash"\nat_s = 3\nfor_s = 5\n', "fault.0.plant_crash.for_s is 5"),
        (DETECTED, "a fault of this file, not 'loss' (it has none)"),
        (LOSS + DETECTED.replace("bus", "buss"), "by: one of initialising, ok"),
        ('[[expect]]\nkind = "soc_error"\nbelow = 0.1\nfrom_s = 9\nto_s = 3\n', "to_s after from_s"),
        (LOSS + LOSS, "a name of its own for each (several are called loss)"),
    ],
)
def test_a_typo_in_a_scenario_is_one_line(short, bms_ukf, more, told):
    line = bms_ukf("hil", short(more)).line
    assert "short.toml: " in line
    assert told in line


def test_a_folder_without_scenarios_is_one_line(bms_ukf, tmp_path):
    assert "a folder with scenarios" in bms_ukf("hil", tmp_path).line
