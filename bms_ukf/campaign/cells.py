"""Makes the cell files of plants: `python -m bms_ukf.campaign.cells [--plant NAME] [--out DIR] [--keep DIR]`

A cycler tests the plant as a user would test a cell, and the cell file is what `identify` makes of it by default:
nothing is tuned. Before each test the cell is charged full at 25 degC, and soaked at the temperature of the test. Needs
the `plant` extra and a C compiler.
"""

from __future__ import annotations

import argparse
import gzip
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bms_ukf import identify, resources
from bms_ukf.campaign.driving import Leg, Run, drive
from bms_ukf.campaign.plants import PLANTS, CampaignPlant
from bms_ukf.campaign.recipes import vehicle

ROOM_DEGC, COLD_DEGC, HOT_DEGC = 25.0, 0.0, 45.0
VOLTAGE_DECIMALS, TEMPERATURE_DECIMALS = 4, 2  # of the cycler


class CyclerTest(NamedTuple):
    """A file of the programme."""

    role: str
    name: str
    ambient_degC: float
    load: dict[str, Any]
    step_s: float = 1.0


def programme(plant: CampaignPlant) -> list[CyclerTest]:
    """C/20 full to empty and back and one drive at 25 degC, pulses there and in the cold and the heat."""
    C, low, high = plant.nominal_Ah, plant.low_V, plant.high_V
    slow = [
        {"current_A": C / 20, "duration_s": 30 * 3600.0, "until_below_V": low},
        {"rest_s": 3600.0},
        {"current_A": -C / 20, "duration_s": 30 * 3600.0, "until_above_V": high},
    ]
    round_ = [{"cycle": "wltc_3b", "until_below_V": low}, {"rest_s": 900.0}]
    long_drive = [{"rest_s": 600.0}, {"schedule": round_, "repeat": 12, "until_below_V": low, "until_below_soc": 0.05}]
    drive_load = {"segments": long_drive, "vehicle": vehicle(plant, ROOM_DEGC)}
    return [
        CyclerTest("ocv", "slow_25degC", ROOM_DEGC, {"segments": slow}, step_s=5.0),
        *(
            CyclerTest("pulse", f"pulse_{degC:g}degC", degC, {"segments": _pulses(plant, degC)})
            for degC in (ROOM_DEGC, COLD_DEGC, HOT_DEGC)
        ),
        CyclerTest("drive", "drive_25degC", ROOM_DEGC, drive_load),
    ]


def _pulses(plant: CampaignPlant, ambient_degC: float) -> list[dict[str, Any]]:
    """10 s pulses of both signs every 5 % of charge, each after half an hour of rest."""
    C, end = plant.nominal_Ah, {"until_below_V": plant.low_V}
    pulse_A = C if ambient_degC >= 10 else C / 2
    level = [
        {"current_A": C / 2, "duration_s": 360.0} | end,
        {"rest_s": 1800.0},
        {"current_A": pulse_A, "duration_s": 10.0} | end,
        {"rest_s": 60.0},
        {"current_A": -pulse_A / 2, "duration_s": 10.0},
        {"rest_s": 60.0},
    ]
    return [{"rest_s": 600.0}, {"schedule": level, "repeat": 22} | end]


def run_test(plant: CampaignPlant, test: CyclerTest, fmu: Path | str) -> Run:
    """Charges the cell full at 25 degC, soaks it, and runs the test."""
    full = [
        {"cccv_A": -plant.nominal_Ah / 3, "voltage_V": plant.high_V, "cutoff_A": plant.nominal_Ah / 50},
        {"rest_s": 3600.0},
    ]
    lead = Leg({"segments": full}, ROOM_DEGC)
    soak = Leg({"segments": [{"rest_s": 7200.0}]}, test.ambient_degC, 10.0)
    return drive(fmu, {"soc_initial": 0.8}, lead, soak, Leg(test.load, test.ambient_degC, test.step_s))


def write_manifest(plant: CampaignPlant, folder: Path, fmu: Path | str) -> Iterator[str]:
    """Runs the programme and writes its recordings and MANIFEST.toml into `folder`; yields what was recorded."""
    text = f'''format = 1
cell = "{plant.cell}"
chemistry = "{plant.chemistry}"
current_positive = "discharge"
voltage_limits_V = [{plant.low_V}, {plant.high_V}]
'''
    for test in programme(plant):
        run = run_test(plant, test, fmu)
        _write_recording(run, test.step_s, folder / f"{test.name}.csv.gz")
        text += f'''
[[test]]
role = "{test.role}"
file = "{test.name}.csv.gz"
temperature_degC = {test.ambient_degC}
'''
        yield f"{test.name}: {len(run.current_A)} rows, full {run.soc_start[0]:.4f}, lowest {run.soc.min():.4f}"
    (folder / "MANIFEST.toml").write_text(text, encoding="utf-8")


def _write_recording(run: Run, step_s: float, path: Path) -> None:
    rows = len(run.current_A)
    columns = (
        step_s * np.arange(1, rows + 1),
        run.current_A,
        run.voltage_V[:, 0].round(VOLTAGE_DECIMALS),
        run.temperature_degC[:, 0].round(TEMPERATURE_DECIMALS),
    )
    with gzip.open(path, "wt", encoding="utf-8", compresslevel=1) as file:
        file.write("time_s,current_A,voltage_V,temperature_degC\n")
        np.savetxt(file, np.column_stack(columns), fmt=("%g", "%.3f", "%.4f", "%.2f"), delimiter=",")


def main(arguments: list[str] | None = None) -> int:
    made = [name for name, plant in sorted(PLANTS.items()) if plant.maker]
    parser = argparse.ArgumentParser(prog="python -m bms_ukf.campaign.cells", description="Makes the cell files.")
    parser.add_argument("--plant", choices=made, action="append", help="one of them; may be given again")
    parser.add_argument("--out", type=Path, default=resources.folder("campaign") / "cells", help="folder to write to")
    parser.add_argument("--keep", type=Path, help="folder for the recordings and manifests; left out: none are kept")
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    for name in given.plant or made:
        plant = PLANTS[name]
        with tempfile.TemporaryDirectory() as scratch:
            folder = given.keep / name if given.keep else Path(scratch)
            folder.mkdir(parents=True, exist_ok=True)
            for line in write_manifest(plant, folder, plant.fmu(folder)):
                _say(f"{name}: {line}")
            found = identify.run(folder / "MANIFEST.toml", _say)
        for warning in found.warnings:
            _say(f"{name}: warning: {warning}")
        (given.out / f"{plant.cell}.toml").write_text(found.text, encoding="utf-8")
    return 0


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
