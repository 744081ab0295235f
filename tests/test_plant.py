"""`Plant`: what it makes of FMUs and names that are wrong, and how it counts time."""

from __future__ import annotations

import platform
import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy
import pytest

import bms_ukf
from bms_ukf import resources
from bms_ukf.errors import ConfigError, PlantError
from bms_ukf.plant import open_plant

ROOT = Path(bms_ukf.__file__).parents[1]
FMU = resources.find("lgm50_spme", "plants", ".fmu")
SECOND = 1_000_000_000

VARIABLE = (
    '<ScalarVariable name="{}" valueReference="{}" causality="{}" variability="continuous">'
    '<Real unit="{}" start="0"/></ScalarVariable>'
)
BARE = {"temperature_degC": "", "soc": ""}
PLAIN = [("current_A", "input", "A"), ("ambient_degC", "input", "degC"), ("voltage_V", "output", "V")]


def description(version="2.0", kind="CoSimulation", variables=PLAIN, more=""):
    listed = "".join(VARIABLE.format(name, k, causality, unit) for k, (name, causality, unit) in enumerate(variables))
    return (
        f'<fmiModelDescription fmiVersion="{version}" modelName="fake" guid="{{0}}" {more}>'
        f'<{kind} modelIdentifier="fake"/>'
        f"<ModelVariables>{listed}</ModelVariables><ModelStructure/></fmiModelDescription>"
    )


@pytest.fixture
def make_fmu(tmp_path):
    def make(files):
        path = tmp_path / "fake.fmu"
        with zipfile.ZipFile(path, "w") as archive:
            for name, text in files.items():
                archive.writestr(name, text)
        return path

    return make


def refusal(*args, **kwargs):
    """The one line with which a plant is refused."""
    with pytest.raises(ConfigError) as caught:
        open_plant(*args, **kwargs).close()
    line = str(caught.value)
    assert "\n" not in line
    assert str(args[0]) in line
    return line


def test_a_file_that_is_not_there_is_refused(tmp_path):
    assert "one of the shipped plants: lgm50_spme" in refusal(tmp_path / "nothing.fmu")


def test_a_file_that_is_not_a_zip_is_refused(tmp_path):
    path = tmp_path / "text.fmu"
    path.write_text("not an FMU")
    assert "zip archive" in refusal(path)


def test_a_truncated_fmu_is_refused(tmp_path):
    path = tmp_path / "half.fmu"
    path.write_bytes(FMU.read_bytes()[:20000])
    assert "zip archive" in refusal(path)


def test_an_fmu_with_a_damaged_library_is_refused(tmp_path):
    path = tmp_path / "damaged.fmu"
    data = bytearray(FMU.read_bytes())
    data[2000:2100] = bytes(100)
    path.write_bytes(data)
    assert "can be unpacked" in refusal(path)


def test_a_zip_without_a_model_description_is_refused(make_fmu):
    assert "modelDescription.xml" in refusal(make_fmu({"readme.txt": "hello"}))


def test_a_model_description_that_is_not_xml_is_refused(make_fmu):
    assert "modelDescription.xml can be read" in refusal(make_fmu({"modelDescription.xml": "<fmiModelDescription"}))


def test_an_fmu_for_model_exchange_only_is_refused(make_fmu):
    line = refusal(make_fmu({"modelDescription.xml": description(kind="ModelExchange")}))
    assert "model exchange only" in line
    assert "FMI 2.0 or 3.0 co-simulation" in line


def test_another_fmi_version_is_refused_with_its_number(make_fmu):
    line = refusal(
        make_fmu(
            {
                "modelDescription.xml": description(
                    version="1.0", more='modelIdentifier="fake" numberOfContinuousStates="0"'
                )
            }
        )
    )
    assert "FMI 2.0" in line


def test_an_fmu_for_other_platforms_is_refused_naming_them_and_ours(make_fmu):
    files = {"modelDescription.xml": description(), "binaries/win64/fake.dll": "", "binaries/darwin64/fake.dylib": ""}
    line = refusal(make_fmu(files), variables=BARE, validate=False)
    assert "darwin64, win64" in line
    assert "linux64" in line


def test_a_library_that_does_not_load_is_refused(make_fmu):
    files = {"modelDescription.xml": description(), "binaries/linux64/fake.so": "not a library"}
    assert "can be loaded here" in refusal(make_fmu(files), variables=BARE, validate=False)


def elf(machine: int) -> bytes:
    """The start of a library of 64 bits for a machine, by its number in elf(5)."""
    return b"\x7fELF\x02\x01".ljust(18, b"\0") + machine.to_bytes(2, "little")


def test_a_library_for_another_processor_is_refused_though_its_folder_has_the_name_of_this_platform(make_fmu):
    x86_64, aarch64 = 62, 183
    other = x86_64 if platform.machine() == "aarch64" else aarch64
    files = {"modelDescription.xml": description(), "binaries/linux64/fake.so": elf(other)}
    line = refusal(make_fmu(files), variables=BARE, validate=False)
    assert "linux64/fake.so" in line
    assert f"expected one for this machine's processor, {fmpy.platform_tuple}" in line


