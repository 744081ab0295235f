"""One recording through one estimator: its trace and the figures that `bms-ukf replay --json` writes.

| key | meaning |
|---|---|
| `recording`, `cell`, `estimator` | what was run |
| `n`, `duration_s`, `steps_per_s` | samples, their time, and how many a second the estimator took |
| `final_soc`, `soc_sigma_final`, `soc_low_final`, `soc_high_final` | at the last sample; null: none could be defended |
| `warnings` | what was doubtful in the recording |

To them come those of `replay.ageing`. With a reference SoC, also what `metrics.score` documents: errors in % SoC over
all rows and under `after_600s`.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bms_ukf import metrics
from bms_ukf.cell import CellParams
from bms_ukf.errors import ConfigError
from bms_ukf.offline.estimators import followed, prepare
from bms_ukf.offline.signals import Signals, Told
from bms_ukf.offline.start import begins_at_rest
from bms_ukf.pack import Health
from bms_ukf.recordings import Recording, Sign, read, require_sign, require_units, resample
from bms_ukf.replay.ageing import ageing
from bms_ukf.trace import Trace
from bms_ukf.tuning import Tuning

RECORDINGS = (".csv", ".csv.gz", ".parquet")
CAN_LOGS = (".log", ".asc", ".blf", ".trc", ".mf4")  # candump -L, Vector's two, PEAK's, ASAM's
FLIGHT = ".flight"  # of the flight recorder


@dataclass(slots=True, frozen=True)
class Options:
    """How a recording is read, and what is done to it before an estimator sees it. Current is positive on discharge.

    Of a CAN log all that is the configuration's.
    """

    current_positive: Sign | None = None  # None: for CAN logs only
    temperature_degC: float | None = None  # for a recording without a temperature
    voltage_lag_s: float = 0.0
    resample_s: float | None = None
    current_offset_A: float = 0.0
    current_gain: float = 1.0
    voltage_offset_V: float = 0.0
    initial_soc: float | None = None  # None: from the first voltage
    initial_sigma: float | None = None
    soc_ref_sigma: float = 0.0
    estimator: str = "srukf"
    health: bool = True  # of srukf; see `pack.Health`
    force: bool = False  # run a recording that does not fit the cell


def load(path: Path, options: Options, cell: CellParams | None = None) -> Recording:
    """The recording at `path`, its sign checked, lag removed, resampled. Raises ConfigError.

    One whose numbers do not fit `cell` is refused, too, but with `options.force`.
    """
    if options.current_positive is None:
        raise ConfigError("--current-positive", expected=f"charge or discharge, for {path}")
    recording = read(path, current_positive=options.current_positive, temperature_degC=options.temperature_degC)
    if cell is not None and not options.force:
        limits = cell.cell
        require_units(recording, limits.voltage_limits_V, limits.capacity_Ah, hint=" (--force runs it)")
    require_sign(recording, options.current_positive)
    if options.voltage_lag_s:
        recording = recording.with_voltage_lag(options.voltage_lag_s)
    return resample(recording, options.resample_s) if options.resample_s else recording


def rerun(
    recording: Recording, cell: CellParams, options: Options, tuning: Tuning | None = None
) -> tuple[Trace, dict[str, Any]]:
    """The estimate at every row of a recording, and the summary."""
    sensors = tuning or Tuning()
    signals = Signals.of(recording).with_errors(
        options.current_offset_A, options.current_gain, options.voltage_offset_V
    )
    warnings = list(recording.warnings)
    told = None
    if options.initial_soc is not None:
        told = Told(options.initial_soc, options.initial_sigma or sensors.initial_soc_sigma)
    elif not begins_at_rest(cell, signals):
        warnings.append(f"{recording.name}: does not begin at rest: SoC starts from a voltage under load")
    run = prepare(options.estimator, cell, sensors)
    run(signals.rows(slice(0, 2)), told)  # compiles
    begin_s = time.perf_counter()
    health: Health | None = None
    if options.estimator == "srukf" and options.health:
        columns, health = followed(cell, sensors, signals, told)
    else:
        columns = run(signals, told)
    took_s = time.perf_counter() - begin_s
    inputs = {
        "current_A": signals.current_A,
        "voltage_V": signals.voltage_V,
        "temperature_degC": signals.temperature_degC,
    }
    soc_ref = np.full(signals.time_s.size, math.nan) if recording.soc_ref is None else recording.soc_ref
    trace = Trace.of(signals.t_ns, {**columns, **inputs, "soc_ref": soc_ref})
    summary = {
        "recording": recording.name,
        "cell": cell.cell.name,
        "estimator": options.estimator,
        "n": len(trace),
        "duration_s": float(signals.time_s[-1] - signals.time_s[0]),
        "steps_per_s": len(trace) / took_s,
        "final_soc": _known(trace["soc"][-1]),
        "soc_sigma_final": _known(trace["soc_sigma"][-1]),
        "soc_low_final": _known(trace["soc_low"][-1]),
        "soc_high_final": _known(trace["soc_high"][-1]),
        "warnings": warnings,
    }
    summary |= ageing(health)
    if np.isfinite(soc_ref).any():
        summary |= metrics.score(trace.t_s, trace["soc"], trace.interval, soc_ref, options.soc_ref_sigma)
    return trace, summary


def difference(first: Trace, second: Trace) -> dict[str, float | None]:
    """How far two runs over the same rows are apart: second minus first, in % SoC; None where either has no SoC."""
    apart_pct = 100 * (second["soc"] - first["soc"])
    apart_pct = apart_pct[np.isfinite(apart_pct)]
    if not apart_pct.size:
        return dict.fromkeys(("mean_pct", "rms_pct", "max_pct"))
    return {
        "mean_pct": float(apart_pct.mean()),
        "rms_pct": float(np.sqrt(np.mean(apart_pct**2))),
        "max_pct": float(np.abs(apart_pct).max()),
    }


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
