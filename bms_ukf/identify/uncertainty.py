"""One standard error of what a cell file says: of its tables and of its OCV.

From the curvature of the least squares, with the residuals counted as so many independent rows as `effective.rows`
finds in them; it holds what the tests tell apart, not what no model of this form can follow.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bms_ukf.identify import ocv
from bms_ukf.identify.dynamics import SPLINES, Model
from bms_ukf.identify.simulate import HYSTERESIS, KNEE, R0, R0_CHARGE, R1
from bms_ukf.identify.tables import SOC

Array = NDArray[np.float64]

MIDDLE = (SOC >= 0.1) & (SOC <= 0.9)


def tables(model: Model) -> dict[str, Array]:
    """Relative standard errors by key of the cell file, shape (temperatures, SOC); empty for a model not fitted."""
    if model.sigma is None:
        return {}
    unknowns = model.unknowns
    parts = unknowns.to_tables.reshape(*unknowns.shape, -1)
    sigma = np.sqrt(parts**2 @ model.sigma[: unknowns.n_tables] ** 2)
    channels = {"r0_ohm": R0}
    channels |= {"r0_charge_ohm": R0_CHARGE} if unknowns.structure.charge else {}
    channels |= {"r0_knee_A": KNEE} if unknowns.structure.knee else {}
    for j in range(unknowns.structure.pairs):
        channels |= {f"r{j + 1}_ohm": R1 + 2 * j, f"tau{j + 1}_s": R1 + 2 * j + 1}
    if unknowns.structure.hysteresis:
        channels["hysteresis_V"] = HYSTERESIS
    return {key: sigma[channel] for key, channel in channels.items()}


def ocv_V(model: Model, slow: ocv.Slow) -> Array:
    """Of the OCV rows, V, shape (temperatures, ocv.SOC): of the slow test and of the correction on it."""
    knots = [curve.temperature_degC for curve in slow.curves]
    measured = np.array([curve.sigma_V for curve in slow.curves])
    rows = model.unknowns.temperature_degC
    at_rows = np.array([np.interp(rows, knots, column) for column in measured.T]).T
    if model.sigma is None:
        return at_rows
    correction = model.sigma[model.unknowns.ocv].reshape(rows.size, -1)
    return np.asarray(np.hypot(at_rows, np.sqrt(correction**2 @ (SPLINES(ocv.SOC) ** 2).T)))
