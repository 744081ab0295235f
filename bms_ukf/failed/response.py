"""What the cell file says a current does to the voltage from one block of time to the next: ohmic, RC pairs, charge.

The absolute voltage does not matter here, so neither SoC nor the start need be known well: SoC only chooses the row of
the tables.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from bms_ukf.cell import CellParams

SOC_BIN = 0.02  # of the tables that are kept: looking one up takes longer than all the rest
TEMPERATURE_BIN_K = 2.0


class _At(NamedTuple):
    """The cell near one SoC and temperature."""

    r0_ohm: float
    r0_charge_ohm: float
    knee_A: float
    pairs: tuple[tuple[float, float], ...]  # ohm and s of each RC pair
    slope_V: float  # of the OCV over SoC


class Response:
    """The polarisation of one cell under the currents that it is given, positive on discharge."""

    def __init__(self, cell: CellParams) -> None:
        self._cell, self._charge_As = cell, 3600.0 * cell.cell.capacity_Ah
        self._kept: dict[tuple[int, int], _At] = {}
        self._rc_V = [0.0] * cell.dynamics.n_rc
        self._current_A = math.nan

    def begin(self, current_A: float) -> None:
        """A current whose past is not known."""
        self._rc_V = [0.0] * len(self._rc_V)
        self._current_A = current_A

    def fall_V(self, current_A: float, dt_s: float, soc: float, temperature_degC: float) -> tuple[float, float]:
        """By how much the voltage falls to the end of a block of `dt_s` that has this mean current, and on r0 alone."""
        at = self._near(soc, temperature_degC)
        if math.isnan(self._current_A):
            self._current_A = current_A
        ohmic_V = _drop_V(at, current_A) - _drop_V(at, self._current_A)
        fall_V = ohmic_V + at.slope_V * current_A * dt_s / self._charge_As
        for j, (ohm, tau_s) in enumerate(at.pairs):
            step_V = -math.expm1(-dt_s / tau_s) * (ohm * current_A - self._rc_V[j])
            self._rc_V[j] += step_V
            fall_V += step_V
        self._current_A = current_A
        return fall_V, ohmic_V

    def _near(self, soc: float, temperature_degC: float) -> _At:
        place = round(soc / SOC_BIN), round(temperature_degC / TEMPERATURE_BIN_K)
        found = self._kept.get(place)
        if found is None:
            found = self._kept[place] = self._look_up(place[0] * SOC_BIN, place[1] * TEMPERATURE_BIN_K)
        return found

    def _look_up(self, soc: float, temperature_degC: float) -> _At:
        values = {key: float(value) for key, value in self._cell.dynamics_at(soc, temperature_degC).items()}
        low, high = max(soc - SOC_BIN, 0.0), min(soc + SOC_BIN, 1.0)
        ocv_V = self._cell.ocv_V([low, high], temperature_degC)
        pairs = tuple((values[f"r{j}_ohm"], values[f"tau{j}_s"]) for j in range(1, len(self._rc_V) + 1))
        slope_V = float(ocv_V[1] - ocv_V[0]) / (high - low)
        return _At(values["r0_ohm"], values["r0_charge_ohm"], values["r0_knee_A"], pairs, slope_V)


def _drop_V(at: _At, current_A: float) -> float:
    ohm = at.r0_charge_ohm if current_A < 0 else at.r0_ohm
    return ohm * at.knee_A * math.asinh(current_A / at.knee_A)
