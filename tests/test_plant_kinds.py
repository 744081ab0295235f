"""What FMUs may be: FMI 2.0 and 3.0, types, arrays, events, early returns, fixed steps, sources only, other units."""

from __future__ import annotations

import shutil
import subprocess
import zipfile

import numpy as np
import pytest
from c_fmu import CELL, CELL_START, CELL_STEP, PLATFORM, Var, build

from bms_ukf.errors import ConfigError, PlantError
from bms_ukf.plant import open_plant

SECOND = 1_000_000_000
BOTH = pytest.mark.parametrize("fmi", [2, 3])
NONE = {"ambient_degC": "", "temperature_degC": "", "soc": ""}


@BOTH
def test_both_versions_of_the_standard_give_the_same_cell(tmp_path, fmi):
    with open_plant(build(tmp_path / "cell.fmu", fmi=fmi), ambient_degC=10.0) as plant:
        assert plant.state.soc == 0.5
        plant.step(0.0, SECOND)
        state = plant.step(3.6, SECOND)
    assert state.soc == pytest.approx(0.499)
    assert state.voltage_V == pytest.approx(3.139)
    assert (state.temperature_degC, state.current_A, state.t_ns) == (10.0, 3.6, 2 * SECOND)


def test_cells_are_an_array_of_fmi_3_as_long_as_a_structural_parameter_says(tmp_path):
    variables = (
        Var("I", "input", "A", "0"),
        Var("cells", "structuralParameter", "", "3", type="UInt8"),
        Var("v", "output", "mV", size=8, length="cells"),
        Var("spread", "parameter", "V", "0.1 0.2 0.3", size=8, length="cells"),
        Var("soc", "output", "%"),
    )
    step = "soc = 50; for (int k = 0; k < cells; k++) (&v)[k] = 1000 * (3 + (&spread)[k] - I); return 0;"
    fmu = build(tmp_path / "pack.fmu", variables, step, step.replace("return 0;", ""), fmi=3)
    names = {"current_A": "I", "voltage_V": "v", "temperature_degC": "", "ambient_degC": ""}
    with open_plant(fmu, variables=names) as plant:
        assert plant.state.voltage_V == pytest.approx([3.1, 3.2, 3.3])
        state = plant.step(1.0, SECOND)
        assert state.voltage_V == pytest.approx([2.1, 2.2, 2.3])
        assert state.soc == 0.5
    with open_plant(fmu, variables=names, parameters={"cells": 2, "spread": [0.0, 0.5]}) as plant:
        assert plant.state.voltage_V == pytest.approx([3.0, 3.5])
    with pytest.raises(ConfigError, match=r"parameters\.spread is 1\.0; expected 3 values"):
        open_plant(fmu, variables=names, parameters={"spread": 1.0})


@pytest.mark.parametrize(("name", "mapped"), [("v", {"voltage_V": ["v[1]", "v[2]"]}), ("voltage_V", {})])
def test_cells_are_a_list_of_variables(tmp_path, name, mapped):
    variables = (Var("I", "input", "A", "0"), *(Var(f"{name}[{k}]", "output", "V") for k in (1, 2)))
    step = "v_1_ = 3 - I; v_2_ = 4 - I; return 0;".replace("v_", f"{name}_")
    fmu = build(tmp_path / "pack.fmu", variables, step, f"{name}_1_ = 3; {name}_2_ = 4;")
    with open_plant(fmu, variables={"current_A": "I", **mapped, **NONE}) as plant:
        np.testing.assert_array_equal(plant.state.voltage_V, [3.0, 4.0])
        np.testing.assert_array_equal(plant.step(1.0, SECOND).voltage_V, [2.0, 3.0])


