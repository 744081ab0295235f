"""The C kernel is the same filter as the Python one: else its time says nothing. Then how long each takes."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest
import synthetic_cell
from c_kernel import CKernel

from bms_ukf import CellParams, Estimator, Fault, Sample, Tuning
from bms_ukf.kernel import layout

pytestmark = pytest.mark.bench

STEPS, PACK = 2000, 37  # two blocks and a part of one
TOLERANCE = {64: 1e-9, 32: 1e-4}
TUNING = Tuning(initial_soc=0.8, initial_soc_sigma=0.01)  # never so wide as to need the quadrature, which C has not
VARIANTS = pytest.mark.parametrize(("hysteresis", "bits"), [(False, 64), (False, 32), (True, 64), (True, 32)])


def cell_of(hysteresis: bool) -> CellParams:
    data = synthetic_cell.nonlinear()
    if hysteresis:
        max_V = [[0.020, 0.015, 0.010]]
        data["hysteresis"] = {"soc": [0.0, 0.5, 1.0], "temperature_degC": [25.0], "max_V": max_V, "rate": 20.0}
        data["noise"]["hysteresis_sigma_V"] = 0.003
    return synthetic_cell.cell_of(data)


class Drive:
    """Steps of current and temperature, sampled at 1 s with some faster, coinciding and missing samples.

    Temperature moves by half a kelvin or not at all: the single C cell has no cache of its dynamics.
    """

    def __init__(self, cell: CellParams, cells: int, faults: bool = True) -> None:
        random = np.random.default_rng(1)
        self.dt = np.ones(STEPS)
        self.dt[0] = 0.0
        self.current = np.repeat(random.uniform(-4, 8, STEPS // 20), 20)
        temperature = 25 + np.repeat(random.integers(-10, 10, STEPS // 50) / 2, 50)
        soc = np.clip(0.8 - np.cumsum(self.current) / (3600 * cell.cell.capacity_Ah), 0, 1)
        ocv = [float(cell.ocv_V(*at)) for at in zip(soc, temperature, strict=True)]
        rest = np.array(ocv) - 0.03 * self.current
        self.voltage = rest[:, None] + random.normal(0, 0.003, (STEPS, cells))
        self.temperature = np.repeat(temperature[:, None], cells, axis=1)
        if faults:
            self.dt[100:200], self.dt[400:410] = 0.1, 0.0
            self.dt[300] = 7.0  # longer than a current counts
            self.voltage[500:520] = np.nan
            self.voltage[600], self.voltage[1300:1320] = (
                self.voltage[600] + 0.5,
                self.voltage[1300:1320] + 0.3,
            )  # refused
            self.current[700:705], self.current[1400:1412] = np.nan, np.nan
            self.temperature[800:900] = np.nan
            self.voltage[1200], self.current[1500], self.temperature[1600] = 9.0, 1e4, 400.0  # implausible

    @property
    def samples(self) -> np.ndarray:
        """(n, 4) of the first cell, as `CKernel.replay` takes them."""
        return np.column_stack([self.dt, self.current, self.voltage[:, 0], self.temperature[:, 0]])

    @property
    def measured(self) -> np.ndarray:
        """(n, 2, cells), as `CKernel.replay_pack` takes them."""
        return np.stack([self.voltage, self.temperature], axis=1)


@VARIANTS
def test_a_cell_in_c_follows_the_estimator(hysteresis: bool, bits: int) -> None:
    cell = cell_of(hysteresis)
    samples = Drive(cell, 1).samples
    estimator, single = Estimator(cell, tuning=TUNING, precision=f"f{bits}"), CKernel(cell, TUNING, bits)
    expected, codes = np.empty((STEPS, 3)), np.empty((STEPS, 2), int)
    t_ns = np.cumsum(np.round(samples[:, 0] * 1e9)).astype(int)
    for k, (dt, *measured) in enumerate(samples.tolist()):
        estimate = estimator.step(Sample(int(t_ns[k]), *measured))
        expected[k] = estimate.soc, estimate.soc_sigma, estimate.nis
        codes[k] = estimator._code, single.step(dt, *measured)
    single.reset()
    replayed = single.replay(samples)
    assert np.array_equal(codes[:, 0], codes[:, 1])
    assert np.array_equal(np.isnan(expected[:, 2]), np.isnan(replayed[:, 2]))
    np.testing.assert_allclose(replayed[:, :2], expected[:, :2], rtol=0, atol=TOLERANCE[bits])
    np.testing.assert_allclose(replayed[:, 2], expected[:, 2], rtol=1e-2 if bits == 32 else 1e-6, atol=1e-3)


@VARIANTS
def test_a_pack_in_c_follows_the_estimator(hysteresis: bool, bits: int) -> None:
    cell = cell_of(hysteresis)
    drive = Drive(cell, PACK)
    estimator = Estimator(cell, PACK, TUNING, f"f{bits}")
    pack = CKernel(cell, TUNING, bits, PACK)
    shown = [layout.OUT_SOC, layout.OUT_SOC_SIGMA]
    t_ns = 0
    for k in range(STEPS):
        t_ns += round(drive.dt[k] * 1e9)
        estimator.step(Sample(t_ns, drive.current[k], drive.voltage[k], drive.temperature[k]))
        pack.io[layout.IN_VOLTAGE], pack.io[layout.IN_TEMPERATURE] = drive.voltage[k], drive.temperature[k]
        assert pack.tick(drive.dt[k], drive.current[k]) == estimator._code
        np.testing.assert_allclose(pack.io[shown], estimator._io[shown], rtol=0, atol=TOLERANCE[bits])
        np.testing.assert_array_equal(pack.io[layout.OUT_CODE], estimator._io[layout.OUT_CODE])


@VARIANTS
def test_ticks_in_c_and_from_python_end_alike(hysteresis: bool, bits: int) -> None:
    cell = cell_of(hysteresis)
    drive = Drive(cell, PACK)
    pack, replayed = CKernel(cell, TUNING, bits, PACK), CKernel(cell, TUNING, bits, PACK)
    for dt, current, measured in zip(drive.dt, drive.current, drive.measured, strict=True):
        pack.io[: layout.IN_TEMPERATURE + 1] = measured
        pack.tick(dt, current)
    replayed.replay_pack(np.column_stack([drive.dt, drive.current]), drive.measured)
    np.testing.assert_array_equal(replayed.pack, pack.pack)


@VARIANTS
def test_what_overflows_in_c_is_refused_whole(hysteresis: bool, bits: int) -> None:
    cell = cell_of(hysteresis)
    estimator, single = Estimator(cell, tuning=TUNING, precision=f"f{bits}"), CKernel(cell, TUNING, bits)
    estimator.step(Sample(0, 1.0, 3.6, 25.0))
    single.step(0.0, 1.0, 3.6, 25.0)
    n = 3 + hysteresis
    in_c, results = 8 + n + n + 1, -4  # sqrt_P[1, 1]; what was held comes first, and the results last
    root = estimator._state[0, estimator._form.root + 2]
    assert root[0] == pytest.approx(single.cell[in_c], rel=1e-5)
    root[0] = single.cell[in_c] = 1e200 if bits == 64 else 1e30
    before = single.cell[:results].copy()
    estimator.step(Sample(10**9, 1.0, 3.6, 25.0))
    assert single.step(1.0, 1.0, 3.6, 25.0) == estimator._code
    assert estimator._code & Fault.NUMERIC
    np.testing.assert_array_equal(single.cell[:results], before)


def test_time_of_a_step_in_c(capsys: pytest.CaptureFixture[str]) -> None:
    rows = []
    for hysteresis in (False, True):
        cell = cell_of(hysteresis)
        for bits in (64, 32):
            single, samples = CKernel(cell, TUNING, bits), Drive(cell, 1, faults=False).samples
            times = [ns_per_step(single, lambda single=single, samples=samples: single.replay(samples), 1)]
            for cells in (96, 400):
                pack, drive = CKernel(cell, TUNING, bits, cells), Drive(cell, cells, faults=False)
                steps = np.column_stack([drive.dt, drive.current]).astype(pack.dtype)
                measured = drive.measured.astype(pack.dtype)
                run = lambda pack=pack, steps=steps, measured=measured: pack.replay_pack(steps, measured)  # noqa: E731
                times.append(ns_per_step(pack, run, cells))
            rows.append((3 + hysteresis, bits, *times))
    with capsys.disabled():
        print(f"\n{'C, ns per step of a cell':26} {'alone':>8} {'96 cells':>9} {'400 cells':>9}")
        for n, bits, *times in rows:
            print(f"{f'{n} states, float{bits}':26} {times[0]:8.0f} {times[1]:9.1f} {times[2]:9.1f}")
    assert all(time > 1 for _, _, *times in rows for time in times)  # ns: a loop that ran nothing takes less


def ns_per_step(kernel: CKernel, run: Callable[[], object], cells: int, rounds: int = 9) -> float:
    times = []
    for _ in range(rounds):
        kernel.reset()
        started = time.perf_counter()
        run()
        times.append(time.perf_counter() - started)
    return 1e9 * float(np.median(times)) / STEPS / cells
