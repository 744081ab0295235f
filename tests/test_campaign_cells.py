"""The cell files of the campaign's plants: a cycler's programme on the plant, and what `identify` made of it."""

from __future__ import annotations

import numpy as np
import pytest

from bms_ukf import measured
from bms_ukf.campaign import cells, traces
from bms_ukf.campaign.cells import CyclerTest
from bms_ukf.campaign.plants import PLANTS
from bms_ukf.cell import CellParams
from bms_ukf.manifest import Manifest

IDENTIFIED = [name for name in traces.plants() if PLANTS[name].maker]


def test_each_test_of_a_programme_begins_full_and_soaked_and_its_manifest_can_be_identified(tmp_path, monkeypatch):
    load = {"segments": [{"rest_s": 60.0}, {"current_A": 5.0, "duration_s": 120.0}]}
    monkeypatch.setattr(cells, "programme", lambda plant: [CyclerTest("pulse", "cold", 0.0, load)])
    (line,) = cells.write_manifest(PLANTS["lgm50_spme"], tmp_path, "lgm50_spme")
    assert line.startswith("cold: 180 rows, full 0.99")
    path = tmp_path / "MANIFEST.toml"
    tests = Manifest.load(path)
    recording = measured.load(path, tests, tests.test[0])
    assert recording.temperature_degC[0] == pytest.approx(0.0, abs=0.05)
    assert recording.current_A[-1] == 5.0
    assert recording.voltage_V[-1] < recording.voltage_V[0] - 0.1
    assert recording.voltage_V[0] == pytest.approx(4.19, abs=0.02)


@pytest.mark.parametrize("name", IDENTIFIED)
def test_a_programme_has_one_slow_test_one_drive_and_pulses_hot_and_cold(name):
    tests = cells.programme(PLANTS[name])
    roles = [test.role for test in tests]
    assert (roles.count("ocv"), roles.count("drive")) == (1, 1)
    assert sorted(test.ambient_degC for test in tests if test.role == "pulse") == [0.0, 25.0, 45.0]


@pytest.mark.parametrize("name", IDENTIFIED)
def test_the_cell_file_of_a_plant_is_what_identify_made_and_was_not_touched(name):
    plant = PLANTS[name]
    cell = CellParams.load(traces.cell_file(traces.load(traces.names(name)[0])))
    assert cell.cell.name == plant.cell
    assert tuple(cell.cell.voltage_limits_V) == (plant.low_V, plant.high_V)
    assert cell.provenance["made_by"] == "bms-ukf identify MANIFEST.toml"
    assert set(cell.provenance["sha256"]) == {f"{test.name}.csv.gz" for test in cells.programme(plant)}
    assert cell.hysteresis is not None or not plant.hysteresis  # slow diffusion is taken for hysteresis, too
    assert np.all(np.diff(cell.ocv.voltage_V, axis=-1) > 0)
