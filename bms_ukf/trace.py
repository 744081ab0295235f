"""One run, row by row: what was measured, what was estimated, and what was true if that is known; also as CSV.

| column | meaning |
|---|---|
| `time_s` | time of the sample |
| `soc`, `soc_sigma` | estimate, 0..1; its 95 % interval is 3.92 `soc_sigma` wide |
| `voltage_pred_V` | terminal voltage predicted before the measured one was fused |
| `innovation_V`, `nis` | measured minus predicted; its square over its variance |
| `status`, `faults` | words of `records.Status` and `records.Fault`, faults joined by a bar |
| `soc_ref` | true or reference SoC, 0..1 |
| `current_A`, `voltage_V`, `temperature_degC` | what the estimator got; positive = discharge |
| `current_true_A`, `voltage_true_V`, `temperature_true_degC` | what the plant gave, before the sensors |
| `current_bias_A`, `r0_ohm`, `soh` | what the estimator has learnt of the sensor and the cell, where it does |
| `soc_low`, `soc_high` | 95 % interval of SoC, 0..1: of a pack the smallest and the largest bound of its cells |

In a CSV a missing value is an empty field. A column from `soc_ref` to `soh` is left out if all its values are missing.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bms_ukf.errors import ConfigError
from bms_ukf.records import NAN, Estimate, Fault, Sample, Status

_ESTIMATED = ("soc", "soc_sigma", "voltage_pred_V", "innovation_V", "nis")
_OPTIONAL = (
    "soc_ref",
    "current_A",
    "voltage_V",
    "temperature_degC",
    "current_true_A",
    "voltage_true_V",
    "temperature_true_degC",
    "current_bias_A",
    "r0_ohm",
    "soh",
)
_INTERVAL = ("soc_low", "soc_high")
_NUMBERS = _ESTIMATED + _OPTIONAL + _INTERVAL
_APPENDED = _NUMBERS.index("current_bias_A") + 1
_UNKNOWN = Sample(0)


class Trace:
    """Columns for the rows of one cell, `capacity` at first; `trace["soc"]` is a view of shape (rows so far,).

    Number columns are float64 with NaN for missing. `status` and `faults` are integer columns of the records' values.
    """

    def __init__(self, capacity: int) -> None:
        self._n = 0
        self._t_ns = np.empty(capacity, dtype=np.int64)
        self._numbers = np.full((capacity, len(_NUMBERS)), NAN)
        self._words = np.empty((capacity, 2), dtype=np.int64)

    @classmethod
    def of(cls, t_ns: NDArray[np.int64], columns: Mapping[str, NDArray[Any]]) -> Trace:
        """A whole run at once: `status`, `faults` and whatever number columns there are; others are ignored."""
        trace = cls(t_ns.size)
        trace._n = t_ns.size
        trace._t_ns[:] = t_ns
        trace._words[:, 0], trace._words[:, 1] = columns["status"], columns["faults"]
        for j, name in enumerate(_NUMBERS):
            if name in columns:
                trace._numbers[:, j] = columns[name]
        return trace

    def __len__(self) -> int:
        return self._n

    @property
    def t_ns(self) -> NDArray[np.int64]:
        return self._t_ns[: self._n]

    @property
    def t_s(self) -> NDArray[np.float64]:
        return np.asarray(self.t_ns * 1e-9, dtype=np.float64)

    @property
    def status(self) -> NDArray[np.int64]:
        return self._words[: self._n, 0]

    @property
    def faults(self) -> NDArray[np.int64]:
        return self._words[: self._n, 1]

    def __getitem__(self, column: str) -> NDArray[np.float64]:
        return self._numbers[: self._n, _NUMBERS.index(column)]

    @property
    def interval(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lower and upper bound of SoC, 0..1; NaN in rows without a SoC."""
        return self["soc_low"], self["soc_high"]

    def append(self, sample: Sample, estimate: Estimate, soc_ref: float = NAN, true: Sample = _UNKNOWN) -> None:
        """Add a row stamped by `sample`. `true` holds the plant's own values. Views taken before may not show it."""
        row = self._n
        if row == self._t_ns.size:
            self._grow(2 * row + 1)
        self._t_ns[row] = sample.t_ns
        self._numbers[row, :_APPENDED] = (
            estimate.soc,
            estimate.soc_sigma,
            estimate.voltage_pred_V,
            estimate.innovation_V,
            estimate.nis,
            soc_ref,
            sample.current_A,
            sample.voltage_V,
            sample.temperature_degC,
            true.current_A,
            true.voltage_V,
            true.temperature_degC,
            estimate.current_bias_A,
        )
        self._numbers[row, -2:] = estimate.soc_low, estimate.soc_high
        self._words[row] = estimate.status, estimate.faults
        self._n = row + 1

    def _grow(self, capacity: int) -> None:
        larger = Trace(capacity)
        larger._t_ns[: self._n], larger._numbers[: self._n] = self._t_ns, self._numbers
        larger._words[: self._n] = self._words
        self._t_ns, self._numbers, self._words = larger._t_ns, larger._numbers, larger._words

    def columns(self) -> dict[str, NDArray[np.float64] | list[str]]:
        """What a file holds, by column: `time_s`, numbers as they are, `status` and `faults` in words."""
        last = [name for name in _OPTIONAL if np.isfinite(self[name]).any()]
        last += _INTERVAL
        words: dict[str, NDArray[np.float64] | list[str]] = {
            "status": [Status(value).word for value in self.status.tolist()],
            "faults": [_fault_words(value) for value in self.faults.tolist()],
        }
        estimated = {name: self[name] for name in _ESTIMATED}
        return {"time_s": self.t_ns / 1e9} | estimated | words | {name: self[name] for name in last}

    def write_csv(self, path: Path) -> None:
        """Write all rows, numbers with 9 significant digits. Raises ConfigError if `path` cannot be written."""
        columns = self.columns()
        time_s = [f"{t_s:.15g}" for t_s in np.asarray(columns.pop("time_s")).tolist()]
        texts = [values if isinstance(values, list) else _texts(values) for values in columns.values()]
        try:
            with path.open("w", newline="", encoding="utf-8") as file:
                writer = csv.writer(file, lineterminator="\n")
                writer.writerow(["time_s", *columns])
                writer.writerows(zip(time_s, *texts, strict=True))
        except OSError as error:
            raise ConfigError(path, expected=f"a file that can be written ({error.strerror})") from None

    @classmethod
    def read_csv(cls, path: Path) -> Trace:
        """Read what `write_csv` wrote. Raises ConfigError naming file, column and row (the header is row 0)."""
        with path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            rows = list(reader)
            missing = [n for n in ("time_s", *_ESTIMATED, "status", "faults") if n not in (reader.fieldnames or ())]
        if missing:
            raise ConfigError(path, key=missing[0], expected="this column in the header row")
        trace = cls(len(rows))
        for k, row in enumerate(rows):
            try:
                column = "time_s"
                trace._t_ns[k] = round(float(row[column]) * 1e9)
                column = "status"
                trace._words[k, 0] = Status[row[column].upper()]
                column = "faults"
                trace._words[k, 1] = sum(Fault[word.upper()] for word in row[column].split("|") if word)
                for j, column in enumerate(_NUMBERS):
                    trace._numbers[k, j] = float(row.get(column) or NAN)
            except (ValueError, KeyError, AttributeError):
                expected = "a number, a status word or fault words as this program writes them"
                raise ConfigError(path, key=f"{column}, row {k + 1}", value=row[column], expected=expected) from None
        trace._n = len(rows)
        return trace


def _texts(column: NDArray[np.float64]) -> list[str]:
    return ["" if math.isnan(value) else f"{value:.9g}" for value in column.tolist()]


@cache
def _fault_words(faults: int) -> str:
    return "|".join(fault.name.lower() for fault in Fault if fault.name and fault & faults)
