"""A flight recorder: the last minutes of what the estimator was given and said, written to a file on a fault.

The file can be run again bit for bit (`bms-ukf replay FILE.flight`). Its first line is JSON (`HEADER`); then parts
follow, oldest first, each a length (uint32), a snapshot of the estimator, a length and entries. A part ends, too, where
a cell is given another capacity, which the snapshot of the next one has:

    kind (bits of KIND), t_ns · current_A, voltage_V, temperature_degC · mean SoC, largest sigma, status, faults,
    CRC-32 of all cells' SoC, sigma and bounds · for each array a count, the indices (uint16) and values (float64)

little-endian. Arrays are of cells, sensors or strings; what was not measured is left out.
"""

from __future__ import annotations

import json
import logging
import struct
import threading
import zlib
from collections import deque
from datetime import UTC, datetime
from enum import IntFlag
from pathlib import Path

import numpy as np

from bms_ukf.estimator import Estimator
from bms_ukf.records import NAN, Detail, Estimate, Fault, PerCell, Sample, Status

log = logging.getLogger(__name__)

SUFFIX = ".flight"
FORMAT = 3  # 2 had no bounds in the CRC, 1 no strings
HEADER = ("format", "reason", "written", "cells", "precision", "cell", "tuning")
ENTRY = struct.Struct("<BqdddddBII")
COUNT = struct.Struct("<H")
LENGTH = struct.Struct("<I")
PARTS = 4  # of the span: the oldest goes when a new one begins
AFTER_NS = 5_000_000_000  # what followed the fault is in the file, too


class Kind(IntFlag):
    """What an entry is."""

    STEP = 0
    COAST = 1
    OPEN_CIRCUIT = 2
    VOLTAGES = 4  # an array follows
    TEMPERATURES = 8
    BLEED = 16
    STRINGS = 32  # the currents of several


class Recorder:
    """The daemon's witness; see `daemon.Witness`. Keeps between `span_s` and a quarter more of it."""

    def __init__(self, estimator: Estimator, folder: Path, span_s: float = 120.0, keep: int = 10) -> None:
        """Of the files in `folder` the newest `keep` stay."""
        self.folder, self._estimator, self._keep = folder, estimator, keep
        self._part_ns = round(span_s * 1e9 / PARTS)
        self._parts: deque[tuple[bytes, bytearray]] = deque(maxlen=PARTS + 1)
        self._part_until_ns: int | None = None
        self._faults = Fault.NONE
        self._reason = Fault.NONE
        self._bleed_A = estimator.bleed_A
        self._adjusted = estimator.adjusted
        self._due_ns: int | None = None
        self._not_before_ns: int | None = None
        self._begin()

    def stepped(self, sample: Sample, estimate: Estimate) -> None:
        kind = Kind.OPEN_CIRCUIT if sample.open_circuit else Kind.STEP
        self._enter(kind, sample, estimate)

    def coasted(self, t_ns: int, estimate: Estimate) -> None:
        self._enter(Kind.COAST, Sample(t_ns), estimate)

    def published(self, t_ns: int, estimate: Estimate, _: Detail) -> None:
        new = estimate.faults & ~self._faults
        self._faults = estimate.faults
        if self._due_ns is not None:
            if t_ns >= self._due_ns:
                self._due_ns = None
                self._not_before_ns = t_ns + PARTS * self._part_ns
                threading.Thread(target=self._write, args=(self.file(self._reason),), name="flight").start()
        elif new and estimate.status is not Status.INITIALISING and t_ns >= (self._not_before_ns or t_ns):
            self._reason, self._due_ns = new, t_ns + AFTER_NS

    def file(self, reason: Fault) -> bytes:
        """All that is remembered, as a file."""
        estimator = self._estimator
        written = datetime.now(UTC).isoformat(timespec="seconds")
        cell, tuning = estimator.cell.model_dump_json(), estimator.tuning.model_dump_json()
        values = (FORMAT, words(reason), written, estimator.cells, estimator.precision, cell, tuning)
        indices = {key: getattr(estimator.wiring, key) for key in estimator.wiring.__slots__}
        wiring = {key: None if of is None else of.tolist() for key, of in indices.items()}
        parts = [json.dumps(dict(zip(HEADER, values, strict=True)) | wiring).encode() + b"\n"]
        for snapshot, entries in self._parts:
            parts += [LENGTH.pack(len(snapshot)), snapshot, LENGTH.pack(len(entries)), bytes(entries)]
        return b"".join(parts)

    def _enter(self, kind: Kind, sample: Sample, told: Estimate) -> None:
        t_ns, voltage_V, temperature_degC, arrays = sample.t_ns, sample.voltage_V, sample.temperature_degC, b""
        if not isinstance(voltage_V, float):
            kind, arrays, voltage_V = kind | Kind.VOLTAGES, _packed(voltage_V), NAN
        if not isinstance(temperature_degC, float):
            kind, arrays, temperature_degC = kind | Kind.TEMPERATURES, arrays + _packed(temperature_degC), NAN
        if sample.string_current_A is not None:
            kind, arrays = kind | Kind.STRINGS, arrays + _packed(sample.string_current_A)
        bleed_A = self._estimator.bleed_A
        if bleed_A.tobytes() != self._bleed_A.tobytes():  # what the estimator has taken, whoever told it
            self._bleed_A, kind, arrays = bleed_A, kind | Kind.BLEED, arrays + _packed(bleed_A)
        self._parts[-1][1].extend(
            ENTRY.pack(kind, t_ns, sample.current_A, voltage_V, temperature_degC, *summary(told)) + arrays
        )
        if self._part_until_ns is None:
            self._part_until_ns = t_ns + self._part_ns
        elif t_ns >= self._part_until_ns or self._estimator.adjusted != self._adjusted:
            self._begin()
            self._part_until_ns = t_ns + self._part_ns

    def _begin(self) -> None:
        self._adjusted = self._estimator.adjusted
        self._parts.append((self._estimator.snapshot(), bytearray()))

    def _write(self, data: bytes) -> None:
        name = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ") + SUFFIX
        try:
            (self.folder / name).write_bytes(data)
            for old in sorted(self.folder.glob(f"*{SUFFIX}"))[: -self._keep]:
                old.unlink(missing_ok=True)
            told = {"faults": words(self._reason), "file": self.folder / name}
            log.warning("flight recorder: %(faults)s written to %(file)s", told)
        except OSError as error:
            told = {"file": self.folder / name, "error": error.strerror}
            log.warning("flight recorder: %(file)s: not written (%(error)s)", told)


def words(faults: Fault) -> str:
    """Their names, joined by a bar."""
    return "|".join(fault.name.lower() for fault in faults if fault.name)


def summary(estimate: Estimate) -> tuple[float, float, int, int, int]:
    """Mean SoC, largest sigma, status, faults and a CRC of all cells' SoC, sigma and bounds."""
    soc, sigma = np.asarray(estimate.soc), np.asarray(estimate.soc_sigma)
    crc = 0
    for values in (soc, sigma, np.asarray(estimate.soc_low), np.asarray(estimate.soc_high)):
        crc = zlib.crc32(values.tobytes(), crc)
    return float(soc.mean()), float(sigma.max()), int(estimate.status), int(estimate.faults), crc


def _packed(values: PerCell) -> bytes:
    array = np.asarray(values)
    known = np.flatnonzero(~np.isnan(array))
    return COUNT.pack(known.size) + known.astype("<u2").tobytes() + array[known].astype("<f8").tobytes()
