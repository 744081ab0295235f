"""The three estimators that a recording can be given to: ours, an EKF and coulomb counting, from one cell file."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bms_ukf.cell import CellParams
from bms_ukf.estimator import Estimator
from bms_ukf.records import Status
from bms_ukf.replay import ekf
from bms_ukf.replay.signals import Signals, Told
from bms_ukf.replay.start import from_first_voltage
from bms_ukf.tuning import Tuning

Columns = dict[str, NDArray[Any]]


def run(name: str, cell: CellParams, signals: Signals, told: Told | None, tuning: Tuning | None = None) -> Columns:
    """The estimate at every row by `name`, a key of `ESTIMATORS`: arrays by the names of `Estimate`'s fields.

    `told` None: the estimator finds its start by itself, in the first voltage.
    """
    return ESTIMATORS[name](cell, signals, told, tuning or Tuning())


def srukf(cell: CellParams, signals: Signals, told: Told | None, tuning: Tuning) -> Columns:
    """Ours. A recording's current is known over the whole of each interval, however long it is."""
    longest_s = float(signals.step_s.max(initial=0.0))
    changes: dict[str, float] = {"current_timeout_s": max(tuning.current_timeout_s, 1.001 * longest_s)}
    if told is not None:
        changes |= {"initial_soc": told.soc, "initial_soc_sigma": told.sigma}
    estimator = Estimator(cell, tuning=tuning.model_copy(update=changes))
    return estimator.replay(signals.t_ns, signals.current_A, signals.voltage_V, signals.temperature_degC)


def extended(cell: CellParams, signals: Signals, told: Told | None, tuning: Tuning) -> Columns:
    """The EKF of `ekf`."""
    return ekf.run(cell, signals, told or from_first_voltage(cell, signals, tuning), tuning)


def coulomb(cell: CellParams, signals: Signals, told: Told | None, tuning: Tuning) -> Columns:
    """The charge counted from the start; its sigma is what the current sensor's offset and gain may have added up to."""
    told = told or from_first_voltage(cell, signals, tuning)
    moved_As = np.cumsum(signals.current_A * signals.step_s * np.where(signals.current_A < 0, cell.cell.coulombic_efficiency, 1))
    offset_A = tuning.current_offset_sigma_A or cell.cell.capacity_Ah / 100
    elapsed_s = signals.time_s - signals.time_s[:1]
    charge_As = 3600 * cell.cell.capacity_Ah
    drift = np.hypot(offset_A * elapsed_s, tuning.current_gain_sigma * moved_As) / charge_As
    nothing = np.full(moved_As.size, np.nan)
    return {
        "soc": np.clip(told.soc - moved_As / charge_As, 0, 1),
        "soc_sigma": np.hypot(told.sigma, drift),
        "voltage_pred_V": nothing,
        "innovation_V": nothing,
        "nis": nothing,
        "status": np.full(moved_As.size, Status.OK, dtype=np.int64),
        "faults": np.zeros(moved_As.size, dtype=np.int64),
    }


ESTIMATORS: dict[str, Callable[[CellParams, Signals, Told | None, Tuning], Columns]] = {
    "srukf": srukf,
    "ekf": extended,
    "coulomb": coulomb,
}