@pytest.mark.parametrize("kind", ["Float32", "Int32", "Int64", "UInt8"])
def test_numbers_of_any_type_of_fmi_3_are_inputs_and_outputs(tmp_path, kind):
    variables = (
        Var("I", "input", start="0", type=kind),
        Var("on", "parameter", start="true", type="Boolean"),
        Var("v", "output", type=kind),
    )
    fmu = build(tmp_path / "cell.fmu", variables, "v = 100 + I + on; return 0;", "", fmi=3)
    names = {"current_A": "I", "voltage_V": {"name": "v", "unit": "mV"}, **NONE}
    with open_plant(fmu, variables=names) as plant:
        assert plant.step(7.0, SECOND).voltage_V == pytest.approx(0.108)
    with open_plant(fmu, variables=names, parameters={"on": False}) as plant:
        assert plant.step(7.0, SECOND).voltage_V == pytest.approx(0.107)
    with pytest.raises(ConfigError, match=r"parameters\.on is 1; expected a value of FMI type Boolean"):
        open_plant(fmu, variables=names, parameters={"on": 1})


def test_an_early_return_is_followed_by_the_rest_of_the_step(tmp_path):
    early = CELL_STEP.replace("return 0;", "if (h > 0.25) *reached = t + 0.25; return 0;").replace("* h", "* 0.25")
    with open_plant(build(tmp_path / "cell.fmu", step=early, fmi=3)) as plant:
        assert plant.step(3.6, SECOND).soc == pytest.approx(0.499)


def test_a_step_that_is_discarded_part_way_goes_on_from_there_in_fmi_2(tmp_path):
    early = CELL_STEP.replace("return 0;", "if (h > 0.25) { *reached = t + 0.25; return 2; } return 0;")
    with open_plant(build(tmp_path / "cell.fmu", step=early.replace("* h", "* 0.25"))) as plant:
        assert plant.step(3.6, SECOND).soc == pytest.approx(0.499)


def test_early_returns_that_get_nowhere_are_refused(tmp_path):
    stuck = build(tmp_path / "stuck.fmu", step="*reached = t; return 0;", fmi=3)
    with open_plant(stuck) as plant, pytest.raises(PlantError, match="got no further than t = 0 s") as caught:
        plant.step(1.0, SECOND)
    assert caught.value.kind == "refused"


@pytest.mark.parametrize(("capabilities", "events"), [('hasEventMode="true"', 3), ("", 0)])
def test_events_are_handled_in_event_mode_if_the_fmu_has_it(tmp_path, capabilities, events):
    step = CELL_STEP.replace("return 0;", "temperature_degC = all[4095]; return 100;")
    with open_plant(build(tmp_path / "cell.fmu", step=step, fmi=3, capabilities=capabilities)) as plant:
        for _ in range(4):
            plant.step(0.0, SECOND)
        assert plant.state.temperature_degC == events


def test_a_step_ends_where_the_fmu_said_its_next_event_would_be(tmp_path):
    # soc counts steps, the temperature is the length of the last one.
    step = "temperature_degC = h; soc += 1; all[4094] = t < 1.5 ? 1.5 : 0; return 0;"
    fmu = build(
        tmp_path / "c.fmu", step=step, start="all[4094] = 1.5; soc = 0;", fmi=3, capabilities='hasEventMode="true"'
    )
    with open_plant(fmu) as plant:
        lengths = [plant.step(0.0, SECOND).temperature_degC for _ in range(3)]
    assert lengths == [1.0, 0.5, 1.0]
    assert plant.state.soc == 4


def test_an_fmu_that_works_asynchronously_is_refused_by_that_word(tmp_path):
    fmu = build(tmp_path / "cell.fmu", step="return 5;")
    with open_plant(fmu) as plant, pytest.raises(PlantError, match="works asynchronously"):
        plant.step(1.0, SECOND)


# The voltage is the number of steps made, the temperature the length of the last one, soc the mean current.
COUNT = "voltage_V += 1; temperature_degC = h; soc = current_A; return 0;"


