"""The estimator: samples in, estimates out. It owns the buffers; the kernel does the work.

estimator = Estimator(CellParams.load("lgm50_chen2020"))
estimate = estimator.step(Sample(t_ns=..., current_A=..., voltage_V=..., temperature_degC=...))
"""

from __future__ import annotations

import hashlib
import math
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bms_ukf.cell import CellParams
from bms_ukf.kernel import entry, layout
from bms_ukf.kernel.params import aligned, params
from bms_ukf.kernel.step import FAULT_MASK, STATUS_SHIFT
from bms_ukf.records import Estimate, Fault, Sample, Status
from bms_ukf.tuning import Tuning

_STATUS = tuple(Status)
_HIDDEN = tuple(status in {Status.INITIALISING, Status.INVALID} for status in Status)  # no SoC that could be shown
_FAULTS = tuple(Fault(bits) for bits in range(2 * max(Fault)))  # making one costs more than the filter step
_NUMERIC = int(Fault.NUMERIC)
_BODY = struct.Struct("<q?3q")  # cells, whether a sample was seen, its time, code, samples accepted; then the state
_MAGIC = b"BMSUKF01"

_PER_CELL = ("soc", "soc_sigma", "voltage_pred_V", "innovation_V", "innovation_var_V2", "nis", "age_s")

_HELD = layout.held_offset(entry.N)
_SIGMA = layout.root_offset(entry.N)
_VOLTAGE_IN = _HELD + layout.H_INPUT_VOLTAGE
_TEMPERATURE_IN = _HELD + layout.H_INPUT_TEMPERATURE
_AGE = _HELD + layout.H_VOLTAGE_AGE
_VOLTAGE_PRED = _HELD + layout.H_VOLTAGE_PRED
_INNOVATION = _HELD + layout.H_INNOVATION
_INNOVATION_VAR = _HELD + layout.H_INNOVATION_VAR


