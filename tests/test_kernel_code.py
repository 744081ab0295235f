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

from bms_ukf import CellParams, Estimator, Sample, Tuning, beliefs
from bms_ukf.kernel import adapt, entry, gaussian_sum, histories, jit, layout, ohmic, parts
from bms_ukf.kernel.params import params
from bms_ukf.kernel.voltage import REPEATS_MOST

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
    "default": (2, False, True, False),
    "all there is": (3, True, True, True),
}
COMPILED = """
import sys
import tempfile
from bms_ukf.kernel import entry, jit
from bms_ukf.kernel.layout import PART_LANES, form
n_rc, hysteresis, bias, core, lanes, bits = eval(sys.argv[1])
entry.tick(form(n_rc, hysteresis, bias, core, lanes, bits == 32, PART_LANES), bits)
tick, = jit.DISPATCHERS
print(*tick.inspect_llvm().values(), "=" * 80, *tick.inspect_asm().values(), sep="\\n")
"""


@functools.cache
def compiled(form: tuple[int, bool, bool, bool], lanes: int, bits: int) -> tuple[str, str]:
    """LLVM and machine code of a tick, from a process with an empty cache: numba shows none that a cache gave it."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
        command = [sys.executable, "-c", COMPILED, repr((*form, lanes, bits))]
        code = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    llvm, _, asm = code.partition("\n" + "=" * 80 + "\n")
    return llvm, asm


@pytest.mark.parametrize(
    ("form", "lanes", "bits"),
    [(FORMS["default"], 1, 64), (FORMS["default"], 16, 64), (FORMS["all there is"], 1, 32)],
    ids=["one cell", "pack", "all there is, float32"],
)
def test_a_compiled_tick_calls_no_allocator_and_no_python(form, lanes, bits):
    # Mathematical functions, the smaller of two integers, and clearing and copying the stack: nothing else.
    allowed = re.compile(
        r"(sqrtf?|llvm\.(sqrt|fabs|fma|fmuladd|floor|m(ax|in)num|[su]m(ax|in)|mem(set|cpy|move)|lifetime"
        r"|masked\.\w+|vector\.reduce\.\w+|usub\.sat|uadd\.with\.overflow|experimental\.noalias\.scope\.decl|assume)\b.*)$"
    )
    assert {name for name in called(numeric_part(compiled(form, lanes, bits)[0])) if not allowed.match(name)} == set()


@pytest.mark.parametrize("lanes", [1, 16], ids=["one cell", "pack"])
def test_the_loops_over_states_are_gone_and_their_vectors_in_registers(lanes):
    """What a tick leaves on the stack is meant to lie there: working copies, and the sums and ends of components.

    A vector or a matrix over states would appear as an array of N_MAX, of 36 or of DENSE_MAX numbers.
    """
    function = numeric_part(compiled(FORMS["default"], lanes, 64)[0])
    m = layout.form(*FORMS["default"], lanes, 0, layout.PART_LANES)
    scratch = [lanes * m.cache, *parts.room(m), *[gaussian_sum.HISTORIES] * 3]
    scratch += [lanes * layout.VALUES] * (lanes > 1)  # the values of one lane are in registers, too
    sizes = [int(size) for size in re.findall(r"alloca \[(\d+) x double\]", function)]
    assert sorted(sizes) == sorted(scratch)


@pytest.mark.skipif(platform.machine() != "x86_64", reason="looks for x86-64 vector instructions")
@pytest.mark.parametrize("bits", [64, 32])
def test_a_packs_tick_takes_the_square_roots_of_several_cells_at_once(bits):
    """Of cells: six for the time update, five for its noise, seven for a voltage, seven for a rest, five for the drop.

    Of components: seven for each of a first voltage, another one, and a rest.
    """
    _, code = compiled(FORMS["default"], 16, bits)
    several = re.findall(rf"\bv?sqrtp{'d' if bits == 64 else 's'}\b", code)
    assert len(several) >= 6 + 5 + 7 + 7 + 5 + 3 * 7, len(several)


def test_a_float32_instance_computes_nothing_in_double():
    function = numeric_part(compiled(FORMS["all there is"], 1, 32)[0])
    lines = [line for line in function.splitlines() if "double" in line]
    # But for its two arguments, the step's length and the current, which are float64 for everyone.
    assert [line for line in lines if "%arg." not in line and not line.startswith("define")] == []
    assert "float" in function


@pytest.mark.parametrize("rate_hz", [1, 10, 100])
def test_float32_follows_float64_at_any_sample_rate(rate_hz):
    """Within 0.2 % of its sigma over 1e6 steps: a plain float32 SoC would lose what a step of 10 ms adds to it."""
    difference, travelled = float32_against_float64(rate_hz, steps=1_000_000)
    assert travelled > 0.1
    assert difference < 2e-3


def variance_of_parts(estimator: Estimator) -> float:
    """Of SoC, by the components of the first cell."""
    m, parts = estimator._form, estimator._parts[0].astype(float)
    slots = m.size - layout.HELD
    blocks = parts[: layout.PARTS * slots].reshape(-1, slots, m.part_lanes)
    weight = parts[layout.PARTS * slots :][: layout.PARTS]
    soc, root = (blocks[:, slot - layout.HELD].ravel() for slot in (m.x, m.root))
    mean = weight @ soc / weight.sum()
    return float(weight @ (root**2 + (soc - mean) ** 2) / weight.sum())


@pytest.mark.parametrize("shape", ["components", "one Gaussian"])
@pytest.mark.parametrize("rate_hz", [10, 100])
def test_without_voltages_a_float32_sigma_grows_as_a_float64_one(rate_hz, shape):
    """One step at 100 Hz adds 4e-8 of itself to the variance of components, which a float32 cannot show.

    Judged by the variance: an interval also changes with the shape that it is taken from. That of components is taken
    from them: without a voltage the cell's root is no more than what one wide Gaussian would have grown to.
    """
    steps = 2000 * rate_hz
    t_ns = np.round(np.arange(steps) * 1e9 / rate_hz).astype(np.int64)
    voltage = np.where(np.arange(steps) < 100, 3.6, np.nan)
    grown = []
    for precision in ("f64", "f32"):
        estimator = Estimator(CELL, precision=precision, tuning=Tuning(wide_soc_sigma=0.5))
        m, record, variances = estimator._form, estimator._state[0, :, 0], []
        for rows in (slice(200), slice(200, steps)):
            count = len(t_ns[rows])
            estimator.replay(t_ns[rows], np.full(count, 1.0), voltage[rows], np.full(count, 25.0))
            if shape == "one Gaussian" and not variances:
                record[layout.H_PARTS], record[m.root] = 0.0, 0.02
            variances.append(float(record[m.root]) ** 2 if shape == "one Gaussian" else variance_of_parts(estimator))
        assert bool(record[layout.H_PARTS]) == (shape == "components")
        grown.append(variances[1] - variances[0])
    assert grown[0] > 1e-5
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


class Truth:
    """`cells` cells that are drawn from what the filter believes of one: its start, its process and its voltage."""

    def __init__(self, tuning: Tuning, cell: CellParams, cells: int, seed: int) -> None:
        self.rng, self.cells, self.cell = np.random.default_rng(seed), cells, cell
        model = Record(cell, tuning)
        self.p, self.at = model.params, model.dynamics(tuning.initial_soc, 25.0)
        self.table = np.linspace(-0.1, 1.1, 4801)
        self.ocv = np.array([model.ocv(soc, 25.0) for soc in self.table])
        p = self.p
        stray = self.rng.random(cells) < histories.STRAY
        told = self.normal(tuning.initial_soc_sigma) + tuning.initial_soc
        self.soc = np.where(stray, self.rng.random(cells), told)
        loaded = self.rng.random(cells) > histories.PARKED  # the first current is none
        before = np.where(loaded, p[layout.P_HISTORY], p[layout.P_INITIAL_CURRENT])
        self.resistances = [self.at["r1_ohm"], self.at["r2_ohm"]]
        self.v = [self.normal(np.hypot(math.sqrt(p[layout.P_VAR_V + j]), r * before)) for j, r in self.pairs]
        times = np.where(loaded, histories.LOADED_SLOW, 1.0)
        self.polarised = [0.0, 0.0]
        self.v_slow = self.normal(times * math.sqrt(self.slow_variance()))
        self.r0_error = self.normal(math.sqrt(p[layout.P_R0_VAR]))
        self.recent = self.crowded = 0.0
        self.age = adapt.FAST_S

    @property
    def pairs(self) -> list[tuple[int, float]]:
        return list(enumerate(self.resistances))

    def normal(self, sigma: float | np.ndarray) -> np.ndarray:
        return sigma * self.rng.standard_normal(self.cells)

    def slow_variance(self) -> float:
        p = self.p
        offset_V = p[layout.P_BIAS_SIGMA] * (self.at["r0_ohm"] + sum(self.resistances))
        return p[layout.P_SLOW_VAR] + offset_V**2 + (p[layout.P_SLOW_REL] * sum(self.polarised)) ** 2

    def move(self, i: float) -> None:
        """One second under `i`, A. Voltages and errors are Ornstein-Uhlenbeck processes, lasting ones of charge too."""
        p, at = self.p, self.at
        efficiency = p[layout.P_CE_CHARGE] if i < 0 else 1.0
        walk = p[layout.P_SOC_WALK_OFFSET] + p[layout.P_SOC_WALK_GAIN] * abs(i)
        self.soc = self.soc - efficiency * i / p[layout.P_CHARGE_COULOMB] + self.normal(math.sqrt(walk))
        for j, r in self.pairs:
            a = math.exp(-1 / at[f"tau{j + 1}_s"])
            own = math.hypot(math.sqrt(p[layout.P_VAR_V + j]), p[layout.P_RC_REL] * r * i)
            self.v[j] = a * self.v[j] + (1 - a) * r * i + self.normal(own * math.sqrt(1 - a * a))
            self.polarised[j] = a * self.polarised[j] + (1 - a) * r * i
        a = math.exp(-1 / p[layout.P_SLOW_TAU] - p[layout.P_SLOW_RATE] * abs(i))
        self.v_slow = a * self.v_slow + self.normal(math.sqrt((1 - a * a) * self.slow_variance()))
        a = math.exp(-1 / p[layout.P_R0_TAU] - p[layout.P_R0_RATE] * abs(i))
        self.r0_error = a * self.r0_error + self.normal(math.sqrt((1 - a * a) * p[layout.P_R0_VAR]))

    def voltage(self, i: float) -> np.ndarray:
        """Whose fast error is white and so much larger as the filter takes it for, by the part `crowded`, V^2."""
        p, at = self.p, self.at
        drop = at["r0_ohm"] * at["r0_knee_A"] * math.asinh(i / at["r0_knee_A"])
        noise = p[layout.P_VAR_VOLTAGE] + (p[layout.P_FAST_REL] * (drop - self.recent)) ** 2
        r = (noise + p[layout.P_FAST_VAR] * adapt.FAST_S / self.age) / (1 + 1 / REPEATS_MOST)
        self.age, self.crowded = 1.0, r - noise - p[layout.P_FAST_VAR]
        self.recent += (drop - self.recent) / (1 + ohmic.RECENT_S)
        small = at["r0_ohm"] * ohmic.SMALL_LOAD * p[layout.P_STILL]
        scaled = drop - min(max(drop, -small), small) + sum(self.polarised)
        ocv = np.interp(self.soc, self.table, self.ocv)
        return ocv - sum(self.v) - self.v_slow - drop - scaled * self.r0_error + self.normal(math.sqrt(r))


@pytest.fixture(scope="module")
def matched() -> dict[str, np.ndarray]:
    """Truth, bounds, NIS and whether components held the belief before, of 300 cells over 600 s; (steps, cells)."""
    tuning = Tuning(initial_soc=0.8, initial_soc_sigma=0.02, gate_sigmas=1e6, adaptive=False, current_bias=False)
    truth = Truth(tuning, steady(), cells=300, seed=2)
    estimator, rows = Estimator(truth.cell, truth.cells, tuning), []
    for k in range(600):
        current = 1.0 + 2.0 * math.sin(k / 30) if k else 0.0
        if k:
            truth.move(current)
        shapes = beliefs.with_parts(estimator._state, truth.cells) if k else np.ones(truth.cells, bool)
        estimate = estimator.step(Sample(k * 10**9, current, truth.voltage(current), 25.0))
        nis = estimate.innovation_V**2 / (estimate.innovation_var_V2 + truth.crowded)
        rows.append((truth.soc, estimate.soc_low, estimate.soc_high, nis, shapes))
    names = ("truth", "low", "high", "nis", "shapes")
    return {name: np.array([row[k] for row in rows], float) for k, name in enumerate(names)}


def test_mean_nis_on_a_matched_model_is_that_of_a_chi_square(matched):
    """White innovations if the filter is right: the mean of so many has a sigma of sqrt(2 / count).

    Where one Gaussian has the belief: the sum of components is none, so their innovations are not of a chi-square.
    """
    nis = matched["nis"][matched["shapes"] == 0]
    assert nis.size > 60_000
    assert abs(nis.mean() - 1) < 3 * math.sqrt(2 / nis.size)
    assert abs((nis > 3.841).mean() - 0.05) < 0.005


def test_95_percent_of_the_truth_lies_in_the_95_percent_band_on_a_matched_model(matched):
    inside = (matched["low"] < matched["truth"]) & (matched["truth"] < matched["high"])
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