@pytest.mark.parametrize(
    ("fmi", "fixed", "keys", "steps", "length_s"),
    [
        (2, ("", 'stepSize="0.25"'), {}, 2, 1.0),
        (2, ("", 'stepSize="0.25"'), {"step_s": 0.25}, 8, 0.25),
        (2, ('canHandleVariableCommunicationStepSize="false"', 'stepSize="2"'), {}, 1, 2.0),
        (2, ('canHandleVariableCommunicationStepSize="false"', 'stepSize="0.3"'), {}, 2, 1.0),
        (3, ('fixedInternalStepSize="0.25"', ""), {}, 2, 1.0),
        (3, ('fixedInternalStepSize="2"', ""), {}, 1, 2.0),
    ],
)
def test_an_fmu_is_stepped_as_it_or_its_user_asks(tmp_path, fmi, fixed, keys, steps, length_s):
    capabilities, experiment = fixed
    fmu = build(
        tmp_path / "c.fmu",
        step=COUNT,
        start="voltage_V = 0;",
        fmi=fmi,
        capabilities=capabilities,
        experiment=experiment,
    )
    with open_plant(fmu, **keys) as plant:
        for current_A in (1.0, 3.0):
            state = plant.step(current_A, SECOND)
    assert (state.voltage_V, state.temperature_degC, state.t_ns) == (steps, length_s, 2 * SECOND)
    assert state.soc == (2.0 if length_s == 2.0 else 3.0)  # charge is kept: the mean current over a longer step


def test_a_step_that_fits_nothing_is_one_line(tmp_path):
    with (
        open_plant(build(tmp_path / "c.fmu"), step_s=0.3) as plant,
        pytest.raises(ConfigError, match=r"step_s is 0\.3; expected a part or a multiple of the plant's step, 1 s"),
    ):
        plant.step(1.0, SECOND)


def test_a_step_the_fmu_refuses_is_one_line_with_its_length(tmp_path):
    fmu = build(tmp_path / "c.fmu", step="if (h != 0.5) return 3;" + CELL_STEP)
    with open_plant(fmu) as plant, pytest.raises(PlantError, match=r"a step of 1 s; step_s sets another"):
        plant.step(1.0, SECOND)
    with open_plant(fmu, step_s=0.5) as plant:
        assert plant.step(0.0, SECOND).voltage_V == 3.5


def test_the_fmus_clock_starts_where_its_experiment_does(tmp_path):
    step = "temperature_degC = t; return 0;"
    fmu = build(tmp_path / "c.fmu", step=step, experiment='startTime="100" stopTime="101" tolerance="1e-6"')
    with open_plant(fmu) as plant:
        for _ in range(3):
            state = plant.step(1.0, SECOND)
    assert (state.temperature_degC, state.t_ns) == (102.0, 3 * SECOND)


@pytest.mark.skipif(shutil.which("cmake") is None, reason="no cmake: sources cannot be compiled")
@BOTH
def test_sources_are_compiled_once(tmp_path, monkeypatch, fmi):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    fmu = build(tmp_path / "cell.fmu", fmi=fmi, sources_only=True)
    with open_plant(fmu) as plant:
        assert plant.step(0.0, SECOND).voltage_V == 3.5
    (kept,) = (tmp_path / "cache").rglob("*.so")
    monkeypatch.setattr("bms_ukf.plant.archive._build", None)
    open_plant(fmu).close()
    kept.unlink()
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ConfigError, match="or cmake and cc to compile its sources"):
        open_plant(fmu)


