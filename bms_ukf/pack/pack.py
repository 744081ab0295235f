"""From what is known of the cells to what is known of the pack."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from bms_ukf.estimator import Estimator
from bms_ukf.kernel import entry, limit_rows
from bms_ukf.kernel.params import BITS, aligned
from bms_ukf.pack.limits import Limits
from bms_ukf.pack.record import PackEstimate
from bms_ukf.records import Estimate, Fault, Sample, Status

Array = NDArray[np.float64]
# What is not told without a cell that is known.
_NUMBERS = [
    name for name in PackEstimate.__slots__ if name.split("_")[0] not in {"t", "status", "faults", "power", "silent"}
]
_NUMBERS = [name for name in _NUMBERS if not name.startswith(("cell_", "current_"))]
IDLE_C = 0.005  # a mean current below this share of the capacity per hour is none: there is no time to empty


class Pack:
    """Follows an estimator; `update` is called once for every publication, at 1 to 10 Hz.

    It changes nothing in the estimator. For one cell it says of that cell what it says of a pack.
    """

    def __init__(self, estimator: Estimator, limits: Limits | None = None) -> None:
        self.estimator, self.limits = estimator, limits or Limits()
        cell, bits = estimator.cell.cell, BITS[estimator.precision]
        cells, wiring = estimator.cells, estimator.wiring
        self._rows = aligned(limit_rows.LIMIT_ROWS * cells, bits).reshape(limit_rows.LIMIT_ROWS, cells)
        self._conditions = a = aligned(limit_rows.CONDITIONS, bits)
        a[limit_rows.A_VOLTAGE_MIN], a[limit_rows.A_VOLTAGE_MAX] = self.limits.voltage_V or cell.voltage_limits_V
        a[limit_rows.A_CURRENT_MIN], a[limit_rows.A_CURRENT_MAX] = self.limits.current_A or cell.current_limits_A
        a[limit_rows.A_DISCHARGE_RATE] = self.limits.discharge_rate * cell.capacity_Ah
        a[limit_rows.A_CHARGE_RATE] = -self.limits.charge_rate * cell.capacity_Ah
        a[limit_rows.A_SECONDS] = self.limits.pulse_s
        params, state, _, _ = estimator._addresses
        self._addresses = params, state, self._rows.ctypes.data, a.ctypes.data, cells
        self._limits, self._energy = entry.limits(estimator._form, bits), entry.energy(estimator._form, bits)
        self._strings = wiring.members() or {0: np.arange(cells)}
        self._estimate = PackEstimate(current_bias_A=np.full(wiring.strings, math.nan))
        self._power_ns: int | None = None
        self._current_A = math.nan  # mean of late, of the pack

    def update(self, estimate: Estimate, sample: Sample) -> PackEstimate:
        """What is known after `estimate`, which is what `sample` gave; returns the same object every time.

        Before every input has been seen, and without a cell that is known, all but status, faults and power is NaN.
        """
        pack = self._estimate
        pack.t_ns, pack.status, pack.faults = estimate.t_ns, estimate.status, estimate.faults
        self._average(pack, sample)
        self._limits(*self._addresses)
        soc, sigma = np.atleast_1d(estimate.soc), np.atleast_1d(estimate.soc_sigma)
        status = self.estimator.cell_status
        known = (status == Status.OK) | (status == Status.DEGRADED)
        silent = ~known | (self.estimator.cell_faults & Fault.VOLTAGE_MISSING > 0)
        pack.silent = int(np.count_nonzero(silent))
        pack.silent_cell = int(np.argmax(silent)) if pack.silent else -1
        if estimate.status not in {Status.OK, Status.DEGRADED} or not known.any():
            self._forget(pack)
            return pack
        bias = np.atleast_1d(estimate.current_bias_A)
        for string, members in self._strings.items():
            pack.current_bias_A[string] = np.mean(bias[members])
        self._spread(pack, soc, known)
        self._reach(pack, soc, sigma)
        self._pulses(pack, known)
        return pack

    def _average(self, pack: PackEstimate, sample: Sample) -> None:
        """Recent power and current, of samples that have both; after a silence as long as their time constant, anew."""
        voltage, strings_A = np.atleast_1d(sample.voltage_V), sample.string_current_A
        watts, amperes = 0.0, 0.0
        for string, members in self._strings.items():
            own = voltage[members] if len(voltage) > 1 else voltage
            heard = np.isfinite(own)
            if not heard.any():
                return
            current = float(sample.current_A) if strings_A is None else float(strings_A[string])
            amperes += current
            watts += current * float(np.mean(own[heard])) * len(members)
        if not math.isfinite(watts):
            return
        tau_s = self.limits.power_tau_s
        since_s = math.inf if self._power_ns is None else (sample.t_ns - self._power_ns) * 1e-9
        kept = math.exp(-since_s / tau_s) if since_s <= tau_s else 0.0
        self._power_ns = sample.t_ns
        pack.power_W = float(watts + kept * (pack.power_W - watts) if kept else watts)
        self._current_A = float(amperes + kept * (self._current_A - amperes) if kept else amperes)

    def _forget(self, pack: PackEstimate) -> None:
        blank = PackEstimate()
        for name in _NUMBERS:
            setattr(pack, name, getattr(blank, name))
        pack.current_bias_A[:] = math.nan

    def _spread(self, pack: PackEstimate, soc: Array, known: NDArray[np.bool_]) -> None:
        pack.lowest, pack.highest = _least(soc), _least(-soc)
        pack.soc_min, pack.soc_max = float(soc[pack.lowest]), float(soc[pack.highest])
        apart = soc[known] - _mean(soc)
        pack.soc_spread = math.sqrt(float(apart @ apart) / len(apart))

    def _reach(self, pack: PackEstimate, soc: Array, sigma: Array) -> None:
        """Charge and energy to the first cell's end, and the times these take."""
        rows = self._rows
        pack.cell_empty_soc, pack.cell_full_soc = rows[limit_rows.L_EMPTY], rows[limit_rows.L_FULL]
        capacity_Ah = self.estimator.cell.cell.capacity_Ah * self.estimator.capacity_scale
        left, room = (soc - pack.cell_empty_soc) * capacity_Ah, (pack.cell_full_soc - soc) * capacity_Ah
        lefts, rooms, variance, empties, fulls = 0.0, 0.0, 0.0, [], []
        for members in self._strings.values():
            if not np.isfinite(left[members]).any():
                return self._forget(pack)
            empty, full = int(members[_least(left[members])]), int(members[_least(room[members])])
            lefts += max(float(left[empty]), 0.0)
            rooms += max(float(room[full]), 0.0)
            variance += float((sigma[empty] * capacity_Ah[empty]) ** 2)
            empties.append(empty)
            fulls.append(full)
        pack.empty_first = min(empties, key=lambda cell: float(left[cell]))
        pack.full_first = min(fulls, key=lambda cell: float(room[cell]))
        pack.remaining_Ah, pack.chargeable_Ah, pack.remaining_sigma_Ah = lefts, rooms, math.sqrt(variance)
        whole = lefts + rooms
        pack.soc = lefts / whole if whole > 0 else math.nan
        pack.soc_sigma = pack.remaining_sigma_Ah / whole if whole > 0 else math.nan
        strings, idle_A = len(self._strings), IDLE_C * self.estimator.cell.cell.capacity_Ah
        a, drain = self._conditions, self._current_A / strings
        pack.remaining_Wh = self._energy_of(lefts, drain if drain > idle_A else float(a[limit_rows.A_DISCHARGE_RATE]))
        pack.chargeable_Wh = self._energy_of(-rooms, drain if drain < -idle_A else float(a[limit_rows.A_CHARGE_RATE]))
        pack.time_to_empty_s = 3600 * pack.remaining_Wh / pack.power_W if drain > idle_A else math.nan
        pack.time_to_full_s = 3600 * pack.chargeable_Wh / -pack.power_W if drain < -idle_A else math.nan
        return None

    def _energy_of(self, charge_Ah: float, string_A: float) -> float:
        """Wh of the pack's charge moved, > 0, at a current of each string."""
        strings = len(self._strings)
        self._conditions[limit_rows.A_MOVED] = 3600 * charge_Ah / strings
        self._conditions[limit_rows.A_DRAIN] = string_A
        self._energy(*self._addresses)
        mean_V = self._rows[limit_rows.L_MEAN_V]
        string_V = sum(_mean(mean_V[members]) * len(members) for members in self._strings.values()) / strings
        return abs(charge_Ah) * string_V

    def _pulses(self, pack: PackEstimate, known: NDArray[np.bool_]) -> None:
        """The current of the cell that allows least, through every string: by resistance, not by limit, it divides."""
        rows, strings = self._rows, len(self._strings)
        for row, side, most in (
            (limit_rows.L_DISCHARGE, "discharge", float(self._conditions[limit_rows.A_CURRENT_MAX])),
            (limit_rows.L_CHARGE, "charge", float(self._conditions[limit_rows.A_CURRENT_MIN])),
        ):
            current, sigma = rows[row], rows[row + limit_rows.L_SIGMA]
            sigma[np.abs(current) >= abs(most)] = 0.0
            size = np.where(known, np.abs(current), math.inf)
            cell = int(np.argmin(size))
            string_A = float(current[cell])
            volts = rows[row + limit_rows.L_VOLTAGE] + rows[row + limit_rows.L_OHM] * (current - string_A)
            setattr(pack, f"cell_{side}_A", current)
            setattr(pack, f"cell_{side}_sigma_A", sigma)
            setattr(pack, f"{side}_A", strings * string_A)
            setattr(pack, f"{side}_sigma_A", strings * float(sigma[cell]))
            setattr(pack, f"{side}_W", string_A * _mean(volts) * len(volts))
            setattr(pack, f"{side}_cell", cell)


def _least(values: Array) -> int:
    """Index of the smallest that is not NaN; a sixth of the time of `np.nanargmin`."""
    return int(np.where(np.isnan(values), math.inf, values).argmin())


def _mean(values: Array) -> float:
    """Of those that are not NaN, at least one; a sixth of the time of `np.nanmean`."""
    known = values[~np.isnan(values)]
    return float(np.add.reduce(known)) / len(known)
