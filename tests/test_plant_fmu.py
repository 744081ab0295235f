"""The plant FMU itself: FMI 2.0 behaviour, the committed binary against its sources, and the physics against PyBaMM."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import zipfile
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import fmpy
import numpy as np
import pytest
from fmpy import fmi2
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu

from bms_ukf.fmumaker.build import build

ROOT = Path(__file__).resolve().parents[1]
FMU = ROOT / "models" / "plants" / "lgm50_spme.fmu"
MODEL = ROOT / "models" / "lgm50_spme"
CURRENT, AMBIENT, VOLTAGE, TEMPERATURE, SOC, SOC_INITIAL = range(6)
OUTPUTS = [VOLTAGE, TEMPERATURE, SOC]


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fmu")
    fmpy.extract(FMU, folder)
    return folder


@contextmanager
def instance(folder, initialised=True, **start):
    """An instance of an unpacked FMU, ready to step; `start` sets soc and ambient."""
    description = fmpy.read_model_description(folder)
    slave = fmi2.FMU2Slave(
        guid=description.guid, unzipDirectory=folder, modelIdentifier=description.coSimulation.modelIdentifier
    )
    slave.instantiate()
    try:
        if initialised:
            initialise(slave, **start)
        yield slave
    finally:
        slave.fmi2FreeInstance(slave.component)


def initialise(slave, soc=0.5, ambient=25.0):
    slave.setReal([SOC_INITIAL, AMBIENT], [soc, ambient])
    slave.setupExperiment()
    slave.enterInitializationMode()
    slave.exitInitializationMode()


def drive(slave, currents, step_s=1.0, t_s=0.0):
    """Outputs after each step; shape (n, 3)."""
    trace = []
    for k, current in enumerate(currents):
        slave.setReal([CURRENT], [current])
        slave.doStep(t_s + k * step_s, step_s)
        trace.append(slave.getReal(OUTPUTS))
    return np.array(trace)


def status_of(call, *args, **kwargs):
    with pytest.raises(FMICallException) as caught:
        call(*args, **kwargs)
    return caught.value.status


def load(current_A, n, seed=3):
    return np.random.default_rng(seed).normal(current_A, 3.0, n).clip(-7, 12)


# --- the file


def test_fmpy_finds_nothing_wrong():
    assert validate_fmu(str(FMU)) == []


def test_the_library_needs_libc_and_libm_only(unpacked):
    library = unpacked / "binaries" / "linux64" / "lgm50_spme.so"
    listed = subprocess.run(["ldd", library], capture_output=True, text=True, check=True).stdout
    needed = {line.split()[0].split("/")[-1].split(".")[0] for line in listed.splitlines()}
    assert needed <= {"linux-vdso", "libc", "libm", "ld-linux-x86-64"}


def test_only_the_standard_s_functions_can_be_seen_from_outside(unpacked):
    if not shutil.which("nm"):
        pytest.skip("no nm: the exported symbols are not checked")
    library = unpacked / "binaries" / "linux64" / "lgm50_spme.so"
    printed = subprocess.run(["nm", "-D", "--defined-only", library], capture_output=True, text=True, check=True).stdout
    names = {line.split()[-1] for line in printed.splitlines()}
    assert "fmi2DoStep" in names
    assert all(name.startswith("fmi2") for name in names)


def test_the_fmu_carries_all_its_sources_and_its_documentation():
    with zipfile.ZipFile(FMU) as archive:
        members = set(archive.namelist())
        carried = archive.read("sources/cell.c")
    assert {"documentation/README.md", "documentation/index.html", "sources/fmi2.c", "sources/variables.h"} <= members
    assert carried == (MODEL / "cell.c").read_bytes()


def test_xml_and_c_have_the_same_start_values_and_limits(unpacked):
    variables = fmpy.read_model_description(unpacked).modelVariables
    with instance(unpacked, initialised=False) as slave:
        slave.setupExperiment()
        slave.enterInitializationMode()
        for variable in variables:
            if variable.start is None:
                assert status_of(slave.setReal, [variable.valueReference], [0.0]) == fmi2.fmi2Error
                continue
            low, high = float(variable.min), float(variable.max)
            assert slave.getReal([variable.valueReference]) == [float(variable.start)]
            slave.setReal([variable.valueReference] * 2, [low, high])
            for outside in (low - 1e-6, high + 1e-6, float("nan")):
                assert status_of(slave.setReal, [variable.valueReference], [outside]) == fmi2.fmi2Discard
            slave.setReal([variable.valueReference], [float(variable.start)])


@pytest.fixture(scope="module")
def rebuilt(tmp_path_factory):
    if not shutil.which(os.environ.get("CC", "cc")):
        pytest.skip("no C compiler: the committed FMU is not compared with its sources")
    fmus = [tmp_path_factory.mktemp("rebuilt") / "lgm50_spme.fmu" for _ in range(2)]
    for fmu in fmus:
        build(MODEL, fmu)
    return fmus


def test_the_sources_compiled_anew_give_the_committed_trace(unpacked, rebuilt, tmp_path):
    fmpy.extract(rebuilt[0], tmp_path)
    assert fmpy.read_model_description(tmp_path).guid == fmpy.read_model_description(unpacked).guid
    currents = load(1.5, 600)
    with instance(unpacked, soc=0.6, ambient=5.0) as ours, instance(tmp_path, soc=0.6, ambient=5.0) as theirs:
        np.testing.assert_allclose(drive(theirs, currents), drive(ours, currents), rtol=0, atol=1e-9)


def test_two_builds_give_the_same_bytes(rebuilt):
    assert rebuilt[0].read_bytes() == rebuilt[1].read_bytes()


# --- FMI behaviour


def test_two_instances_do_not_disturb_each_other(unpacked):
    with instance(unpacked, soc=0.9) as alone:
        expected = drive(alone, load(1.0, 50))
    with instance(unpacked, soc=0.9) as one, instance(unpacked, soc=0.2, ambient=0.0) as other:
        mixed = []
        for k, current in enumerate(load(1.0, 50)):
            mixed.append(drive(one, [current], t_s=float(k))[0])
            drive(other, [-current], t_s=float(k))
    np.testing.assert_array_equal(mixed, expected)


def test_a_state_taken_and_set_resumes_bit_for_bit(unpacked):
    with instance(unpacked) as slave:
        drive(slave, load(1.0, 20))
        state = slave.getFMUstate()
        expected = drive(slave, load(2.0, 20), t_s=20.0)
        slave.setFMUstate(state)
        np.testing.assert_array_equal(drive(slave, load(2.0, 20), t_s=20.0), expected)
        slave.freeFMUstate(state)


def test_a_serialised_state_resumes_bit_for_bit_in_another_instance(unpacked):
    with instance(unpacked) as slave:
        drive(slave, load(1.0, 20))
        state = slave.getFMUstate()
        data = slave.serializeFMUstate(state)
        assert slave.serializeFMUstate(state) == data
        expected = drive(slave, load(2.0, 20), t_s=20.0)
        slave.freeFMUstate(state)
    with instance(unpacked, initialised=False) as other:
        state = other.deSerializeFMUstate(data)
        other.setFMUstate(state)
        np.testing.assert_array_equal(drive(other, load(2.0, 20), t_s=20.0), expected)
        other.freeFMUstate(state)


def test_bytes_that_are_not_a_state_of_this_fmu_are_refused(unpacked):
    with instance(unpacked) as slave:
        state = slave.getFMUstate()
        data = slave.serializeFMUstate(state)
        slave.freeFMUstate(state)
        assert status_of(slave.deSerializeFMUstate, data[:-1]) == fmi2.fmi2Error
        assert status_of(slave.deSerializeFMUstate, b"x" + data[1:]) == fmi2.fmi2Error


def test_reset_starts_from_the_start_values_again(unpacked):
    with instance(unpacked, soc=0.9) as slave:
        first = drive(slave, load(1.0, 20))
        slave.reset()
        initialise(slave, soc=0.9)
        np.testing.assert_array_equal(drive(slave, load(1.0, 20)), first)
        slave.reset()
        slave.setupExperiment()
        slave.enterInitializationMode()
        assert slave.getReal([SOC]) == pytest.approx([0.5])


def test_calls_out_of_order_are_errors(unpacked):
    with instance(unpacked, initialised=False) as slave:
        assert status_of(slave.doStep, 0.0, 1.0) == fmi2.fmi2Error
        assert status_of(slave.getReal, OUTPUTS) == fmi2.fmi2Error
        assert status_of(slave.exitInitializationMode) == fmi2.fmi2Error
        assert status_of(slave.terminate) == fmi2.fmi2Error
        initialise(slave)
        assert status_of(slave.enterInitializationMode) == fmi2.fmi2Error
        assert status_of(slave.setReal, [SOC_INITIAL], [0.4]) == fmi2.fmi2Error
        slave.terminate()
        assert status_of(slave.doStep, 0.0, 1.0) == fmi2.fmi2Error
        assert slave.getReal([SOC]) == pytest.approx([0.5])


def test_a_value_reference_or_type_that_does_not_exist_is_an_error(unpacked):
    with instance(unpacked) as slave:
        assert status_of(slave.getReal, [99]) == fmi2.fmi2Error
        assert status_of(slave.setReal, [99], [0.0]) == fmi2.fmi2Error
        assert status_of(slave.getInteger, [0]) == fmi2.fmi2Error
        assert status_of(slave.setBoolean, [0], [True]) == fmi2.fmi2Error


@pytest.mark.parametrize(("t_s", "step_s"), [(1.0, 1.0), (0.0, 0.0), (0.0, -1.0), (0.0, float("nan"))])
def test_a_step_from_another_time_or_of_no_length_is_an_error(unpacked, t_s, step_s):
    with instance(unpacked) as slave:
        assert status_of(slave.doStep, t_s, step_s) == fmi2.fmi2Error


def test_a_step_past_the_stop_time_is_an_error(unpacked):
    with instance(unpacked, initialised=False) as slave:
        slave.setupExperiment(stopTime=10.0)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        slave.doStep(0.0, 10.0)
        assert status_of(slave.doStep, 10.0, 1.0) == fmi2.fmi2Error


def test_a_wrong_guid_gives_no_instance(unpacked):
    slave = fmi2.FMU2Slave(guid="{0}", unzipDirectory=unpacked, modelIdentifier="lgm50_spme")
    with pytest.raises(Exception, match="instantiate"):
        slave.instantiate()


def test_a_step_beyond_empty_is_discarded_and_leaves_the_state_as_it_was(unpacked):
    with instance(unpacked, soc=0.05) as slave:
        before = drive(slave, [1.0])
        slave.setReal([CURRENT], [5.0])
        assert status_of(slave.doStep, 1.0, 3600.0) == fmi2.fmi2Discard
        assert slave.getRealStatus(fmi2.fmi2LastSuccessfulTime) == 1.0
        assert slave.getReal([SOC]) == [before[0, 2]]
        assert np.isfinite(drive(slave, [-1.0] * 5, t_s=1.0)).all()


def test_a_step_beyond_full_is_discarded(unpacked):
    with instance(unpacked, soc=1.0) as slave:
        slave.setReal([CURRENT], [-5.0])
        assert status_of(slave.doStep, 0.0, 7200.0) == fmi2.fmi2Discard


def test_a_missing_instance_is_an_error_and_not_a_crash(unpacked):
    with instance(unpacked) as slave:
        value = ctypes.c_double()
        assert slave.dll.fmi2DoStep(None, 0.0, 1.0, 1) == fmi2.fmi2Error
        assert slave.dll.fmi2GetReal(None, ctypes.c_uint(0), 1, value) == fmi2.fmi2Error
        slave.dll.fmi2FreeInstance(None)


# --- physics


def assert_same(outputs, expected):
    """Within 0.1 mV, 10 mK and rounding of SoC: what the integrator's tolerance leaves."""
    assert (np.abs(np.subtract(outputs, expected)) < [1e-4, 1e-2, 1e-9]).all()