def test_sources_that_do_not_compile_are_one_line_with_the_error(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    fmu = build(tmp_path / "bad.fmu", step="return nonsense;", sources_only=True)
    with pytest.raises(ConfigError, match=r"sources that compile here \(.*nonsense") as caught:
        open_plant(fmu)
    assert "\n" not in str(caught.value)


def converted(tmp_path, current, voltage, temperature, soc, **keys):
    variables = (
        Var("i", "input", current, "0"),
        Var("u", "output", voltage),
        Var("T", "output", temperature),
        Var("x", "output", soc),
    )
    fmu = build(tmp_path / "c.fmu", variables, "u = 4000 - i; T = 300; x = 40; return 0;", "")
    keys = {
        "variables": {"current_A": "i", "voltage_V": "u", "temperature_degC": "T", "soc": "x", "ambient_degC": ""}
    } | keys
    with open_plant(fmu, **keys) as plant:
        return plant.step(0.5, SECOND)


def test_units_are_converted_from_those_the_fmu_declares(tmp_path):
    state = converted(tmp_path, "mA", "mV", "K", "%")
    assert state.voltage_V == pytest.approx(3.5)
    assert state.temperature_degC == pytest.approx(26.85)
    assert state.soc == pytest.approx(0.4)
    assert state.current_A == 0.5


def test_current_is_turned_round_where_the_fmu_charges_with_it(tmp_path):
    state = converted(tmp_path, "mA", "mV", "K", "%", current_positive="charge")
    assert state.voltage_V == pytest.approx(4.5)
    assert state.current_A == 0.5


def test_a_unit_that_cannot_be_converted_is_one_line_with_those_that_can(tmp_path):
    with pytest.raises(ConfigError) as caught:
        converted(tmp_path, "mA", "Ah", "K", "%")
    assert "variables.voltage_V is 'u in Ah'; expected a variable in V" in str(caught.value)
    assert "V, mV, kV, uV" in str(caught.value)


def test_the_map_adds_what_the_fmu_does_not_say(tmp_path):
    voltage = {"name": "u", "unit": "mV", "gain": 0.5, "offset": 1.0}
    names = {"current_A": "i", "voltage_V": voltage, "temperature_degC": "", "soc": "", "ambient_degC": ""}
    assert converted(tmp_path, "", "", "K", "%", variables=names).voltage_V == pytest.approx(3.9995 / 2 + 1)


POWERED = (Var("P", "input", "kW", "0"), Var("v", "output", "V"), Var("i", "output", "A"))


def test_a_plant_driven_by_power_gives_the_current(tmp_path):
    fmu = build(tmp_path / "p.fmu", POWERED, "i = 1000 * P / 4; v = 4; return 0;", "v = 4;")
    names = {"power_W": "P", "voltage_V": "v", "current_A": "i", **NONE}
    with open_plant(fmu, variables=names, current_positive="charge") as plant:
        assert plant.input == "power_W"
        state = plant.step(8.0, SECOND)
        assert (state.voltage_V, state.current_A) == (4.0, 2.0)
    with open_plant(fmu, variables=names | {"current_A": ""}) as plant:
        assert plant.step(8.0, SECOND).current_A == 2.0


@pytest.mark.parametrize("role", ["voltage_V", "supply_V"])
def test_a_plant_driven_by_voltage_gives_the_current(tmp_path, role):
    variables = (Var("u", "input", "V", "3.5"), Var("i", "output", "A"), Var("ocv", "local", "V"))
    fmu = build(tmp_path / "u.fmu", variables, "ocv = 3.5; i = (3.5 - u) / 0.1; return 0;", "i = 0; ocv = 3.5;")
    with open_plant(fmu, variables={role: "u", "current_A": "i", **NONE}) as plant:
        assert plant.input == "voltage_V"
        assert plant.state.voltage_V == 3.5
        state = plant.step(3.4, SECOND)
        assert (state.voltage_V, state.current_A) == (3.4, pytest.approx(1.0))
    with pytest.raises(ConfigError, match=r"variables\.current_A .*expected an output, as the plant is driven by"):
        open_plant(fmu, variables={role: "u", **NONE})


def test_a_local_variable_may_have_a_role(tmp_path):
    variables = (*CELL[:5], Var("inner", "local", "1"), CELL[5])
    step = CELL_STEP.replace("all[6]", "all[7]").replace("return 0;", "inner = 0.25; return 0;")
    fmu = build(tmp_path / "c.fmu", variables, step, CELL_START)
    with open_plant(fmu, variables={"soc": "inner"}) as plant:
        assert plant.step(1.0, SECOND).soc == 0.25


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (('unit="V"', 'unit="furlong"'), 'The unit "furlong" of variable "voltage_V"'),
        (('guid="{token}"', ""), "validate = false"),
        (("<ModelVariables>", '<DefaultExperiment stepSize="often"/><ModelVariables>'), "often"),
    ],
)
def test_an_invalid_description_is_refused_until_told_not_to_look(tmp_path, change, expected):
    fmu = build(tmp_path / "c.fmu", replace=change)
    with pytest.raises(ConfigError, match=r"plant\.validate is True; expected .* or validate = false") as caught:
        open_plant(fmu)
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_breaks_the_standard_runs_where_it_is_told_to(tmp_path):
    fmu = build(tmp_path / "c.fmu", replace=('start="0"', ""))
    with pytest.raises(ConfigError, match="has no start value"):
        open_plant(fmu)
    with open_plant(fmu, validate=False) as plant:
        assert plant.step(1.0, SECOND).voltage_V == pytest.approx(3.4, abs=1e-3)


