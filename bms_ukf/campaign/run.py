"""Runs one situation through the daemon's own core: frames in, published sets out, with the daemon's own settings.

Frames are encoded by the project's DBC and decoded again, so that scale, limits and E2E are those of the bus. The
published sets are kept as arrays.
"""

from __future__ import annotations

import math
from array import array
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bms_ukf.campaign.situation import Situation
from bms_ukf.cell import CellParams
from bms_ukf.config import Bus, Config, Setup
from bms_ukf.core import Core
from bms_ukf.node import SampleEncoder
from bms_ukf.records import Detail, Estimate, Sample
from bms_ukf.tuning import Tuning

Array = NDArray[np.float64]
SECOND_NS = 1_000_000_000
COVERED_K = 2.0  # beyond the tables by less is within the specification of a temperature sensor


class Published(NamedTuple):
    """Every set that the daemon published, and the truth at its time."""

    t_s: Array  # (sets,)
    soc: Array  # (sets, cells) NaN: none published
    low: Array  # (sets, cells)
    high: Array  # (sets, cells)
    status: NDArray[np.int64]  # (sets,)
    faults: NDArray[np.int64]  # (sets,)
    truth: Array  # (sets, cells)
    silent: NDArray[np.bool_]  # (sets,) True while the bus was silent
    ref_sigma: float  # one sigma of the truth
    flat: bool  # an LFP cell, whose voltage hardly depends on SoC
    covered: bool  # the cell file's tables hold the temperature


class _Witness:
    """Keeps what is published."""

    def __init__(self) -> None:
        self.t_ns, self.words, self.values = array("q"), array("q"), array("d")

    def stepped(self, sample: Sample, estimate: Estimate) -> None:
        """Steps are kept when they are published."""

    def coasted(self, t_ns: int, estimate: Estimate) -> None:
        """So are predictions."""

    def published(self, t_ns: int, estimate: Estimate, detail: Detail) -> None:
        self.t_ns.append(t_ns)
        self.words.extend((int(estimate.status), int(estimate.faults)))
        for values in (estimate.soc, estimate.soc_low, estimate.soc_high):
            if isinstance(values, float):
                self.values.append(values)
            else:
                self.values.frombytes(values.tobytes())


def run(situation: Situation) -> Published:
    """Run the daemon's core over a situation, from its first row to its last."""
    core, cell = _core(situation)
    witness = core.witness = _Witness()
    encoder = SampleEncoder(situation.cells)
    t_ns = np.rint(situation.t_s * SECOND_NS).astype(np.int64).tolist()
    current_A, degC = situation.current_A.tolist(), situation.temperature_degC.tolist()
    several = situation.cells > 1
    voltage_V = list(situation.voltage_V) if several else situation.voltage_V[:, 0].tolist()
    for k, is_silent in enumerate(situation.silent.tolist()):
        now_ns = t_ns[k]
        if is_silent:
            core.idle(now_ns)
            continue
        for identifier, extended, data in encoder.encode(Sample(now_ns, current_A[k], voltage_V[k], degC[k])):
            core.hear(identifier, extended, data, now_ns)
    tables_degC, flat = cell.dynamics.temperature_degC, "LFP" in cell.cell.chemistry.upper()
    covered = tables_degC[0] - COVERED_K <= situation.true_degC <= tables_degC[-1] + COVERED_K
    return _published(situation, witness, flat, covered)


def _core(situation: Situation) -> tuple[Core, CellParams]:
    config = Config(
        format=1,
        cell=situation.cell,
        cells=situation.cells,
        bus=Bus(interface="direct", channel="campaign"),
        estimator=Tuning(**situation.tuning),
        **situation.config,
    )
    setup = Setup(config, Path("campaign"))
    estimator = setup.estimator()
    return Core(estimator, setup.intake(), setup.pace, setup.health(estimator)), setup.cell


def _published(situation: Situation, witness: _Witness, flat: bool, covered: bool) -> Published:
    t_s = np.frombuffer(witness.t_ns, dtype=np.int64) / SECOND_NS if witness.t_ns else np.empty(0)
    words = np.array(witness.words, dtype=np.int64).reshape(-1, 2)
    soc, low, high = np.array(witness.values).reshape(-1, 3, situation.cells).transpose(1, 0, 2)
    truth = np.stack([np.interp(t_s, situation.t_s, column) for column in situation.soc.T], axis=1)
    row = np.minimum(np.searchsorted(situation.t_s, t_s - 1e-6), situation.t_s.size - 1)
    return Published(
        t_s,
        soc,
        low,
        high,
        words[:, 0],
        words[:, 1],
        truth,
        situation.silent[row],
        situation.soc_ref_sigma,
        flat,
        covered,
    )


def judged(published: Published) -> NDArray[np.intp]:
    """Return the sets that count: one a second at most, and of a silence some 300, however long it lasts."""
    t_s, silent = published.t_s, published.silent
    count = max(int(silent.sum()), 1)
    every_s = np.where(silent, max(1.0, count * _usual_step_s(t_s[silent]) / 300), 1.0)
    kept, last_s = [], -math.inf
    for k, (time_s, apart_s) in enumerate(zip(t_s.tolist(), every_s.tolist(), strict=True)):
        if time_s - last_s >= apart_s - 1e-3:
            kept.append(k)
            last_s = time_s
    return np.array(kept, dtype=np.intp)


def _usual_step_s(t_s: Array) -> float:
    return float(np.median(np.diff(t_s))) if t_s.size > 1 else 1.0
