"""The estimator as an FMU: the Python one to rounding, in FMI 2.0 and 3.0, here and on aarch64, and no Python in it.

What runs on aarch64, under QEMU, is `pil/fmu.c`. Without the tools for that it is not run and the test says so, which
is an error only if REQUIRE_PIL=1, as in CI.
"""

from __future__ import annotations

import math
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from drives import drive
from fmpy import fmi2, fmi3
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu
from numpy.typing import NDArray

from bms_ukf import CellParams, Estimator, Fault, Sample, Status
from bms_ukf.estimator_fmu.package import machines_here, write
from bms_ukf.fmumaker.build import HERE, build

PIL = Path(__file__).parent / "pil" / "fmu.c"
PLANT = Path(__file__).resolve().parents[1] / "models" / "plants" / "lgm50_spme.fmu"
AARCH64 = "aarch64-linux"
TOOLS = ["aarch64-linux-gnu-gcc", "qemu-aarch64"]
PACKAGES = "gcc-aarch64-linux-gnu libc6-dev-arm64-cross qemu-user"
INPUTS, REALS, INTEGERS = [0, 1, 2], [3, 4, 5, 6, 7, 8], [9, 10]
TIME = 11  # FMI 3.0
STEP_S = 0.5
ROUNDING = 1e-12


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, cell: CellParams) -> Path:
    if not shutil.which(os.environ.get("CC", "cc")):
        pytest.skip("NO FMU BUILT: no C compiler; get it with: apt install gcc libc6-dev")
    folder = tmp_path_factory.mktemp("estimator")
    write(cell, folder, machines_here())
    return folder


@pytest.fixture(scope="module", params=[2, 3], ids=["fmi2", "fmi3"])
def fmu(request: pytest.FixtureRequest, folder: Path) -> Path:
    path = folder / f"fmi{request.param}.fmu"
    build(folder, path, request.param, machines_here())
    return path


@pytest.fixture(scope="module")
def unpacked(fmu: Path) -> Path:
    fmpy.extract(fmu, fmu.with_suffix(""))
    return fmu.with_suffix("")


@contextmanager
def instance(unpacked: Path) -> Iterator[Any]:
    """An initialised instance of an FMU of either version; `outputs` and `step` hide which."""
    description = fmpy.read_model_description(unpacked)
    is_fmi2 = description.fmiVersion == "2.0"
    slave = (fmi2.FMU2Slave if is_fmi2 else fmi3.FMU3Slave)(
        guid=description.guid, unzipDirectory=unpacked, modelIdentifier=description.coSimulation.modelIdentifier
    )
    slave.instantiate()
    if is_fmi2:
        slave.setupExperiment()
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    try:
        yield slave
    finally:
        slave.freeInstance()


def outputs(slave: Any) -> list[float]:
    """soc, soc_sigma, innovation_V, voltage_pred_V, soc_low, soc_high, status, faults."""
    if isinstance(slave, fmi2.FMU2Slave):
        return [*slave.getReal(REALS), *slave.getInteger(INTEGERS)]
    return [*slave.getFloat64(REALS), *slave.getInt32(INTEGERS)]


def step(slave: Any, k: int, measured: NDArray[np.float64], step_s: float = STEP_S) -> list[float]:
    (slave.setReal if isinstance(slave, fmi2.FMU2Slave) else slave.setFloat64)(INPUTS, measured.tolist())
    slave.doStep(k * step_s, step_s)
    return outputs(slave)


@pytest.fixture(scope="module")
def measured() -> NDArray[np.float64]:
    """Current, voltage and temperature of a drive whose sensors fail; shape (600, 3)."""
    rng = np.random.default_rng(9)
    rows = np.array([row[1:] for row in drive(600, varying_dt=False, seed=9)])
    rows[rng.random(rows.shape) < 0.05] = math.nan
    rows[200:230, 0] = math.nan
    rows[300:330, 1] = math.nan
    rows[400, 1] += 2.0
    return rows


@pytest.fixture(scope="module")
def expected(cell: CellParams, measured: NDArray[np.float64]) -> NDArray[np.float64]:
    """The Python estimator's outputs; shape (600, 8)."""
    estimator, rows = Estimator(cell), []
    for k, (current, voltage, temperature) in enumerate(measured, start=1):
        e = estimator.step(Sample(round(k * STEP_S * 1e9), current, voltage, temperature))
        rows.append([e.soc, e.soc_sigma, e.innovation_V, e.voltage_pred_V, e.soc_low, e.soc_high, e.status, e.faults])
    return np.array(rows, float)


def assert_same(found: NDArray[np.float64], expected: NDArray[np.float64]) -> None:
    np.testing.assert_array_equal(found[:, 6:], expected[:, 6:])
    np.testing.assert_allclose(found[:, :6], expected[:, :6], rtol=0, atol=ROUNDING)


def test_fmpy_finds_nothing_wrong(fmu):
    assert validate_fmu(str(fmu)) == []


