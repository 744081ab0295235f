"""The exported estimator is the Python one: same source, same results, and nothing in it but the estimator."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import synthetic_cell
from drives import CELL, drive
from embedded import Embedded

from bms_ukf import CellParams, Estimator, Fault, Sample, Status, firmware
from bms_ukf.firmware import elf, stack
from bms_ukf.firmware.compile import compiled
from bms_ukf.firmware.package import FAULTS, RESULTS, STATUSES, TABLES
from bms_ukf.firmware.targets import TARGETS
from bms_ukf.kernel import entry, layout
from bms_ukf.kernel.params import form_of, params
from bms_ukf.kernel.step import FAULT_MASK, STATUS_SHIFT
from bms_ukf.scaling import scaled
from bms_ukf.tuning import Tuning

FIELDS = {
    "SOC": "soc",
    "SOC_SIGMA": "soc_sigma",
    "SOC_LOW": "soc_low",
    "SOC_HIGH": "soc_high",
    "VOLTAGE_PRED": "voltage_pred_V",
    "INNOVATION": "innovation_V",
    "INNOVATION_VAR": "innovation_var_V2",
    "NIS": "nis",
    "AGE": "age_s",
    "BIAS": "current_bias_A",
    "R0": "r0_ohm",
}


def faulty(steps: int, seed: int):
    """(time in ms, the sample) of a drive whose sensors fail, whose clock runs backwards, and whose contactor opens.

    An open contactor shows the sensor's offset. A load there would contradict the voltages until they are refused, and
    after a refusal the belief begins again: then rounding decides at which sample.
    """
    rng = np.random.default_rng(seed)
    time_ms = 2**32 - 200_000  # begins anew on the way
    for dt, current, voltage, temperature in drive(steps, varying_dt=True, seed=seed):
        time_ms += round(1000 * dt)
        late_ms = 5000 if rng.random() < 0.01 else 0
        contactor_open = bool(rng.random() < 0.03)
        sample = Sample(
            (time_ms - late_ms) * 10**6,
            math.nan if rng.random() < (0.5 if contactor_open else 0.03) else 0.02 if contactor_open else current,
            math.nan if rng.random() < 0.05 else voltage + (2.0 if rng.random() < 0.01 else 0.0),
            math.nan if rng.random() < 0.05 else temperature,
            open_circuit=contactor_open,
        )
        yield time_ms - late_ms, sample


def largest_differences(cell: CellParams, folder: Path, precision: str, steps: int, seed: int) -> dict[str, float]:
    """Between the Python estimator and the one compiled for this machine; status and faults are to be the same."""
    firmware.export(cell, folder, "host", precision)
    compiled, estimator = Embedded(folder), Estimator(cell, precision=precision)
    found = dict.fromkeys(FIELDS, 0.0)
    seen = Fault.NONE
    for time_ms, sample in faulty(steps, seed):
        estimate = estimator.step(sample)
        code = compiled.step(time_ms, sample.current_A, sample.voltage_V, sample.temperature_degC, sample.open_circuit)
        assert (Status(code >> STATUS_SHIFT), Fault(code & FAULT_MASK)) == (estimate.status, estimate.faults)
        seen |= estimate.faults
        for name, field in FIELDS.items():
            here, there = compiled.get(name), getattr(estimate, field)
            assert math.isnan(here) == math.isnan(there), (name, time_ms)
            if not math.isnan(here):
                found[name] = max(found[name], abs(here - there))
    assert seen & Fault.TIME_REVERSED
    assert seen & Fault.VOLTAGE_IMPLAUSIBLE
    return found


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_compiled_float64_estimator_is_the_python_one_whatever_the_cell_and_its_sensors(tmp_path, cell, seed):
    rng = np.random.default_rng(seed)
    another = scaled(cell, *rng.uniform(0.5, 2.0, 2))
    differences = largest_differences(another, tmp_path, "f64", 1500, seed)
    assert differences["SOC"] < 1e-12
    assert differences["SOC_SIGMA"] < 1e-12
    assert differences["INNOVATION"] < 1e-12


@pytest.mark.parametrize("seed", [1, 2])
def test_the_compiled_float32_estimator_is_the_python_one_but_for_fused_operations(tmp_path, seed):
    """Python's fuses multiplications and additions, the exported one does not (`firmware.compile`).

    The drive is of this cell: of another one, voltages are refused, and rounding decides which.
    """
    differences = largest_differences(CELL, tmp_path, "f32", 1500, seed)
    assert differences["SOC"] < 2e-5
    assert differences["SOC_SIGMA"] < 1e-5  # components have it from quantiles
    assert differences["INNOVATION"] < 2e-5


@pytest.fixture(scope="module", params=["cortex-m4", "cortex-m7", "rv32"])
def exported(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    cost = firmware.export(CellParams.load("lgm50_chen2020"), folder, request.param, tables="compact")
    return request.param, folder, cost


def test_a_float32_object_needs_nothing_but_libms_whole_part(exported):
    target, folder, cost = exported
    needed = elf.undefined((folder / "bms_ukf.o").read_bytes())
    assert set(needed) <= (set() if target == "cortex-m7" else {"floorf"})  # an M7 has an instruction for it
    assert cost.undefined == needed


def test_a_float32_object_computes_nothing_in_double(exported, cell):
    numbers, form = params(cell, Tuning(), 32), form_of(cell, Tuning(), 1, 32, part_lanes=1)
    made = compiled(form, 1, numbers, TARGETS[exported[0]])
    assert "double" not in made.llvm
    assert "float" in made.llvm


def test_flash_ram_and_stack_are_within_what_a_small_microcontroller_has(exported):
    _, _, cost = exported
    assert cost.flash < 73_000
    assert cost.ram_cell < 4096
    assert cost.ram < 8192
    assert 100 < cost.stack < 1024


def test_several_cells_are_several_estimators_of_one_cell_each(tmp_path, cell):
    firmware.export(cell, tmp_path, "host", "f32", cells=3)
    pack = Embedded(tmp_path)
    firmware.export(cell, tmp_path / "one", "host", "f32")
    alone = [Embedded(tmp_path / "one") for _ in range(3)]
    for k, (_, current, voltage, temperature) in enumerate(drive(300, varying_dt=False, seed=4)):
        voltages = np.array([voltage, voltage - 0.02, math.nan if k % 7 == 3 else voltage + 0.01])
        pack.step(1000 * k, current, voltages, temperature)
        for number, one in enumerate(alone):
            one.step(1000 * k, current, voltages[number], temperature)
            assert {name: pack.get(name, number) for name in RESULTS} == pytest.approx(
                {name: one.get(name) for name in RESULTS}, rel=0, abs=0, nan_ok=True
            )


def test_a_state_that_was_stored_goes_on_where_it_was(tmp_path, cell):
    firmware.export(cell, tmp_path, "host", "f32")
    whole, stored = Embedded(tmp_path), Embedded(tmp_path)
    samples = list(drive(200, varying_dt=False, seed=5))
    for k, (_, *measured) in enumerate(samples):
        if k == 100:
            stored.state[:] = np.frombuffer(whole.state.tobytes(), stored.dtype)
        whole.step(1000 * k, *measured)
        if k >= 100:
            stored.step(1000 * k, *measured)
    assert stored.state.tobytes() == whole.state.tobytes()
    assert not math.isnan(whole.get("SOC"))


def test_a_result_that_does_not_exist_is_nan(tmp_path, cell):
    firmware.export(cell, tmp_path, "host", "f32")
    one = Embedded(tmp_path)
    one.step(0, 1.0, 3.7, 25.0)
    assert not math.isnan(one.get("AGE"))
    assert math.isnan(one.get("AGE", cell=1))
    one.macros |= {"BEFORE": str(layout.OUT_SOC - 1), "AFTER": str(layout.IO_ROWS)}
    assert math.isnan(one.get("BEFORE"))
    assert math.isnan(one.get("AFTER"))


def test_float64_for_a_machine_without_doubles_names_what_its_compilers_library_must_have(tmp_path, cell):
    cost = firmware.export(cell, tmp_path, "cortex-m4", "f64")
    assert "__aeabi_dmul" in cost.undefined
    assert "__aeabi_dmul" in (tmp_path / "bms_ukf.h").read_text()
    assert "__aeabi_dmul" in (tmp_path / "size.txt").read_text()


def test_the_header_has_every_status_and_every_fault_the_kernel_can_report():
    assert set(STATUSES) == set(Status)
    daemons_own = Fault.E2E | Fault.BUS | Fault.CURRENT_SIGN | Fault.CURRENT_SCALE | Fault.CURRENT_FAILED
    assert set(FAULTS) == set(~daemons_own & Fault(2 * max(Fault) - 1))


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler (apt install gcc libc6-dev)")
def test_the_example_compiles_without_a_warning_and_runs(tmp_path, cell):
    firmware.export(cell, tmp_path, "host", "f32", cells=2)
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    build = ["cc", *flags, tmp_path / "main.c", tmp_path / "bms_ukf.o", "-lm", "-o", tmp_path / "main"]
    subprocess.run(build, check=True)
    assert subprocess.run([tmp_path / "main"], check=False).returncode == 0


def test_compact_tables_say_nearly_the_same(cell):
    """On a drive of the daemon's own tables: what they differ by is far below what the filter is in doubt about."""
    full, compact = (params(cell, Tuning(), 64, TABLES[name]) for name in ("full", "compact"))
    assert compact.nbytes < full.nbytes / 2
    ocv = entry.ocv()
    off = [ocv(compact.ctypes.data, soc, 25.0) - ocv(full.ctypes.data, soc, 25.0) for soc in np.linspace(0.05, 1, 951)]
    assert np.abs(off).max() < 1e-3


