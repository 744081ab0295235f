"""What a recording is made to test: the start that an estimator is told, and the error of its current sensor.

The cases are those of the blind benchmark of McMaster University (Kollmeyer et al., ITEC 2022), and a start-up case.
What an estimator is told of SoC has the same sigma in all of them: it cannot know which case it is in.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bms_ukf.offline.signals import Signals, Told
from bms_ukf.score.recorded import STEP_S, Recorded

Array = NDArray[np.float64]

NOMINAL, INITIAL, STARTUP, OFFSET = "nominal", "initial", "startup", "offset"
LEVELS = (0.9, 0.6, 0.3)
OFFSETS_A = (-0.3, -0.1, 0.1, 0.3)
TAKEN_FOR = 1.0  # the SoC that the benchmark's models take every start for
PAD_S = 3600  # of the first sample, before a recording that is cut: not scored
STANDSTILL_RATE_PER_H = 0.02  # a current that empties the cell in no less than 50 h: a pad of it moves 2 %
NEAR = 0.05  # of SoC: no standstill nearer to a level than this, no case
LEAST_S = 300.0  # of rows that count after a cut: no fewer, or no case


@dataclass(slots=True, frozen=True)
class Case:
    """One run of an estimator; arrays have a row a sample, those of the pad included."""

    kind: str
    value: float  # SoC told or cut at, or the offset in A; 0 for the nominal case
    signals: Signals
    soc_ref: Array  # NaN: does not count
    told: Told
    pad: int = 0  # rows before the recording

    @property
    def name(self) -> str:
        shown = {NOMINAL: "", OFFSET: f" {self.value:+g} A"}
        return self.kind + shown.get(self.kind, f" {self.value:g}")


def of(recorded: Recorded, capacity_Ah: float, sigma: float) -> Iterator[Case]:
    """Every case the recording can fill; wrong starts are for drives, as a charge has no standstill to begin at.

    `sigma` is that of every SoC told.
    """
    signals, start = recorded.signals, recorded.start_soc
    reference = np.where(recorded.counted, recorded.soc_ref, np.nan)
    yield Case(NOMINAL, 0.0, signals, reference, Told(start, sigma))
    for offset_A in OFFSETS_A:
        yield Case(OFFSET, offset_A, signals.with_errors(offset_A), reference, Told(start, sigma))
    if recorded.test.role == "charge":
        return
    for level in LEVELS:
        yield Case(STARTUP, level, signals, reference, Told(level, sigma))
        row = _standstill(recorded, level, capacity_Ah)
        if row is not None and np.isfinite(reference[row:]).sum() >= LEAST_S / STEP_S:
            yield _cut(recorded, row, level, reference, sigma)


def _standstill(recorded: Recorded, level: float, capacity_Ah: float) -> int | None:
    """The row nearest to `level` in SoC that is at rest, if the recording crosses it: a pad under load moves charge."""
    if not np.nanmin(recorded.soc_ref) <= level <= np.nanmax(recorded.soc_ref):
        return None
    still = np.abs(recorded.signals.current_A) <= STANDSTILL_RATE_PER_H * capacity_Ah
    usable = still & np.isfinite(recorded.signals.voltage_V) & np.isfinite(recorded.soc_ref)
    away = np.where(usable, np.abs(recorded.soc_ref - level), np.inf)
    row = int(np.argmin(away))
    return row if away[row] <= NEAR else None


def _cut(recorded: Recorded, row: int, level: float, reference: Array, sigma: float) -> Case:
    signals = recorded.signals
    pad = int(PAD_S / STEP_S)

    def padded(column: Array) -> Array:
        return np.concatenate([np.full(pad, column[row]), column[row:]])

    before_s = signals.time_s[row] - STEP_S * np.arange(pad, 0, -1)
    cut = Signals(
        np.concatenate([before_s, signals.time_s[row:]]),
        padded(signals.current_A),
        padded(signals.voltage_V),
        padded(signals.temperature_degC),
    )
    return Case(INITIAL, level, cut, padded(reference), Told(TAKEN_FOR, sigma), pad)