def test_the_folder_with_the_processors_own_name_is_used_where_linux64_is_for_another(make_fmu):
    x86_64, aarch64 = 62, 183
    other = x86_64 if platform.machine() == "aarch64" else aarch64
    own = f"binaries/{fmpy.platform_tuple}/fake.so"
    files = {"modelDescription.xml": description(), "binaries/linux64/fake.so": elf(other), own: "not a library"}
    assert "can be loaded here" in refusal(make_fmu(files), variables=BARE, validate=False)


def test_a_misspelt_variable_is_refused_with_the_nearest_names():
    line = refusal(FMU, variables={"voltage_V": "voltag_V"})
    assert "variables.voltage_V" in line
    assert "'voltag_V'" in line
    assert "such as voltage_V" in line


def test_a_variable_the_fmu_lacks_is_refused_until_the_map_says_so(make_fmu):
    path = make_fmu({"modelDescription.xml": description(), "binaries/linux64/fake.so": "not a library"})
    assert "variables.temperature_degC" in refusal(path, validate=False)
    assert "can be loaded here" in refusal(path, variables=BARE, validate=False)


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({"volts": "voltage_V"}, "a role among current_A"),
        ({"current_A": ""}, "an input for current"),
        ({"current_A": "voltage_V"}, "a variable in A"),
        ({"voltage_V": "temperature_degC"}, "a variable in V"),
    ],
)
def test_a_role_mapped_to_the_wrong_thing_is_refused(variables, expected):
    assert expected in refusal(FMU, variables=variables)


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({"soc_inital": 0.5}, "such as soc_initial"),
        ({"soc_initial": "half"}, "a value of FMI type Real"),
        ({"soc_initial": True}, "a value of FMI type Real"),
        ({"soc_initial": 1.5}, "not within [0, 1]"),
        ({"soc": 0.5}, "a variable that can be set"),
        ({"ambient_degC": 5.0}, "no variable that has a role"),
    ],
)
def test_a_start_value_the_fmu_cannot_take_is_refused(parameters, expected):
    line = refusal(FMU, parameters=parameters)
    assert f"{next(iter(parameters))}" in line
    assert expected in line


def test_an_ambient_temperature_out_of_range_is_refused():
    assert "ambient_degC = 200 is not within" in refusal(FMU, ambient_degC=200.0)


def test_the_state_at_the_start_is_that_of_the_parameters():
    with open_plant(FMU, parameters={"soc_initial": 0.8}, ambient_degC=10.0) as plant:
        assert plant.state.t_ns == 0
        assert plant.state.soc == pytest.approx(0.8)
        assert plant.state.temperature_degC == pytest.approx(10.0)


def test_time_is_counted_exactly_over_steps_no_float_can_hold():
    step_ns = 100_000_000  # 0.1 s
    with open_plant(FMU) as plant:
        for _ in range(2000):
            state = plant.step(1.0, step_ns)
        assert state.t_ns == 2000 * step_ns


def test_current_is_positive_on_discharge():
    with open_plant(FMU) as plant:
        rest = plant.state
        discharged = plant.step(5.0, SECOND)
        assert discharged.voltage_V < rest.voltage_V
        assert discharged.soc < rest.soc


def test_a_new_ambient_temperature_acts_from_the_next_step():
    with open_plant(FMU, ambient_degC=25.0) as plant:
        plant.step(0.0, SECOND)
        plant.set_ambient(0.0)
        assert plant.state.temperature_degC == pytest.approx(25.0)
        assert plant.step(0.0, 600 * SECOND).temperature_degC < 20


def test_a_role_the_map_leaves_out_reads_as_not_measured():
    with open_plant(FMU, variables={"soc": "", "ambient_degC": ""}) as plant:
        plant.set_ambient(40.0)
        state = plant.step(1.0, SECOND)
        assert state.soc != state.soc
        assert state.temperature_degC == pytest.approx(25.0, abs=0.1)


def test_a_step_the_fmu_refuses_names_the_fmu_the_time_and_its_reason():
    with open_plant(FMU, parameters={"soc_initial": 0.1}) as plant:
        with pytest.raises(PlantError) as caught:
            plant.step(5.0, 3600 * SECOND)
        assert plant.step(-5.0, SECOND).t_ns == SECOND
    line = str(caught.value)
    assert str(FMU) in line
    assert "at t = 0 s" in line
    assert "outside the model's range" in line
    assert "\n" not in line


def test_closing_removes_the_unpacked_files_and_may_be_repeated(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    plant = open_plant(FMU)
    assert list(tmp_path.glob("plant-*/binaries"))
    plant.close()
    plant.close()
    assert not list(tmp_path.iterdir())


def test_a_refused_fmu_leaves_no_files_behind(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    refusal(FMU, parameters={"soc_initial": 2.0})
    assert not list(tmp_path.iterdir())


def test_import_bms_ukf_does_not_load_fmpy():
    code = "import sys, bms_ukf; sys.exit('fmpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0
