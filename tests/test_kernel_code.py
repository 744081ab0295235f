"""The compiled kernel: it allocates nothing, computes in the type it is given, and is recompiled when it changes."""

from __future__ import annotations

import functools
import math
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest
import synthetic_cell
from drives import float32_against_float64, steady, variant
from kernel_record import Record

from bms_ukf import CellParams, Estimator, Sample, Tuning
from bms_ukf.kernel import entry, jit, layout
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


FORMS = {
    "[soc, v1, v2]": (2, False, False, False),
    "all there is": (3, True, True, True),
}
COMPILED = """
import sys
import tempfile
from bms_ukf.kernel import entry, jit
from bms_ukf.kernel.layout import form
n_rc, hysteresis, bias, core, lanes, bits = eval(sys.argv[1])
entry.tick(form(n_rc, hysteresis, bias, core, lanes, bits == 32), bits)
tick, = jit.DISPATCHERS
show = tick.inspect_asm if sys.argv[2] == "asm" else tick.inspect_llvm
print(*show().values())
"""


@functools.cache
def compiled(form: tuple[int, bool, bool, bool], lanes: int, bits: int, what: str) -> str:
    """The code of a tick, from a process with an empty cache: numba shows none of what it took from a cache."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
        command = [sys.executable, "-c", COMPILED, repr((*form, lanes, bits)), what]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize(
    ("form", "lanes", "bits"),
    [(FORMS["[soc, v1, v2]"], 1, 64), (FORMS["[soc, v1, v2]"], 16, 64), (FORMS["all there is"], 1, 32)],
    ids=["one cell", "pack", "all there is, float32"],
)
def test_a_compiled_tick_calls_no_allocator_and_no_python(form, lanes, bits):
    # Mathematical functions, the smaller of two integers, and clearing and copying the stack: nothing else.
    allowed = re.compile(
        r"(sqrtf?|llvm\.(sqrt|fabs|fma|fmuladd|floor|m(ax|in)num|[su]m(ax|in)|mem(set|cpy|move)|lifetime"
        r"|masked\.\w+|vector\.reduce\.\w+|usub\.sat|experimental\.noalias\.scope\.decl|assume)\b.*)$"
    )
    assert {
        name for name in called(numeric_part(compiled(form, lanes, bits, "llvm"))) if not allowed.match(name)
    } == set()


def test_the_loops_over_states_are_gone_and_their_vectors_in_registers():
    """What is left on the stack of one cell's tick: three arrays of 64, of the quadrature, and the record it copies."""
    function = numeric_part(compiled(FORMS["[soc, v1, v2]"], 1, 64, "llvm"))
    record = layout.form(2, 0, 0, 0, 1, 0).cache
    assert re.findall(r"alloca \[(\d+) x double\]", function) == ["64"] * 3 + [str(record)]


@pytest.mark.skipif(platform.machine() != "x86_64", reason="looks for x86-64 vector instructions")
@pytest.mark.parametrize("bits", [64, 32])
def test_a_packs_tick_takes_the_square_roots_of_several_cells_at_once(bits):
    """Three for the time update, three for the process noise, three for the measurement, five for the ohmic drop."""
    code = compiled(FORMS["[soc, v1, v2]"], 16, bits, "asm")
    several = re.findall(rf"\bv?sqrtp{'d' if bits == 64 else 's'}\b", code)
    assert len(several) >= 14, len(several)


def test_a_float32_instance_computes_nothing_in_double():
    function = numeric_part(compiled(FORMS["all there is"], 1, 32, "llvm"))
    lines = [line for line in function.splitlines() if "double" in line]
    # But for its two arguments, the step's length and the current, which are float64 for everyone.
    assert [line for line in lines if "%arg." not in line and not line.startswith("define")] == []
    assert "float" in function


@pytest.mark.parametrize("rate_hz", [1, 10, 100])
def test_float32_follows_float64_at_any_sample_rate(rate_hz):
    """Within 1e-5 of SoC over 1e6 steps: a plain float32 SoC would lose what a step of 10 ms adds to it."""
    difference, travelled = float32_against_float64(rate_hz, steps=1_000_000)
    assert travelled > 0.1
    assert difference < 1e-5


@pytest.mark.parametrize("rate_hz", [10, 100])
def test_without_voltages_a_float32_sigma_grows_as_a_float64_one(rate_hz):
    """What one step adds to a variance of 0.01 is below what a float32 can show."""
    steps = 2000 * rate_hz
    t_ns = np.round(np.arange(steps) * 1e9 / rate_hz).astype(np.int64)
    voltage = np.where(np.arange(steps) < 100, 3.6, np.nan)
    grown = []
    for precision in ("f64", "f32"):
        estimator = Estimator(CELL, precision=precision, tuning=Tuning(wide_soc_sigma=0.5))
        sigma = estimator.replay(t_ns, np.full(steps, 1.0), voltage, np.full(steps, 25.0))["soc_sigma"]
        grown.append(sigma[-1] - sigma[200])
    assert grown[0] > 1e-4
    assert grown[1] == pytest.approx(grown[0], rel=0.02)


