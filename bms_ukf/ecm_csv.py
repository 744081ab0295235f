"""Reads one CSV file of an equivalent circuit's tables: header, numbers, grid, each checked for what it can be.

The last column is the quantity, in the unit of its title; the columns before it are what it depends on.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bms_ukf import plausible
from bms_ukf.errors import ConfigError

Array = NDArray[np.float64]

OVER = ("Temperature [degC]", "Current [A]", "SoC")
LEAST_AND_MOST = {"R": (1e-9, 1e3), "C": (1e-6, 1e12)}  # Ohm, F: within them, no product over- or underflows


@dataclass(slots=True)
class Table:
    """A quantity on a grid: shape (temperatures, currents, SoC), 1 along what it does not depend on."""

    path: Path
    axes: list[Array]
    values: Array


def header(path: Path) -> list[str]:
    """Titles of a file's columns. Raises ConfigError if the last is no quantity of a circuit in its unit."""
    try:
        with path.open(encoding="utf-8-sig") as file:
            first = file.readline()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(path, expected=f"a readable CSV file ({error})") from None
    titles = [title.strip() for title in first.lstrip("# ").strip().split(",")]
    if not re.fullmatch(r"R\d \[Ohm\]|C\d \[F\]|OCV \[V\]|dUdT \[V/K\]", titles[-1]):
        expected = "'R0 [Ohm]', 'R1 [Ohm]', 'C1 [F]' .., 'OCV [V]' or 'dUdT [V/K]' in the last column"
        raise ConfigError(path, key="header", value=titles[-1], expected=expected)
    return titles


def load(path: Path, over: Sequence[str]) -> tuple[list[str], Array]:
    """Titles of the columns before the last, which must be of `over`, and all numbers, in the units of the titles."""
    titled = header(path)
    titles, of = titled[:-1], titled[-1]
    unknown = [title for title in titles if title not in over or titles.count(title) > 1]
    if unknown:
        raise ConfigError(path, key="header", value=unknown[0], expected=f"columns of {', '.join(over)}, each once")
    if not titles:
        raise ConfigError(path, key="header", value=of, expected=f"before it a column of {', '.join(over)}, at least")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # that there are no rows
            numbers = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2, comments=None)
    except ValueError as error:
        raise ConfigError(path, expected=f"numbers below the header ({error})") from None
    if not numbers.size or numbers.shape[1] != len(titled) or not np.isfinite(numbers).all():
        raise ConfigError(path, expected=f"rows below the header, with {len(titled)} finite numbers in each")
    for title, column in zip(titled, numbers.T, strict=True):
        _require_unit(path, title, column)
    return titles, numbers


def _require_unit(path: Path, title: str, column: Array) -> None:
    """Raise ConfigError for a column that its title's unit rules out for cells of any size."""
    if title == "SoC" and column.max() > plausible.MOST_SOC:
        raise ConfigError(path, key=title, value=float(column.max()), expected="fractions of 1: is it in percent?")
    if title == "Temperature [degC]" and column.min() > plausible.HOTTEST_DEGC:
        raise ConfigError(path, key=title, value=float(column.min()), expected="degC: is it in K?")
    if title == "OCV [V]":
        require(path, title, float(np.median(column)), plausible.VOLTAGE_V)
    if title[1].isdigit():  # a resistance or a capacitance
        least, most = LEAST_AND_MOST[title[0]]
        wrong = column[~((column >= least) & (column <= most))]
        if wrong.size:
            raise ConfigError(path, key=title, value=float(wrong[0]), expected=f"{least:g} to {most:g} in every row")


def require(path: Path, key: str, value: float, span: plausible.Range, of: str = "") -> None:
    """Raise ConfigError for a value outside a range; `of` says what the range is for."""
    doubt = span.doubt(value, of)
    if doubt:
        raise ConfigError(path, key=key, value=float(f"{value:.4g}"), expected=doubt)


def table(path: Path, over: Sequence[str] = OVER) -> Table:
    """A full grid. Raises ConfigError if a combination is missing or given twice."""
    titles, numbers = load(path, over)
    axes = [np.unique(numbers[:, titles.index(t)]) if t in titles else np.zeros(1) for t in over]
    places = [
        np.searchsorted(axis, numbers[:, titles.index(t)]) for t, axis in zip(over, axes, strict=True) if t in titles
    ]
    values = np.full([axis.size for axis, t in zip(axes, over, strict=True) if t in titles], np.nan)
    values[tuple(places)] = numbers[:, -1]
    if np.isnan(values).any() or values.size != len(numbers):
        expected = f"one row for each combination of {', '.join(titles)}: {values.size}"
        raise ConfigError(path, key="rows", value=len(numbers), expected=expected)
    return Table(path, axes, values.reshape([axis.size for axis in axes]))
