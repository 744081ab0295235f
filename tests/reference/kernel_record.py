"""One cell's kernel buffers with names: what the kernel tests look at and set without going through `Estimator`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bms_ukf import CellParams, Fault, Status, Tuning
from bms_ukf.kernel import entry, layout
from bms_ukf.kernel.params import aligned, form_of, params, state_size
from bms_ukf.kernel.step import FAULT_MASK, STATUS_SHIFT

Array = NDArray[np.floating]


class Record:
    """A record that has seen nothing yet, with its `params`; `tick` is the compiled step."""

    def __init__(self, cell: CellParams, tuning: Tuning | None = None, bits: int = 64) -> None:
        tuning = tuning or Tuning()
        self.form = form_of(cell, tuning, 1, bits)
        self.n = self.form.n
        self.params = params(cell, tuning, bits)
        self.state = aligned(state_size(self.form, 1), bits)
        self.io = aligned(layout.IO_ROWS, bits)
        self.addresses = self.params.ctypes.data, self.state.ctypes.data, self.io.ctypes.data, 1
        self._tick = entry.tick(self.form, bits)

    def tick(
        self, dt: float, current: float = math.nan, voltage: float = math.nan, temperature: float = math.nan
    ) -> tuple[Status, Fault]:
        self.io[layout.IN_VOLTAGE], self.io[layout.IN_TEMPERATURE] = voltage, temperature
        code = self._tick(*self.addresses, dt, current)
        return Status(code >> STATUS_SHIFT), Fault(code & FAULT_MASK)

    def __getitem__(self, slot: str) -> float:
        """By the name of its slot in `layout`: `rejected_s` for what is held in H_REJECTED_S, `nis` for OUT_NIS."""
        if hasattr(layout, f"H_{slot.upper()}"):
            return float(self.state[getattr(layout, f"H_{slot.upper()}")])
        return float(self.io[getattr(layout, f"OUT_{slot.upper()}")])

    def __setitem__(self, slot: str, value: float) -> None:
        self.state[getattr(layout, f"H_{slot.upper()}")] = value

    @property
    def x(self) -> Array:
        return self.state[self.form.x : self.form.root].copy()

    @x.setter
    def x(self, values: Array) -> None:
        self.state[self.form.x : self.form.root] = values

    @property
    def root(self) -> Array:
        """sqrt_P as a full matrix; what is packed is its lower triangle by rows."""
        full = np.zeros((self.n, self.n))
        full[np.tril_indices(self.n)] = self.state[self.form.root : self.form.carry]
        return full

    @root.setter
    def root(self, full: Array) -> None:
        self.state[self.form.root : self.form.carry] = np.asarray(full)[np.tril_indices(self.n)]

    @property
    def P(self) -> Array:
        return self.root @ self.root.T

    @property
    def belief(self) -> bytes:
        """x and sqrt_P, bit for bit."""
        return self.state[self.form.x : self.form.cache].tobytes()

    def ocv(self, soc: float, temperature: float) -> float:
        return entry.ocv()(self.params.ctypes.data, soc, temperature)

    def dynamics(self, soc: float, temperature: float) -> dict[str, float]:
        """By the names of `CellParams.dynamics_at`."""
        names = ["r0_ohm", "r0_charge_ohm", "r0_knee_A", "error_scale"]
        names += [name for j in range(1, self.form.n_rc + 1) for name in (f"r{j}_ohm", f"tau{j}_s")]
        names += ["hysteresis_V"] * self.form.hysteresis
        at = entry.dynamics()
        channels = self.form.channels
        return {k: at(self.params.ctypes.data, soc, temperature, c, channels) for c, k in enumerate(names)}

    def drop(self, soc: float, temperature: float, current: float) -> float:
        """What the cell loses to its current at once, V."""
        at = self.dynamics(soc, temperature)
        r0 = at["r0_ohm"] if current >= 0 else at["r0_charge_ohm"]
        return r0 * at["r0_knee_A"] * math.asinh(current / at["r0_knee_A"])
