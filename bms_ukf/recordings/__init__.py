"""Measured tests of a cell, from cycler files: read, checked and brought to the project's sign and units."""

from bms_ukf.recordings.checks import estimate_voltage_lag_s, require_sign
from bms_ukf.recordings.columns import Selection, read_columns
from bms_ukf.recordings.recording import Recording, Sign, read
from bms_ukf.recordings.resample import resample
from bms_ukf.recordings.units import require_units, require_voltage

__all__ = [
    "Recording",
    "Selection",
    "Sign",
    "estimate_voltage_lag_s",
    "read",
    "read_columns",
    "require_sign",
    "require_units",
    "require_voltage",
    "resample",
]
