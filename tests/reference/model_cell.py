"""A cell for the tests to measure: what the estimator's model says it is, and nothing else."""

from __future__ import annotations

import math

from bms_ukf import CellParams


class ModelCell:
    """A cell at 25 degC that is just what its file says, at rest to begin with."""

    def __init__(self, cell: CellParams, soc: float) -> None:
        self._cell = cell
        self.soc = soc
        self._v_rc = [0.0, 0.0]

    def step(self, current_A: float, dt_s: float) -> float:
        """The terminal voltage after `dt_s` under a current, positive on discharge."""
        self.soc -= current_A * dt_s / 3600 / self._cell.cell.capacity_Ah
        at = {key: float(value) for key, value in self._cell.dynamics_at(self.soc, 25.0).items()}
        for k in (0, 1):
            decay = math.exp(-dt_s / at[f"tau{k + 1}_s"])
            self._v_rc[k] = decay * self._v_rc[k] + (1 - decay) * at[f"r{k + 1}_ohm"] * current_A
        drop_V = at["r0_ohm"] * at["r0_knee_A"] * math.asinh(current_A / at["r0_knee_A"])
        return float(self._cell.ocv_V(self.soc, 25.0)) - sum(self._v_rc) - drop_V