def test_the_fmu_is_the_python_estimator_to_rounding_through_gaps_and_faults(unpacked, measured, expected):
    with instance(unpacked) as slave:
        found = np.array([step(slave, k, row) for k, row in enumerate(measured)])
    assert_same(found, expected)
    seen = Fault(int(np.bitwise_or.reduce(expected[:, 7].astype(int))))
    assert seen & Fault.CURRENT_MISSING
    assert seen & Fault.VOLTAGE_MISSING
    assert seen & Fault.VOLTAGE_IMPLAUSIBLE
    assert {*expected[:, 6]} >= {Status.OK, Status.DEGRADED}
    assert np.isfinite(expected[:, 0]).mean() > 0.9


def test_a_state_taken_and_set_and_one_that_was_bytes_go_on_where_they_were(unpacked, measured, expected):
    with instance(unpacked) as slave, instance(unpacked) as other:
        for k in range(250):
            step(slave, k, measured[k])
        state = slave.getFMUState()
        restored = other.deserializeFMUState(slave.serializeFMUState(state))
        ahead = np.array([step(slave, k, measured[k]) for k in range(250, 350)])
        slave.setFMUState(state)
        again = np.array([step(slave, k, measured[k]) for k in range(250, 350)])
        other.setFMUState(restored)
        elsewhere = np.array([step(other, k, measured[k]) for k in range(250, 350)])
        slave.freeFMUState(state)
        other.freeFMUState(restored)
    np.testing.assert_array_equal(again, ahead)
    np.testing.assert_array_equal(elsewhere, ahead)
    assert_same(ahead, expected[250:350])


def test_what_nobody_connects_is_a_fault_and_no_soc(unpacked):
    with instance(unpacked) as slave:
        assert np.isnan(outputs(slave)[:6]).all()
        for k in range(20):
            slave.doStep(float(k), 1.0)
        soc, *_, status, faults = outputs(slave)
    assert math.isnan(soc)
    assert status == Status.INITIALISING
    assert Fault.VOLTAGE_IMPLAUSIBLE | Fault.TEMPERATURE_IMPLAUSIBLE in Fault(faults)


def test_a_step_too_long_for_the_clock_is_discarded(unpacked, measured):
    with instance(unpacked) as slave:
        before = step(slave, 0, measured[0], 1.0)
        with pytest.raises(FMICallException) as caught:
            slave.doStep(1.0, 2.0**31 / 1000)
        assert caught.value.status == fmi2.fmi2Discard
        np.testing.assert_array_equal(outputs(slave), before)


def test_an_output_of_another_type_is_an_error(unpacked):
    with instance(unpacked) as slave:
        is_fmi2 = isinstance(slave, fmi2.FMU2Slave)
        real, integer = (slave.getReal, slave.getInteger) if is_fmi2 else (slave.getFloat64, slave.getInt32)
        for get, references in ((real, INTEGERS), (integer, REALS), (integer, [TIME])):
            with pytest.raises(FMICallException):
                get(references)


def test_fmi_2_and_3_give_the_same_bits(folder, measured):
    found = []
    for fmi in (2, 3):
        build(folder, folder / "one.fmu", fmi)
        place = folder / f"one{fmi}"
        fmpy.extract(folder / "one.fmu", place)
        with instance(place) as slave:
            found.append([step(slave, k, row) for k, row in enumerate(measured[:100])])
    np.testing.assert_array_equal(found[0], found[1])


def test_the_estimator_fmu_finds_the_soc_of_the_plant_fmu_it_is_coupled_to(unpacked, tmp_path):
    """The plant steps first, and hands its voltage and temperature on: they and the current are of one instant."""
    fmpy.extract(PLANT, tmp_path)
    current_A = np.repeat([0.0, 5.0, -2.0, 2.5, 0.0], 240)
    with instance(tmp_path) as plant, instance(unpacked) as estimator:
        plant_soc = soc = sigma = math.nan
        for k, current in enumerate(current_A):
            plant.setReal([0], [current])
            plant.doStep(float(k), 1.0)
            voltage, temperature, plant_soc = plant.getReal([2, 3, 4])
            soc, sigma, *_, status, _ = step(estimator, k, np.array([current, voltage, temperature]), 1.0)
    assert status == Status.OK
    assert abs(plant_soc - 0.5) > 0.02
    assert abs(soc - plant_soc) < min(0.02, 3 * sigma)


def test_the_libraries_need_libc_and_libm_and_show_the_standards_functions_only(unpacked):
    machine = "linux64" if HERE == "x86_64-linux" and unpacked.name == "fmi2" else HERE
    library = unpacked / "binaries" / machine / "bms_ukf.so"
    listed = subprocess.run(["ldd", library], capture_output=True, text=True, check=True).stdout
    needed = {line.split()[0].split("/")[-1].split(".")[0] for line in listed.splitlines()}
    assert needed <= {"linux-vdso", "libc", "libm", "ld-linux-x86-64", "ld-linux-aarch64"}
    if not shutil.which("nm"):
        pytest.skip("no nm: the exported symbols are not checked")
    for library in unpacked.glob("binaries/*/*.so"):
        shown = subprocess.run(["nm", "-D", "--defined-only", library], capture_output=True, text=True, check=True)
        names = {line.split()[-1] for line in shown.stdout.splitlines()}
        assert f"{unpacked.name}DoStep" in names
        assert all(name.startswith(unpacked.name) for name in names)