@pytest.mark.parametrize("step_s", [0.1, 10.0, 60.0, 600.0])
def test_the_length_of_a_step_does_not_matter(unpacked, step_s):
    with instance(unpacked, soc=0.8) as fine, instance(unpacked, soc=0.8) as other:
        expected = drive(fine, [3.0] * 600)[-1]
        assert_same(drive(other, [3.0] * round(600 / step_s), step_s)[-1], expected)


def test_uneven_steps_give_the_same_trace(unpacked):
    steps = np.random.default_rng(1).uniform(0.001, 20.0, 60)
    with instance(unpacked, soc=0.8) as uneven, instance(unpacked, soc=0.8) as whole:
        t_s = 0.0
        uneven.setReal([CURRENT], [3.0])
        for step_s in steps:
            uneven.doStep(t_s, step_s)
            t_s += step_s
        expected = drive(whole, [3.0], t_s)[-1]
        assert_same(uneven.getReal(OUTPUTS), expected)


def test_soc_falls_by_the_charge_drawn(unpacked):
    currents = load(1.5, 600)
    with instance(unpacked, soc=0.7) as slave:
        soc = drive(slave, currents)[:, 2]
    capacity_Ah = 5.1532  # between the stoichiometries at 2.5 V and 4.2 V
    np.testing.assert_allclose(soc, 0.7 - np.cumsum(currents) / 3600 / capacity_Ah, atol=1e-7)


