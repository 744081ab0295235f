"""A file of the flight recorder run again: the same estimates, bit for bit, or the row from which they differ."""

from __future__ import annotations

import json
import math
import struct
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from bms_ukf.cell import CellParams
from bms_ukf.errors import ConfigError
from bms_ukf.estimator import Estimator
from bms_ukf.flight import COUNT, ENTRY, FORMAT, HEADER, LENGTH, Kind, summary
from bms_ukf.records import NAN, Estimate, Sample
from bms_ukf.replay.rows import Rows
from bms_ukf.trace import Trace
from bms_ukf.tuning import Tuning
from bms_ukf.wiring import Wiring


class Entry(NamedTuple):
    """What was given, and what was said of it then."""

    sample: Sample
    coasted: bool
    told: tuple[float, float, int, int, int]


def rerun(path: Path, cell: CellParams | None = None) -> tuple[Trace, dict[str, Any]]:
    """A row for every step, and the summary. With another `cell` it starts anew, as that one's state is not known."""
    try:
        return _rerun(path, cell)
    except (OSError, ValueError, KeyError, IndexError, struct.error, ValidationError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ConfigError(path, expected=f"a file of the flight recorder ({reason})") from None


def _rerun(path: Path, cell: CellParams | None) -> tuple[Trace, dict[str, Any]]:
    line, _, body = path.read_bytes().partition(b"\n")
    head = json.loads(line)
    missing = [key for key in HEADER if key not in head]
    if missing or head["format"] != FORMAT:
        raise ValueError(f"no {', '.join(missing)} in its first line" if missing else "of another format")
    cells = int(head["cells"])
    used = cell or CellParams.model_validate_json(head["cell"])
    wiring = Wiring(head.get("sensor_of"), head.get("string_of"))
    estimator = Estimator(used, cells, Tuning.model_validate_json(head["tuning"]), head["precision"], wiring)
    sensors = cells if wiring.sensor_of is None else int(wiring.sensor_of.max()) + 1
    snapshots, entries = _parts(body, _Counts(cells, sensors, wiring.strings))
    if cell is None:
        estimator.restore(snapshots[0])
    rows, estimate, apart = Rows(), estimator.coast(estimator.t_ns or entries[0].sample.t_ns), []
    begin_s = time.perf_counter()
    for number, (sample, coasted, told) in enumerate(entries, 1):
        if cell is None and number - 1 in snapshots:
            estimator.restore(snapshots[number - 1])
        if sample.bleed_A is not None:  # before a coasting, too, that somebody told it to the estimator before
            estimator.bleed_A = sample.bleed_A
        if coasted:
            estimator.coast(sample.t_ns, out=estimate)
        else:
            estimator.step(sample, out=estimate)
        if not _same(told, summary(estimate)):
            apart.append(number)
        rows.measured(sample)
        rows.add(sample.t_ns, estimate)
    took_s = time.perf_counter() - begin_s
    trace = rows.trace()
    final = estimate if cells == 1 else _mean(estimate)
    known = math.isfinite(float(final.soc))
    return trace, {
        "recording": path.name,
        "cell": used.cell.name,
        "estimator": "srukf",
        "n": len(trace),
        "duration_s": float(trace.t_s[-1] - trace.t_s[0]) if len(trace) else 0.0,
        "steps_per_s": len(trace) / took_s,
        "final_soc": float(final.soc) if known else None,
        "soc_sigma_final": float(final.soc_sigma) if known else None,
        "soc_low_final": float(final.soc_low) if known else None,
        "soc_high_final": float(final.soc_high) if known else None,
        "warnings": [f"{path.name}: not what was said then, from row {apart[0]} on"] if apart and cell is None else [],
        "reason": head["reason"],
        "written": head["written"],
        "identical": None if cell is not None else not apart,
    }


class _Counts(NamedTuple):
    """How many of each there are."""

    cells: int
    sensors: int
    strings: int


def _parts(body: bytes, counts: _Counts) -> tuple[dict[int, bytes], list[Entry]]:
    """All entries, and the snapshots before those of these indices."""
    found: list[Entry] = []
    at = 0
    snapshots: dict[int, bytes] = {}
    while at < len(body):
        (length,) = LENGTH.unpack_from(body, at)
        at += LENGTH.size
        snapshots[len(found)] = body[at : at + length]
        at += length
        (length,) = LENGTH.unpack_from(body, at)
        at += LENGTH.size
        if at + length > len(body):
            raise ValueError("cut off")
        found += _entries(body[at : at + length], counts)
        at += length
    if not found:
        raise ValueError("nothing in it")
    return snapshots, found


def _entries(data: bytes, counts: _Counts) -> Iterator[Entry]:
    at = 0
    while at < len(data):
        kind, t_ns, current_A, voltage_V, temperature_degC, *told = ENTRY.unpack_from(data, at)
        at += ENTRY.size
        if kind & Kind.VOLTAGES:
            voltage_V, at = _array(data, at, counts.cells)
        if kind & Kind.TEMPERATURES:
            temperature_degC, at = _array(data, at, counts.sensors)
        sample = Sample(t_ns, current_A, voltage_V, temperature_degC, bool(kind & Kind.OPEN_CIRCUIT))
        if kind & Kind.STRINGS:
            sample.string_current_A, at = _array(data, at, counts.strings)
        if kind & Kind.BLEED:
            sample.bleed_A, at = _array(data, at, counts.cells)
        yield Entry(sample, bool(kind & Kind.COAST), tuple(told))


def _array(data: bytes, at: int, size: int) -> tuple[NDArray[np.float64], int]:
    (count,) = COUNT.unpack_from(data, at)
    at += COUNT.size
    values = np.full(size, NAN)
    middle = at + 2 * count
    values[np.frombuffer(data[at:middle], "<u2")] = np.frombuffer(data[middle : middle + 8 * count], "<f8")
    return values, middle + 8 * count


def _mean(estimate: Estimate) -> Estimate:
    return Estimate(
        soc=float(np.mean(estimate.soc)),
        soc_sigma=float(np.max(estimate.soc_sigma)),
        soc_low=float(np.min(estimate.soc_low)),
        soc_high=float(np.max(estimate.soc_high)),
    )


def _same(then: tuple[float, ...], now: tuple[float, ...]) -> bool:
    return struct.pack("<dd", *then[:2]) == struct.pack("<dd", *now[:2]) and tuple(then[2:]) == tuple(now[2:])
