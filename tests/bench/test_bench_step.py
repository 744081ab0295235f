"""Time of one filter step from Python, beside filterpy's UKF on the same cell: `make bench` prints the table.

All contenders are measured in turn in one run and compared as ratios of medians, as machines are noisy.
Nothing here is a pass mark except that the contenders agree on the SoC.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np
import pytest
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from bms_ukf import CellParams, Estimate, Estimator, Sample, Tuning
from bms_ukf.kernel import entry, layout

pytestmark = pytest.mark.bench

STEPS, ROUNDS = 500, 15
CURRENT_A, TEMPERATURE_DEGC = 2.0, 25.0


class FilterpyCell:
    """The same equivalent circuit, noise and weights in filterpy, with the callbacks as lean as Python allows."""

    def __init__(self, cell: CellParams, tuning: Tuning) -> None:
        estimator = Estimator(cell, tuning=tuning)
        self._params = estimator._params
        address = self._params.ctypes.data
        p = self._params
        points = MerweScaledSigmaPoints(3, alpha=tuning.alpha, beta=tuning.beta, kappa=tuning.kappa)
        charge = p[layout.P_CHARGE_COULOMB]

        def fx(x: np.ndarray, dt: float) -> np.ndarray:
            soc, v1, v2 = x
            return np.array([soc - dt * CURRENT_A / charge, self.a1 * v1 + self.c1, self.a2 * v2 + self.c2])

        def hx(x: np.ndarray) -> np.ndarray:
            soc, v1, v2 = x
            drop = CURRENT_A * entry.dynamics(address, soc, TEMPERATURE_DEGC, 0)
            return np.array([entry.ocv(address, soc, TEMPERATURE_DEGC) - v1 - v2 - drop])

        self.filter = UnscentedKalmanFilter(3, 1, 1.0, hx, fx, points)
        self.filter.x = np.array([tuning.initial_soc, 0.0, 0.0])
        self.filter.P = np.diag([tuning.initial_soc_sigma**2, 1e-4, 1e-4])
        self.filter.R *= p[layout.P_VAR_VOLTAGE]
        self._address = address

    def step(self, voltage_V: float) -> float:
        soc, p = self.filter.x[0], self._params
        r1, tau1, r2, tau2 = (entry.dynamics(self._address, soc, TEMPERATURE_DEGC, k) for k in (1, 2, 3, 4))
        self.a1, self.a2 = math.exp(-1 / tau1), math.exp(-1 / tau2)
        self.c1, self.c2 = r1 * CURRENT_A * (1 - self.a1), r2 * CURRENT_A * (1 - self.a2)
        q1, q2 = ((1 - self.a1**2) * p[layout.P_VAR_RC], (1 - self.a2**2) * p[layout.P_VAR_RC2])
        self.filter.Q = np.diag([p[layout.P_SOC_WALK_OFFSET], q1, q2])
        self.filter.predict()
        self.filter.update(voltage_V)
        return float(self.filter.x[0])


def test_step_time_beside_filterpy(capsys: pytest.CaptureFixture[str]) -> None:
    cell = CellParams.load("lgm50_chen2020")
    tuning = Tuning(initial_soc=0.7, initial_soc_sigma=0.2)
    charge = 3600 * cell.cell.capacity_Ah
    voltages = cell.ocv_V(0.8 - np.arange(STEPS) * CURRENT_A / charge, TEMPERATURE_DEGC) - 0.05 * CURRENT_A
    readings = voltages.tolist()
    ends: dict[str, float] = {}
    estimator = Estimator(cell, tuning=tuning)

    def public() -> None:
        estimator.reset()
        estimate, sample = Estimate(), Sample(0, CURRENT_A, 0.0, TEMPERATURE_DEGC)
        for k, voltage_V in enumerate(readings):
            sample.t_ns, sample.voltage_V = k * 10**9, voltage_V
            estimator.step(sample, out=estimate)
        ends["Estimator.step(sample, out=estimate)"] = float(estimate.soc)

    def low_level() -> None:
        estimator.reset()
        params, state = estimator._params_address, estimator._state_address
        buffer = memoryview(estimator._state.reshape(-1).data)
        held = layout.held_offset(entry.N)
        buffer[held + layout.H_INPUT_TEMPERATURE] = TEMPERATURE_DEGC
        dt = 0.0
        for voltage_V in readings:
            buffer[held + layout.H_INPUT_VOLTAGE] = voltage_V
            entry.tick(params, state, 1, dt, CURRENT_A)
            dt = 1.0
        ends["kernel.entry.tick"] = buffer[layout.SOC]

    def filterpy() -> None:
        peer = FilterpyCell(cell, tuning)
        for voltage_V in readings:
            end = peer.step(voltage_V)
        ends["filterpy UKF"] = end

    contenders: dict[str, Callable[[], None]] = {
        "kernel.entry.tick": low_level,
        "Estimator.step(sample, out=estimate)": public,
        "filterpy UKF": filterpy,
    }
    times: dict[str, list[float]] = {name: [] for name in contenders}
    for _ in range(ROUNDS):
        for name, contender in contenders.items():
            started = time.perf_counter()
            contender()
            times[name].append((time.perf_counter() - started) / STEPS)
    medians = {name: float(np.median(values)) for name, values in times.items()}
    with capsys.disabled():
        print(f"\n{'one step of one cell, from Python':40} {'us':>8} {'ratio':>8}   SoC at the end")
        for name, median in medians.items():
            print(f"{name:40} {1e6 * median:8.2f} {median / medians['kernel.entry.tick']:8.1f}   {ends[name]:.5f}")
    assert np.ptp(list(ends.values())) < 0.01
