"""The C kernel is the same filter as the Python one: else its time says nothing."""

from __future__ import annotations

import numpy as np
import pytest
from bench_drive import STEPS, TUNING, Drive, cell_of
from c_kernel import CKernel

from bms_ukf import Estimator, Fault, Sample
from bms_ukf.kernel import layout

pytestmark = pytest.mark.bench

PACK = 37  # two blocks and a part of one
TOLERANCE = {64: 1e-9, 32: 1e-4}
VARIANTS = pytest.mark.parametrize(("hysteresis", "bits"), [(False, 64), (False, 32), (True, 64), (True, 32)])


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
    shown = [layout.OUT_SOC, layout.OUT_SOC_SIGMA, layout.OUT_SOC_LOW, layout.OUT_SOC_HIGH, layout.OUT_R0]
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
    in_c, results = 19 + n + n + 1, -8  # sqrt_P[1, 1]; what was held comes first, and the results last
    root = estimator._state[0, estimator._form.root + 2]
    assert root[0] == pytest.approx(single.cell[in_c], rel=1e-5)
    root[0] = single.cell[in_c] = 1e200 if bits == 64 else 1e30
    before = single.cell[:results].copy()
    estimator.step(Sample(10**9, 1.0, 3.6, 25.0))
    assert single.step(1.0, 1.0, 3.6, 25.0) == estimator._code
    assert estimator._code & Fault.NUMERIC
    np.testing.assert_array_equal(single.cell[:results], before)
