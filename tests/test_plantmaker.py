"""Plants made of PyBaMM's models: FMI 2.0 and 3.0 alike, cells in series that differ, and PyBaMM's own solution."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy import fmi3
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu

pytest.importorskip("pybamm", reason="no PyBaMM: no plant is made of its models")

from pybamm_solution import solution_of

from bms_ukf.plantmaker import folder, models
from bms_ukf.plantmaker.__main__ import main

pytestmark = [
    pytest.mark.filterwarnings("ignore"),  # PyBaMM's own
    pytest.mark.skipif(not shutil.which(os.environ.get("CC", "cc")), reason="no C compiler: no plant is made"),
]

SPREAD = ["--series", "3", "--spread-capacity", "0.05", "--spread-resistance", "0.2", "--spread-soc", "0.02"]
MADE = {
    "nmc": ["--parameters", "Chen2020", "--model", "SPM"],
    "nmc3": ["--parameters", "Chen2020", "--model", "SPM", "--fmi", "3"],
    "lfp": ["--parameters", "Prada2013", "--thermal", "isothermal"],
    "branches": ["--parameters", "Prada2013", "--model", "SPM", "--thermal", "isothermal", "--hysteresis", "0.02"],
    "table": ["--parameters", "OKane2022", "--model", "SPM"],  # an electrode as a table: another form of C
    "block": ["--parameters", "Chen2020", "--model", "SPM", "--parallel", "3"],
    "ecm": ["--model", "Thevenin", "--parameters", "ECM_Example", "--fmi", "3"],
    "string": [*SPREAD, "--model", "SPM", "--seed", "4"],
    "string3": [*SPREAD, "--model", "SPM", "--seed", "4", "--fmi", "3"],
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The FMU of that name in `MADE`, made once."""
    place = tmp_path_factory.mktemp("made")

    def make(name: str) -> Path:
        fmu = place / f"{name}.fmu"
        if not fmu.exists():
            assert main([str(fmu), *MADE[name]]) == 0
        return fmu

    return make


def currents(scale_A: float, n: int = 300) -> np.ndarray:
    return (np.random.default_rng(3).normal(0.24, 0.6, n).clip(-1.4, 2.4)) * scale_A


def drive(fmu: Path, currents_A: np.ndarray, **start: object) -> tuple[np.ndarray, float]:
    """voltage, temperature and SoC after each second, (n, 3, cells); and the wall time of a step."""
    n = currents_A.size
    signal = np.zeros(n + 1, dtype=[("time", float), ("current_A", float)])
    signal["time"], signal["current_A"][:-1] = np.arange(n + 1), currents_A
    kept = fmpy.read_model_description(fmu)
    outputs = [v.name for v in kept.modelVariables if v.causality == "output"]
    started = time.perf_counter()
    result = fmpy.simulate_fmu(
        fmu, stop_time=n, step_size=1.0, output_interval=1.0, input=signal, start_values=start, output=outputs
    )
    wall_s = (time.perf_counter() - started) / n
    columns = [np.asarray(result[name][1:]).reshape(n, -1) for name in outputs]
    return np.concatenate(columns, axis=1).reshape(n, 3, -1), wall_s


@pytest.mark.parametrize("name", MADE)
def test_what_is_made_is_valid_and_needs_no_python(made, name, tmp_path) -> None:
    fmu = made(name)
    assert validate_fmu(str(fmu)) == []
    fmpy.extract(fmu, tmp_path)
    (library,) = tmp_path.glob("binaries/*/*.so")
    listed = subprocess.run(["ldd", library], capture_output=True, text=True, check=True).stdout
    needed = {line.split()[0].split("/")[-1].split(".")[0] for line in listed.splitlines()}
    assert needed <= {"linux-vdso", "libc", "libm", "ld-linux-x86-64", "ld-linux-aarch64"}


@pytest.mark.parametrize(("two", "three"), [("nmc", "nmc3"), ("string", "string3")])
def test_both_versions_of_fmi_give_the_same_numbers(made, two, three) -> None:
    expected, _ = drive(made(two), currents(5.0), soc_initial=0.6)
    trace, _ = drive(made(three), currents(5.0), soc_initial=0.6)
    np.testing.assert_array_equal(trace, expected)


@pytest.mark.parametrize(
    ("name", "model", "parameters", "thermal", "scale_A"),
    [
        ("nmc", "SPM", "Chen2020", "lumped", 5.0),
        ("lfp", "SPMe", "Prada2013", "isothermal", 2.3),
        ("ecm", "Thevenin", "ECM_Example", "lumped", 100.0),
    ],
)
def test_voltage_is_that_of_pybamm(made, name, model, parameters, thermal, scale_A) -> None:
    currents_A = currents(scale_A)
    expected = solution_of(model, parameters, thermal)(currents_A, 1.0, 0.6, 25.0)
    trace, wall_s = drive(made(name), currents_A, soc_initial=0.6)
    largest_mV = 1000 * np.abs(trace[:, 0, 0] - expected[:, 0]).max()
    print(f"{model}, {parameters}: within {largest_mV:.4f} mV of PyBaMM's own solution, {1000 * wall_s:.2f} ms a step")
    assert largest_mV < 0.2
    assert np.abs(trace[:, 1, 0] - expected[:, 1]).max() < 0.01


