"""The recordings a manifest has to score, as the estimators see them: 1 Hz, sign and lag put right, without soak."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bms_ukf import manifest
from bms_ukf.errors import ConfigError
from bms_ukf.manifest import Manifest, MeasuredTest
from bms_ukf.offline.signals import Signals
from bms_ukf.recordings import Recording, estimate_voltage_lag_s, read, require_sign, resample

Array = NDArray[np.float64]

STEP_S = 1.0
SCORED_ROLES = ("drive", "charge")


@dataclass(slots=True, frozen=True)
class Recorded:
    """One test at 1 Hz; arrays of shape (n,)."""

    test: MeasuredTest
    name: str  # of the recording, and the part of it that counts
    signals: Signals
    soc_ref: Array
    counted: NDArray[np.bool_]  # rows of the test's `part`

    @property
    def start_soc(self) -> float:
        """SoC at the first row, by the manifest or the reference."""
        known = np.flatnonzero(np.isfinite(self.soc_ref))
        return float(self.soc_ref[known[0]]) if self.test.initial_soc is None else self.test.initial_soc


def load(path: Path, tests: Manifest, test: MeasuredTest) -> Recording:
    """A test of the manifest at `path`: sign checked, voltage lag removed, leading soak cut."""
    sign = test.current_positive or tests.current_positive
    recording = read(
        manifest.find(path, test.file),
        current_positive=sign,
        current_hold=test.current_hold,
        temperature_degC=test.temperature_degC,
    )
    require_sign(recording, sign)
    lag_s = estimate_voltage_lag_s(recording) if test.voltage_lag_s == "estimate" else test.voltage_lag_s
    if lag_s:
        recording = recording.with_voltage_lag(lag_s)
    # Hours of soak before the load would be scored as hours without an error.
    loaded = np.abs(recording.current_A) > 0.01 * np.abs(recording.current_A).max()
    return recording.rows(slice(max(int(np.argmax(loaded)) - 1, 0), None))


def sample(recording: Recording, test: MeasuredTest, name: str) -> Recorded:
    """The recording at 1 Hz. It has to have a reference SoC."""
    first, last = (np.array(test.part) * (recording.time_s.size - 1)).round().astype(np.int64)
    begin_s, end_s = recording.time_s[[first, last]]
    even = resample(recording, STEP_S)
    if even.soc_ref is None or not np.isfinite(even.soc_ref).any():
        raise ConfigError(test.file, key="soc_ref", expected="this column: there is nothing to score against")
    part = "" if test.part == [0.0, 1.0] else " {:.0f}-{:.0f} %".format(*(100 * edge for edge in test.part))
    counted = (even.time_s >= begin_s) & (even.time_s <= end_s)
    return Recorded(test, name + part, Signals.of(even), even.soc_ref, counted)
