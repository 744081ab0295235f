"""A recording: one test's time, current, voltage and temperature, with everything doubtful in it named.

Current is positive on discharge and is the mean over the interval that ends at its row, whatever the file holds.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bms_ukf.errors import ConfigError
from bms_ukf.recordings.columns import EVERYTHING, Selection, read_columns
from bms_ukf.recordings.edges import early_voltages

Array = NDArray[np.float64]
Hold = Literal["preceding", "following", "trapezoid"]
Sign = Literal["charge", "discharge"]

MISSING_SHARE = 0.02  # more rows than this without current or voltage: the file is broken, not interrupted
GAP_S = 600.0  # a longer interval says nothing of what flowed in it, unless a charge counter does
REPEATED_S = 1.0  # an interval so short that one current is as good as the other for its charge
EDGE_S = 0.05  # closer to the row before than this, and than a third of the usual interval: an extra record
REST_A = 0.02  # as a share of the largest current: below it a cell rests


@dataclass(slots=True)
class Recording:
    """One test. All columns have shape (n,); row k's current is the mean over (t[k-1], t[k]]."""

    name: str
    time_s: Array  # strictly increasing
    current_A: Array  # positive = discharge
    voltage_V: Array
    temperature_degC: Array
    drawn_Ah: Array  # charge drawn since the first row; from the file's own counter where it has one
    soc_ref: Array | None = None
    warnings: list[str] = field(default_factory=list)

    @property
    def step_s(self) -> Array:
        """Length of the interval that ends at each row; 0 at the first."""
        return np.diff(self.time_s, prepend=self.time_s[0])

    @property
    def after_gap(self) -> NDArray[np.bool_]:
        """Rows whose interval is so long that the file does not say what flowed in it."""
        return self.step_s > max(GAP_S, 20 * float(np.median(self.step_s)))

    @property
    def at_rest(self) -> NDArray[np.bool_]:
        """Rows without load."""
        return np.asarray(np.abs(self.current_A) <= REST_A * np.abs(self.current_A).max())

    def rows(self, kept: NDArray[np.int64] | NDArray[np.bool_] | slice) -> Recording:
        """The recording at some of its rows, each with the mean current of its longer interval."""
        time_s = self.time_s[kept]
        current_A = self.current_A[kept].copy()
        current_A[1:] = np.diff(np.cumsum(self.current_A * self.step_s)[kept]) / np.diff(time_s)
        return Recording(
            self.name,
            time_s,
            current_A,
            self.voltage_V[kept],
            self.temperature_degC[kept],
            self.drawn_Ah[kept],
            None if self.soc_ref is None else self.soc_ref[kept],
            self.warnings,
        )

    def with_voltage_lag(self, lag_s: float) -> Recording:
        """The recording with its voltage moved back by the time it lags the current."""
        voltage_V = np.interp(self.time_s + lag_s, self.time_s, self.voltage_V)
        fields = (self.temperature_degC, self.drawn_Ah, self.soc_ref, self.warnings)
        return Recording(self.name, self.time_s, self.current_A, voltage_V, *fields)


def read(
    path: Path,
    *,
    current_positive: Sign,
    current_hold: Hold = "preceding",
    temperature_degC: float | None = None,
    selection: Selection = EVERYTHING,
    restarts: bool = False,
) -> Recording:
    """The recording in a file, or in its selected rows. `temperature_degC` stands in for a column that is not there.

    With `restarts` a row at rest after a gap starts anew, with a SoC nobody counted; else what follows a gap under
    current is cut. Rows without a number, repeated rows and gaps are left out and named in `warnings`. Raises
    ConfigError for what cannot be mended: time running backwards, too many holes, no temperature.
    """
    columns = read_columns(path, selection)
    warnings: list[str] = []
    if "temperature_degC" not in columns:
        if temperature_degC is None:
            raise ConfigError(path, key="temperature_degC", expected="a column, or the temperature of the test")
        columns["temperature_degC"] = np.full_like(columns["time_s"], temperature_degC)
    columns = _without_holes(path, columns, warnings)
    columns = _without_repeats(path, columns, warnings)
    sign = 1.0 if current_positive == "discharge" else -1.0
    current_A = sign * _mean_over_preceding(columns["current_A"], current_hold)
    step_s = np.diff(columns["time_s"], prepend=columns["time_s"][0])
    drawn_Ah = np.cumsum(current_A * step_s) / 3600
    counter = columns.get("ah")
    counted = counter is not None and bool(np.isfinite(counter).all())
    if counter is not None and counted:
        drawn_Ah = sign * (counter - counter[0])
        long = step_s > GAP_S  # a counter is coarse, but knows what flowed in a gap
        current_A[long] = 3600 * np.diff(drawn_Ah, prepend=0.0)[long] / step_s[long]
    stem = path.name.removesuffix(".gz").removesuffix(path.suffix).removesuffix(".csv")
    recording = Recording(
        f"{stem} {selection}".strip(),
        columns["time_s"],
        current_A,
        columns["voltage_V"],
        columns["temperature_degC"],
        drawn_Ah,
        columns.get("soc_ref"),
        warnings,
    )
    early = np.flatnonzero(early_voltages(recording.current_A, recording.voltage_V, recording.at_rest))
    if early.size:
        recording.voltage_V[early] = recording.voltage_V[early - 1]
        warnings.append(
            f"{path.name}: {early.size} rests end with a voltage of the load that follows: that of the row before taken"
        )
    return recording if counted else _until_gap(recording, restarts=restarts)


