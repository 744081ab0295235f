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
from numpy.typing import ArrayLike, NDArray

from bms_ukf import beliefs, shown
from bms_ukf.cell import CellParams
from bms_ukf.kernel import entry, layout
from bms_ukf.kernel.params import BITS, Precision, aligned, form_of, params, state_size
from bms_ukf.kernel.step import FAULT_MASK, STATUS_SHIFT
from bms_ukf.percell import SHARE_NS, PerCell
from bms_ukf.records import Estimate, Fault, Sample, Status
from bms_ukf.tuning import Tuning
from bms_ukf.wiring import Wiring

_NUMERIC = int(Fault.NUMERIC)
_BODY = struct.Struct("<q?3q")  # cells, whether a sample was seen, its time, code, samples accepted; numbers follow
_MAGIC = b"BMSUKF05"


class Estimator(PerCell):
    """State of charge of `cells` cells of one type: one filter each, all of them in one call of the kernel.

    The cells are in series under one current, unless `wiring` puts them into strings. One that is not measured is
    predicted: from its own belief, or, if it has never been heard within `voltage_timeout_s` of the others, from that
    of its median neighbour, in doubt by `cell_spread_sigma` more. `cell_faults` says which.

    A sample may be partial (NaN for what was not measured) and may share its time with the one before; time never runs
    backwards. Where the parts of one instant come apart, the current comes first: it is what has flowed up to then, and
    the part that comes first moves time on. The first estimate appears once a current, a voltage and a temperature have
    been seen.

    `precision` is that of the filter's numbers: "f64", or "f32" to see what a microcontroller would.
    """

    __slots__ = ("_code", "_memory", "_params", "_row", "_tick", "accepted", "cell", "t_ns")

    def __init__(
        self,
        cell: CellParams,
        cells: int = 1,
        tuning: Tuning | None = None,
        precision: Precision = "f64",
        wiring: Wiring | None = None,
    ) -> None:
        """ValueError for no cell, or a wiring of another number of cells."""
        if cells < 1:
            raise ValueError(f"cells is {cells}; expected at least 1")
        self.wiring = wiring or Wiring()
        self.wiring.check(cells)
        self.cell, self.cells, self.tuning, self.precision = cell, cells, tuning or Tuning(), precision
        bits = BITS[precision]
        form = self._form = form_of(cell, self.tuning, 1 if cells == 1 else layout.LANES, bits)
        self._params = params(cell, self.tuning, bits)
        blocks = -(-cells // form.lanes)
        self._memory = aligned(state_size(form, cells), bits, filled=False)
        records = blocks * form.lanes * form.size
        self._state = self._memory[:records].reshape(blocks, form.size, form.lanes)
        self._parts = self._memory[records:].reshape(cells, form.parts)  # components of each cell's belief
        self._io = aligned(layout.IO_ROWS * cells, bits).reshape(layout.IO_ROWS, cells)
        self._row: Any = memoryview(self._io[:, 0].data)  # a number in or out of it costs half of what an ndarray asks
        self._addresses = self._params.ctypes.data, self._state.ctypes.data, self._io.ctypes.data, cells
        self._tick = entry.tick(form, bits)
        self._exchange = entry.exchange(form, bits) if form.bias and cells > 1 else None
        self._share_ns = SHARE_NS
        self._strings = aligned(cells, bits)
        self._strings[:] = 0 if self.wiring.string_of is None else self.wiring.string_of
        self.reset()

    def reset(self) -> None:
        """Forget everything measured so far, and every cell's own capacity, resistance and bleed."""
        self._state[:] = np.nan
        self._io[:] = np.nan
        self.t_ns: int | None = None
        self._heard_ns = None
        self._code = 0  # what the kernel said last
        self.adjusted = 0
        self.accepted = 0  # samples that were not refused: what the alive counter on the bus follows

    @property
    def lean(self) -> NDArray[Any]:
        """Mean of each cell's innovations over five minutes, in their own sigmas; NaN before the first voltage."""
        return self._state[:, layout.H_LEAN].reshape(-1)[: self.cells]

    def step(self, sample: Sample, out: Estimate | None = None) -> Estimate:
        """Advance to `sample` and say what is now known; `out`, if given, is overwritten and returned.

        A sample older than the last one is refused whole (`Fault.TIME_REVERSED`): the belief stays as it was.
        """
        estimate = shown.blank(self.cells) if out is None else out
        last_ns = self.t_ns
        dt = 0.0 if last_ns is None else (sample.t_ns - last_ns) / 1e9
        if dt < 0.0:
            self._read(estimate, self._code)
            shown.clear_comparison(estimate)
            estimate.faults |= Fault.TIME_REVERSED
            if estimate.status is Status.OK:
                estimate.status = Status.DEGRADED
            return estimate
        current_A = self._take(sample)
        code = self._tick(*self._addresses, dt, current_A)
        if sample.open_circuit:
            self._io[layout.IN_OFFSET] = math.nan
        if self.cells > 1:
            self._tend(sample.t_ns, code)
        if not code & _NUMERIC:
            self.accepted += 1
        if not code & _NUMERIC or self.cells > 1:  # a refused step has not passed: the next one covers its time
            self.t_ns = sample.t_ns
        self._code = code
        self._read(estimate, code)
        return estimate

    def _take(self, sample: Sample) -> float:
        """Write what was measured where the kernel reads it; returns the current of all cells, NaN with strings."""
        if self.cells == 1:
            self._row[layout.IN_VOLTAGE], self._row[layout.IN_TEMPERATURE] = sample.voltage_V, sample.temperature_degC
        else:
            temperature, sensor_of = sample.temperature_degC, self.wiring.sensor_of
            if sensor_of is not None and not isinstance(temperature, float):
                temperature = temperature[sensor_of]
            self._io[layout.IN_VOLTAGE], self._io[layout.IN_TEMPERATURE] = sample.voltage_V, temperature
        if sample.bleed_A is not None:
            self.bleed_A = sample.bleed_A
        current_A, strings_A = sample.current_A, sample.string_current_A
        if self.wiring.string_of is not None:
            current_A = math.nan
            self._io[layout.IN_CURRENT] = math.nan if strings_A is None else strings_A[self.wiring.string_of]
        if sample.open_circuit:
            strings, reading, offset = self.wiring.string_of is not None, self._io[layout.IN_CURRENT], layout.OUT_BIAS
            self._io[layout.IN_OFFSET] = reading if strings else current_A
            if not self._form.bias:
                current_A, self._io[layout.IN_CURRENT] = 0.0, math.nan
            elif strings:  # a reading that is missing: what the sensor would show
                self._io[layout.IN_CURRENT] = np.where(np.isnan(reading), self._io[offset], reading)
            elif math.isnan(current_A):
                current_A = float(np.mean(self._io[offset]))
        return current_A

    def coast(self, t_ns: int, out: Estimate | None = None) -> Estimate:
        """Advance to `t_ns` with nothing measured. It does not count as accepted: nothing was."""
        accepted = self.accepted
        estimate = self.step(Sample(t_ns), out)
        self.accepted = accepted
        return estimate

    def sleep(self, off_s: float, t_ns: int) -> None:
        """Let `off_s` >= 0 s pass with nothing measured and the cell at rest but for `tuning.standby_current_A`.

        For a belief that was stored: polarisation fades, the offset of the current sensor is forgotten, and SoC falls
        by the standby current and is in doubt by its sigma times the time. Afterwards the time is `t_ns`, of whatever
        clock the samples to come are stamped by. Without a belief only the time is set. ValueError if `off_s` is
        below 0.
        """
        if not off_s >= 0:
            raise ValueError(f"off_s is {off_s}; expected at least 0")
        self.t_ns = t_ns
        tuning, held = self.tuning, self._params.copy()
        sigma_A = self.cell.cell.capacity_Ah / 2000 if tuning.standby_sigma_A is None else tuning.standby_sigma_A
        in_doubt = sigma_A * off_s / float(held[layout.P_CHARGE_COULOMB])
        self._params[layout.P_CURRENT_TIMEOUT] = np.inf  # the current is known, however long ago it was measured
        self._params[layout.P_SOC_WALK_OFFSET] = in_doubt**2 / off_s if off_s else 0.0
        self._io[[layout.IN_VOLTAGE, layout.IN_TEMPERATURE, layout.IN_OFFSET, layout.IN_CURRENT]] = np.nan
        bleed_A = self.bleed_A  # balancing stops with the rest
        self.bleed_A = math.nan
        self._state[:, layout.H_PARTS] = 0  # their mean and covariance stay
        bias = beliefs.set_bias_aside(self._form, self._state)  # what flowed is known without the sensor
        self._code = self._tick(*self._addresses, float(off_s), tuning.standby_current_A)
        self._params[:] = held
        self.bleed_A = bleed_A
        self._state[:, layout.H_FRESH] = 1  # the first voltage meets a cell with an unknown history
        kept, unknown_A = math.exp(-off_s / float(held[layout.P_BIAS_TAU])), float(held[layout.P_BIAS_SIGMA])
        beliefs.take_bias_back(self._form, self._state, bias, kept, unknown_A)

    def replay(
        self, t_ns: ArrayLike, current_A: ArrayLike, voltage_V: ArrayLike, temperature_degC: ArrayLike
    ) -> dict[str, NDArray[Any]]:
        """Step through a whole recording of one cell in one call: the same results as by `step`, bit for bit, sooner.

        Arrays of one length in, NaN for what was not measured. Returns arrays by the names of `Estimate`'s fields, with
        `status` and `faults` as integers. ValueError for several cells, lengths that differ, or time running backwards.
        """
        if self.cells > 1:
            raise ValueError("replay is for one cell")
        time = np.asarray(t_ns, dtype=np.int64)
        columns = [np.asarray(column, dtype=float) for column in (current_A, voltage_V, temperature_degC)]
        if time.ndim != 1 or any(column.shape != time.shape for column in columns):
            raise ValueError("t_ns, current_A, voltage_V and temperature_degC as arrays of one length")
        before = time[:1] if self.t_ns is None else [self.t_ns]
        dt = np.diff(time, prepend=before) / 1e9
        if (dt < 0).any():
            raise ValueError(f"t_ns runs backwards at row {int(np.argmax(dt < 0))}")
        dtype = self._io.dtype
        io = np.full((len(time), layout.IO_ROWS), math.nan, dtype)
        io[:, layout.IN_VOLTAGE], io[:, layout.IN_TEMPERATURE] = columns[1], columns[2]
        io[:, layout.IN_BLEED] = self._io[layout.IN_BLEED, 0]
        spans, currents = dt.astype(dtype), columns[0].astype(dtype)
        params, state, *_ = self._addresses
        run = entry.replay(self._form, BITS[self.precision])
        run(params, state, io.ctypes.data, len(time), spans.ctypes.data, currents.ctypes.data)
        code = io[:, layout.OUT_CODE].astype(np.int64)
        status, faults = code >> STATUS_SHIFT, code & FAULT_MASK
        results = {name: io[:, row].astype(float) for name, row in shown.SHOWN.items()}
        for name in shown.SOC_FIELDS:
            results[name][np.array(shown.HIDDEN)[status]] = np.nan
        if len(time):
            self._io[:, 0] = io[-1]
            self.t_ns, self._code = int(time[-1]), int(code[-1])
            self.accepted += int(np.count_nonzero(faults & _NUMERIC == 0))
        return {"t_ns": time, **results, "status": status, "faults": faults}

    def snapshot(self) -> bytes:
        """All the estimator knows, for `restore`; valid for the same cell file, tuning, number of cells and strings."""
        body = _BODY.pack(self.cells, self.t_ns is not None, self.t_ns or 0, self._code, self.accepted)
        body += self._state.tobytes() + self._io.tobytes()
        body += self._parts[beliefs.with_parts(self._state, self.cells)].tobytes()
        return _MAGIC + self._params_hash() + hashlib.sha256(body).digest() + body

    def restore(self, snapshot: bytes) -> None:
        """Go back to a `snapshot`. Raises ValueError, changing nothing, if cell file, tuning or size differ."""
        magic, params_hash, body_hash, body = snapshot[:8], snapshot[8:40], snapshot[40:72], snapshot[72:]
        if magic != _MAGIC and magic.startswith(_MAGIC[:6]):
            raise ValueError(
                f"a snapshot of another version ({magic.decode('ascii', 'replace')}, not {_MAGIC.decode()})"
            )
        fixed = _BODY.size + self._state.nbytes + self._io.nbytes
        if magic != _MAGIC or len(body) < fixed:
            raise ValueError(f"not a snapshot of {self.cells} cells by this version")
        if params_hash != self._params_hash():
            raise ValueError("a snapshot of another cell file or tuning")
        if body_hash != hashlib.sha256(body).digest():
            raise ValueError("a damaged snapshot")
        _, started, t_ns, code, accepted = _BODY.unpack_from(body)
        records, io, parts = np.split(
            np.frombuffer(body, self._state.dtype, offset=_BODY.size),
            [self._state.size, self._state.size + self._io.size],
        )
        state = records.reshape(self._state.shape)
        with_parts = beliefs.with_parts(state, self.cells)
        if parts.size != np.count_nonzero(with_parts) * self._form.parts:
            raise ValueError(f"not a snapshot of {self.cells} cells by this version")
        self._state[:], self._io[:] = state, io.reshape(self._io.shape)
        self._parts[with_parts] = parts.reshape(-1, self._form.parts)
        self.t_ns, self._code, self.accepted = (t_ns if started else None), code, accepted

    def _params_hash(self) -> bytes:
        string_of = self.wiring.string_of  # whose sensor has which offset
        wired = b"" if string_of is None else string_of.tobytes()
        return hashlib.sha256(repr(self._form).encode() + self._params.tobytes() + wired).digest()

    def _read(self, estimate: Estimate, code: int) -> None:
        estimate.t_ns = self.t_ns or 0
        if self.cells == 1:
            shown.show_cell(self._row, code, estimate)
        else:
            shown.show_pack(self._io, code, estimate)
