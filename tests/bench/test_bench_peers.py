"""Time of one filter step from Python, beside published packages on the same cell (`peers`); `make bench`.

All contenders take turns in one run and are compared as ratios of medians, as machines are noisy.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable

import numpy as np
import peers
import pytest
from peers import CURRENT_A, DT_S, TEMPERATURE_DEGC

from bms_ukf import CellParams, Estimate, Estimator, Sample, Tuning
from bms_ukf.kernel import layout

pytestmark = pytest.mark.bench

STEPS, ROUNDS = 500, 15
TUNING = Tuning(initial_soc=0.7, initial_soc_sigma=0.2)
TRUE_SOC = 0.8  # at the start
TICK, STEP = "the tick that Estimator calls", "Estimator.step(sample, out=estimate)"
Contender = Callable[[CellParams, list[float]], tuple[float, float]]  # -> s for all readings, SoC after them


def discharge(cell: CellParams) -> tuple[list[float], float]:
    """The voltages that the model cell shows at each step, and its SoC after the last."""
    model = peers.Model(cell, TUNING)
    x = np.array([TRUE_SOC, 0.0, 0.0])
    readings = []
    for _ in range(STEPS):
        model.schedule(x[0])
        x = np.array(model.transition(x, DT_S))
        readings += model.measurement(x)
    return readings, float(x[0])


def low_level(cell: CellParams, readings: list[float]) -> tuple[float, float]:
    estimator = Estimator(cell, tuning=TUNING)
    row, dt = estimator._row, 0.0
    started = time.perf_counter()
    for voltage_V in readings:
        row[layout.IN_VOLTAGE], row[layout.IN_TEMPERATURE] = voltage_V, TEMPERATURE_DEGC
        estimator._tick(*estimator._addresses, dt, CURRENT_A)
        soc = row[layout.OUT_SOC]
        dt = DT_S
    return time.perf_counter() - started, soc


def public(cell: CellParams, readings: list[float]) -> tuple[float, float]:
    estimator = Estimator(cell, tuning=TUNING)
    estimate, sample = Estimate(), Sample(0, CURRENT_A, 0.0, TEMPERATURE_DEGC)
    started = time.perf_counter()
    for k, voltage_V in enumerate(readings):
        sample.t_ns, sample.voltage_V = k * 10**9, voltage_V
        estimator.step(sample, out=estimate)
    return time.perf_counter() - started, float(estimate.soc)


def stepped(make: type[peers.Peer], cell: CellParams, readings: list[float]) -> tuple[float, float]:
    peer = make(cell, TUNING)
    started = time.perf_counter()
    for voltage_V in readings:
        soc = peer.step(voltage_V)
    return time.perf_counter() - started, soc


@pytest.mark.filterwarnings("ignore:Please import:DeprecationWarning")  # bayesian-filters
def test_every_peer_finds_the_same_soc_and_filterpy_takes_fifty_ticks(
    cell: CellParams, capsys: pytest.CaptureFixture[str]
) -> None:
    readings, true_soc = discharge(cell)
    contenders: dict[str, Contender] = {TICK: low_level, STEP: public}
    missing = []
    for peer in peers.PEERS:
        if peers.version(peer) is None:
            missing.append(peer.package)
        else:
            contenders[peer.package] = functools.partial(stepped, peer)
    times: dict[str, list[float]] = {name: [] for name in contenders}
    ends: dict[str, float] = {}
    for _ in range(ROUNDS):
        for name, contender in contenders.items():
            seconds, ends[name] = contender(cell, readings)
            times[name].append(1e6 * seconds / STEPS)
    us = {name: float(np.median(values)) for name, values in times.items()}

    what = {peer.package: f"{peer.package} {peers.version(peer)} ({peer.kind})" for peer in peers.PEERS}
    with capsys.disabled():
        print(f"\n{'one step of one cell, from Python':38}{'us':>9}{'/ step':>9}{'/ tick':>9}   SoC ({true_soc:.5f})")
        for name, median in us.items():
            ratios = f"{median / us[STEP]:9.1f}{median / us[TICK]:9.1f}"
            print(f"{what.get(name, name):38}{median:9.2f}{ratios}   {ends[name]:.5f}")
        for name in missing:
            print(f"{name:38}  not installed")
    assert max(abs(soc - true_soc) for soc in ends.values()) < 0.01
    assert np.ptp(list(ends.values())) < 0.01
    assert "filterpy" in us, "filterpy, of the test extra, is what the tick is measured against"
    assert us["filterpy"] > 50 * us[TICK]
