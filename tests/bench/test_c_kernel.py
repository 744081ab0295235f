"""The C kernel is the same filter as the Python one: else its time says nothing."""

from __future__ import annotations

import numpy as np
import pytest
from bench_drive import STEPS, TUNING, Drive, cell_of, tick
from c_kernel import CKernel

from bms_ukf import Estimator, Fault
from bms_ukf.kernel import layout

pytestmark = pytest.mark.bench

PACK = 37  # two blocks and a part of one
TOLERANCE = {64: 1e-9, 32: 1e-4}
SHOWN = [layout.OUT_SOC, layout.OUT_SOC_SIGMA, layout.OUT_SOC_LOW, layout.OUT_SOC_HIGH, layout.OUT_BIAS, layout.OUT_R0]
VARIANTS = pytest.mark.parametrize(("hysteresis", "bits"), [(False, 64), (False, 32), (True, 64), (True, 32)])


def begun(hysteresis: bool, bits: int, cells: int) -> tuple[Estimator, CKernel, Drive]:
    """Both filters at the same narrow belief, and the drive that goes on from there."""
    cell = cell_of(hysteresis)
    drive = Drive(cell, cells)
    estimator, in_c = Estimator(cell, cells, TUNING, f"f{bits}"), CKernel(cell, TUNING, bits, cells)
    drive.begin(estimator)
    in_c.adopt(estimator)
    return estimator, in_c, drive


@VARIANTS
def test_a_cell_in_c_follows_the_estimator(hysteresis: bool, bits: int) -> None:
    estimator, single, drive = begun(hysteresis, bits, 1)
    samples, start = drive.samples, single.cell.copy()
    expected, codes = np.empty((STEPS, 3)), np.empty((STEPS, 2), int)
    for k, sample in enumerate(samples.tolist()):
        codes[k] = tick(estimator, *sample), single.step(*sample)
        expected[k] = estimator._io[[layout.OUT_SOC, layout.OUT_SOC_SIGMA, layout.OUT_NIS], 0]
    single.cell[:] = start
    replayed = single.replay(samples)
    assert np.array_equal(codes[:, 0], codes[:, 1])
    assert np.array_equal(np.isnan(expected[:, 2]), np.isnan(replayed[:, 2]))
    np.testing.assert_allclose(replayed[:, :2], expected[:, :2], rtol=0, atol=TOLERANCE[bits])
    np.testing.assert_allclose(replayed[:, 2], expected[:, 2], rtol=1e-2 if bits == 32 else 1e-6, atol=1e-3)


@VARIANTS
def test_a_pack_in_c_follows_the_estimator(hysteresis: bool, bits: int) -> None:
    estimator, pack, drive = begun(hysteresis, bits, PACK)
    for k in range(STEPS):
        code = tick(estimator, drive.dt[k], drive.current[k], drive.voltage[k], drive.temperature[k])
        pack.io[layout.IN_VOLTAGE], pack.io[layout.IN_TEMPERATURE] = drive.voltage[k], drive.temperature[k]
        assert pack.tick(drive.dt[k], drive.current[k]) == code
        np.testing.assert_allclose(pack.io[SHOWN], estimator._io[SHOWN], rtol=0, atol=TOLERANCE[bits])
        np.testing.assert_array_equal(pack.io[layout.OUT_CODE], estimator._io[layout.OUT_CODE])


@VARIANTS
def test_ticks_in_c_and_from_python_end_alike(hysteresis: bool, bits: int) -> None:
    estimator, pack, drive = begun(hysteresis, bits, PACK)
    replayed = CKernel(estimator.cell, TUNING, bits, PACK)
    replayed.adopt(estimator)
    for dt, current, measured in zip(drive.dt, drive.current, drive.measured, strict=True):
        pack.io[: layout.IN_TEMPERATURE + 1] = measured
        pack.tick(dt, current)
    replayed.replay_pack(np.column_stack([drive.dt, drive.current]), drive.measured)
    np.testing.assert_array_equal(replayed.pack, pack.pack)


@VARIANTS
def test_what_overflows_in_c_is_refused_whole(hysteresis: bool, bits: int) -> None:
    estimator, single, drive = begun(hysteresis, bits, 1)
    estimator._state[0, estimator._form.root + 2] = 1e200 if bits == 64 else 1e30  # sqrt_P[1, 1]
    single.adopt(estimator)
    results = -8  # they come last
    before = single.cell[:results].copy()
    code = tick(estimator, *drive.samples[0])
    assert single.step(*drive.samples[0]) == code
    assert code & Fault.NUMERIC
    np.testing.assert_array_equal(single.cell[:results], before)