@pytest.mark.parametrize(
    ("kind", "instructions", "size"),
    [
        ("thumb", ["push.w\t{r4, r5, lr}", "vpush\t{d8-d15}", "sub.w\tsp, sp, #1024"], 1100),
        ("thumb", ["str\tlr, [sp, #-4]!", "sub\tsp, #8"], 12),
        ("riscv32", ["addi\tsp, sp, -224", "addi\tsp, sp, 224"], 224),
    ],
)
def test_a_frame_is_all_that_a_function_lowers_the_stack_pointer_by(kind, instructions, size):
    assembly = "".join(["f:\n", *(f"\t{instruction}\n" for instruction in instructions), ".Lfunc_end0:\n"])
    assert stack.frames(assembly, kind) == {"f": size}


def test_a_stack_that_grows_by_an_unknown_number_is_an_error():
    with pytest.raises(ValueError, match="f: sub sp"):
        stack.frames("f:\n\tsub\tsp, r0\n.Lfunc_end0:\n", "thumb")


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["lgm50_chen2020", "--target", "avr"], ["--target", "avr", "cortex-m7"]),
        (["no_such_cell", "--target", "rv32"], ["no_such_cell", "lgm50_chen2020"]),
        (["lgm50_chen2020", "--target", "rv32", "--precision", "f16"], ["--precision", "f16"]),
        (["lgm50_chen2020", "--target", "rv32", "--cells", "0"], ["--cells", "0"]),
    ],
)
def test_a_wrong_argument_costs_one_line(bms_ukf, tmp_path, arguments, named):
    line = bms_ukf("export", "firmware", *arguments, "--out", tmp_path / "out").line
    assert all(word in line for word in named), line


def test_a_cell_the_precision_cannot_hold_costs_one_line(bms_ukf, tmp_path):
    data = synthetic_cell.nonlinear()
    data["hysteresis"] = {"soc": [0.0, 1.0], "temperature_degC": [25.0], "max_V": [[1e-42, 0.01]], "rate": 100.0}
    data["noise"]["hysteresis_sigma_V"] = 0.003
    path = tmp_path / "tiny.toml"
    path.write_text(synthetic_cell.as_toml(data))
    line = bms_ukf("export", "firmware", path, "--target", "cortex-m4", "--out", tmp_path / "out").line
    assert re.search(r"1e-42.*f32 can hold.*--precision f64", line), line


def test_a_folder_that_cannot_be_written_costs_one_line(bms_ukf, tmp_path):
    (tmp_path / "file").touch()
    assert (
        "file" in bms_ukf("export", "firmware", "lgm50_chen2020", "--target", "host", "--out", tmp_path / "file").line
    )
