"""Traces of real cells, from recordings that are not part of the project: those of the folder `BMS_UKF_DATA` names.

Their reference SoC is a cycler's count, with a sigma of its own, and their current and voltage are a cycler's too.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bms_ukf.campaign.traces import Trace
from bms_ukf.cell import CellParams
from bms_ukf.errors import ConfigError
from bms_ukf.manifest import DATA_FOLDER
from bms_ukf.recordings import read, require_sign, resample
from bms_ukf.resources import find

STEP_S = 1.0
SOAK_S = 120.0  # a cycler logs a soak at longer intervals than a drive: up to this one, its voltage is interpolated


class Recorded(NamedTuple):
    """A drive of a real cell. `cell` is its folder below the data folder, and the name of a shipped cell file."""

    cell: str
    file: str
    ambient_degC: float
    soc_ref_sigma: float
    voltage_lag_s: float = 0.0

    @property
    def name(self) -> str:
        return f"{self.cell}/{self.file}"


# The Panasonic's voltage column lags its current column by one sample of 0.1 s.
RECORDED = {
    recorded.name: recorded
    for recorded in (
        *(
            Recorded("panasonic_ncr18650pf", f"{prefix}degC_{drive}", ambient_degC, sigma, 0.1)
            for prefix, ambient_degC, sigma, drives in (
                ("25", 25.0, 0.01, ("Cycle_1", "Cycle_2", "US06", "HWFTa")),
                ("10", 10.0, 0.01, ("Cycle_1", "US06")),
                ("0", 0.0, 0.02, ("Cycle_1", "US06")),
                ("n10", -10.0, 0.03, ("Cycle_1", "US06")),
            )
            for drive in drives
        ),
        *(
            Recorded("a123_lfp", f"DYN_{suffix}", ambient_degC, 0.005)
            for suffix, ambient_degC in (("N15", -15.0), ("P05", 5.0), ("P25", 25.0), ("P45", 45.0))
        ),
    )
}


def missing() -> str | None:
    """Why there are no recordings here, in a sentence; None if all of them are there."""
    given = os.environ.get(DATA_FOLDER)
    if not given:
        return f"no recordings of real cells: {DATA_FOLDER} names no folder"
    absent = [name for name, recorded in RECORDED.items() if not _path(Path(given), recorded).is_file()]
    return f"no recordings of real cells: {', '.join(absent)} not in the folder {DATA_FOLDER} names" if absent else None


def load(name: str) -> Trace:
    """A recording of `RECORDED` in steps of a second, with all of its charge. Raises ConfigError if it is not there."""
    if name not in RECORDED:
        raise ConfigError(name, expected=f"one of the recordings {', '.join(RECORDED)}")
    if reason := missing():
        raise ConfigError(name, expected=reason)
    recorded = RECORDED[name]
    path = _path(Path(os.environ[DATA_FOLDER]), recorded)
    recording = read(path, current_positive="charge", temperature_degC=recorded.ambient_degC)
    require_sign(recording, "charge")
    if recorded.voltage_lag_s:
        recording = recording.with_voltage_lag(recorded.voltage_lag_s)
    even = resample(recording, STEP_S)
    if even.soc_ref is None:
        raise ConfigError(path, key="soc_ref", expected="this column: it is the truth")
    kept = _whole(even.voltage_V)
    cell = CellParams.load(find(recorded.cell, "cells", ".toml"))
    return Trace(
        name=name,
        plant=recorded.cell,
        cell=recorded.cell,
        kind="recorded",
        step_s=STEP_S,
        current_A=even.current_A[kept],
        voltage_V=_interpolated(even.voltage_V[kept])[:, None],
        temperature_degC=even.temperature_degC[kept],
        soc=even.soc_ref[kept, None],
        ambient_degC=recorded.ambient_degC,
        capacity_Ah=np.array([cell.cell.capacity_Ah]),
        aged=False,
        soc_ref_sigma=recorded.soc_ref_sigma,
    )


def _path(folder: Path, recorded: Recorded) -> Path:
    return folder.expanduser() / recorded.cell / f"{recorded.file}.csv.gz"


def _whole(voltage_V: NDArray[np.float64]) -> slice:
    """The longest stretch of rows without a hole longer than `SOAK_S`."""
    known = np.flatnonzero(np.isfinite(voltage_V))
    holes = np.flatnonzero(np.diff(known) * STEP_S > SOAK_S)
    begins, ends = known[np.append(0, holes + 1)], known[np.append(holes, known.size - 1)]
    longest = int(np.argmax(ends - begins))
    return slice(int(begins[longest]), int(ends[longest]) + 1)


def _interpolated(voltage_V: NDArray[np.float64]) -> NDArray[np.float64]:
    rows, known = np.arange(voltage_V.size), np.isfinite(voltage_V)
    return np.interp(rows, rows[known], voltage_V[known])
