"""The three estimators that a recording can be given to: ours, an EKF and coulomb counting, from one cell file."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bms_ukf import honesty
from bms_ukf.cell import CellParams
from bms_ukf.estimator import Estimator
from bms_ukf.offline import ekf
from bms_ukf.offline.signals import Signals, Told
from bms_ukf.offline.start import from_first_voltage
from bms_ukf.pack import Health
from bms_ukf.records import Status
from bms_ukf.tuning import Tuning

Columns = dict[str, NDArray[Any]]
Runner = Callable[[Signals, Told | None], Columns]


def prepare(name: str, cell: CellParams, tuning: Tuning | None = None) -> Runner:
    """The estimator of that name, a key of `ESTIMATORS`, ready to be run over any number of recordings.

    What it returns takes the signals and what is told of SoC before the first of them, None for nothing: then the start
    is found in the first voltage. It gives the estimate at every row, arrays by the names of `Estimate`'s fields.
    """
    return ESTIMATORS[name](cell, tuning or Tuning())


def srukf(cell: CellParams, tuning: Tuning) -> Runner:
    """Ours, with the capacity of the cell file."""

    def run(signals: Signals, told: Told | None) -> Columns:
        estimator = _estimator(cell, tuning, signals, told)
        return estimator.replay(signals.t_ns, signals.current_A, signals.voltage_V, signals.temperature_degC)

    return run


def followed(cell: CellParams, tuning: Tuning, signals: Signals, told: Told | None) -> tuple[Columns, Health]:
    """Ours as the daemon has it: with `soh`, the capacity that use has told of, once it has. And all that it told."""
    health = Health(_estimator(cell, tuning, signals, told))
    return health.replay(signals.t_ns, signals.current_A, signals.voltage_V, signals.temperature_degC), health


def _estimator(cell: CellParams, tuning: Tuning, signals: Signals, told: Told | None) -> Estimator:
    """A recording's current is known over the whole of each interval, however long it is."""
    longest_s = float(signals.step_s.max(initial=0.0))
    changes: dict[str, float] = {"current_timeout_s": max(tuning.current_timeout_s, 1.001 * longest_s)}
    if told is not None:
        changes |= {"initial_soc": told.soc, "initial_soc_sigma": told.sigma}
    return Estimator(cell, tuning=tuning.model_copy(update=changes))


def extended(cell: CellParams, tuning: Tuning) -> Runner:
    """The EKF of `ekf`."""
    model = ekf.model_of(cell, tuning)
    return lambda signals, told: ekf.run(model, signals, told or from_first_voltage(cell, signals, tuning))


def coulomb(cell: CellParams, tuning: Tuning) -> Runner:
    """The charge counted from the start; its sigma is what the sensor's offset and gain may have added up to."""
    limits = cell.cell
    charge_As = 3600 * limits.capacity_Ah
    spec = tuning.sensor_spec
    offset_A = spec.current_offset_sigma_A(limits.capacity_Ah)

    def run(signals: Signals, told: Told | None) -> Columns:
        start = told or from_first_voltage(cell, signals, tuning)
        efficiency = np.where(signals.current_A < 0, limits.coulombic_efficiency, 1.0)
        moved_As = np.cumsum(efficiency * signals.current_A * signals.step_s)
        elapsed_s = signals.time_s - signals.time_s[:1]
        drift = np.hypot(offset_A * elapsed_s, spec.current_gain_sigma * moved_As) / charge_As
        nothing = np.full(moved_As.size, np.nan)
        soc, sigma = np.clip(start.soc - moved_As / charge_As, 0, 1), np.hypot(start.sigma, drift)
        low, high = honesty.bounds(soc, sigma)
        return {
            "soc": soc,
            "soc_sigma": sigma,
            "soc_low": low,
            "soc_high": high,
            "voltage_pred_V": nothing,
            "innovation_V": nothing,
            "nis": nothing,
            "status": np.full(moved_As.size, Status.OK, dtype=np.int64),
            "faults": np.zeros(moved_As.size, dtype=np.int64),
        }

    return run


ESTIMATORS: dict[str, Callable[[CellParams, Tuning], Runner]] = {
    "srukf": srukf,
    "ekf": extended,
    "coulomb": coulomb,
}