@pytest.mark.parametrize(("name", "capacity_Ah", "scale_A"), [("lfp", 2.3035, 2.3), ("ecm", 100.0, 100.0)])
def test_soc_is_the_charge_above_empty_over_the_capacity(made, name, capacity_Ah, scale_A) -> None:
    trace, _ = drive(made(name), currents(scale_A), soc_initial=0.6)
    expected = 0.6 - np.cumsum(currents(scale_A)) / 3600 / capacity_Ah
    np.testing.assert_allclose(trace[:, 2, 0], expected, atol=2e-5)


def starts(fmu: Path, name: str) -> np.ndarray:
    found = [v for v in fmpy.read_model_description(fmu).modelVariables if v.name.split("[")[0] == name]
    return np.array([float(text) for v in found for text in str(v.start).split()])


def test_cells_of_a_string_differ_as_drawn(made) -> None:
    fmu = made("string3")
    capacity, offset, ohm = (starts(fmu, name) for name in ("capacity_factor", "soc_offset", "resistance_ohm"))
    assert capacity.size == offset.size == ohm.size == 3
    assert len(set(capacity)) == len(set(offset)) == len(set(ohm)) == 3
    trace, _ = drive(fmu, np.full(300, 5.0), soc_initial=0.6)
    np.testing.assert_allclose(trace[-1, 2], 0.6 + offset - 5.0 * 300 / 3600 / (5.1532 * capacity), atol=2e-5)
    # In the last instant of a current the resistance in series falls away, and nothing else of the same size.
    pulse, _ = drive(fmu, np.array([5.0, 5.0]), soc_initial=0.6, resistance_ohm=[0.0, 0.0, 0.0])
    with_ohm, _ = drive(fmu, np.array([5.0, 5.0]), soc_initial=0.6)
    np.testing.assert_allclose(pulse[:, 0] - with_ohm[:, 0], np.tile(5.0 * ohm, (2, 1)), atol=1e-12)


def test_equal_cells_are_the_single_cell(made) -> None:
    single, _ = drive(made("nmc"), currents(5.0, 60), soc_initial=0.6)
    equal = {"capacity_factor": [1.0] * 3, "resistance_ohm": [0.0] * 3, "soc_offset": [0.0] * 3}
    trace, _ = drive(made("string3"), currents(5.0, 60), soc_initial=0.6, **equal)
    np.testing.assert_array_equal(trace, np.repeat(single, 3, axis=2))


def test_a_cell_of_three_in_parallel_takes_three_times_the_current(made) -> None:
    single, _ = drive(made("nmc"), currents(5.0, 60), soc_initial=0.6)
    block, _ = drive(made("block"), currents(15.0, 60), soc_initial=0.6)
    np.testing.assert_allclose(block, single, rtol=1e-9)


def test_the_branches_lie_apart_by_twice_the_hysteresis_and_a_short_reversal_goes_part_of_the_way(made) -> None:
    """The same SoC, 0.6, is reached by charging, by discharging, and by charging with a reversal of 2 % of charge."""
    half_Ah, rest = 2.3035 / 2, np.zeros(3600)
    up, down, short = (np.full(900, share * half_Ah * 4) for share in (-0.6, 0.6, 0.04))
    rests_V = []
    for load, start in ((up, 0.3), (down, 0.9), (np.concatenate([up, -short, short]), 0.3)):
        trace, _ = drive(made("branches"), np.concatenate([load, rest]), soc_initial=start)
        assert trace[-1, 2, 0] == pytest.approx(0.6, abs=2e-4)
        rests_V.append(trace[-1, 0, 0])
    charged_V, discharged_V, turned_V = rests_V
    assert charged_V - discharged_V == pytest.approx(0.04, abs=1e-3)
    assert 0.2 < (charged_V - turned_V) / 0.04 < 0.8


def test_the_seed_decides_the_spread_and_a_spread_does_not_change_another() -> None:
    spread = folder.Spread(capacity=0.01, seed=1)
    assert spread.draw("capacity", 0.01, 5) == folder.Spread(soc=0.3, seed=1).draw("capacity", 0.01, 5)
    assert spread.draw("capacity", 0.01, 5) != folder.Spread(seed=2).draw("capacity", 0.01, 5)
    drawn = np.array(spread.draw("capacity", 0.01, 20_000))
    assert drawn.std() == pytest.approx(0.01, rel=0.03)
    assert np.abs(drawn).max() <= 0.03