class Estimator:
    """State of charge of `cells` cells of one type in series: one filter each, one current through all.

    A sample may be partial (NaN for what was not measured) and may share its time with the one before; time never runs
    backwards. Where the parts of one instant come apart, the current comes first: it is what has flowed up to then, and
    the part that comes first moves time on. The first estimate appears once a current, a voltage and a temperature have
    been seen.
    """

    __slots__ = (
        "_buffer",
        "_code",
        "_params",
        "_params_address",
        "_state",
        "_state_address",
        "accepted",
        "cell",
        "cells",
        "t_ns",
        "tuning",
    )

    def __init__(self, cell: CellParams, cells: int = 1, tuning: Tuning | None = None) -> None:
        if cells < 1:
            raise ValueError(f"cells is {cells}; expected at least 1")
        self.cell, self.cells, self.tuning = cell, cells, tuning or Tuning()
        self._params = params(cell, self.tuning)
        buffer = aligned(cells * entry.RECORD_SIZE)
        self._state: NDArray[np.float64] = buffer.reshape(cells, entry.RECORD_SIZE)
        self._buffer: Any = memoryview(buffer.data)  # a number in or out of it costs half of what an ndarray asks
        self._params_address, self._state_address = self._params.ctypes.data, self._state.ctypes.data
        self.reset()

    def reset(self) -> None:
        """Forget everything measured so far."""
        self._state[:] = np.nan
        self._state[:, _HELD + layout.H_GAP_S] = 0.0
        self.t_ns: int | None = None
        self._code = 0  # what the kernel said last
        self.accepted = 0  # samples that were not refused: what the alive counter on the bus follows

    def step(self, sample: Sample, out: Estimate | None = None) -> Estimate:
        """Advance to `sample` and say what is now known; `out`, if given, is overwritten and returned.

        A sample older than the last one is refused whole (`Fault.TIME_REVERSED`): the belief stays as it was.
        """
        estimate = self._blank() if out is None else out
        last_ns = self.t_ns
        dt = 0.0 if last_ns is None else (sample.t_ns - last_ns) * 1e-9
        if dt < 0.0:
            self._read(estimate, self._code)
            self._clear_comparison(estimate)
            estimate.faults |= Fault.TIME_REVERSED
            if estimate.status is Status.OK:
                estimate.status = Status.DEGRADED
            return estimate
        self._write(sample)
        code = entry.tick(self._params_address, self._state_address, self.cells, dt, sample.current_A)
        if not code & _NUMERIC:
            self.accepted += 1
        self.t_ns, self._code = sample.t_ns, code
        self._read(estimate, code)
        return estimate

    def coast(self, t_ns: int, out: Estimate | None = None) -> Estimate:
        """Advance to `t_ns` with nothing measured. It does not count as accepted: nothing was."""
        accepted = self.accepted
        estimate = self.step(Sample(t_ns), out)
        self.accepted = accepted
        return estimate

    def snapshot(self) -> bytes:
        """All the estimator knows, for `restore`; valid for the same cell file, tuning and number of cells."""
        body = _BODY.pack(self.cells, self.t_ns is not None, self.t_ns or 0, self._code, self.accepted)
        body += self._state.tobytes()
        return _MAGIC + self._params_hash() + hashlib.sha256(body).digest() + body

    def restore(self, snapshot: bytes) -> None:
        """Go back to a `snapshot`. Raises ValueError, changing nothing, if cell file, tuning or size differ."""
        magic, params_hash, body_hash, body = snapshot[:8], snapshot[8:40], snapshot[40:72], snapshot[72:]
        if magic != _MAGIC or len(body) != _BODY.size + self._state.nbytes:
            raise ValueError(f"not a snapshot of {self.cells} cells by this version")
        if params_hash != self._params_hash():
            raise ValueError("a snapshot of another cell file or tuning")
        if body_hash != hashlib.sha256(body).digest():
            raise ValueError("a damaged snapshot")
        _, started, t_ns, code, accepted = _BODY.unpack_from(body)
        self._state[:] = np.frombuffer(body, offset=_BODY.size).reshape(self._state.shape)
        self.t_ns, self._code, self.accepted = (t_ns if started else None), code, accepted

    def _params_hash(self) -> bytes:
        return hashlib.sha256(self._params.tobytes()).digest()

    def _write(self, sample: Sample) -> None:
        if self.cells == 1:
            self._buffer[_VOLTAGE_IN] = sample.voltage_V
            self._buffer[_TEMPERATURE_IN] = sample.temperature_degC
        else:
            self._state[:, _VOLTAGE_IN] = sample.voltage_V
            self._state[:, _TEMPERATURE_IN] = sample.temperature_degC

    def _read(self, estimate: Estimate, code: int) -> None:
        status = code >> STATUS_SHIFT
        estimate.t_ns = self.t_ns or 0
        estimate.status, estimate.faults = _STATUS[status], _FAULTS[code & FAULT_MASK]
        if self.cells > 1:
            _read_pack(self._state, estimate, _HIDDEN[status])
            return
        b = self._buffer
        estimate.age_s = b[_AGE]
        if _HIDDEN[status]:
            estimate.soc = estimate.soc_sigma = math.nan
        else:
            soc = b[layout.SOC]
            estimate.soc = 0.0 if soc < 0.0 else 1.0 if soc > 1.0 else soc
            estimate.soc_sigma = b[_SIGMA]
        innovation = estimate.innovation_V = b[_INNOVATION]
        variance = estimate.innovation_var_V2 = b[_INNOVATION_VAR]
        estimate.voltage_pred_V = b[_VOLTAGE_PRED]
        estimate.nis = innovation * innovation / variance

    def _clear_comparison(self, estimate: Estimate) -> None:
        """Nothing was compared: the values of the last comparison would be counted twice."""
        for name in ("voltage_pred_V", "innovation_V", "innovation_var_V2", "nis"):
            if self.cells == 1:
                setattr(estimate, name, math.nan)
            else:
                getattr(estimate, name)[:] = math.nan

    def _blank(self) -> Estimate:
        if self.cells == 1:
            return Estimate()
        arrays = {name: np.full(self.cells, math.nan) for name in _PER_CELL}
        return Estimate(**arrays)  # type: ignore[arg-type]


def _read_pack(state: NDArray[np.float64], estimate: Estimate, hidden: bool) -> None:
    """Copy every cell's results into the arrays that `estimate` holds."""
    soc, sigma, predicted, innovation, variance, nis, age = (np.asarray(getattr(estimate, name)) for name in _PER_CELL)
    if hidden:
        soc[:] = sigma[:] = math.nan
    else:
        np.clip(state[:, layout.SOC], 0.0, 1.0, out=soc)
        sigma[:] = state[:, _SIGMA]
    predicted[:] = state[:, _VOLTAGE_PRED]
    innovation[:] = state[:, _INNOVATION]
    variance[:] = state[:, _INNOVATION_VAR]
    np.divide(innovation * innovation, variance, out=nis)
    age[:] = state[:, _AGE]
