"""State of health of plants that have aged, and of real cells that have not; `python -m ageing` has more."""

from __future__ import annotations

import csv
import json

import ageing
import numpy as np
import pytest

from bms_ukf import CellParams, Tuning
from bms_ukf.offline.estimators import followed
from bms_ukf.offline.signals import Signals
from bms_ukf.pack import Health
from bms_ukf.pack import counted as counted_module
from bms_ukf.recordings import read


@pytest.fixture(scope="module")
def days() -> np.ndarray:
    """Of a cell that has lost a tenth of its capacity, and has a resistance of 30 % of the cell file's in series."""
    return ageing.lived(ageing.PLANTS["both"])


@pytest.mark.parametrize("offset_A", [0.05, -0.1])
def test_five_days_tell_what_an_aged_cell_has_become(days, offset_A):
    health, true = ageing.found(days, offset_A), ageing.PLANTS["both"]
    assert health.segments[0] == 10
    assert health.capacity[0] == pytest.approx(true.capacity, rel=0.02)
    assert abs(health.capacity[0] - true.capacity) < 2 * health.capacity_sigma[0]
    assert health.resistance[0] == pytest.approx(true.resistance, rel=0.1)


def test_a_replay_has_the_state_of_health_from_when_it_is_told(days, tmp_path, bms_ukf):
    day = days[: len(days) // 4]
    with (tmp_path / "day.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time_s", "current_A", "voltage_V", "temperature_C"])
        writer.writerows([row[0] / 1e9, *row[1:]] for row in day.tolist())
    options = ("--cell", "lgm50_chen2020", "--current-positive", "discharge")
    written = ("--out", tmp_path / "e.csv", "--json", tmp_path / "s.json")
    assert bms_ukf("replay", tmp_path / "day.csv", *options, *written).code == 0
    rows = list(csv.DictReader((tmp_path / "e.csv").read_text().splitlines()))
    summary = json.loads((tmp_path / "s.json").read_text())
    assert rows[0]["soh"] == ""
    assert float(rows[-1]["soh"]) == pytest.approx(0.9, rel=0.02)
    assert summary["soh"] == pytest.approx(float(rows[-1]["soh"]))
    assert summary["soh_segments"] == 2
    assert 0 < summary["soh_sigma"] < 0.05
    assert bms_ukf("replay", tmp_path / "day.csv", *options, "--no-health", "--json", tmp_path / "s.json").code == 0
    assert json.loads((tmp_path / "s.json").read_text())["soh"] is None
    assert summary["r0_scale"] == pytest.approx(ageing.PLANTS["both"].resistance, rel=0.1)


def recorded(cell: str, file: object) -> Health:
    return followed(CellParams.load(cell), Tuning(), Signals.of(read(file, current_positive="charge")), None)[1]


@pytest.mark.parametrize(
    ("cell", "file"),
    [
        ("panasonic_ncr18650pf", "25degC_Cycle_1.csv.gz"),
        ("panasonic_ncr18650pf", "25degC_US06.csv.gz"),
        ("panasonic_ncr18650pf", "0degC_US06.csv.gz"),
        ("a123_lfp", "DYN_P25.csv.gz"),
    ],
)
def test_a_drive_of_a_real_cell_shows_no_ageing(third_party, cell, file):
    """Nobody rests for half an hour within one, so nothing is said of capacity; r0 is what the cell file has.

    The hysteresis of LFP hides r0 for longer than one drive: then nothing may be said of it.
    """
    health = recorded(cell, third_party / cell / file)
    assert np.isnan(health.told_capacity[0])
    told = health.told_resistance[0]
    assert told == pytest.approx(1.0, abs=0.15) or (cell == "a123_lfp" and np.isnan(told))


@pytest.mark.parametrize("temperature", ["25degC", "10degC", "n10degC"])
def test_a_whole_discharge_of_a_real_cell_with_rests_shows_no_loss_of_capacity(third_party, temperature, monkeypatch):
    """The only recordings with rests between shares of the charge, of 20 minutes, which have to do here."""
    monkeypatch.setattr(counted_module, "REST_S", 1150.0)
    health = recorded("panasonic_ncr18650pf", third_party / "panasonic_ncr18650pf" / f"{temperature}_HPPC.csv.gz")
    assert health.segments[0] >= 3
    assert health.capacity[0] == pytest.approx(1.0, abs=0.03)
    assert abs(health.capacity[0] - 1.0) < health.capacity_sigma[0]
    # At -10 degC a surface 5 K from the core is 15 % of a resistance: told with the sigma that says so.
    assert health.resistance_sigma[0] < 0.12
    assert abs(health.told_resistance[0] - 1.0) < 1.96 * health.resistance_sigma[0]
