"""What a cell more costs a pack: a step, an update of the pack's quantities, memory; `make bench` prints it."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest

from bms_ukf import CellParams, Estimator, Sample
from bms_ukf.pack import Health, Pack

pytestmark = pytest.mark.bench

SIZES = (96, 400, 1000, 4000, 10000)
STEPS = 60


def median_s(run: Callable[[], object]) -> float:
    times = []
    for _ in range(STEPS):
        started = time.perf_counter()
        run()
        times.append(time.perf_counter() - started)
    return float(np.median(times))


def after(sample: Sample) -> Sample:
    sample.t_ns += 1_000_000_000
    return sample


def test_a_pack_costs_what_its_cells_cost(capsys: pytest.CaptureFixture[str]) -> None:
    cell = CellParams.load("lgm50_chen2020")
    lines = [f"{'cells':>6} {'step, us':>10} {'tick, ns/cell':>14} {'pack, us':>9} {'health, us':>11} {'B/cell':>7}"]
    per_cell = {}
    for cells in SIZES:
        estimator = Estimator(cell, cells)
        pack, health = Pack(estimator), Health(estimator)
        sample = Sample(0, 1.0, 3.8 + 0.01 * np.random.default_rng(0).standard_normal(cells), 25.0)
        out = estimator.step(sample)

        stepped = median_s(lambda e=estimator, s=sample, o=out: e.step(after(s), o))
        ticked = median_s(lambda e=estimator: e._tick(*e._addresses, 1.0, 1.0))
        told = median_s(lambda p=pack, s=sample, o=out: p.update(o, s))
        followed = median_s(lambda h=health, s=sample, o=out: h.follow(after(s), o))
        size = estimator._state.nbytes + estimator._io.nbytes + pack._rows.nbytes
        per_cell[cells] = ticked / cells
        figures = f"{cells:6} {1e6 * stepped:10.1f} {1e9 * per_cell[cells]:14.1f} {1e6 * told:9.0f}"
        lines.append(f"{figures} {1e6 * followed:11.1f} {size / cells:7.0f}")
    with capsys.disabled():
        print("\n" + "\n".join(lines))
    assert per_cell[10000] < 5 * per_cell[400], "more than leaving the cache costs"
