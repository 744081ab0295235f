"""What a recording is made to test: the start that an estimator is told, and the error of its current sensor.

The cases are those of the blind benchmark of McMaster University (Kollmeyer et al., ITEC 2022), and a start-up case.
What an estimator is told of SoC has the same sigma in all of them: it cannot know which case it is in.

As in the benchmark, a wrong start is preceded by an hour without current, at the first voltage and temperature of what
follows. The hour gives the estimator time to find its start, and does not count. Ours are cut in the middle of a drive:
the held voltage is one under load or just after it, so the hour is a rest whose voltage has not recovered.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bms_ukf.offline.signals import Signals, Told
from bms_ukf.score.recorded import Recorded

Array = NDArray[np.float64]

NOMINAL, INITIAL, STARTUP, OFFSET = "nominal", "initial", "startup", "offset"
LEVELS = (0.9, 0.6, 0.3)
OFFSETS_A = (-0.3, -0.1, 0.1, 0.3)
TAKEN_FOR = 1.0  # the SoC that the benchmark's models take every start for
INITIAL_WEIGHTS = {0.9: 3.0, 0.6: 2.0, 0.3: 1.0}  # of the benchmark's three cuts; divided by their sum
PADDED_S = 3600.0  # before a cut
LEAST_S = 300.0  # of rows that count after a cut: no fewer, or no case


@dataclass(slots=True, frozen=True)
class Case:
    """One run of an estimator; arrays have a row a sample."""

    kind: str
    value: float  # SoC told or cut at, or the offset in A; 0 for the nominal case
    signals: Signals
    soc_ref: Array  # NaN: does not count
    told: Told
    padded: int = 0  # rows put before the recording's: figures and time begin after them

    @property
    def name(self) -> str:
        shown = {NOMINAL: "", OFFSET: f" {self.value:+g} A"}
        return self.kind + shown.get(self.kind, f" {self.value:g}")


def of(recorded: Recorded, sigma: float) -> Iterator[Case]:
    """Every case the recording can fill, wrong starts for drives only; `sigma` is that of every SoC told."""
    signals, start = recorded.signals, recorded.start_soc
    reference = np.where(recorded.counted, recorded.soc_ref, np.nan)
    yield Case(NOMINAL, 0.0, signals, reference, Told(start, sigma))
    for offset_A in OFFSETS_A:
        yield Case(OFFSET, offset_A, signals.with_errors(offset_A), reference, Told(start, sigma))
    if recorded.test.role == "charge":
        return
    for level in LEVELS:
        yield Case(STARTUP, level, signals, reference, Told(level, sigma))
        row = _reaches(recorded, level)
        if row is None or not _counts_for(signals.time_s[row:], reference[row:]) >= LEAST_S:
            continue
        padded, rows = _padded(signals.since(row))
        before = np.full(rows, np.nan)
        yield Case(INITIAL, level, padded, np.concatenate([before, reference[row:]]), Told(TAKEN_FOR, sigma), rows)


def _reaches(recorded: Recorded, level: float) -> int | None:
    """The first row at which SoC is down to `level` from above; None if there is none."""
    below = recorded.soc_ref <= level
    row = int(np.argmax(below))
    return row if row > 0 and below[row] else None


def _counts_for(time_s: Array, reference: Array) -> float:
    """Time in rows that count, s."""
    return float(np.diff(time_s, append=time_s[-1])[np.isfinite(reference)].sum())


def _padded(signals: Signals) -> tuple[Signals, int]:
    """The signals after `PADDED_S` without current at their first voltage and temperature, and the rows this adds."""
    step_s = float(np.median(np.diff(signals.time_s)))
    rows = int(np.ceil(PADDED_S / step_s))
    known = np.flatnonzero(np.isfinite(signals.voltage_V))
    first_V = signals.voltage_V[known[0]] if known.size else np.nan
    before = (
        signals.time_s[0] - step_s * np.arange(rows, 0, -1),
        np.zeros(rows),
        np.full(rows, first_V),
        np.full(rows, signals.temperature_degC[0]),
    )
    after = (signals.time_s, signals.current_A, signals.voltage_V, signals.temperature_degC)
    return Signals(*(np.concatenate(pair) for pair in zip(before, after, strict=True))), rows
