"""One cell's kernel buffers with names: what the kernel tests look at and set without going through `Estimator`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bms_ukf import CellParams, Fault, Status, Tuning
from bms_ukf.kernel import entry, layout
from bms_ukf.kernel.params import aligned, params
from bms_ukf.kernel.step import FAULT_MASK, STATUS_SHIFT

Array = NDArray[np.float64]
N = entry.N
ROOT = slice(layout.root_offset(N), layout.held_offset(N))


class Record:
    """A record that has seen nothing yet, with its `params`; `tick` is the compiled step."""

    def __init__(self, cell: CellParams, tuning: Tuning | None = None) -> None:
        self.params = params(cell, tuning or Tuning())
        self.state = aligned(entry.RECORD_SIZE)
        self["gap_s"] = 0.0

    def tick(
        self, dt: float, current: float = math.nan, voltage: float = math.nan, temperature: float = math.nan
    ) -> tuple[Status, Fault]:
        self["input_voltage"], self["input_temperature"] = voltage, temperature
        code = entry.tick(self.params.ctypes.data, self.state.ctypes.data, 1, dt, current)
        return Status(code >> STATUS_SHIFT), Fault(code & FAULT_MASK)

    def __getitem__(self, slot: str) -> float:
        """A held value by the name of its slot in `layout`, `rejected_s` for `H_REJECTED_S`."""
        return float(self.state[self._index(slot)])

    def __setitem__(self, slot: str, value: float) -> None:
        self.state[self._index(slot)] = value

    def _index(self, slot: str) -> int:
        return layout.held_offset(N) + int(getattr(layout, f"H_{slot.upper()}"))

    @property
    def x(self) -> Array:
        return self.state[:N].copy()

    @property
    def root(self) -> Array:
        """sqrt_P as a full matrix; what is packed is its lower triangle by rows."""
        full = np.zeros((N, N))
        full[np.tril_indices(N)] = self.state[ROOT]
        return full

    @property
    def P(self) -> Array:
        return self.root @ self.root.T

    @property
    def belief(self) -> bytes:
        """x and sqrt_P, bit for bit."""
        return self.state[: ROOT.stop].tobytes()

    def ocv(self, soc: float, temperature: float) -> float:
        return entry.ocv(self.params.ctypes.data, soc, temperature)

    def dynamics(self, soc: float, temperature: float) -> tuple[float, ...]:
        """r0, r1, tau1, r2, tau2, knee."""
        return tuple(entry.dynamics(self.params.ctypes.data, soc, temperature, channel) for channel in range(6))

    def drop(self, soc: float, temperature: float, current: float) -> float:
        """What the cell loses to its current at once, V."""
        r0, *_, knee = self.dynamics(soc, temperature)
        return r0 * knee * math.asinh(current / knee)
