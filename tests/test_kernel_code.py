"""The compiled kernel: it allocates nothing, computes in the type it is given, and is recompiled when it changes."""

from __future__ import annotations

import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
import synthetic_cell
from kernel_record import N, Record
from numba import types

from bms_ukf import CellParams, Estimator, Sample, Tuning
from bms_ukf.kernel import entry, layout, memory, step
from bms_ukf.kernel.params import params

CELL = synthetic_cell.cell_of(synthetic_cell.nonlinear())


def numeric_part(llvm: str) -> str:
    """The function itself, without what converts a Python call's arguments and result."""
    functions = re.findall(r"^define [^\n]*\{\n.*?^\}", llvm, re.DOTALL | re.MULTILINE)
    own = [text for text in functions if not re.match(r'define [^@\n]*@"?(_ZN7cpython|cfunc)', text)]
    assert len(own) == 1
    return own[0]


def called(function: str) -> set[str]:
    calls = [
        line for line in function.splitlines() if re.search(r"= (tail |notail )?(call|invoke)|^\s*(tail )?call", line)
    ]
    names = {match[1] for line in calls if (match := re.search(r'@"?([\w.$]+)"?\(', line))}
    assert len(names) > 0
    assert all("@" in line for line in calls), "a call through a pointer"
    return names


@numba.njit(**memory._OPTIONS)
def step_f32(params, state, dt, current, voltage, temperature):
    p, s = memory.pointer_f32(params), memory.pointer_f32(state)
    return step.step_cell(p, s, 0, N, dt, current, voltage, temperature)


@pytest.fixture(scope="module")
def f32():
    address, real = types.int64, types.float32
    step_f32.compile(types.int64(address, address, real, real, real, real))
    step_f32.disable_compile()
    return step_f32


def test_the_compiled_tick_calls_no_allocator_and_no_python(tmp_path):
    """In a process with an empty cache: numba shows no code of what it took from a cache."""
    code = "from bms_ukf.kernel import entry; print(*entry.tick.inspect_llvm().values())"
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    # Mathematical functions, the smaller of two integers, and clearing the stack: nothing else.
    allowed = re.compile(
        r"(sqrt|exp|expm1|log|asinh|llvm\.(sqrt|exp|log|fabs|fma|fmuladd|floor|m(ax|in)num|[su]m(ax|in)|memset|lifetime)\..*)$"
    )
    assert {name for name in called(numeric_part(done.stdout)) if not allowed.match(name)} == set()


def test_a_float32_instance_computes_nothing_in_double(f32):
    function = numeric_part(f32.inspect_llvm(f32.signatures[0]))
    assert "float" in function
    assert [line for line in function.splitlines() if "double" in line] == []


def test_a_float32_instance_follows_the_float64_one(f32):
    """Loosely: SoC in a plain float32 loses what a step adds to it below 6e-8."""
    tuning = Tuning(initial_soc=0.8, initial_soc_sigma=0.1)
    record = Record(CELL, tuning)
    p32, s32 = record.params.astype(np.float32), record.state.astype(np.float32)
    rng = np.random.default_rng(11)
    held = layout.held_offset(N)
    soc, worst = 0.9, 0.0
    for _ in range(10_000):
        current = 1.2 + 2 * rng.standard_normal()
        soc -= current / 18000
        voltage = record.ocv(soc, 25.0) - 0.04 * current + 0.003 * rng.standard_normal()
        inputs = [float(np.float32(value)) for value in (1.0, current, voltage, 25.0)]
        status, faults = record.tick(*inputs)
        code = f32(p32.ctypes.data, s32.ctypes.data, *inputs)
        assert code == faults | (status << step.STATUS_SHIFT)
        worst = max(worst, abs(float(s32[layout.SOC]) - record.x[0]))
    assert worst < 1e-4
    assert soc < 0.3
    assert s32[: held + layout.H_GAP_S] == pytest.approx(
        record.state[: held + layout.H_GAP_S], rel=0.02, abs=1e-3, nan_ok=True
    )


