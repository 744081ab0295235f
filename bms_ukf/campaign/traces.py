"""Base traces of the campaign: what a plant did under an open-loop load, stored small and read back whole.

A file of `models/campaign` holds all traces of one plant: LZMA over a NumPy archive, headers in JSON and the columns of
each trace as differences of integers. Current and time are exact; voltage, temperature and SoC are rounded.
"""

from __future__ import annotations

import io
import json
import lzma
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bms_ukf import resources
from bms_ukf.errors import ConfigError

SUFFIX = ".xz"
CURRENT_A, VOLTAGE_V, TEMPERATURE_K, SOC = 1e-3, 1e-4, 1e-2, 1e-5  # quanta

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


class Trace(NamedTuple):
    """One run of a plant, open-loop and without sensor errors; it starts at equilibrium.

    Row k is at (k + 1) `step_s` after the start, and its current is the mean over the step that ends there. All cells
    of a pack share the current. SoC is the charge above empty at 25 degC over the present capacity.
    """

    name: str  # plant/what
    plant: str
    cell: str  # the cell file that was identified from this plant: a name for `cell_file`
    kind: str  # of load: rest_then_drive, constant, charge, mixed, long_rest
    step_s: float
    current_A: Array  # (rows,), positive = discharge
    voltage_V: Array  # (rows, cells)
    temperature_degC: Array  # (rows,), the cells' mean
    soc: Array  # (rows, cells), 0..1
    ambient_degC: float
    capacity_Ah: Array  # (cells,), present
    aged: bool  # capacity and resistance are not those of the cell file
    soc_ref_sigma: float  # of the reference SoC: 0 for a plant

    @property
    def rows(self) -> int:
        return len(self.current_A)

    @property
    def cells(self) -> int:
        return int(self.soc.shape[1])


def plants() -> list[str]:
    """The plants that have committed traces, sorted."""
    return resources.names("campaign", SUFFIX)


def names(plant: str | None = None) -> list[str]:
    """The committed traces, of one plant or of all."""
    return [name for each in ([plant] if plant else plants()) for name in _file(each)[0]]


def load(name: str) -> Trace:
    """A committed trace by its name, `plant/what`. Raises ConfigError for a name that does not exist."""
    plant = name.partition("/")[0]
    if plant not in plants():
        raise ConfigError(name, expected=f"a trace of one of the plants {', '.join(plants())}")
    headers, columns = _file(plant)
    if name not in headers:
        raise ConfigError(name, expected=f"one of the traces {', '.join(headers)}")
    return _decoded(name, headers[name], columns)


def cell_file(trace: Trace) -> Path:
    """The cell file of a trace's plant: a shipped one, or one of those identified for the campaign."""
    identified = resources.folder("campaign") / "cells" / f"{trace.cell}.toml"
    return identified if identified.is_file() else resources.find(trace.cell, "cells", ".toml")


def save(traces: Sequence[Trace], path: Path) -> None:
    """Writes all traces of one plant. Their currents must be multiples of `CURRENT_A`."""
    headers: dict[str, dict[str, Any]] = {}
    columns: dict[str, Any] = {}  # Any: savez takes an option among its arrays
    for number, trace in enumerate(traces):
        headers[trace.name], of_trace = _encoded(trace)
        columns |= {f"{number}.{name}": column for name, column in of_trace.items()}
        headers[trace.name]["number"] = number
    archive = io.BytesIO()
    text = np.frombuffer(json.dumps(headers).encode(), dtype=np.uint8)
    np.savez(archive, headers=text, **columns)
    path.write_bytes(lzma.compress(archive.getvalue(), preset=9 | lzma.PRESET_EXTREME))


@lru_cache(maxsize=16)
def _file(plant: str) -> tuple[dict[str, dict[str, Any]], dict[str, NDArray[Any]]]:
    path = resources.folder("campaign") / f"{plant}{SUFFIX}"
    with np.load(io.BytesIO(lzma.decompress(path.read_bytes())), allow_pickle=False) as archive:
        columns = {name: archive[name] for name in archive.files}
    headers: dict[str, dict[str, Any]] = json.loads(columns.pop("headers").tobytes())
    return headers, columns


def _charge(current: Integers, header: dict[str, Any]) -> Integers:
    """What the current alone makes of SoC, in quanta; shape (rows, cells)."""
    taken_Ah = np.cumsum(current) * (CURRENT_A * header["step_s"] / 3600)
    return _whole(taken_Ah[:, None] / np.array(header["capacity_Ah"]), -SOC)


def _ohmic(current: Integers, header: dict[str, Any]) -> Integers:
    """What a fixed resistance makes of the voltage, in quanta: the difference from it is smaller, and so its code."""
    return _whole(current[:, None] * (-CURRENT_A * np.array(header["ohm"])), VOLTAGE_V)


def _whole(values: NDArray[Any], quantum: float) -> Integers:
    return np.asarray(np.rint(values / quantum), dtype=np.int64)


def _encoded(trace: Trace) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    current = _whole(trace.current_A, CURRENT_A)
    step_A, step_V = np.diff(trace.current_A), np.diff(trace.voltage_V, axis=0)
    ohm = -(step_A @ step_V) / max(float(step_A @ step_A), 1e-9)
    header = {
        "cell": trace.cell,
        "kind": trace.kind,
        "step_s": trace.step_s,
        "ambient_degC": trace.ambient_degC,
        "aged": trace.aged,
        "capacity_Ah": [round(float(value), 6) for value in trace.capacity_Ah],
        "ohm": [round(float(value), 6) for value in ohm],
    }
    columns = {
        "current": current,
        "voltage": _whole(trace.voltage_V, VOLTAGE_V) - _ohmic(current, header),
        "soc": _whole(trace.soc, SOC) - _charge(current, header),
        "temperature": _whole(trace.temperature_degC, TEMPERATURE_K),
    }
    return header, {name: _differences(column) for name, column in columns.items()}


def _decoded(name: str, header: dict[str, Any], columns: dict[str, NDArray[Any]]) -> Trace:
    def column(what: str) -> Integers:
        return np.cumsum(columns[f"{header['number']}.{what}"].astype(np.int64), axis=-1).T

    def values(whole: Integers, quantum: float) -> Array:
        return np.asarray(whole * quantum, dtype=np.float64)

    current = column("current")
    return Trace(
        name=name,
        plant=name.partition("/")[0],
        cell=header["cell"],
        kind=header["kind"],
        step_s=header["step_s"],
        current_A=values(current, CURRENT_A),
        voltage_V=values(column("voltage") + _ohmic(current, header), VOLTAGE_V),
        temperature_degC=values(column("temperature"), TEMPERATURE_K),
        soc=values(column("soc") + _charge(current, header), SOC),
        ambient_degC=header["ambient_degC"],
        capacity_Ah=np.array(header["capacity_Ah"]),
        aged=header["aged"],
        soc_ref_sigma=0.0,
    )


def _differences(column: Integers) -> NDArray[Any]:
    """From row to row along the last axis, of shape (rows,) or (cells, rows), in the smallest integers that hold it."""
    steps = np.diff(column.T, axis=-1, prepend=0)
    small = next(kind for kind in (np.int8, np.int16, np.int32) if np.iinfo(kind).max >= np.abs(steps).max())
    return steps.astype(small)