def test_full_and_empty_are_the_voltage_limits_at_rest(unpacked):
    for soc, voltage_V in ((0.0, 2.5), (1.0, 4.2)):
        with instance(unpacked, soc=soc) as slave:
            assert slave.getReal([VOLTAGE]) == pytest.approx([voltage_V], abs=1e-4)


def test_the_cell_warms_under_load_and_returns_to_ambient(unpacked):
    with instance(unpacked, soc=0.9, ambient=10.0) as slave:
        warm = drive(slave, [5.0] * 60, 10.0)[-1, 1]
        cooled = drive(slave, [0.0] * 60, 300.0, t_s=600.0)[-1, 1]
    assert warm > 13
    assert cooled == pytest.approx(10.0, abs=0.01)


@pytest.fixture(scope="module")
def pybamm_voltage():
    """PyBaMM's own solution: voltage and temperature after each step of constant current."""
    pytest.importorskip("pybamm", reason="no PyBaMM: the plant is not compared with PyBaMM's own solution")
    from pybamm_solution import solution_of

    return solution_of("SPMe", "Chen2020")


PROFILES = {
    "drive": SimpleNamespace(currents=load(1.2, 300), step_s=1.0, soc=0.7, ambient=25.0),
    "cold drive": SimpleNamespace(currents=load(1.2, 300), step_s=1.0, soc=0.7, ambient=-10.0),
    "full discharge": SimpleNamespace(currents=[5.0] * 360, step_s=10.0, soc=1.0, ambient=25.0),
    "full charge": SimpleNamespace(currents=[-2.5] * 100, step_s=60.0, soc=0.02, ambient=25.0),
}


@pytest.mark.filterwarnings("ignore")  # PyBaMM's own
@pytest.mark.parametrize("name", PROFILES)
def test_voltage_within_2_mV_of_pybamm(unpacked, pybamm_voltage, name):
    profile = PROFILES[name]
    expected = pybamm_voltage(**vars(profile))
    with instance(unpacked, soc=profile.soc, ambient=profile.ambient) as slave:
        trace = drive(slave, profile.currents[: len(expected)], profile.step_s)
    assert len(expected) == len(profile.currents)
    largest_V = np.abs(trace[:, 0] - expected[:, 0]).max()
    print(f"{name}: the voltage is within {1000 * largest_V:.3f} mV of PyBaMM's own solution")
    assert largest_V < 2e-3
    assert np.abs(trace[:, 1] - expected[:, 1]).max() < 0.01
