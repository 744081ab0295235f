"""Where SoC may be, by the first voltage of a recording: for estimators that cannot find their start by themselves."""

from __future__ import annotations

import numpy as np

from bms_ukf.cell import CellParams
from bms_ukf.offline.signals import Signals, Told
from bms_ukf.tuning import Tuning

REST_S = 5.0  # a recording begins at rest if its current is small for so long
REST_RATE_PER_H = 0.05  # small: empties the cell in no less than 20 h, and shifts its voltage by millivolts
NO_REST_SIGMA = 0.3  # of SoC, where the first voltage is one under load


def begins_at_rest(cell: CellParams, signals: Signals) -> bool:
    early = signals.time_s - signals.time_s[0] <= REST_S
    return bool(np.all(np.abs(signals.current_A[early]) <= REST_RATE_PER_H * cell.cell.capacity_Ah))


def from_first_voltage(cell: CellParams, signals: Signals, tuning: Tuning) -> Told:
    """Mean and sigma of SoC given the first voltage, taken for an open-circuit voltage with the model's errors.

    Under load the ohmic drop is taken off and the sigma is NO_REST_SIGMA: the cell's past is not known.
    """
    first = int(np.argmax(np.isfinite(signals.voltage_V)))
    T, i = float(signals.temperature_degC[first]), float(signals.current_A[first])
    soc = np.linspace(0, 1, 1001)
    at, noise = cell.dynamics_at(soc, T), cell.noise
    r0 = at["r0_charge_ohm" if i < 0 else "r0_ohm"]
    drop_V = r0 * at["r0_knee_A"] * np.arcsinh(i / at["r0_knee_A"])
    correlated = (noise.v_rc1_sigma_V, noise.v_rc2_sigma_V, noise.v_rc3_sigma_V, noise.hysteresis_sigma_V)
    white_V2 = noise.voltage_sigma_V**2 + tuning.voltage_white_var_V2
    slow_V2 = sum(sigma**2 for sigma in correlated if sigma is not None)
    variance = white_V2 + slow_V2 + at.get("hysteresis_V", np.zeros_like(soc)) ** 2 / 3
    error = (signals.voltage_V[first] - cell.ocv_V(soc, T) + drop_V) ** 2 / variance
    likelihood = np.exp(-0.5 * (error - error.min())) / np.sqrt(variance)
    weight = likelihood / likelihood.sum()
    mean = float(weight @ soc)
    sigma = float(np.sqrt(weight @ (soc - mean) ** 2))
    return Told(mean, max(sigma, 1e-3) if begins_at_rest(cell, signals) else NO_REST_SIGMA)
