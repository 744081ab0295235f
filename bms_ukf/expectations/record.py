"""What a run recorded, as expectations and the fault matrix read it: what a receiver on the bus knew at each step."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bms_ukf.faults.base import Injection
from bms_ukf.plant import PlantState
from bms_ukf.records import NAN, Estimate, Fault, PerCell, Sample, Status, Stored
from bms_ukf.trace import Trace

SILENT_S = 3.0  # without a valid answer for so long, a receiver has none
SILENT = 1 + max(Status)  # in place of a status
WORDS = (*(status.word for status in Status), "silent")


@dataclass(slots=True, frozen=True)
class FaultFigures:
    """What one fault did; None: it never happened."""

    label: str
    kind: str
    start_s: float
    end_s: float  # infinite: it stays
    soc_error_max: float | None  # from its start until the next fault's, or the end
    detected_s: float | None  # after its start, until the first answer that tells of more than the one before it
    told: str  # by which word
    recovered_s: float | None  # after its end, until the status is ok and stays so until the next fault


@dataclass(slots=True)
class CellsTold:
    """What was told of the cells of a pack since the step before; NaN: nothing."""

    soc: NDArray[np.float64]  # of each
    lowest_cell: float = NAN  # its number, from 1
    lowest_soc: float = NAN


class Record:
    """A row a step. One without an answer has no SoC; a receiver goes by the last answer until it is SILENT_S old."""

    def __init__(self, faults: Sequence[Injection]) -> None:
        self.trace = Trace(1000)
        self.faults = sorted(faults, key=lambda fault: fault.at_s)
        self.stored = Stored.NONE  # what the daemon's last start made of its state file, as told on the bus
        self.plant_failure: str | None = None  # how it failed; see `PlantError`
        self._answered: list[bool] = []
        self._cells: list[CellsTold] = []
        self._cell_ref: list[NDArray[np.float64]] = []

    def append(self, sample: Sample, answer: Estimate | None, true: PlantState, cells: CellsTold | None = None) -> None:
        """Of several cells the mean is kept: of the values that were measured, and of the true ones.

        `cells` is what was told of each, which is kept with the true SoC of each: in every row, or in none.
        """
        self._answered.append(answer is not None)
        told = answer or Estimate(sample.t_ns, status=Status.INVALID)
        self.trace.append(_whole(sample), told, _mean(true.soc), _whole(true))
        if cells is not None:
            self._cells.append(cells)
            self._cell_ref.append(np.broadcast_to(true.soc, cells.soc.shape))

    @property
    def t_s(self) -> NDArray[np.float64]:
        """Of each row, in seconds since the scenario began."""
        return np.asarray(self.trace.t_ns / 1e9, dtype=np.float64)  # a division: 60 s are 60.0

    @property
    def answered(self) -> NDArray[np.bool_]:
        return np.array(self._answered, dtype=bool)

    @property
    def cell_ref(self) -> NDArray[np.float64]:
        """The true SoC of each cell, (rows, cells); (rows, 0) of a single one."""
        return np.array(self._cell_ref).reshape(len(self.trace), -1) if self._cells else np.empty((len(self.trace), 0))

    @property
    def lowest_cell(self) -> NDArray[np.float64]:
        """The number of the cell that is named as the lowest, from 1; NaN in rows without."""
        return np.array([told.lowest_cell for told in self._cells])

    @property
    def lowest_soc(self) -> NDArray[np.float64]:
        """The SoC that the lowest cell is said to have; NaN in rows without."""
        return np.array([told.lowest_soc for told in self._cells])

    def cell_error(self) -> NDArray[np.float64]:
        """SoC of each cell minus its own truth, (rows, cells); NaN where it is not told in that row."""
        told = np.array([told.soc for told in self._cells]).reshape(self.cell_ref.shape)
        return told - self.cell_ref

    def error(self) -> NDArray[np.float64]:
        """SoC minus truth, 0..1; NaN in rows without a SoC on the bus."""
        return self.trace["soc"] - self.trace["soc_ref"]

    def interval(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the lower and the upper bound of SoC as a receiver has them, 0..1; NaN in rows without a SoC."""
        return self.trace.interval

    def states(self) -> NDArray[np.int64]:
        """What the receiver takes the status to be, row by row: a `Status`, or SILENT."""
        rows = np.arange(len(self.trace))
        last = np.maximum.accumulate(np.where(self.answered, rows, -1))
        known = (last >= 0) & (self.t_s - self.t_s[last] <= SILENT_S)
        return np.where(known, self.trace.status[last], SILENT)

    def within(self, from_s: float, to_s: float) -> NDArray[np.bool_]:
        return (self.t_s >= from_s) & (self.t_s <= to_s)

    def fault(self, label: str) -> FaultFigures:
        """KeyError if the scenario has none of this name."""
        return {fault.label: self._figures(fault) for fault in self.faults}[label]

    def matrix(self) -> list[FaultFigures]:
        """A row a fault, in the order of time."""
        return [self._figures(fault) for fault in self.faults]

    def told(self, word: str) -> NDArray[np.bool_]:
        """The rows in which a receiver is told a word: a status, a fault, or is silent."""
        if word in WORDS:
            return np.asarray(self.states() == WORDS.index(word))
        return np.asarray(self.answered & ((self.trace.faults & Fault[word.upper()]) != 0))

    def settled(self, from_s: float, below: float = math.inf) -> float | None:
        """Seconds from `from_s` on until the status is ok and |error| at most `below`, to stay until the next fault."""
        until_s = min((fault.at_s for fault in self.faults if fault.at_s > from_s), default=math.inf)
        rows = np.flatnonzero((self.t_s >= from_s) & (self.t_s < until_s))
        if not rows.size:
            return None
        wrong = np.abs(self.error()) > below  # without a SoC there is nothing to be wrong
        bad = np.flatnonzero(((self.states() != Status.OK) | wrong)[rows])
        first = 0 if not bad.size else bad[-1] + 1
        return float(self.t_s[rows[first]]) - from_s if first < rows.size else None

    def digest(self) -> str:
        """SHA-256 of everything recorded: equal for runs that are equal, bit for bit."""
        whole = hashlib.sha256()
        trace = self.trace
        columns = (
            *("soc", "soc_sigma", "soc_low", "soc_high", "voltage_pred_V", "nis", "soc_ref"),
            *("current_A", "voltage_V", "temperature_degC"),
        )
        for column in (trace.t_ns, trace.status, trace.faults, self.answered, *(trace[name] for name in columns)):
            whole.update(np.ascontiguousarray(column).tobytes())
        if self._cells:
            for column in (self.cell_error(), self.lowest_cell, self.lowest_soc):
                whole.update(column.tobytes())
        return whole.hexdigest()

    def _figures(self, fault: Injection) -> FaultFigures:
        until_s = min((other.at_s for other in self.faults if other.at_s > fault.at_s), default=math.inf)
        window = (self.t_s >= fault.at_s) & (self.t_s < until_s)
        error = np.abs(self.error()[window])
        detected_s, told = self._detected(fault.at_s, until_s)
        ended = fault.end_s <= self.t_s[-1] if len(self.trace) else False
        return FaultFigures(
            fault.label,
            fault.kind,
            fault.at_s,
            fault.end_s,
            float(np.nanmax(error)) if np.isfinite(error).any() else None,
            detected_s,
            told,
            self.settled(fault.end_s) if ended else None,
        )

    def _detected(self, from_s: float, until_s: float) -> tuple[float | None, str]:
        """When and by which word more is told than in the row before `from_s`."""
        states, before = self.states(), np.flatnonzero(self.t_s < from_s)
        faults = np.where(self.answered, self.trace.faults, 0)
        usual = faults[before[-1]] if before.size else 0
        state = states[before[-1]] if before.size else Status.OK
        worse = ((faults & ~usual) != 0) | ((states != state) & (states != Status.OK))
        rows = np.flatnonzero(worse & (self.t_s >= from_s) & (self.t_s < until_s))
        if not rows.size:
            return None, ""
        row = rows[0]
        new = int(faults[row] & ~usual)
        told = " | ".join(bit.name.lower() for bit in Fault(new) if bit.name) if new else WORDS[states[row]]
        return float(self.t_s[row]) - from_s, told


def _whole(of: Sample | PlantState) -> Sample:
    return Sample(of.t_ns, _mean(of.current_A), _mean(of.voltage_V), _mean(of.temperature_degC))


def _mean(values: PerCell) -> float:
    if isinstance(values, float):
        return values
    known = values[~np.isnan(values)]
    return float(known.mean()) if known.size else NAN