@pytest.mark.parametrize(
    "changed",
    ["kernel/ecm.py", "kernel/step.py", "kernel/srukf.py", "kernel/layout.py", "kernel/memory.py", "records.py"],
)
def test_a_change_to_any_source_makes_the_cached_code_stale(tmp_path, monkeypatch, changed):
    """numba itself looks at the file of the cached function only, which is `kernel/entry.py`."""
    package = Path(memory.__file__).parent.parent
    shutil.copytree(package / "kernel", tmp_path / "kernel", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(package / "records.py", tmp_path)
    here = memory._source_stamp.__wrapped__()
    monkeypatch.setattr(memory, "__file__", str(tmp_path / "kernel" / "memory.py"))
    assert memory._source_stamp.__wrapped__() == here  # contents count, not times
    with (tmp_path / changed).open("a") as source:
        source.write("\n")
    assert memory._source_stamp.__wrapped__() != here


def test_the_stamp_is_what_numba_compares():
    for function in (entry.tick, entry.ocv, entry.dynamics):
        assert function._cache._cache_file._source_stamp == memory._source_stamp()


def test_the_buffers_start_on_a_cache_line():
    estimator = Estimator(CELL, 7)
    assert params(CELL, Tuning()).ctypes.data % 64 == 0
    assert estimator._params_address % 64 == 0
    assert estimator._state_address % 64 == 0


def test_every_slot_of_the_header_is_written_once_and_has_one_name():
    slots = {name: value for name, value in vars(layout).items() if name.startswith("P_")}
    starts = sorted(slots.values())
    assert len(set(starts)) == len(starts)
    widths = {layout.P_OCV: layout.T_INV_DSOC + 1, layout.P_DYN: layout.T_INV_DSOC + 1}
    covered = [slot for start in starts for slot in range(start, start + widths.get(start, 1))]
    assert covered == list(range(layout.PARAMS_HEADER))
    header = params(CELL, Tuning(initial_soc=0.5))[: layout.PARAMS_HEADER]
    assert np.isfinite(header).all()


def simulate(tuning: Tuning, cell: CellParams, cells: int, steps: int, seed: int) -> tuple[np.ndarray, ...]:
    """SoC of `cells` cells that are exactly what the filter believes, its estimates, sigmas and NIS, (steps, cells)."""
    rng = np.random.default_rng(seed)
    model, noise = Record(cell, tuning), cell.noise
    table = np.linspace(-0.1, 1.1, 4801)
    ocv = np.array([model.ocv(soc, 25.0) for soc in table])
    r0, r1, tau1, r2, tau2, knee = model.dynamics(tuning.initial_soc, 25.0)
    charge = 3600 * cell.cell.capacity_Ah
    soc = tuning.initial_soc + tuning.initial_soc_sigma * rng.standard_normal(cells)
    v1, v2 = (
        math.hypot(sigma, r * cell.cell.capacity_Ah / 5) * rng.standard_normal(cells)
        for sigma, r in ((noise.v_rc1_sigma_V, r1), (noise.v_rc2_sigma_V, r2))
    )
    estimator, rows = Estimator(cell, cells, tuning), []
    current = 0.0
    for k in range(steps):
        if k > 0:
            current = 1.0 + 2.0 * math.sin(k / 30)
            offset = cell.cell.capacity_Ah / 100
            walk = (offset**2 + (0.01 * current) ** 2) * tuning.current_error_horizon_s / charge**2
            efficiency = cell.cell.coulombic_efficiency if current < 0 else 1.0
            soc = soc - efficiency * current / charge + math.sqrt(walk) * rng.standard_normal(cells)
            for v, r, tau, own in (
                (v1, r1, tau1, math.hypot(noise.v_rc1_sigma_V, offset * r1)),
                (v2, r2, tau2, math.hypot(noise.v_rc2_sigma_V, offset * (r2 + r0))),
            ):
                a = math.exp(-1 / tau)
                error = math.hypot(own, noise.rc_rel_sigma * r * current) * math.sqrt(1 - a * a)
                v[:] = a * v + (1 - a) * r * current + error * rng.standard_normal(cells)
        drop = r0 * knee * math.asinh(current / knee)
        white = math.hypot(noise.voltage_sigma_V, tuning.voltage_sensor_sigma_V, noise.r0_rel_sigma * drop)
        voltage = np.interp(soc, table, ocv) - v1 - v2 - drop + white * rng.standard_normal(cells)
        estimate = estimator.step(Sample(k * 10**9, current, voltage, 25.0))
        rows.append((soc, estimate.soc, estimate.soc_sigma, estimate.nis))
    return tuple(np.array([row[k] for row in rows], dtype=float) for k in range(4))


@pytest.fixture(scope="module")
def matched():
    data = synthetic_cell.nonlinear()
    dynamics = data["dynamics"]
    for key in dynamics.keys() - {
        "soc",
        "temperature_degC",
    }:  # so that reading them at the mean SoC is no approximation
        dynamics[key] = [[row[3]] * len(row) for row in dynamics[key]]
    tuning = Tuning(initial_soc=0.8, initial_soc_sigma=0.02, gate_sigmas=8.0)
    return simulate(tuning, synthetic_cell.cell_of(data), cells=300, steps=600, seed=2)


def test_mean_nis_on_a_matched_model_is_that_of_a_chi_square(matched):
    """180 000 innovations, white if the filter is right: the mean of that many has a sigma of sqrt(2 / 180 000)."""
    nis = matched[3]
    assert abs(nis.mean() - 1) < 3 * math.sqrt(2 / nis.size)
    assert abs((nis > 3.841).mean() - 0.05) < 0.005


def test_95_percent_of_the_truth_lies_in_the_95_percent_band_on_a_matched_model(matched):
    truth, soc, sigma, _ = matched
    inside = np.abs(soc - truth) < 1.96 * sigma
    for part in (inside[:100], inside[100:300], inside[300:]):
        assert 0.90 < part.mean() < 0.99


@pytest.mark.parametrize(("prefix", "size"), [("P_", layout.PARAMS_HEADER), ("H_", layout.H_B + 1), ("T_", 7)])
def test_no_two_slots_of_a_buffer_share_a_place(prefix, size):
    """P_OCV and P_DYN are the first of the seven slots that a table descriptor takes."""
    places = [value for name, value in vars(layout).items() if name.startswith(prefix)]
    assert len(set(places)) == len(places)
    descriptors = {first + offset for first in (layout.P_OCV, layout.P_DYN) for offset in range(7)}
    taken = set(places) | (descriptors if prefix == "P_" else set())
    assert taken == set(range(size))