def test_numbers_of_the_description_that_are_none_are_as_if_not_there(tmp_path):
    experiment = '<DefaultExperiment startTime="now" stepSize="often" tolerance="none"/><ModelVariables>'
    fmu = build(tmp_path / "c.fmu", replace=("<ModelVariables>", experiment))
    with open_plant(fmu, validate=False) as plant:
        assert plant.step(0.0, SECOND).voltage_V == 3.5


def test_a_guid_the_library_does_not_have_is_one_line(tmp_path):
    fmu = build(tmp_path / "c.fmu", replace=("{token}", "{other}"))
    with pytest.raises(ConfigError, match=r"can be loaded here \(fmi2Instantiate returned no instance"):
        open_plant(fmu)


def test_a_library_whose_own_libraries_are_missing_is_one_line_that_names_them(tmp_path):
    fmu = build(tmp_path / "c.fmu", link=["-Wl,--no-as-needed", f"-L{tmp_path}", lost(tmp_path)])
    with pytest.raises(ConfigError, match=r"can be loaded here \(liblost\.so: cannot open shared object file"):
        open_plant(fmu)


def test_a_library_finds_others_beside_it(tmp_path):
    fmu = build(tmp_path / "c.fmu", link=["-Wl,--no-as-needed", f"-L{tmp_path}", lost(tmp_path)])
    with zipfile.ZipFile(fmu, "a") as archive:
        archive.write(tmp_path / "liblost.so", f"binaries/{PLATFORM[2]}/liblost.so")
    with open_plant(fmu) as plant:
        assert plant.step(0.0, SECOND).voltage_V == 3.5


def lost(folder):
    """A library to link with; as a linker option."""
    (folder / "lost.c").write_text("int lost(void) { return 0; }")
    subprocess.run(["cc", "-shared", "-o", folder / "liblost.so", folder / "lost.c"], check=True)
    return "-llost"


def test_a_function_that_is_never_called_may_be_missing(tmp_path):
    missing = "int missing(void); "
    fmu = build(tmp_path / "c.fmu", step="if (current_A > 5) return missing();" + CELL_STEP, declare=missing)
    with open_plant(fmu) as plant:
        assert plant.step(0.0, SECOND).voltage_V == 3.5
        with pytest.raises(PlantError, match=r"exit code 127 .*undefined symbol: missing"):
            plant.step(6.0, SECOND)


def test_a_library_without_the_standards_functions_is_one_line_that_names_one(tmp_path):
    fmu = build(tmp_path / "c.fmu")
    with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(tmp_path / "bare.fmu", "w") as new:
        (tmp_path / "bare.c").write_text("int nothing(void) { return 0; }")
        subprocess.run(["cc", "-shared", "-o", tmp_path / "bare.so", tmp_path / "bare.c"], check=True)
        new.writestr("modelDescription.xml", old.read("modelDescription.xml"))
        new.write(tmp_path / "bare.so", f"binaries/{PLATFORM[2]}/tiny.so")
    with pytest.raises(ConfigError, match="its library has no function fmi2DoStep"):
        open_plant(tmp_path / "bare.fmu")


def test_a_zip_made_on_windows_with_backslashes_is_an_fmu(tmp_path):
    fmu = build(tmp_path / "c.fmu")
    with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(tmp_path / "w.fmu", "w") as new:
        for name in old.namelist():
            new.writestr(name.replace("/", "\\"), old.read(name))
    with open_plant(tmp_path / "w.fmu") as plant:
        assert plant.step(0.0, SECOND).voltage_V == 3.5


def test_a_library_of_another_name_is_one_line_with_both(tmp_path):
    fmu = build(tmp_path / "c.fmu", replace=('modelIdentifier="tiny"', 'modelIdentifier="large"'))
    with pytest.raises(ConfigError, match=r"binaries is '\w+/tiny\.so'; expected \w+/large\.so"):
        open_plant(fmu)
