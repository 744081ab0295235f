"""The recordings a manifest has to score, as the estimators see them: sign and lag put right, without soak."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bms_ukf.errors import ConfigError
from bms_ukf.manifest import MeasuredTest
from bms_ukf.offline.signals import Signals
from bms_ukf.recordings import Recording, resample

Array = NDArray[np.float64]

STEP_S = 1.0  # the benchmark's
SCORED_ROLES = ("drive", "charge")


@dataclass(slots=True, frozen=True)
class Recorded:
    """One test at the rate that is scored; arrays of shape (n,)."""

    test: MeasuredTest
    name: str  # of the recording, and the part of it that counts
    signals: Signals
    soc_ref: Array
    counted: NDArray[np.bool_]  # rows of the test's `part`

    @property
    def start_soc(self) -> float:
        """SoC at the first row, by the manifest or the reference."""
        known = np.flatnonzero(np.isfinite(self.soc_ref))
        told = self.test.initial_soc
        return float(self.soc_ref[known[0]]) if told is None or told == "rest" else told


def sample(recording: Recording, test: MeasuredTest, name: str, step_s: float | None = STEP_S) -> Recorded:
    """The recording with a row each `step_s`, or with the rows it has (None). It has to have a reference SoC."""
    first, last = (np.array(test.part) * (recording.time_s.size - 1)).round().astype(np.int64)
    begin_s, end_s = recording.time_s[[first, last]]
    even = recording if step_s is None else resample(recording, step_s)
    if even.soc_ref is None or not np.isfinite(even.soc_ref).any():
        raise ConfigError(test.file, key="soc_ref", expected="this column: there is nothing to score against")
    part = "" if test.part == [0.0, 1.0] else " {:.0f}-{:.0f} %".format(*(100 * edge for edge in test.part))
    counted = (even.time_s >= begin_s) & (even.time_s <= end_s)
    return Recorded(test, name + part, Signals.of(even), even.soc_ref, counted)
