"""What `cosim --inspect` proposes for FMUs that are not ours, and that it is a scenario."""

from __future__ import annotations

import tomllib

import pytest
from c_fmu import CELL, CELL_START, CELL_STEP, Var, build

from bms_ukf import toml
from bms_ukf.errors import ConfigError
from bms_ukf.plant import PlantTable, inspection, open_plant


def proposed(fmu):
    """The [plant] table that is proposed, which opens the FMU, and the whole text."""
    text = inspection.describe(fmu)
    plant = tomllib.loads(text)["plant"]
    open_plant(toml.validate(plant, PlantTable, fmu)).close()
    return plant, text


def test_an_array_of_cells_is_found_and_structural_parameters_are_shown(tmp_path):
    variables = (
        Var("pack.I", "input", "mA", "0"),
        Var("n", "structuralParameter", "", "2", type="UInt8"),
        Var("pack.U", "output", "mV", size=4, length="n"),
        Var("r", "parameter", "V", "1 2", size=4, length="n"),
        Var("T_housing", "output", "K"),
    )
    fmu = build(tmp_path / "pack.fmu", variables, "return 0;", "T_housing = 300;", fmi=3)
    plant, text = proposed(fmu)
    assert plant["variables"] == {
        "current_A": "pack.I",
        "ambient_degC": "",
        "voltage_V": "pack.U",
        "temperature_degC": "T_housing",
        "soc": "",
    }
    assert '# "n" = 2' in text
    assert '# "r" = [1, 2]' in text
    assert "Float64[2]" in text


def test_cells_that_are_variables_of_their_own_are_a_list(tmp_path):
    variables = (Var("i", "input", "A", "0"), *(Var(f"cell[{k}].v", "output", "V") for k in (1, 2, 3)))
    plant, text = proposed(build(tmp_path / "pack.fmu", variables, "return 0;", ""))
    assert "\ncells = 3 " in text
    assert plant["variables"]["voltage_V"] == ["cell[1].v", "cell[2].v", "cell[3].v"]


def test_units_that_are_not_declared_are_taken_from_the_values_at_the_start(tmp_path):
    variables = (
        Var("I", "input", "", "0"),
        Var("V", "output"),
        Var("SOC", "output"),
        Var("Temp", "output"),
        Var("T_amb", "input", start="25"),
    )
    plant, _ = proposed(build(tmp_path / "pack.fmu", variables, "return 0;", "V = 3.7; SOC = 80; Temp = 298;"))
    assert plant["variables"] == {
        "current_A": "I",
        "ambient_degC": "T_amb",
        "voltage_V": "V",
        "temperature_degC": {"name": "Temp", "unit": "K"},
        "soc": {"name": "SOC", "unit": "%"},
    }


def test_a_plant_driven_by_power_is_loaded_with_power(tmp_path):
    variables = (Var("P_load", "input", "W", "0"), Var("v", "output", "V"), Var("i", "output", "A"))
    plant, text = proposed(build(tmp_path / "p.fmu", variables, "return 0;", "v = 3.7;"))
    assert plant["variables"]["power_W"] == "P_load"
    assert plant["variables"]["current_A"] == "i"
    assert "{ power_W = 4.0, duration_s = 540 }" in text


def test_a_plant_driven_by_voltage_is_loaded_with_the_voltage_it_starts_at(tmp_path):
    variables = (Var("u", "input", "mV", "3600"), Var("i", "output", "A"))
    plant, text = proposed(build(tmp_path / "u.fmu", variables, "return 0;", ""))
    assert plant["variables"]["supply_V"] == "u"
    assert "{ voltage_V = 3.6, duration_s = 600 }" in text


def test_findings_of_the_validation_are_warnings_and_switched_off(tmp_path):
    fmu = build(tmp_path / "c.fmu", replace=('unit="V"', 'unit="volt"'))
    plant, text = proposed(fmu)
    assert plant["validate"] is False
    assert "# warning: validation: " in text


def test_an_fmu_that_does_not_start_by_itself_is_a_warning(tmp_path):
    refuse = "if (soc_initial < 0.6) abort(); " + CELL_START
    text = inspection.describe(build(tmp_path / "c.fmu", CELL, CELL_STEP, refuse))
    assert "# warning: it does not start with its default values: " in text
    assert "SIGABRT" in text


def test_an_fmu_that_cannot_be_loaded_is_refused(tmp_path):
    fmu = build(tmp_path / "c.fmu", instantiate='if (!getenv("NEVER")) return NULL;')
    with pytest.raises(ConfigError, match="can be loaded here"):
        inspection.describe(fmu)
