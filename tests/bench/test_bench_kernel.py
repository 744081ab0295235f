"""The compiled kernel beside the same filter written by hand in C: a step, a pack's tick, a replay; and its start.

One interleaved run: contenders take turns, times are medians, and what counts is the ratio. `make bench` prints it.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable

import numpy as np
import pytest
from bench_drive import TUNING, Drive, cell_of
from c_kernel import CKernel

from bms_ukf import Estimator
from bms_ukf.kernel import entry, layout

pytestmark = pytest.mark.bench

ROUNDS, TICKS = 21, 400
START = """
import time
started = time.perf_counter()
from bms_ukf import CellParams, Estimator, Sample
Estimator(CellParams.load("lgm50_chen2020")).step(Sample(0, 1.0, 3.7, 25.0))
print(time.perf_counter() - started)
"""


def medians(contenders: list[Callable[[], None]]) -> list[float]:
    """Seconds that each takes, in turns."""
    times: list[list[float]] = [[] for _ in contenders]
    for _ in range(ROUNDS):
        for contender, own in zip(contenders, times, strict=True):
            started = time.perf_counter()
            contender()
            own.append(time.perf_counter() - started)
    return [float(np.median(own)) for own in times]


def replays(hysteresis: bool, bits: int) -> list[float]:
    """ns a step of C and of ours, the loop being in the compiled code; they end alike."""
    cell = cell_of(hysteresis)
    c, drive = CKernel(cell, TUNING, bits), Drive(cell, 1, faults=False)
    samples = np.ascontiguousarray(drive.samples, c.dtype)
    estimator = Estimator(cell, tuning=TUNING, precision="f64" if bits == 64 else "f32")
    drive.begin(estimator)
    c.adopt(estimator)
    start, start_c = estimator._state.copy(), c.cell.copy()
    results = np.empty((len(samples), 3), c.dtype)
    io = np.full((len(samples), layout.IO_ROWS), np.nan, c.dtype)
    io[:, layout.IN_VOLTAGE], io[:, layout.IN_TEMPERATURE] = samples[:, 2], samples[:, 3]
    dt, current = (np.ascontiguousarray(samples[:, column]) for column in (0, 1))
    run, (params, state, *_) = entry.replay(estimator._form, bits), estimator._addresses

    def in_c() -> None:
        c.cell[:] = start_c
        c.raw.cell_replay(*c._one, len(samples), samples.ctypes.data, results.ctypes.data)

    def ours() -> None:
        estimator._state[:] = start
        run(params, state, io.ctypes.data, len(samples), dt.ctypes.data, current.ctypes.data)

    taken = medians([in_c, ours])
    assert np.abs(results[:, 0] - io[:, layout.OUT_SOC]).max() < (1e-9 if bits == 64 else 1e-4)
    return [1e9 * seconds / len(samples) for seconds in taken]


def ticks(hysteresis: bool, bits: int, cells: int) -> list[float]:
    """us a tick of C, called by ctypes, and of ours, each a call from Python; temperature and dt stay.

    One cell is a step of C's single cell: a block of C has 16.
    """
    cell = cell_of(hysteresis)
    c, drive = CKernel(cell, TUNING, bits, cells), Drive(cell, cells, faults=False)
    estimator = Estimator(cell, cells, TUNING, "f64" if bits == 64 else "f32")
    drive.begin(estimator)
    c.adopt(estimator)
    tick, addresses = estimator._tick, estimator._addresses
    own, theirs = estimator._io, c.io
    own[layout.IN_TEMPERATURE] = theirs[layout.IN_TEMPERATURE] = 25.0
    c_step, c_one, c_tick, c_all = c.raw.cell_step, c._one, c.raw.pack_tick, c._all
    taken: list[list[float]] = [[], []]
    for k in range(TICKS):
        own[layout.IN_VOLTAGE] = theirs[layout.IN_VOLTAGE] = drive.voltage[k]
        current, voltage = float(drive.current[k]), float(drive.voltage[k, 0])
        started = time.perf_counter()
        if cells == 1:
            c_step(*c_one, 1.0, current, voltage, 25.0)
        else:
            c_tick(*c_all, 1.0, current)
        between = time.perf_counter()
        tick(*addresses, 1.0, current)
        taken[0].append(between - started)
        taken[1].append(time.perf_counter() - between)
    in_c = c.soc if cells == 1 else theirs[layout.OUT_SOC]
    assert np.abs(own[layout.OUT_SOC] - in_c).max() < (1e-9 if bits == 64 else 1e-4)
    return [1e6 * float(np.median(times[50:])) for times in taken]


def test_the_kernel_beside_hand_written_c(capsys: pytest.CaptureFixture[str]) -> None:
    lines = [f"{'':34} {'C':>9} {'ours':>9} {'ratio':>6}"]
    ratios = {}
    for hysteresis in (False, True):
        for bits in (64, 32):
            name = f"n={6 + hysteresis}, float{bits}"
            rows = {f"replay, one cell, {name}, ns": replays(hysteresis, bits)}
            rows |= {f"tick, {cells} cells, {name}, us": ticks(hysteresis, bits, cells) for cells in (1, 96, 400)}
            for what, (in_c, ours) in rows.items():
                lines.append(f"{what:34} {in_c:9.2f} {ours:9.2f} {ours / in_c:6.2f}")
                ratios[what] = ours / in_c
    with capsys.disabled():
        print("\n" + "\n".join(lines))
    # Far from any of the goals: only what would be another algorithm, or scalar code for a pack, is a failure.
    assert max(ratios.values()) < 4, ratios


def test_start(capsys: pytest.CaptureFixture[str]) -> None:
    """Import to first step in a new process: on a machine that has never compiled the filter, and on one that has."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache}

        def seconds() -> float:
            command = [sys.executable, "-c", START]
            return float(subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout)

        cold, warm = seconds(), min(seconds() for _ in range(5))
    with capsys.disabled():
        print(f"\nimport to first step: {cold:.1f} s on a new machine, {warm:.2f} s after")
    assert warm < cold / 3
