"""A cell for the tests to measure: what the estimator's model says it is, and nothing else."""

from __future__ import annotations

import math

from bms_ukf import CellParams


class ModelCell:
    """A cell that is just what its file says at one temperature, at rest to begin with."""

    def __init__(self, cell: CellParams, soc: float, temperature_degC: float = 25.0) -> None:
        self._cell, self._degC = cell, temperature_degC
        self.soc = soc
        self._v_rc = [0.0, 0.0]

    def step(self, current_A: float, dt_s: float) -> float:
        """The terminal voltage after `dt_s` under a current, positive on discharge."""
        self.soc -= current_A * dt_s / 3600 / self._cell.cell.capacity_Ah
        at = {key: float(value) for key, value in self._cell.dynamics_at(self.soc, self._degC).items()}
        for k in (0, 1):
            decay = math.exp(-dt_s / at[f"tau{k + 1}_s"])
            self._v_rc[k] = decay * self._v_rc[k] + (1 - decay) * at[f"r{k + 1}_ohm"] * current_A
        drop_V = at["r0_ohm"] * at["r0_knee_A"] * math.asinh(current_A / at["r0_knee_A"])
        return float(self._cell.ocv_V(self.soc, self._degC)) - sum(self._v_rc) - drop_V