def _without_holes(path: Path, columns: dict[str, Array], warnings: list[str]) -> dict[str, Array]:
    """Rows that lack time, current or voltage dropped; temperature between its neighbours."""
    whole = np.all([np.isfinite(columns[name]) for name in ("time_s", "current_A", "voltage_V")], axis=0)
    if np.count_nonzero(whole) < max(3, (1 - MISSING_SHARE) * whole.size):
        count = f"{np.count_nonzero(~whole)} of {whole.size}"
        expected = f"at least 3, and at most {100 * MISSING_SHARE:g} % without a number"
        raise ConfigError(path, key="rows with time, current or voltage missing", value=count, expected=expected)
    if not whole.all():
        warnings.append(f"{path.name}: {np.count_nonzero(~whole)} rows without time, current or voltage left out")
    columns = {name: column[whole] for name, column in columns.items()}
    known = np.isfinite(columns["temperature_degC"])
    if not known.any():
        raise ConfigError(path, key="temperature_degC", expected="a number in at least one row")
    if not known.all():
        unknown = np.count_nonzero(~known)
        warnings.append(
            f"{path.name}: temperature missing in {unknown} rows of {known.size}: taken from their neighbours"
        )
    rows = np.arange(known.size)
    columns["temperature_degC"] = np.interp(rows, rows[known], columns["temperature_degC"][known])
    return columns


def _without_repeats(path: Path, columns: dict[str, Array], warnings: list[str]) -> dict[str, Array]:
    """One row for each time; a time before that of the row before is refused."""
    step_s = np.diff(columns["time_s"])
    if np.any(step_s < 0):
        row = int(np.argmax(step_s < 0)) + 1
        before, after = columns["time_s"][row - 1 : row + 1]
        raise ConfigError(path, key=f"time_s, row {row + 1}", value=float(after), expected=f"a time after {before:g}")
    new = np.concatenate([[True], step_s > 0])
    first = np.flatnonzero(new)
    last = np.append(first[1:], new.size) - 1
    # Of rows at one time the first ends the old step and the last begins the new: between them, cyclers write voltages
    # that are not those of their currents. After a longer interval the first alone knows what current flowed in it.
    kept = np.where(np.diff(columns["time_s"][first], prepend=-np.inf) <= REPEATED_S, last, first)
    if not new.all():
        warnings.append(f"{path.name}: {np.count_nonzero(~new)} rows at the time of another left out")
    # Records of a step's edge, between two regular ones, pair the current of one step with the voltage of the other.
    interval_s = np.diff(columns["time_s"][kept])
    if kept.size > 1:
        edge = np.concatenate([[False], interval_s < min(EDGE_S, float(np.median(interval_s)) / 3)])
        if edge.any():
            warnings.append(f"{path.name}: {np.count_nonzero(edge)} rows at the edge of a step left out")
        kept = kept[~edge]
    if kept.size < 3:
        raise ConfigError(path, expected="at least three rows at different times")
    return {name: column[kept] for name, column in columns.items()}


def _mean_over_preceding(current_A: Array, hold: Hold) -> Array:
    previous = np.concatenate([current_A[:1], current_A[:-1]])
    return {"preceding": current_A, "following": previous, "trapezoid": (previous + current_A) / 2}[hold]


def _until_gap(recording: Recording, *, restarts: bool) -> Recording:
    """Cut before the first gap under current in which nobody knows what flowed; nothing flows where it starts anew."""
    at_rest = recording.at_rest
    if restarts:
        anew = recording.after_gap & at_rest
        recording.drawn_Ah -= np.cumsum(np.where(anew, recording.current_A * recording.step_s, 0.0)) / 3600
        recording.current_A[anew] = 0.0
    else:
        at_rest = at_rest & np.concatenate([[True], at_rest[:-1]])
    unknown = recording.after_gap & ~at_rest
    if not unknown.any():
        return recording
    row = int(np.argmax(unknown))
    gap_s = recording.step_s[row]
    recording.warnings.append(
        f"{recording.name}: cut at {recording.time_s[row - 1]:.0f} s, before a gap of {gap_s:.0f} s under current"
    )
    if row < 3:
        raise ConfigError(recording.name, key=f"time_s, row {row + 1}", value=gap_s, expected="no gap under current")
    return recording.rows(slice(0, row))
