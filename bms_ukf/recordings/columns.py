"""Finds the columns of a cycler file and brings them to the units of this project, whoever named them.

A header is a quantity and a unit: `voltage_V`, `Voltage / V`, `voltage_volt`, `Voltage [mV]` and `Voltage(V)` are the
same quantity. The Battery Data Format's names are covered in both spellings. What a file calls otherwise, a `Selection`
names; it also picks the rows of one test out of a file that holds several.
"""

from __future__ import annotations

import csv
import gzip
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bms_ukf.errors import ConfigError

Array = NDArray[np.float64]

# Names of a quantity, best first: what the cell's surface says comes before the chamber.
_NAMES: dict[str, tuple[str, ...]] = {
    "time_s": ("time", "test time", "t"),
    "current_A": ("current", "i"),
    "voltage_V": ("voltage", "terminal voltage", "v"),
    "temperature_degC": (
        "temperature",
        "surface temperature",
        "surface temperature t1",
        "cell temperature",
        "temperature t1",
        "ambient temperature",
        "chamber temperature",
    ),
    "ah": ("", "ah", "net capacity", "accumulated capacity", "accumulated charge"),
    "soc_ref": ("soc ref", "soc"),
    "hysteresis_V": (),  # only where `columns` names it: files mean half the width, or all of it
}
REQUIRED = ("time_s", "current_A", "voltage_V")

# Unit: the kind of quantity it measures, factor and offset to the project's unit.
_UNITS: dict[str, tuple[str, float, float]] = {
    **dict.fromkeys(("s", "sec", "second", "seconds"), ("time_s", 1.0, 0.0)),
    **dict.fromkeys(("ms", "millisecond", "milliseconds"), ("time_s", 1e-3, 0.0)),
    **dict.fromkeys(("min", "minute", "minutes"), ("time_s", 60.0, 0.0)),
    **dict.fromkeys(("h", "hour", "hours"), ("time_s", 3600.0, 0.0)),
    **dict.fromkeys(("a", "ampere", "amps"), ("current_A", 1.0, 0.0)),
    **dict.fromkeys(("ma", "milliampere"), ("current_A", 1e-3, 0.0)),
    **dict.fromkeys(("v", "volt", "volts"), ("voltage_V", 1.0, 0.0)),
    **dict.fromkeys(("mv", "millivolt"), ("voltage_V", 1e-3, 0.0)),
    **dict.fromkeys(("c", "degc", "°c", "celsius", "celcius"), ("temperature_degC", 1.0, 0.0)),
    **dict.fromkeys(("k", "kelvin"), ("temperature_degC", 1.0, -273.15)),
    **dict.fromkeys(("degf", "fahrenheit"), ("temperature_degC", 5 / 9, -160 / 9)),
    **dict.fromkeys(("ah", "ampere hour", "ampere hours"), ("ah", 1.0, 0.0)),
    **dict.fromkeys(("mah", "milliampere hour"), ("ah", 1e-3, 0.0)),
    **dict.fromkeys(("pct", "%", "percent"), ("soc_ref", 1e-2, 0.0)),
}
_HEADER = re.compile(r"^(?P<name>.*?)\s*(?:/\s*(?P<slash>[^/]+)|[\[(](?P<bracket>[^\])]+)[\])])$")


Cell = float | str


@dataclass(slots=True, frozen=True)
class Selection:
    """Which columns and rows of a file are meant.

    `columns` maps a quantity of `_NAMES` to the header that holds it, in the unit the header says, else in that of the
    quantity's name. `where` maps headers to the value, or one of the values, a row must have there.
    """

    columns: Mapping[str, str] = field(default_factory=dict)
    where: Mapping[str, Cell | Sequence[Cell]] = field(default_factory=dict)

    def require(self, path: Path, header: Sequence[str]) -> None:
        """Raise ConfigError if a header that is named is not there."""
        for option, titles in (("columns", self.columns.items()), ("where", ((title, title) for title in self.where))):
            for key, title in titles:
                if title not in header:
                    expected = f"one of the file's columns: {', '.join(header)}"
                    raise ConfigError(path, key=f"{option}.{key}", value=title, expected=expected)

    def __str__(self) -> str:
        """The chosen rows, in a few words: `cell=A7 Step=3|4`."""
        return " ".join(f"{title}={'|'.join(map(_text, _values(wanted)))}" for title, wanted in self.where.items())

    def rows(self, path: Path, cells: Mapping[str, Sequence[Any]]) -> NDArray[np.bool_]:
        """Which rows are meant, given the cells of the `where` columns. Raises ConfigError if there are none."""
        kept = np.ones(len(next(iter(cells.values()))), dtype=bool)
        for title, wanted in self.where.items():
            values = _values(wanted)
            matches = np.array([any(_same(cell, value) for value in values) for cell in cells[title]], dtype=bool)
            if not np.any(kept & matches):
                there = dict.fromkeys(str(cell) for cell, k in zip(cells[title], kept, strict=True) if k)
                expected = (
                    f"a value of that column: {', '.join([*list(there)[:12], *(['..'] if len(there) > 12 else [])])}"
                )
                raise ConfigError(path, key=f"where.{title}", value=wanted, expected=expected)
            kept &= matches
        return kept


EVERYTHING = Selection()