# --- FMI 3.0 behaviour; that of FMI 2.0, from the same source, is held in test_plant_fmu.py


@pytest.fixture
def instance(made, tmp_path):
    fmpy.extract(made("string3"), tmp_path)
    description = fmpy.read_model_description(tmp_path)
    slave = fmi3.FMU3Slave(
        guid=description.guid, unzipDirectory=tmp_path, modelIdentifier=description.coSimulation.modelIdentifier
    )
    slave.instantiate()
    slave.references = {v.name: v.valueReference for v in description.modelVariables}
    yield slave
    slave.freeInstance()


def voltages(slave: fmi3.FMU3Slave) -> list[float]:
    return slave.getFloat64([slave.references["voltage_V"]], nValues=3)


def started(slave: fmi3.FMU3Slave) -> fmi3.FMU3Slave:
    slave.enterInitializationMode(startTime=0.0)
    slave.setFloat64([slave.references["current_A"]], [5.0])
    slave.exitInitializationMode()
    return slave


def refused(call, *arguments, **named) -> int:
    with pytest.raises(FMICallException) as caught:
        call(*arguments, **named)
    return caught.value.status


def test_a_step_tells_that_it_is_whole_and_time_is_a_variable(instance) -> None:
    slave = started(instance)
    for k in range(3):
        assert slave.doStep(float(k), 1.0)[-4:] == (False, False, False, k + 1.0)
    assert slave.getFloat64([slave.references["time"]]) == [3.0]


def test_a_state_serialised_resumes_to_the_bit(instance) -> None:
    slave = started(instance)
    slave.doStep(0.0, 10.0)
    state = slave.getFMUState()
    data = slave.serializeFMUState(state)
    slave.doStep(10.0, 10.0)
    expected = voltages(slave)
    slave.freeFMUState(state)
    slave.reset()
    restored = slave.deserializeFMUState(data)
    slave.setFMUState(restored)
    slave.freeFMUState(restored)
    slave.doStep(10.0, 10.0)
    assert voltages(slave) == expected


def test_wrong_calls_are_refused_and_change_nothing(instance) -> None:
    slave = started(instance)
    before = voltages(slave)
    error, discard = fmi3.fmi3Error, fmi3.fmi3Discard
    voltage = slave.references["voltage_V"]
    assert refused(slave.getFloat64, [voltage], nValues=2) == error
    assert refused(slave.getFloat64, [voltage + 1], nValues=1) == error  # within the array
    assert refused(slave.setFloat64, [voltage], before) == error
    assert refused(slave.setFloat64, [slave.references["time"]], [1.0]) == error
    assert refused(slave.setFloat64, [slave.references["current_A"]], [1e4]) == discard
    assert refused(slave.setFloat64, [slave.references["soc_offset"]], [0.0] * 3) == error
    assert refused(slave.doStep, 5.0, 1.0) == error
    assert refused(slave.doStep, 0.0, 36000.0) == discard  # beyond empty
    assert refused(slave.getInt32, [voltage]) == error
    assert refused(slave.enterEventMode) == error
    assert voltages(slave) == before


# --- what cannot be made


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--parameters", "Chen2021"], "a parameter set of PyBaMM, such as Chen2020"),
        (["--model", "DFM"], "one of SPM, SPMe, Thevenin"),
        (["--parameters", "Prada2013"], "it has what --thermal isothermal needs"),
        (["--model", "Thevenin"], "one with 'Cell capacity [A.h]', which the lumped Thevenin needs"),
        (["--model", "Thevenin", "--thermal", "isothermal"], "lumped"),
        (["--soc-initial", "2"], "--soc-initial is 2.0; expected 0 to 1"),
    ],
)
def test_what_cannot_be_made_is_told_in_one_line(tmp_path, capsys, arguments, told) -> None:
    assert main([str(tmp_path / "x.fmu"), *arguments]) == 2
    said = capsys.readouterr().err
    assert told in said
    assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_missing_compiler_is_told_in_one_line(tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    assert main([str(tmp_path / "x.fmu"), "--model", "Thevenin", "--parameters", "ECM_Example"]) == 2
    assert capsys.readouterr().err.startswith("no-such-compiler: expected a C compiler; install one")


def test_a_missing_pybamm_is_told_in_one_line(tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "pybamm", None)
    assert main([str(tmp_path / "x.fmu")]) == 2
    said = capsys.readouterr().err
    assert said == "plantmaker: expected PyBaMM, which is not there: pip install 'bms-ukf[plant]'\n"


def test_every_model_named_in_the_help_is_one() -> None:
    assert set(models.MODELS) == {"SPM", "SPMe", "Thevenin"}
