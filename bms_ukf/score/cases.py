"""What a recording is made to test: the start that an estimator is told, and the error of its current sensor.

The cases are those of the blind benchmark of McMaster University (Kollmeyer et al., ITEC 2022), and a start-up case.
What an estimator is told of SoC has the same sigma in all of them: it cannot know which case it is in.

The benchmark puts an hour of the first sample before each of its recordings. Ours are cut in the middle of a drive
where the benchmark's were made to begin at rest: an hour of such a sample would be a load that never was, or a rest
after which the voltage had not risen. So there is no such hour, and every row from the cut on counts.
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
LEAST_S = 300.0  # of rows that count after a cut: no fewer, or no case


@dataclass(slots=True, frozen=True)
class Case:
    """One run of an estimator; arrays have a row a sample."""

    kind: str
    value: float  # SoC told or cut at, or the offset in A; 0 for the nominal case
    signals: Signals
    soc_ref: Array  # NaN: does not count
    told: Told

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
        if row is not None and np.isfinite(reference[row:]).sum() >= LEAST_S / STEP_S:
            yield Case(INITIAL, level, signals.since(row), reference[row:], Told(TAKEN_FOR, sigma))


def _reaches(recorded: Recorded, level: float) -> int | None:
    """The first row at which SoC is down to `level` from above; None if there is none."""
    below = recorded.soc_ref <= level
    row = int(np.argmax(below))
    return row if row > 0 and below[row] else None