def test_the_fmu_carries_its_page_and_no_sources_of_which_it_could_not_be_built(unpacked):
    assert "first" in (unpacked / "documentation" / "README.md").read_text()
    assert not (unpacked / "sources").exists()


def test_on_aarch64_it_is_the_same(folder, tmp_path, measured, expected):
    missing = [tool for tool in TOOLS if shutil.which(tool) is None]
    if missing:
        text = f"FMU NOT RUN ON AARCH64: no {', '.join(missing)}; get it with: apt install {PACKAGES}"
        if os.environ.get("REQUIRE_PIL") == "1":
            pytest.fail(text)
        pytest.skip(text)
    build(folder, tmp_path / "soc.fmu", 2, [HERE, AARCH64] if HERE != AARCH64 else [HERE])
    fmpy.extract(tmp_path / "soc.fmu", tmp_path)
    headers = Path(fmpy.__file__).parent / "c-code"
    flags = ["-std=gnu11", "-O1", "-Wall", "-Wextra", "-Werror", f"-I{headers}"]
    subprocess.run([TOOLS[0], *flags, PIL, "-o", tmp_path / "fmu", "-ldl"], check=True)
    library = tmp_path / "binaries" / AARCH64 / "bms_ukf.so"
    guid = fmpy.read_model_description(tmp_path).guid
    command = [TOOLS[1], "-L", "/usr/aarch64-linux-gnu", tmp_path / "fmu", library, guid, str(STEP_S)]
    ran = subprocess.run(command, input=measured.tobytes(), capture_output=True, timeout=120, check=False)
    assert ran.returncode == 0, ran.stderr
    found = np.frombuffer(ran.stdout).reshape(len(measured), -1)
    assert_same(found, expected)
    with instance(tmp_path) as slave:  # without fused operations: the same bits
        here = np.array([step(slave, k, row) for k, row in enumerate(measured)])
    np.testing.assert_array_equal(found, here)


def test_several_cells_are_arrays_of_estimators_of_one_cell_each(cell, unpacked, measured, tmp_path):
    write(cell, tmp_path, [HERE], cells=3)
    fmi = int(unpacked.name[-1])
    build(tmp_path, tmp_path / "three.fmu", fmi)
    assert validate_fmu(str(tmp_path / "three.fmu")) == []
    fmpy.extract(tmp_path / "three.fmu", tmp_path / "three")
    variables = {v.name: v.valueReference for v in fmpy.read_model_description(tmp_path / "three").modelVariables}
    offsets_V = [0.0, -0.02, 0.01]
    with instance(tmp_path / "three") as three, ExitStack() as stack:
        alone = [stack.enter_context(instance(unpacked)) for _ in offsets_V]
        for k, (current, voltage, temperature) in enumerate(measured[:150]):
            values = [current, *(voltage + offset for offset in offsets_V), *[temperature] * 3]
            if fmi == 2:
                three.setReal([*range(7)], values)
            else:
                three.setFloat64([variables[name] for name in ("current_A", "voltage_V", "temperature_degC")], values)
            three.doStep(k * STEP_S, STEP_S)
            ones = [
                step(one, k, np.array([current, voltage + offset, temperature]))
                for one, offset in zip(alone, offsets_V, strict=True)
            ]
        if fmi == 2:
            found = three.getReal([variables[f"soc[{k}]"] for k in (1, 2, 3)])
        else:
            found = three.getFloat64([variables["soc"]], 3)
    assert found == [one[0] for one in ones]
    assert len({*found}) == 3


def test_a_missing_compiler_costs_one_line_and_no_half_minute(bms_ukf, tmp_path, monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler")
    line = bms_ukf("export", "fmu", "lgm50_chen2020", "--out", tmp_path / "soc.fmu").line
    assert "no-such-compiler: expected a C compiler; install one" in line


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["no_such_cell"], ["no_such_cell", "lgm50_chen2020"]),
        (["lgm50_chen2020", "--fmi", "1"], ["--fmi", "1"]),
        (["lgm50_chen2020", "--cells", "0"], ["--cells", "0"]),
    ],
)
def test_a_wrong_argument_costs_one_line(bms_ukf, tmp_path, arguments, named):
    line = bms_ukf("export", "fmu", *arguments, "--out", tmp_path / "soc.fmu").line
    assert all(word in line for word in named), line


def test_the_command_says_for_which_machines_it_made_the_fmu(bms_ukf, tmp_path, folder, monkeypatch):
    monkeypatch.setattr(
        "bms_ukf.estimator_fmu.package.write",
        lambda _cell, to, *_: shutil.copytree(folder, to, dirs_exist_ok=True),
    )
    ended = bms_ukf("export", "fmu", "lgm50_chen2020", "--fmi", "3", "--out", tmp_path / "soc.fmu")
    assert ended.code == 0
    assert validate_fmu(str(tmp_path / "soc.fmu")) == []
    for machine in machines_here():
        assert f" {machine}" in ended.out
