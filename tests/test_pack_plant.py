"""The shipped pack of 96 cells: each has equations of its own, which are those of a cell, and they differ as told."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from bms_ukf import toml
from bms_ukf.fmumaker.table import Table
from bms_ukf.plant import open_plant

MODEL = Path(__file__).resolve().parents[1] / "models" / "pack_96s"
WEAK = 60  # cell 61
CURRENTS_A = np.random.default_rng(5).uniform(-4.0, 10.0, 60)


def driven(fmu: str, parameters: dict[str, object]) -> np.ndarray:
    """Voltage, temperature and SoC before the first second and after each, (61, 3, cells)."""
    with open_plant(fmu, ambient_degC=20.0, parameters=parameters) as plant:
        states = [plant.state] + [plant.step(float(current_A), 10**9) for current_A in CURRENTS_A]
    return np.array([np.atleast_2d((s.voltage_V, s.temperature_degC, s.soc)).reshape(3, -1) for s in states])


@pytest.fixture(scope="module")
def trace():
    return driven("pack_96s", {})


def test_the_weak_cell_is_the_lowest_and_has_less_capacity_and_more_resistance(trace):
    soc = trace[:, 2]
    assert (soc.argmin(axis=1) == WEAK).all()
    drawn = soc[0] - soc[-1]
    assert drawn.argmax() == WEAK
    assert drawn[WEAK] / np.median(drawn) == pytest.approx(1 / 0.9, abs=0.03)
    sag_V = trace[0, 0] - trace[1, 0]  # before and within a current
    assert sag_V[WEAK] > 1.2 * np.median(sag_V)


def test_the_ambient_temperature_rises_by_8_K_along_the_string(trace):
    np.testing.assert_allclose(trace[0, 1], 20.0 + np.linspace(0.0, 8.0, 96), atol=1e-5)
    assert np.corrcoef(trace[-1, 1], np.arange(96))[0, 1] > 0.9


def test_no_two_cells_are_alike(trace):
    assert len({tuple(cell) for cell in trace[:, 0].T}) == 96


def test_cells_made_equal_are_the_single_cell_but_for_the_mesh():
    equal = {"capacity_factor": 1.0, "resistance_ohm": 0.0, "soc_offset": 0.0, "ambient_offset_K": 0.0}
    of_each = {f"{name}[{k + 1}]": value for name, value in equal.items() for k in range(96)}
    pack = driven("pack_96s", of_each | {"soc_initial": 0.6})
    cell = driven("lgm50_spme", {"soc_initial": 0.6})
    np.testing.assert_array_equal(pack, np.repeat(pack[:, :, :1], 96, axis=2))
    error_V = np.abs(pack[:, 0, 0] - cell[:, 0, 0])
    assert 0 < error_V.max() < 0.02
    np.testing.assert_allclose(pack[:, 2, 0], cell[:, 2, 0], atol=2e-5)


@pytest.mark.filterwarnings("ignore")  # PyBaMM's own
@pytest.mark.skipif(not shutil.which(os.environ.get("CC", "cc")), reason="no C compiler: no plant is made")
def test_the_command_in_the_readme_makes_the_shipped_start_values(tmp_path):
    pytest.importorskip("pybamm", reason="no PyBaMM: no plant is made of its models")
    from bms_ukf.plantmaker.__main__ import main

    text = (MODEL / "README.md").read_text().replace("\\\n", "")
    (command,) = [line for line in text.splitlines() if "bms_ukf.plantmaker pack.fmu" in line]
    arguments = command.split()[3:]
    arguments[0] = str(tmp_path / "pack.fmu")
    assert main([*arguments, "--sources", str(tmp_path / "sources")]) == 0
    made, shipped = (toml.load(folder / "fmu.toml", Table).variable for folder in (tmp_path / "sources", MODEL))
    assert made == shipped
