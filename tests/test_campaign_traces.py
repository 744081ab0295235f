"""The campaign's base traces: how they are stored, what they promise, and that a recipe gives the same trace again."""

from __future__ import annotations

import numpy as np
import pytest

from bms_ukf import resources
from bms_ukf.campaign import recipes, record, traces
from bms_ukf.campaign.plants import PLANTS
from bms_ukf.cell import CellParams
from bms_ukf.errors import ConfigError

LARGEST_BYTES = 2_000_000
LAST_STEP_V = 0.15  # below the lower limit, in the one step of a strong load after which a discharge ends
BRAKING_V = 0.06  # above the upper limit, for a second, of a car that brakes while its cells are nearly full


def made_up(name: str, rows: int = 500, cells: int = 3) -> traces.Trace:
    """Noise of every column, a multiple of its quantum."""
    rng = np.random.default_rng(3)
    return traces.Trace(
        name=f"{name}/noise",
        plant=name,
        cell="lgm50_chen2020",
        kind="mixed",
        step_s=0.5,
        current_A=rng.integers(-9000, 9000, rows) * 1e-3,
        voltage_V=rng.integers(25000, 42000, (rows, cells)) * 1e-4,
        temperature_degC=rng.integers(-2000, 4500, rows) * 1e-2,
        soc=rng.integers(-100, 100100, (rows, cells)) * 1e-5,
        ambient_degC=-20.0,
        capacity_Ah=np.array([4.9, 5.0, 5.1]),
        aged=True,
        soc_ref_sigma=0.0,
    )


def test_what_is_stored_is_read_back_whole(tmp_path, monkeypatch):
    monkeypatch.setattr(resources, "folder", lambda kind: tmp_path)
    traces._file.cache_clear()
    given = made_up("anything")
    traces.save([given], tmp_path / f"anything{traces.SUFFIX}")
    try:
        assert traces.names() == ["anything/noise"]
        found = traces.load("anything/noise")
    finally:
        traces._file.cache_clear()
    for name, value in given._asdict().items():
        if isinstance(value, np.ndarray):
            np.testing.assert_allclose(getattr(found, name), value, rtol=0, atol=1e-9)
        else:
            assert getattr(found, name) == value


@pytest.mark.parametrize("name", ["nothing", "nothing/drive_25degC", "lgm50_spme/nothing", "../cells/lgm50"])
def test_a_trace_that_does_not_exist_is_refused(name):
    with pytest.raises(ConfigError):
        traces.load(name)


def test_all_committed_traces_together_stay_small():
    files = list(resources.folder("campaign").glob(f"*{traces.SUFFIX}"))
    assert {path.name.removesuffix(traces.SUFFIX) for path in files} <= set(PLANTS)
    assert sum(path.stat().st_size for path in files) < LARGEST_BYTES


@pytest.mark.parametrize("plant", traces.plants())
def test_every_trace_of_a_plant_has_its_recipe(plant):
    assert set(traces.names(plant)) <= {f"{plant}/{recipe.name}" for recipe in recipes.of(PLANTS[plant])}


@pytest.mark.parametrize("name", traces.names())
def test_soc_is_the_charge_over_the_present_capacity(name):
    trace = traces.load(name)
    taken_Ah = np.cumsum(trace.current_A) * trace.step_s / 3600
    expected = trace.soc[0] - (taken_Ah - taken_Ah[0])[:, None] / trace.capacity_Ah
    assert np.abs(trace.soc - expected).max() < 1e-3
    assert -0.002 < trace.soc.min() < trace.soc.max() < 1.002


@pytest.mark.parametrize("name", traces.names())
def test_a_trace_starts_at_equilibrium_and_a_discharge_lowers_its_voltage(name):
    trace = traces.load(name)
    resting = int(np.argmax(trace.current_A != 0))
    assert resting * trace.step_s >= 60
    assert np.ptp(trace.voltage_V[:resting], axis=0).max() < 1e-3
    assert np.ptp(trace.temperature_degC[:resting]) < 0.02
    step_A = np.diff(trace.current_A)
    assert np.all(step_A @ np.diff(trace.voltage_V, axis=0) < 0)


@pytest.mark.parametrize("name", traces.names())
def test_a_trace_stays_within_what_its_cell_is_made_for(name):
    trace = traces.load(name)
    cell = CellParams.load(traces.cell_file(trace))
    low_V, high_V = cell.cell.voltage_limits_V
    assert trace.voltage_V.min() > low_V - LAST_STEP_V
    assert np.count_nonzero(trace.voltage_V < low_V) <= 1
    assert trace.voltage_V.max() < high_V + BRAKING_V
    assert np.all(np.isfinite(trace.temperature_degC))
    share = trace.capacity_Ah / cell.cell.capacity_Ah
    assert np.abs(share - (recipes.AGED_CAPACITY if trace.aged else 1.0)).max() < (0.001 if trace.cells == 1 else 0.15)


def test_a_recipe_gives_the_committed_trace_again():
    plant = PLANTS["lgm50_spme"]
    recipe = next(each for each in recipes.of(plant) if each.name == "mixed_25degC")
    short = recipe._replace(load=recipe.load | {"segments": [{"rest_s": 3600.0}, *recipe.load["segments"][1:2]]})
    made, committed = record.record(plant, short, plant.name), traces.load("lgm50_spme/mixed_25degC")
    rows = made.rows
    assert rows == 6000
    np.testing.assert_allclose(made.current_A, committed.current_A[:rows], atol=1e-9)
    np.testing.assert_allclose(made.voltage_V, committed.voltage_V[:rows], atol=2 * traces.VOLTAGE_V)
    np.testing.assert_allclose(made.soc, committed.soc[:rows], atol=2 * traces.SOC)
    np.testing.assert_allclose(made.temperature_degC, committed.temperature_degC[:rows], atol=2 * traces.TEMPERATURE_K)
