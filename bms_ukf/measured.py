"""The recording of a manifest's test: its own columns and rows, sign checked, voltage lag removed, soak cut."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bms_ukf import manifest
from bms_ukf.manifest import Manifest, MeasuredTest
from bms_ukf.recordings import Recording, Selection, estimate_voltage_lag_s, read, require_sign, require_units


def load(path: Path, tests: Manifest, test: MeasuredTest, *, force: bool = False) -> Recording:
    """A test of the manifest at `path`. Raises ConfigError for a file that cannot be used.

    One whose numbers do not fit the manifest's cell is refused, too, but with `force`.

    It begins with the load: hours of soak are neither to be fitted nor to be scored as hours without an error.
    """
    sign = test.current_positive or tests.current_positive
    recording = read(
        manifest.find(path, test.file),
        current_positive=sign,
        current_hold=test.current_hold,
        temperature_degC=test.temperature_degC,
        selection=Selection(test.columns.named(), test.where),
        restarts=test.initial_soc == "rest",
    )
    if not force:
        require_units(recording, tests.voltage_limits_V, tests.capacity_Ah)
    require_sign(recording, sign)
    lag_s = estimate_voltage_lag_s(recording) if test.voltage_lag_s == "estimate" else test.voltage_lag_s
    if lag_s:
        recording = recording.with_voltage_lag(float(lag_s))
        if test.voltage_lag_s == "estimate":
            recording.warnings.append(f"{recording.name}: voltage found to lag the current by {lag_s:.3f} s")
    loaded = np.abs(recording.current_A) > 0.01 * np.abs(recording.current_A).max()
    return recording.rows(slice(max(int(np.argmax(loaded)) - 1, 0), None))