def read_columns(path: Path, selection: Selection = EVERYTHING, required: Iterable[str] = REQUIRED) -> dict[str, Array]:
    """The columns a recording is made of, by the names above; missing cells are NaN. CSV, gzipped CSV or Parquet.

    Raises ConfigError naming the file and what it lacks.
    """
    try:
        header, table = _parquet(path, selection) if path.suffix == ".parquet" else _csv(path, selection)
    except (OSError, EOFError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(path, expected=f"a readable CSV, CSV.gz or Parquet file ({error})") from None
    chosen = choose(header, selection)
    missing = [name for name in required if name not in chosen]
    if missing:
        expected = f"columns for {', '.join(required)}, with their units in the header or named under `columns`"
        raise ConfigError(path, key=missing[0], value=",".join(header), expected=expected)
    return {name: factor * table[column] + offset for name, (column, factor, offset) in chosen.items()}


def choose(header: Sequence[str], selection: Selection = EVERYTHING) -> dict[str, tuple[int, float, float]]:
    """For each quantity found: the index of its best column, factor and offset to the project's unit."""
    found: dict[str, tuple[int, int, float, float]] = {}
    for kind, title in selection.columns.items():
        if title in header:
            _, unit = _parse(title)
            found[kind] = (-1, header.index(title), *(unit[1:] if unit[0] == kind else (1.0, 0.0)))
    for column, title in enumerate(header):
        name, (kind, factor, offset) = _parse(title)
        if kind in _NAMES and name in _NAMES[kind]:
            rank = _NAMES[kind].index(name)
            if kind not in found or rank < found[kind][0]:
                found[kind] = (rank, column, factor, offset)
    return {kind: place[1:] for kind, place in found.items()}


def _values(wanted: Cell | Sequence[Cell]) -> list[Cell]:
    return [wanted] if isinstance(wanted, int | float | str) else list(wanted)


def _text(value: Cell) -> str:
    return value if isinstance(value, str) else f"{value:g}"


def _same(cell: Any, value: Cell) -> bool:
    """Whether a cell, as text or as what Parquet holds, is a value: numbers by their size, text by its letters."""
    if isinstance(value, str):
        return str(cell).strip() == value
    try:
        return float(cell) == value
    except (TypeError, ValueError):
        return False


def _parse(title: str) -> tuple[str, tuple[str, float, float]]:
    """Name and unit of a header; a name alone is taken for SoC as a fraction, if it says so."""
    text = " ".join(title.strip().lower().replace("_", " ").split())
    match = _HEADER.match(text)
    if match:
        unit = (match["slash"] or match["bracket"]).strip()
        return match["name"], _UNITS.get(unit, ("", 1.0, 0.0))
    words = text.split(" ")
    for count in (2, 1):
        unit = " ".join(words[-count:])
        if unit in _UNITS:
            return " ".join(words[:-count]), _UNITS[unit]
    return text, ("soc_ref", 1.0, 0.0)


def _csv(path: Path, selection: Selection) -> tuple[list[str], list[Array]]:
    opener = gzip.open if path.suffix == ".gz" else open
    with opener(path, "rt", newline="", encoding="utf-8-sig") as file:
        reader = csv.reader(file)
        header = next(reader, [])
        selection.require(path, header)
        wanted = sorted({column for column, _, _ in choose(header, selection).values()})
        body = file.read()
    if wanted and body.strip() and not selection.where:
        with suppress(ValueError):  # the fast way; an empty or odd cell takes the careful one
            fast = np.loadtxt(io.StringIO(body), delimiter=",", usecols=wanted, ndmin=2, comments=None)
            return header, [
                fast[:, wanted.index(column)] if column in wanted else np.empty(0) for column in range(len(header))
            ]
    rows = [row for row in csv.reader(io.StringIO(body)) if row]
    ragged = next((number for number, row in enumerate(rows, start=1) if len(row) != len(header)), None)
    if ragged is not None:
        cells = f"{len(header)} cells as in the header"
        raise ConfigError(path, key=f"row {ragged}", value=f"{len(rows[ragged - 1])} cells", expected=cells)
    if selection.where and rows:
        named = {title: [row[header.index(title)] for row in rows] for title in selection.where}
        rows = [row for row, kept in zip(rows, selection.rows(path, named), strict=True) if kept]
    columns = list(zip(*rows, strict=True)) if rows else [()] * len(header)
    return header, [
        _numbers(path, title, cells) if column in wanted else np.empty(0)
        for column, (title, cells) in enumerate(zip(header, columns, strict=True))
    ]


def _numbers(path: Path, title: str, cells: Sequence[str]) -> Array:
    """An empty cell is NaN; text is refused with its row."""
    try:
        return np.array([cell or "nan" for cell in cells]).astype(np.float64)
    except ValueError:
        for row, cell in enumerate(cells, start=1):
            try:
                float(cell or "nan")
            except ValueError:
                raise ConfigError(path, key=f"{title}, row {row}", value=cell, expected="a number") from None
        raise


def _parquet(path: Path, selection: Selection) -> tuple[list[str], list[Array]]:
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        raise ConfigError(path, expected="pyarrow installed to read Parquet: pip install 'bms-ukf[parquet]'") from None
    try:
        header = list(parquet.read_schema(path).names)
        selection.require(path, header)
        wanted = [header[column] for column, _, _ in choose(header, selection).values()]
        table = parquet.read_table(path, columns=list(dict.fromkeys([*wanted, *selection.where])))
        if selection.where:
            named = {title: table[title].to_pylist() for title in selection.where}
            table = table.filter(pa.array(selection.rows(path, named)))
        columns = {name: np.asarray(table[name].cast(pa.float64()).to_numpy(), dtype=np.float64) for name in wanted}
    except pa.ArrowException as error:
        raise ConfigError(path, expected=f"a Parquet file of numbers ({error})") from None
    return header, [columns.get(name, np.empty(0)) for name in header]