@pytest.mark.parametrize(
    "changed",
    ["kernel/ecm.py", "kernel/step.py", "kernel/srukf.py", "kernel/layout.py", "kernel/memory.py", "records.py"],
)
def test_a_change_to_any_source_makes_the_cached_code_stale(tmp_path, monkeypatch, changed):
    """numba itself looks at the file of the cached function only, which is `kernel/entry.py`."""
    package = Path(jit.__file__).parent.parent
    shutil.copytree(package / "kernel", tmp_path / "kernel", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(package / "records.py", tmp_path)
    here = jit.source_stamp.__wrapped__()
    monkeypatch.setattr(jit, "__file__", str(tmp_path / "kernel" / "jit.py"))
    assert jit.source_stamp.__wrapped__() == here  # contents count, not times
    with (tmp_path / changed).open("a") as source:
        source.write("\n")
    assert jit.source_stamp.__wrapped__() != here


def test_the_stamp_is_what_numba_compares():
    Estimator(CELL), entry.ocv()
    for dispatcher in jit.DISPATCHERS:
        assert dispatcher._cache._cache_file._source_stamp == jit.source_stamp()


def test_the_buffers_start_on_a_cache_line():
    estimator = Estimator(CELL, 7)
    assert params(CELL, Tuning()).ctypes.data % 64 == 0
    assert [address % 64 for address in estimator._addresses[:3]] == [0, 0, 0]


def test_every_slot_of_the_header_is_written_once_and_has_one_name():
    slots = {name: value for name, value in vars(layout).items() if name.startswith("P_")}
    starts = sorted(slots.values())
    assert len(set(starts)) == len(starts)
    widths = {layout.P_OCV: layout.T_INV_DTEMP + 1, layout.P_DYN: layout.T_INV_DTEMP + 1}
    widths[layout.P_VAR_V] = layout.N_RC_MAX + 1
    covered = [slot for start in starts for slot in range(start, start + widths.get(start, 1))]
    assert covered == list(range(layout.PARAMS_HEADER))
    header = params(variant(3, hysteresis=True, core=True), Tuning(initial_soc=0.5))[: layout.PARAMS_HEADER]
    assert np.isfinite(header).all()


def simulate(tuning: Tuning, cell: CellParams, cells: int, steps: int, seed: int) -> tuple[np.ndarray, ...]:
    """SoC of `cells` cells that are exactly what the filter believes, its estimates, sigmas and NIS, (steps, cells)."""
    rng = np.random.default_rng(seed)
    model, noise = Record(cell, tuning), cell.noise
    table = np.linspace(-0.1, 1.1, 4801)
    ocv = np.array([model.ocv(soc, 25.0) for soc in table])
    r0, _, knee, _, r1, tau1, r2, tau2 = model.dynamics(tuning.initial_soc, 25.0).values()
    charge = 3600 * cell.cell.capacity_Ah
    soc = tuning.initial_soc + tuning.initial_soc_sigma * rng.standard_normal(cells)
    v1, v2 = (
        math.hypot(sigma, r * cell.cell.capacity_Ah / 20) * rng.standard_normal(cells)
        for sigma, r in ((noise.v_rc1_sigma_V, r1), (noise.v_rc2_sigma_V, r2))
    )
    estimator, rows = Estimator(cell, cells, tuning), []
    current = 0.0
    for k in range(steps):
        if k > 0:
            current = 1.0 + 2.0 * math.sin(k / 30)
            offset, gain = cell.cell.capacity_Ah / 50 / 1.96, math.hypot(0.005 / 1.96, 0.01)
            walk = (offset**2 + (gain * current) ** 2) * tuning.current_error_horizon_s / charge**2
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
        white = math.hypot(noise.voltage_sigma_V, tuning.voltage_noise_V, noise.r0_rel_sigma * drop)
        voltage = np.interp(soc, table, ocv) - v1 - v2 - drop + white * rng.standard_normal(cells)
        estimate = estimator.step(Sample(k * 10**9, current, voltage, 25.0))
        rows.append((soc, estimate.soc, estimate.soc_sigma, estimate.nis))
    return tuple(np.array([row[k] for row in rows], dtype=float) for k in range(4))


@pytest.fixture(scope="module")
def matched():
    tuning = Tuning(initial_soc=0.8, initial_soc_sigma=0.02, gate_sigmas=8.0, adaptive=False, current_bias=False)
    return simulate(tuning, steady(), cells=300, steps=600, seed=2)


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


@pytest.mark.parametrize(
    ("prefix", "wide", "size"),
    [
        ("P_", {"P_OCV": 6, "P_DYN": 6, "P_VAR_V": layout.N_RC_MAX + 1}, layout.PARAMS_HEADER),
        ("H_", {"H_PART_WIDTH": 2, "H_POLARISED": layout.N_RC_MAX}, layout.HELD),
        ("T_", {}, 6),
        ("OUT_", {}, layout.IO_ROWS),
        (
            "Y_",
            {
                "Y_OCV_AT": 3,
                "Y_OCV_D": 3,
                "Y_B": layout.N_MAX,
                "Y_DYN": layout.CHANNELS_MAX,
                "Y_FALL": layout.N_RC_MAX + 4,
                "Y_FADE": layout.N_RC_MAX + 3,
            },
            layout.VALUES,
        ),
    ],
)
def test_no_two_slots_of_a_buffer_share_a_place(prefix, wide, size):
    taken = [
        place + offset
        for name, place in vars(layout).items()
        if name.startswith(prefix)
        for offset in range(wide.get(name, 1))
    ]
    first = layout.IN_BLEED + 1 if prefix == "OUT_" else 0  # the IN_* rows come first
    assert sorted(taken) == list(range(first, size))


@pytest.mark.parametrize("form", FORMS.values(), ids=list(FORMS))
@pytest.mark.parametrize("compensated", [False, True])
def test_the_parts_of_a_record_follow_each_other(form, compensated):
    m = layout.form(*form, lanes=16, compensated=compensated)
    packed = m.n * (m.n + 1) // 2
    assert (m.x, m.root, m.carry) == (layout.HELD, layout.HELD + m.n, layout.HELD + m.n + packed)
    assert m.cache == m.carry + m.n * compensated
    assert m.size == m.cache + layout.C_VALUES + 2 * m.channels
    assert m.n <= layout.N_MAX
    assert m.channels <= layout.CHANNELS_MAX
