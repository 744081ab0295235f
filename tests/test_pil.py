"""The exported estimator on its own processor: compiled by that processor's tool chain, run by QEMU over a drive cycle.

What is compared, and how, is in `pil/pil.c`. With -s the figures of the README are printed. Without the tools nothing
is run and every test says so; that is an error only if REQUIRE_PIL=1, as in CI.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

import measured
import numpy as np
import pytest
from embedded import Embedded

from bms_ukf import CellParams, Estimator, Sample, firmware
from bms_ukf.benchmark_entry import STEP_INSTRUCTIONS
from bms_ukf.firmware.report import Cost
from bms_ukf.firmware.targets import TARGETS

SOURCE = Path(__file__).parent / "pil" / "pil.c"
SAMPLE = np.dtype(
    [("time_ms", "<u4"), ("current_A", "<f4"), ("voltage_V", "<f4"), ("temperature_degC", "<f4"), ("open", "<u4")]
)
ANSWER = np.dtype(
    [
        ("code", "<u4"),
        ("SOC", "<f4"),
        ("SOC_SIGMA", "<f4"),
        ("INNOVATION", "<f4"),
        ("SOC_LOW", "<f4"),
        ("SOC_HIGH", "<f4"),
        ("instructions", "<u4"),
        ("stack", "<u4"),
    ]
)
LIBM_STACK = 64  # bytes that floorf may take
TIME_LIMIT_S = 120
CLOCK_HZ = 216e6
CYCLES = 2  # an instruction: pessimistic for a Cortex-M7 with its caches on
# The goal of 2 ms is that of a Cortex-M7. For rv32 the same step is 1.9 times as many instructions.
PARTS_LIMIT_S = {"cortex-m4": 2e-3, "cortex-m7": 2e-3, "rv32": 3e-3}
USUAL_MAX = 20_000  # instructions of a step of one Gaussian; components take far more


class Board(NamedTuple):
    """A processor in QEMU, and what builds for it."""

    compiler: str
    qemu: list[str]
    flash: int
    ram: int
    clock: str  # virtual time an instruction takes, 2^clock ns, as `pil.c` expects it
    packages: str


ARM = "gcc-arm-none-eabi picolibc-arm-none-eabi qemu-system-arm"
RISCV = "gcc-riscv64-unknown-elf picolibc-riscv64-unknown-elf qemu-system-misc"
BOARDS = {
    "cortex-m4": Board("arm-none-eabi-gcc", ["qemu-system-arm", "-M", "mps2-an386"], 0, 0x20000000, "6", ARM),
    "cortex-m7": Board("arm-none-eabi-gcc", ["qemu-system-arm", "-M", "mps2-an500"], 0, 0x20000000, "6", ARM),
    "rv32": Board(
        "riscv64-unknown-elf-gcc",
        ["qemu-system-riscv32", "-M", "virt", "-bios", "none"],
        0x80000000,
        0x80400000,
        "0",
        RISCV,
    ),
}


class Run(NamedTuple):
    target: str
    cost: Cost
    answers: np.ndarray
    host: np.ndarray  # of the same object made for this machine


@pytest.fixture(scope="module")
def samples() -> np.ndarray:
    """A WLTC at 1 Hz from 90 %, of the physics-based plant, through sensors; now and then one says nothing."""
    rows = measured.record(measured.DRIVE, 0.9)
    drive = np.zeros(len(rows), SAMPLE)
    drive["time_ms"] = np.round(1000 * rows[:, 0])
    drive["current_A"], drive["voltage_V"], drive["temperature_degC"] = -rows[:, 1], rows[:, 2], rows[:, 3]
    drive["voltage_V"][200::50] = np.nan
    drive["current_A"][300:310] = np.nan
    drive["open"][:20] = 1
    return drive


@pytest.fixture(scope="module")
def on_this_machine(samples, tmp_path_factory) -> np.ndarray:
    folder = tmp_path_factory.mktemp("host")
    firmware.export(CellParams.load("lgm50_chen2020"), folder, "host", "f32")
    estimator = Embedded(folder)
    answers = np.zeros(len(samples), ANSWER)
    for answer, sample in zip(answers, samples, strict=True):
        answer["code"] = estimator.step(*sample.tolist())
        for name in ("SOC", "SOC_SIGMA", "INNOVATION", "SOC_LOW", "SOC_HIGH"):
            answer[name] = estimator.get(name)
    return answers


@pytest.fixture(scope="module", params=BOARDS)
def run(request, samples, on_this_machine, tmp_path_factory) -> Run:
    target, board = request.param, BOARDS[request.param]
    require(board)
    folder = tmp_path_factory.mktemp(target)
    cost = firmware.export(CellParams.load("lgm50_chen2020"), folder, target, "f32")
    samples.tofile(folder / "samples.bin")
    places = {"flash": board.flash, "flash_size": 1 << 22, "ram": board.ram, "ram_size": 1 << 22}
    build = [
        board.compiler,
        *TARGETS[target].gcc.split(),
        "-std=gnu11",
        "-O2",
        "-Wall",
        "-Wextra",
        "-Wpedantic",
        "-Werror",
    ]
    build += ["--specs=picolibc.specs", "--oslib=semihost", "--crt0=semihost"]
    build += [f"-Wl,--defsym=__{name}={place:#x}" for name, place in places.items()]
    carry_out([*build, "-I", folder, SOURCE, folder / "bms_ukf.o", "-lm", "-o", folder / "pil.elf"], folder)
    emulate = [*board.qemu, "-nographic", "-monitor", "none", "-serial", "none", "-icount", f"shift={board.clock}"]
    emulate += ["-semihosting-config", "enable=on,target=native", "-kernel", "pil.elf"]
    carry_out(emulate, folder)
    return Run(target, cost, np.fromfile(folder / "answers.bin", ANSWER), on_this_machine)


def carry_out(command: list[str | Path], folder: Path) -> None:
    done = subprocess.run(
        command, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=TIME_LIMIT_S, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def require(board: Board) -> None:
    missing = [tool for tool in (board.compiler, board.qemu[0]) if shutil.which(tool) is None]
    if not missing and picolibc(board) is None:
        missing = [f"picolibc for {board.compiler}"]
    if missing:
        text = f"PIL NOT RUN: no {', '.join(missing)}; get it with: apt install {board.packages}"
        if os.environ.get("REQUIRE_PIL") == "1":
            pytest.fail(text)
        pytest.skip(text)


def say(run: Run, text: str) -> None:
    print(f"\n{run.target}: {text}")  # noqa: T201 - a figure of the README


def picolibc(board: Board) -> str | None:
    found = subprocess.run(
        [board.compiler, "-print-file-name=picolibc.specs"], capture_output=True, text=True, check=True
    )
    return found.stdout.strip() if Path(found.stdout.strip()).is_file() else None


def test_the_trace_on_the_processor_is_that_of_this_machine_bit_for_bit(run):
    assert len(run.answers) == len(run.host) > 1800
    for name in ("code", "SOC", "SOC_SIGMA", "INNOVATION", "SOC_LOW", "SOC_HIGH"):
        np.testing.assert_array_equal(run.answers[name].view(np.uint32), run.host[name].view(np.uint32), err_msg=name)
    assert np.isfinite(run.answers["SOC"][1:]).all()
    assert np.ptp(run.answers["SOC"]) > 0.05


def test_the_trace_on_the_processor_is_that_of_the_daemons_float32_but_for_fused_operations(run, samples, cell):
    estimator = Estimator(cell, precision="f32")
    soc = [
        estimator.step(Sample(int(row["time_ms"]) * 10**6, *row.tolist()[1:4], open_circuit=bool(row["open"]))).soc
        for row in samples
    ]
    difference = float(np.nanmax(np.abs(np.array(soc) - run.answers["SOC"])))
    say(run, f"SoC differs from the daemon's float32 by at most {difference:.1e}")
    assert difference < 1e-5


def test_a_step_takes_no_longer_than_100_us_at_216_mhz_and_its_limit_where_components_hold_the_belief(run):
    """The components take over at the first voltage, which costs most: it is weighed on fine intervals of SoC."""
    count = run.answers["instructions"]
    by_components = count > USUAL_MAX
    usual, parts = count[~by_components], count[by_components]
    text = f"{usual.mean():.0f} instructions a step, {usual.max()} at most; of components {len(parts)} steps of"
    say(run, f"{text} {np.median(parts):.0f}, {np.sort(parts)[-2]} at most; first voltage {count[0]}")
    assert usual.min() > 500
    assert len(usual) > len(count) / 2
    assert len(parts) > 0
    assert count[0] == count.max()
    assert usual.max() * CYCLES / CLOCK_HZ < 100e-6
    assert np.sort(parts)[:-1].max() * CYCLES / CLOCK_HZ < PARTS_LIMIT_S[run.target]


@pytest.mark.parametrize("run", ["cortex-m7"], indirect=True)
def test_the_benchmark_entry_states_what_a_step_takes_on_a_cortex_m7(run):
    count = run.answers["instructions"]
    by_components = count > USUAL_MAX
    measured_counts = {
        "usual": count[~by_components].mean(),
        "wide": np.median(count[by_components]),
        "first": count[0],
    }
    for step, stated in STEP_INSTRUCTIONS.items():
        assert measured_counts[step] == pytest.approx(stated, rel=0.1), step


def test_the_stack_a_step_takes_is_what_the_report_says(run):
    taken = run.answers["stack"]
    say(run, f"{np.median(taken):.0f} bytes of stack, {taken.max()} at most; the report says {run.cost.stack}")
    assert run.cost.stack / 2 < np.median(taken) <= run.cost.stack
    assert taken.max() <= run.cost.stack + LIBM_STACK
