"""Reads a time series from a CSV, and says what is wrong with it."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bms_ukf.errors import ConfigError

Array = NDArray[np.float64]


def read_series(path: Path, column: str) -> tuple[Array, Array]:
    """The columns `time_s` and `column` of a CSV: at least two rows, finite, time increasing. Others are ignored.

    Raises ConfigError naming the file, the column and the row (the header is row 0).
    """
    with path.open(newline="", encoding="utf-8-sig") as file:
        try:
            reader = csv.DictReader(file)
            missing = [name for name in ("time_s", column) if name not in (reader.fieldnames or ())]
            if missing:
                header = f"a header row with the columns time_s,{column}"
                raise ConfigError(path, key=missing[0], value=",".join(reader.fieldnames or ()), expected=header)
            rows = [(row["time_s"], row[column]) for row in reader]
        except UnicodeDecodeError:
            raise ConfigError(path, expected=f"a text file with the columns time_s,{column}") from None
    time_s = _numbers(path, "time_s", (row[0] for row in rows))
    value = _numbers(path, column, (row[1] for row in rows))
    if time_s.size < 2:
        raise ConfigError(path, value=f"{time_s.size} rows", expected="at least two rows below the header")
    if not np.all(np.diff(time_s) > 0):
        row_index = int(np.argmin(np.diff(time_s) > 0)) + 1
        expected = f"a time after that of the row before, {time_s[row_index - 1]:g}"
        raise ConfigError(path, key=f"time_s, row {row_index + 1}", value=float(time_s[row_index]), expected=expected)
    return time_s, value


def _numbers(path: Path, column: str, texts: Iterable[str | None]) -> Array:
    numbers = []
    for row, text in enumerate(texts, start=1):
        try:
            number = float(text or "")
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise ConfigError(path, key=f"{column}, row {row}", value=text, expected="a finite number")
        numbers.append(number)
    return np.array(numbers)
